"""Three hubs in three network namespaces, joined by veth: a cut, a dead gateway, a one-way link, heals.

The namespaces are made here, named after this process, and taken away again.
"""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("zenoh", reason="the extra `backbone` is not installed")

from sim.rigs.bridged_processes import BridgedSegments, write_area

LIMIT_S = 120.0  # for what takes seconds on a machine of its own
PORT = 7447
NOBODY = "02:00:00:00:00:99"  # a link-layer address that nobody has


def name(number: int) -> str:
    return f"headland{os.getpid()}-{number}"


def ip(*words: str) -> bool:
    done = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    return done.returncode == 0


def build() -> bool:
    """Segment 1 in the middle, a veth pair to each of the others. False where that is not allowed."""
    if shutil.which("ip") is None or not all(ip("netns", "add", name(k)) for k in (1, 2, 3)):
        return False
    made = [ip("-n", name(k), "link", "set", "lo", "up") for k in (1, 2, 3)]
    for k in (2, 3):
        made += [
            ip("-n", name(1), "link", "add", f"to{k}", "type", "veth", "peer", "name", "uplink",
               "netns", name(k)),
            ip("-n", name(1), "addr", "add", f"10.77.{k}.1/24", "dev", f"to{k}"),
            ip("-n", name(k), "addr", "add", f"10.77.{k}.2/24", "dev", "uplink"),
            ip("-n", name(1), "link", "set", f"to{k}", "up"),
            ip("-n", name(k), "link", "set", "uplink", "up"),
        ]  # fmt: skip
    return all(made)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BridgedSegments]:
    folder: Path = tmp_path_factory.mktemp("areas")
    made = BridgedSegments(3, prefix=lambda k: ["ip", "netns", "exec", name(k)])
    try:
        if not build():
            pytest.skip("network namespaces cannot be made here: this needs root and iproute2")
        made.start_hosts()
        listen = [word for k in (2, 3) for word in ("--listen", f"tcp/10.77.{k}.1:{PORT}")]
        made.start_gateway(1, *listen, area=write_area(folder, 1, 3))
        for k in (2, 3, 3):
            made.start_gateway(
                k, "--zenoh", f"tcp/10.77.{k}.1:{PORT}", area=write_area(folder, k, 3)
            )
        made.wait_reached(2, LIMIT_S)
        yield made
    finally:
        made.close()
        for k in (1, 2, 3):
            ip("netns", "del", name(k))


@pytest.fixture
def segments(built: BridgedSegments) -> Iterator[BridgedSegments]:
    """Whatever a test has cut is mended for the next one."""
    yield built
    ip("-n", name(1), "link", "set", "to2", "up")
    ip("-n", name(1), "neigh", "del", "10.77.2.2", "dev", "to2")


def arm(segments: BridgedSegments) -> None:
    for host in segments.hosts.values():
        host.ask({"do": "arm"})


def alone(segments: BridgedSegments, number: int) -> bool:
    return all(segments.state(number)["alone"])


def stopped(segments: BridgedSegments, number: int) -> int:
    return int(segments.state(number)["stopped"])


@pytest.mark.slow
def test_a_cut_backbone_and_its_heal(segments: BridgedSegments) -> None:
    assert ip("-n", name(1), "link", "set", "to2", "down")
    segments.wait("segment 2 knows that it is alone", lambda: alone(segments, 2), LIMIT_S)
    segments.wait("1 reaches only 3", lambda: segments.state(1)["reached"] == 1, LIMIT_S)
    assert not alone(segments, 3)
    segments.hosts[1].ask({"do": "press", "slot": 0})
    segments.wait("segment 3 stands", lambda: stopped(segments, 3) == 2, LIMIT_S)
    assert stopped(segments, 2) == 0, "it cannot have heard"
    assert ip("-n", name(1), "link", "set", "to2", "up")
    segments.wait("segment 2 stands after the heal", lambda: stopped(segments, 2) == 2, LIMIT_S)
    segments.wait_reached(2, LIMIT_S)
    arm(segments)


@pytest.mark.slow
def test_a_link_that_carries_one_way(segments: BridgedSegments) -> None:
    """From 2 to 1 it carries; what 1 sends to 2 goes to nobody."""
    wrong = ("10.77.2.2", "lladdr", NOBODY, "dev", "to2", "nud", "permanent")
    assert ip("-n", name(1), "neigh", "replace", *wrong)
    segments.wait("segment 2 knows that it is alone", lambda: alone(segments, 2), LIMIT_S)
    segments.wait("1 reaches only 3", lambda: segments.state(1)["reached"] == 1, LIMIT_S)
    assert ip("-n", name(1), "neigh", "del", "10.77.2.2", "dev", "to2")
    segments.wait_reached(2, LIMIT_S)


@pytest.mark.slow
def test_a_killed_gateway(segments: BridgedSegments) -> None:
    segments.gateways[3][0].process.kill()
    segments.press_and_wait(2, limit_for_s=LIMIT_S)
    arm(segments)
    segments.wait_reached(2, LIMIT_S)
