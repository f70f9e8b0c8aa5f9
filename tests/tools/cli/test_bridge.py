"""`headland bridge` between real processes on loopback: stops, work at the border, a killed gateway."""

from collections.abc import Iterator
from pathlib import Path
from socket import socket

import pytest

pytest.importorskip("zenoh", reason="the extra `backbone` is not installed")

from sim.rigs.bridged_processes import BridgedSegments, write_area

LIMIT_S = 120.0  # for what takes seconds on a machine of its own


@pytest.fixture(scope="module")
def segments(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BridgedSegments]:
    """Two segments; the second has two gateways."""
    folder: Path = tmp_path_factory.mktemp("areas")
    with socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    made = BridgedSegments(2)
    try:
        made.start_hosts()
        made.start_gateway(1, "--listen", endpoint, area=write_area(folder, 1, 2))
        for _ in range(2):
            made.start_gateway(2, "--zenoh", endpoint, area=write_area(folder, 2, 2))
        made.wait_reached(1, LIMIT_S)
        yield made
    finally:
        made.close()


@pytest.mark.slow
def test_work_at_the_border_is_known_on_the_other_side(segments: BridgedSegments) -> None:
    host, lent = segments.hosts[1], 0  # of segment 1, lent to 2

    def done_here() -> bool:
        host.ask({"do": "finish", "slot": 0, "section": lent})
        return bool(segments.state(1)["sections"].get(str(lent)) == "DONE")

    host.ask({"do": "claim", "slot": 0, "section": lent})
    segments.wait("the section is done", done_here, LIMIT_S)
    segments.wait(
        "the neighbour knows it",
        lambda: "DONE" in segments.state(2)["sections"].values(), LIMIT_S,
    )  # fmt: skip


def test_a_stop_passes_in_both_directions(segments: BridgedSegments) -> None:
    for number in (1, 2):
        segments.press_and_wait(number, limit_for_s=LIMIT_S)
    for host in segments.hosts.values():
        host.ask({"do": "arm"})


def test_gateways_are_back_when_their_bus_is(segments: BridgedSegments) -> None:
    segments.restart_host(2)
    segments.wait_reached(1, LIMIT_S)
    segments.press_and_wait(1, limit_for_s=LIMIT_S)
    for host in segments.hosts.values():
        host.ask({"do": "arm"})


@pytest.mark.slow
def test_a_killed_gateway_is_replaced(segments: BridgedSegments) -> None:
    leader = segments.gateways[2][0]
    leader.process.kill()
    segments.press_and_wait(1, limit_for_s=LIMIT_S)  # whichever it was, a stop passes at once
    for host in segments.hosts.values():
        host.ask({"do": "arm"})
    segments.wait_reached(1, LIMIT_S)
