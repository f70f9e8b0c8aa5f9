"""The door to Foxglove: what an independent viewer of everything is sent, what that costs, and its stop.

The viewer is the package `websockets` and the description of the protocol
(https://github.com/foxglove/ws-protocol); nothing of the SDK that serves is in it.

A stop is judged by the beat in which the last robot says that it is latched, and by the bodies.
"""

import asyncio
import json
import os
import struct
from asyncio.subprocess import Process
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from sim.scenarios.scenario import load
from sim.world.drive_trains import Chassis
from tools.bench.figure import Figure
from tools.bench.standing_bodies import Bodies, BodiesPress, standing, start_watched
from tools.bench.stopped_beats import BUS_BOUND_MS, Beats
from tools.bench.systems import ADDED_MS, CounterpartAbsent
from tools.bench.vda5050.counterparts import WAIT_S, drain, end, release, said, start
from tools.common.bus_address import CHANNEL
from tools.common.bus_attach import attach
from tools.operate.operator_device import Operator

ROBOTS, ROBOTS_QUICK = 20, 2
LOOK_S, LOOK_QUICK_S = 30.0, 5.0
PRESSES, PRESSES_QUICK = 10, 1
RELEASES_MAX, RELEASED_S = 5, 10.0  # a release is said again to robots that are stopped after this
RATE_MIN_HZ, CPU_MAX = 20.0, 0.05
SETTLED_SHARE = 0.95  # of the rate, from which on a fleet counts as started
ROUNDING_HZ = 0.05  # of a count over the time that was looked
MESSAGE = struct.Struct("<BIQ")  # opcode, subscription, nanoseconds
CALL = struct.Struct("<BIII")  # opcode, service, call, length of the encoding's name
PROTOCOL = "foxglove.sdk.v1"
STOP = "/emergency_stop"
SCENARIO, SCENARIO_QUICK = (
    "oxted",
    "small",
)  # twenty robots end the small field before the last press
AGAINST = "websockets and the published protocol"


class Watched(NamedTuple):
    """What a viewer of everything was sent, and the processes' CPU meanwhile."""

    transforms_hz: float  # mean of all robots
    poses_hz: float  # the same of the places on the bus
    messages: int
    cpu: float  # of the map, as a share of the robots'
    idle_cpu: float  # the same without a viewer
    door_ms: list[float]  # from the call of the service to the last robot
    bus_ms: list[float]
    door_bodies: list[BodiesPress]
    bus_bodies: list[BodiesPress]


class Viewer:
    """Subscribes to every topic, counts what comes, and calls services."""

    def __init__(self, connection: Any) -> None:
        self.connection = connection
        self.topics: dict[int, str] = {}
        self.services: dict[str, int] = {}
        self.counts: Counter[str] = Counter()
        self.transforms = 0

    async def read(self) -> None:
        """Until the connection ends."""
        async for data in self.connection:
            if isinstance(data, str):
                await self._told(json.loads(data))
            elif data[0] == 1:
                _, number, _ = MESSAGE.unpack_from(data)
                topic = self.topics[number]
                self.counts[topic] += 1
                if topic == "/tf":
                    self.transforms += parts_of(data[MESSAGE.size :])

    async def _told(self, told: dict[str, Any]) -> None:
        if told["op"] == "advertiseServices":
            self.services |= {service["name"]: service["id"] for service in told["services"]}
        if told["op"] == "advertise":
            self.topics |= {channel["id"]: channel["topic"] for channel in told["channels"]}
            wanted = [{"id": c["id"], "channelId": c["id"]} for c in told["channels"]]
            await self.connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    async def call(self, service: str, asked: dict[str, Any]) -> None:
        """Ask; the answer is not waited for."""
        head = CALL.pack(2, self.services[service], 1, len(b"json")) + b"json"
        await self.connection.send(head + json.dumps(asked).encode())


def figures(quick: bool) -> Iterator[Figure]:
    """Rate, CPU and stops. Raises CounterpartAbsent."""
    for package in ("foxglove", "websockets"):
        if find_spec(package) is None:
            raise CounterpartAbsent(f"{package} is not installed: pip install 'headland[foxglove]'")
    robots, look_s = (ROBOTS_QUICK, LOOK_QUICK_S) if quick else (ROBOTS, LOOK_S)
    scenario, presses = (SCENARIO_QUICK, PRESSES_QUICK) if quick else (SCENARIO, PRESSES)
    with TemporaryDirectory(prefix="headland-foxglove-") as folder:
        told = asyncio.run(trial(Path(folder), scenario, robots, look_s, presses))
    scope = (
        f"{robots} robots as processes, `headland map --foxglove` subscribed to everything for "
        f"{look_s:.0f} s, {told.messages} messages; {told.poses_hz:.2f} places a second on the bus"
    )
    rate_hz = told.transforms_hz
    yield Figure(
        "Foxglove: transforms of each robot", rate_hz, "Hz", f">= {RATE_MIN_HZ:g}",
        rate_hz >= RATE_MIN_HZ - ROUNDING_HZ, AGAINST, scope,
    )  # fmt: skip
    added = told.cpu - told.idle_cpu
    yield Figure(
        "Foxglove: CPU that a viewer of everything adds to the map", added, "of the robots' CPU",
        f"<= {CPU_MAX:g}", None if quick else added <= CPU_MAX, "",
        f"{told.cpu:.3f} with it, {told.idle_cpu:.3f} without; {scope}",
    )  # fmt: skip
    limit_ms = BUS_BOUND_MS + ADDED_MS
    for side, times in (("by the service", told.door_ms), ("on the bus", told.bus_ms)):
        yield Figure(
            f"Foxglove: stop {side}, last robot latched", max(times), "ms", f"<= {limit_ms:g}",
            max(times) <= limit_ms, "",
            f"longest of {len(times)}, to the beat that says it; bound of the bus "
            f"{BUS_BOUND_MS:g} ms; {robots} robots",
        )  # fmt: skip
    braking_ms = 1000 * load(scenario).fleet.speed_m_s / Chassis().braking_m_s2
    sides = [("by the service", told.door_bodies), ("on the bus", told.bus_bodies)]
    yield from standing("Foxglove", sides, robots, braking_ms, AGAINST)


async def trial(folder: Path, scenario: str, robots: int, look_s: float, presses: int) -> Watched:
    """A launch, a map beside it, and a viewer."""
    from websockets.asyncio.client import connect
    from websockets.typing import Subprotocol

    launch = await start_watched(folder, scenario, robots)
    shown: Process | None = None
    beats, reading = Beats(robots), []
    bodies = Bodies(load(scenario).fleet.speed_m_s)
    try:
        port = await said(launch, r"socketcand \S+:(\d+)")
        pids = [int(await said(launch, rf"robot {k}: process (\d+)")) for k in range(robots)]
        reading.append(asyncio.create_task(bodies.read(launch)))
        bus = attach("socketcand", CHANNEL, 250_000, "127.0.0.1", int(port))
        bus.subscribe(beats.hear)
        operator = Operator(bus, None)
        await operator.device.held()
        shown = await start(folder, "map", "--page-port", "0", "--foxglove", "0", "--json")
        told = json.loads(await said(shown, r"(\{.*\})"))
        reading.append(asyncio.create_task(drain(shown)))
        async with asyncio.timeout(WAIT_S):
            while len(beats.stopped) < robots:
                await asyncio.sleep(0.1)
        await beats.until(False)
        await bodies.drive()  # all have planned at once by then, and beat rarely meanwhile
        await beats.settled(SETTLED_SHARE * RATE_MIN_HZ)  # if they never do, the figure says it
        async with connect(
            told["foxglove"], subprotocols=[Subprotocol(PROTOCOL)], max_size=None, close_timeout=0.3
        ) as connection:
            viewer = Viewer(connection)
            reading.append(asyncio.create_task(viewer.read()))
            async with asyncio.timeout(WAIT_S):
                while not (viewer.counts["/tf"] and STOP in viewer.services):
                    await asyncio.sleep(0.1)
            watched = await _watch(viewer, beats, shown.pid, pids, look_s)
            ask = {"key": told["map"].partition("#")[2]}
            times: tuple[list[float], list[float]] = ([], [])
            stood: tuple[list[BodiesPress], list[BodiesPress]] = ([], [])
            loop = asyncio.get_running_loop()
            for _ in range(presses):
                for took, by_world in zip(times, stood, strict=True):
                    driving = await bodies.drive()
                    beats.all_at_s, begun_at_s = None, loop.time()
                    if took is times[0]:
                        await viewer.call(STOP, ask)
                        took.append(await beats.since(begun_at_s))
                    else:
                        took.append(await beats.pressed(operator))
                    by_world.append(await bodies.stood(begun_at_s, driving))
                    await _released(folder, port, beats)
        alone = await _watch(Viewer(None), beats, shown.pid, pids, look_s)
        bus.close()
    finally:
        for task in reading:
            task.cancel()
        await end(shown)
        await end(launch)
    return watched._replace(
        idle_cpu=alone.cpu, door_ms=times[0], bus_ms=times[1], door_bodies=stood[0],
        bus_bodies=stood[1],
    )  # fmt: skip


async def _watch(
    viewer: Viewer, beats: Beats, shown: int, pids: list[int], look_s: float
) -> Watched:
    loop = asyncio.get_running_loop()
    viewer.counts.clear()
    viewer.transforms = 0
    begun_s, placed = loop.time(), beats.placed
    map_s, robots_s = _cpu_s(shown), sum(map(_cpu_s, pids))
    await asyncio.sleep(look_s)
    each_s = (loop.time() - begun_s) * len(pids)
    return Watched(
        viewer.transforms / each_s, (beats.placed - placed) / each_s, viewer.counts.total(),
        (_cpu_s(shown) - map_s) / (sum(map(_cpu_s, pids)) - robots_s), 0.0, [], [], [], [],
    )  # fmt: skip


def parts_of(data: bytes) -> int:
    """How many parts a message of protobuf has that is one list: each with a tag and a length."""
    count = at = 0
    while at < len(data):
        length, shift, at = 0, 0, at + 1
        while True:
            byte, at = data[at], at + 1
            length |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                break
        count, at = count + 1, at + length
    return count


def _cpu_s(pid: int) -> float:
    """User and system time of a process and its threads."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


async def _released(folder: Path, port: str, beats: Beats) -> None:
    """Release until no robot is stopped: 20 robots take more than two cores, and some hear it late."""
    for _ in range(RELEASES_MAX):
        await release(folder, port)
        with suppress(TimeoutError):
            async with asyncio.timeout(RELEASED_S):
                await beats.until(False)
                return
    await beats.until(False)
