"""The door to ROS 2: two rclpy robots worked through a field, and stops from an rclpy node.

A stop is judged three times: by the bodies in the world of the launch, which get no command to move and
then stand, and by the beat in which the last robot says that it is latched.
"""

import asyncio
import os
from asyncio.subprocess import Process
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from secrets import randbelow
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from sim.fleet.outcome import COVERAGE_MIN
from sim.scenarios.scenario import load
from sim.world.drive_trains import Chassis
from tools.bench.figure import Figure
from tools.bench.ros2_field import LIMIT_S, POSES_MIN, worked_field
from tools.bench.standing_bodies import Bodies, BodiesPress, standing, start_watched
from tools.bench.stopped_beats import BUS_BOUND_MS, READY_S, Beats
from tools.bench.systems import ADDED_MS, CounterpartAbsent
from tools.bench.vda5050.counterparts import drain, end, release, said, start
from tools.common.bus_address import CHANNEL
from tools.common.bus_attach import attach
from tools.operate.operator_device import Operator

AGAINST = "rclpy (Jazzy) and rmw_fastrtps"
ROBOTS = 2
PRESSES, PRESSES_QUICK = 10, 1
MISSED_TOLD = 8  # places that the figure names
TOPIC = "/headland/emergency_stop"
SCENARIO = "small"


class Stops(NamedTuple):
    """The presses of one side."""

    latched_ms: list[float]  # until the last beat says it
    bodies: list[BodiesPress]


def figures(quick: bool) -> Iterator[Figure]:
    """Stops from both sides, and the field. Raises CounterpartAbsent."""
    if find_spec("rclpy") is None:
        raise CounterpartAbsent("rclpy is not installed: pip install 'headland[ros2]'")
    presses = PRESSES_QUICK if quick else PRESSES
    with TemporaryDirectory(prefix="headland-ros2-") as folder:
        door, bus = asyncio.run(stops(Path(folder), presses))
    limit_ms = BUS_BOUND_MS + ADDED_MS
    sides = ((f"on {TOPIC}", door), ("on the bus", bus))
    for side, pressed in sides:
        latest_ms = max(pressed.latched_ms)
        yield Figure(
            f"ROS 2: stop {side}, last robot latched", latest_ms, "ms", f"<= {limit_ms:g}",
            latest_ms <= limit_ms, AGAINST,
            f"longest of {len(pressed.latched_ms)}, to the beat that says it; bound of the bus "
            f"{BUS_BOUND_MS:g} ms; {ROBOTS} robots as processes",
        )  # fmt: skip
    braking_ms = 1000 * load(SCENARIO).fleet.speed_m_s / Chassis().braking_m_s2
    stood = [(side, pressed.bodies) for side, pressed in sides]
    yield from standing("ROS 2", stood, ROBOTS, braking_ms, AGAINST)
    if quick:  # the field takes minutes in real time
        return
    told = worked_field()
    yield Figure(
        "ROS 2: field worked by two rclpy robots", told.reached, "share", f">= {COVERAGE_MIN:g}",
        told.reached >= COVERAGE_MIN, AGAINST,
        f"by their traces, in {told.for_s:.0f} of at most {LIMIT_S:.0f} s; "
        f"{told.velocities} velocities received; {len(told.missed)} cells not worked: "
        f"{told.missed[:MISSED_TOLD]}",
    )  # fmt: skip
    clean = not told.lost and told.poses >= POSES_MIN
    yield Figure(
        "ROS 2: places on the bus that a reader of the topics missed", told.lost, "", "= 0", clean,
        AGAINST, f"of {told.poses}, equal and in order; `headland ros2` beside the robots of the field",
    )  # fmt: skip


async def stops(folder: Path, presses: int) -> tuple[Stops, Stops]:
    """Presses of a node, and of a device on the bus."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain = 1 + randbelow(100)
    launch = await start_watched(folder, SCENARIO, ROBOTS)
    door: Process | None = None
    node: _Presser | None = None
    speed_m_s = load(SCENARIO).fleet.speed_m_s
    beats, bodies, reading = Beats(ROBOTS), Bodies(speed_m_s), []
    times = (Stops([], []), Stops([], []))
    try:
        port = await said(launch, r"socketcand \S+:(\d+)")
        await said(launch, rf"(robot {ROBOTS - 1}: process)")
        reading.append(asyncio.create_task(bodies.read(launch)))
        bus = attach("socketcand", CHANNEL, 250_000, "127.0.0.1", int(port))
        bus.subscribe(beats.hear)
        operator = Operator(bus, None)
        await operator.device.held()
        door = await start(folder, "ros2", "--domain", str(domain))
        await said(door, "(node /)")
        reading.append(asyncio.create_task(drain(door)))
        node = _Presser(domain)
        async with asyncio.timeout(READY_S):
            while not node.linked():
                await asyncio.sleep(0.1)
        await beats.until(False)
        loop = asyncio.get_running_loop()
        for _ in range(presses):
            for took in times:
                driving = await bodies.drive()
                beats.all_at_s, begun_at_s = None, loop.time()
                if took is times[0]:
                    node.press()
                    took.latched_ms.append(await beats.since(begun_at_s))
                else:
                    took.latched_ms.append(await beats.pressed(operator))
                took.bodies.append(await bodies.stood(begun_at_s, driving))
                await release(folder, port)
                await beats.until(False)
        bus.close()
    finally:
        for task in reading:
            task.cancel()
        if node is not None:
            node.close()
        await end(door)
        await end(launch)
    return times


class _Presser:
    """A node of this bench, with a context of its own."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from rclpy.context import Context
        from rclpy.node import Node
        from std_msgs.msg import Bool

        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.node: Any = Node("presser", context=self.context)
        self.publisher: Any = self.node.create_publisher(Bool, TOPIC, 10)
        self.pressed: Any = Bool(data=True)

    def linked(self) -> bool:
        """Whether somebody subscribes."""
        return bool(self.publisher.get_subscription_count())

    def press(self) -> None:
        """Publish a stop."""
        self.publisher.publish(self.pressed)

    def close(self) -> None:
        """Leave the graph."""
        from rclpy.utilities import try_shutdown

        self.node.destroy_node()
        try_shutdown(context=self.context)
