"""One bus, robots on either side of a link between two network namespaces: it is cut, and healed.

Real robot processes; their world, with bodies, is in this process and reaches them by links of its own:
what is cut is the bus and nothing else. The namespaces are named after this process and taken away.
"""

import asyncio
import contextlib
import json
import os
import shutil
import subprocess
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import Iterator
from math import dist, hypot
from pathlib import Path

import pytest

from agent.interface.config import beat_of
from sim.record.remote_body import BodyServer
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tests.tools.launching import ENVIRONMENT, ROOT, WAIT_S
from tests.tools.watch import STANDING_M_S, Watch
from tools.run.launch_setup import robot_document, setting_of

SCENARIO, ROBOTS = "yard", 3
HUB_SIDE, FAR_SIDE = (0,), (1, 2)  # robots in the namespace of the hub, and in the other
HUB, FAR = "hub", "far"
BUS_NET, NETS = "10.79.0", {HUB: "10.79.1", FAR: "10.79.2"}  # of the bus; of the bodies
BUS_PORT = 29536
STOOD_S, MOVED_M = 2.0, 0.05
# A silence is noticed, and the body brakes: a second at full speed; more on a busy machine.
CUT_S = beat_of(ROBOTS).silence_for_us / 1e6 + 3.0


def space(side: str) -> str:
    return f"headland{os.getpid()}-{side}"


def ip(*words: str) -> bool:
    done = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    return done.returncode == 0


def link(number: int, near: tuple[str, ...], net: str, side: str) -> bool:
    """A veth pair from `near` (words of ip that name a namespace, none: ours) to a namespace."""
    here, there = f"hl{os.getpid() % 100000}{number}", f"bus{number}"
    return all((
        ip(*near, "link", "add", here, "type", "veth", "peer", "name", there, "netns", space(side)),
        ip(*near, "addr", "add", f"{net}.1/24", "dev", here),
        ip("-n", space(side), "addr", "add", f"{net}.2/24", "dev", there),
        ip(*near, "link", "set", here, "up"),
        ip("-n", space(side), "link", "set", there, "up"),
        ip("-n", space(side), "link", "set", "lo", "up"),
    ))  # fmt: skip


def carry(up: bool) -> None:
    assert ip("-n", space(FAR), "link", "set", "bus0", "up" if up else "down")


@pytest.fixture
def spaces() -> Iterator[None]:
    try:
        if shutil.which("ip") is None or not all(ip("netns", "add", space(s)) for s in (HUB, FAR)):
            pytest.skip("network namespaces cannot be made here: this needs root and iproute2")
        made = [
            link(1, (), NETS[HUB], HUB),
            link(2, (), NETS[FAR], FAR),
            link(0, ("-n", space(HUB)), BUS_NET, FAR),
        ]
        if not all(made):
            pytest.skip("veth links between namespaces cannot be made here")
        yield
    finally:
        for side in (HUB, FAR):
            ip("netns", "del", space(side))


class Yard(Watch):
    """With its world, which knows the truth."""

    def __init__(self) -> None:
        super().__init__(ROBOTS)
        self.world = FieldSetup(load(SCENARIO).changed(ROBOTS, 1, None)).world()

    @property
    def places(self) -> dict[int, tuple[float, float]]:
        """True ones."""
        seen = {slot: body.sense(self.world.now_us) for slot, body in self.world.robots.items()}
        return {slot: (here.x_m, here.y_m) for slot, here in seen.items()}

    @property
    def speeds_m_s(self) -> dict[int, float]:
        seen = {slot: body.sense(self.world.now_us) for slot, body in self.world.robots.items()}
        return {slot: hypot(here.vx_m_s, here.vy_m_s) for slot, here in seen.items()}

    def stand(self) -> bool:
        return all(v < STANDING_M_S for v in self.speeds_m_s.values())

    def held(self, slot: int, cause: str) -> bool:
        return cause in self.now[slot]["holds"]

    def __str__(self) -> str:
        return f"{self.now}, {self.speeds_m_s}"


async def enter(side: str, *words: str) -> Process:
    return await asyncio.create_subprocess_exec(
        "ip", "netns", "exec", space(side), sys.executable, "-m", *words,
        cwd=ROOT, stdin=PIPE, stdout=PIPE if words[0] == "tools.cli.headland" else DEVNULL,
        stderr=DEVNULL, env=ENVIRONMENT,
    )  # fmt: skip


async def robot(folder: Path, slot: int, bodies: Path) -> Process:
    side = HUB if slot in HUB_SIDE else FAR
    process = await enter(side, "tools.run.robot")
    host = "127.0.0.1" if side == HUB else f"{BUS_NET}.1"
    bus = {
        "interface": "socketcand", "channel": "can0",
        "options": {"host": host, "port": BUS_PORT},
    }  # fmt: skip
    setting = setting_of(SCENARIO, ROBOTS, 1, None)
    # One computer: files are the same in every namespace.
    order = {"robot": robot_document(setting, slot, bus, bodies, folder), "first_boot": True}
    assert process.stdin is not None
    process.stdin.write(json.dumps(order).encode() + b"\n")
    return process


async def cut_and_heal(yard: Yard) -> None:
    await yard.until("all work", yard.work)
    await yard.until("somebody drives", lambda: max(yard.speeds_m_s.values()) > 1.0)
    carry(False)
    await yard.until("all stand", yard.stand, CUT_S)
    before = yard.places
    far_off = lambda: all(yard.held(slot, "BUS_OFF") for slot in FAR_SIDE)  # noqa: E731
    await yard.until("the far side knows that it is off the bus", far_off)
    assert yard.held(0, "MEMBER_SILENT"), yard.now
    await yard.for_s(STOOD_S)
    assert max(dist(before[s], place) for s, place in yard.places.items()) < MOVED_M
    carry(True)
    await yard.until("all work after the heal", yard.work)
    await yard.until("somebody drives again", lambda: max(yard.speeds_m_s.values()) > 1.0)
    assert yard.world.contacts == []


@pytest.mark.slow
@pytest.mark.usefixtures("spaces")
def test_a_bus_is_cut_in_two_and_healed(tmp_path: Path) -> None:
    async def story() -> None:
        yard, loop = Yard(), asyncio.get_running_loop()
        zero_at_us = round(loop.time() * 1e6)
        bodies = BodyServer(yard.world, zero_at_us)
        path = await bodies.start()
        bodies.relay.keep = yard.told
        stepping = asyncio.create_task(bodies.run())
        words = ("hub", "--host", "0.0.0.0", "--port", str(BUS_PORT), "--json")
        processes = [await enter(HUB, "tools.cli.headland", *words)]
        try:
            assert processes[0].stdout is not None
            async with asyncio.timeout(WAIT_S):
                assert await processes[0].stdout.readline()
            for slot in range(ROBOTS):
                processes.append(await robot(tmp_path, slot, path))
            await cut_and_heal(yard)  # long and short of it: once known, twice the same
            await cut_and_heal(yard)
        finally:
            stepping.cancel()
            bodies.close()
            for process in processes:
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
                await process.wait()

    asyncio.run(story())
