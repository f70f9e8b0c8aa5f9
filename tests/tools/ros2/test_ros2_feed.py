"""What `headland ros2` publishes and takes, read and asked by an rclpy node of the test."""

import asyncio
import os
import time
from collections.abc import AsyncIterator, Callable
from math import cos, sin
from secrets import randbelow
from typing import Any

import pytest
import pytest_asyncio

pytest.importorskip("rclpy", reason="ROS 2 is not installed (pip install 'headland[ros2]')")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.utilities import try_shutdown
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from agent.interface.lifecycle import State
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.messages import Message
from tools.inspect.inspector import NO_KEYS
from tools.ros2.dds_graph import DdsGraph
from tools.ros2.ros2_feed import Ros2Feed

WAIT_S = 30.0  # for other nodes to be discovered, on a machine that does much else
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
EVERY = QoSProfile(depth=1000)
SCENE = {
    "rings": [[[0.0, 0.0], [20.0, 0.0], [20.0, 10.0]]], "width_m": 2.0, "radius_m": 0.8,
    "sections": [{"id": 0, "swaths": [[[1.0, 1.0], [19.0, 1.0]]]}],
}  # fmt: skip


class Listener:
    """A node of the test with its own context: nothing of ours is in it."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.node = Node("listener", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.got: dict[str, list[Any]] = {}

    def hear(self, kind: Any, topic: str, quality: Any) -> None:
        self.got[topic] = []
        self.node.create_subscription(kind, topic, self.got[topic].append, quality)

    async def until(self, holds: Callable[[], bool], what: str) -> None:
        ends_s = time.monotonic() + WAIT_S
        while not holds():
            assert time.monotonic() < ends_s, f"no {what} in {WAIT_S:.0f} s; got {self.got}"
            await asyncio.to_thread(self.executor.spin_once, 0.01)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        try_shutdown(context=self.context)


class Side:
    """A feed that hears frames of a test, and a listener on the other side."""

    def __init__(self) -> None:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        domain = 101 + randbelow(100)
        self.asked: list[str] = []
        self.released = asyncio.Event()
        self.released.set()
        self.graph = DdsGraph.joined("headland", "headland", domain)
        self.feed = Ros2Feed(self.graph, SCENE, self._stop, self._release)
        self.listener = Listener(domain)

    async def _stop(self) -> tuple[bool, str]:
        self.asked.append("stop")
        return True, "stopped: [0]"

    async def _release(self) -> tuple[bool, str]:
        self.asked.append("release")
        await self.released.wait()
        return False, "no operator's key"

    def say(self, message: Message, source: int = 128) -> None:
        self.feed.hear(asyncio.get_running_loop().time(), encode(message, source))

    async def linked(self, topic: str) -> None:
        """Wait until the publisher of a topic has found its reader."""
        made = self.graph.node.node
        await self.listener.until(lambda: made.count_subscribers(topic) > 0, f"reader of {topic}")


@pytest_asyncio.fixture
async def side() -> AsyncIterator[Side]:
    one = Side()
    yield one
    one.feed.close()
    one.listener.close()


@pytest.mark.asyncio
async def test_every_pose_on_the_bus_is_an_odometry_that_no_reader_misses(side: Side) -> None:
    side.say(Member(3, 1, 7))
    side.say(_pose(0.0, 0.0, 0.0, 0.0))
    topic = "/headland/robot_3/odom"
    side.listener.hear(Odometry, topic, EVERY)
    await side.linked(topic)
    got = side.listener.got[topic]
    side.say(_pose(-1.0, 0.0, 0.0, 0.0))
    await side.listener.until(lambda: bool(got), "first odometry")
    got.clear()
    for number in range(500):
        side.say(_pose(number / 10, -2.5, 1.5, 0.5))
        if number % 5 == 0:  # a reader of a bus at 1000 poses a second
            side.listener.executor.spin_once(timeout_sec=0.0)
    await side.listener.until(lambda: len(got) >= 500, "500 odometries")
    assert [round(m.pose.pose.position.x, 2) for m in got] == [k / 10 for k in range(500)]
    newest = got[-1]
    assert newest.header.frame_id == "map" and newest.child_frame_id == "robot_3"
    assert abs(newest.twist.twist.linear.x - 1.5) < 0.02
    turn = newest.pose.pose.orientation
    assert abs(turn.z - sin(0.25)) < 0.01 and abs(turn.w - cos(0.25)) < 0.01


@pytest.mark.asyncio
async def test_states_grids_markers_and_diagnostics_come_also_to_a_late_reader(side: Side) -> None:
    side.say(Member(0, 1, 7))
    side.say(_pose(5.0, 1.0, 0.0, 0.0))
    side.say(_beat("IDLE"))
    side.feed.tell()
    hear = side.listener.hear
    hear(String, "/headland/robot_0/state", LATCHED)
    hear(OccupancyGrid, "/headland/coverage", LATCHED)
    hear(MarkerArray, "/headland/markers", LATCHED)
    hear(Bool, "/headland/stopped", LATCHED)
    hear(DiagnosticArray, "/diagnostics", EVERY)
    got = side.listener.got
    await side.listener.until(lambda: all(got.values()), "one of each")
    assert got["/headland/robot_0/state"][-1].data == "IDLE"
    grid = got["/headland/coverage"][-1]
    assert set(grid.data) == {-1, 0} and grid.info.resolution == 0.5
    assert len(grid.data) == grid.info.width * grid.info.height
    kinds = {(m.ns, m.id) for m in got["/headland/markers"][-1].markers}
    assert kinds == {("outlines", 0), ("robots", 0)}
    assert got["/headland/stopped"][-1].data is False
    robot, keys = got["/diagnostics"][-1].status
    assert robot.name == "headland: robot 0"
    assert keys.message == NO_KEYS and keys.level == DiagnosticStatus.ERROR
    side.say(_beat("EMERGENCY_STOP"))
    await side.listener.until(lambda: got["/headland/stopped"][-1].data is True, "stop")


@pytest.mark.asyncio
async def test_a_plan_of_a_launch_is_a_path(side: Side) -> None:
    topic = "/headland/robot_0/plan"
    side.listener.hear(Path, topic, EVERY)
    intent = {"slot": 0, "x": 1.0, "y": 2.0, "heading": 0.0, "path": [[3.0, 4.0], [5.0, 6.0]]}
    side.feed.intend(0.0, intent)
    await side.linked(topic)
    side.feed.intend(0.1, intent)
    await side.listener.until(lambda: bool(side.listener.got[topic]), "plan")
    places = [(p.pose.position.x, p.pose.position.y) for p in side.listener.got[topic][-1].poses]
    assert places == [(1.0, 2.0), (3.0, 4.0), (5.0, 6.0)]


@pytest.mark.asyncio
async def test_a_stop_is_heard_while_a_release_waits_for_the_bus(side: Side) -> None:
    """A release waits up to 30 s for robots. The thread that heard stops was the one that waited."""
    node = side.listener.node
    releases, stops = (
        node.create_client(Trigger, f"/headland/{name}") for name in ("release", "stop")
    )
    presses = node.create_publisher(Bool, "/headland/emergency_stop", 10)
    until = side.listener.until
    await until(
        lambda: releases.service_is_ready() and stops.service_is_ready()
        and presses.get_subscription_count() > 0, "services and reader of stops",
    )  # fmt: skip
    side.released.clear()
    releasing = releases.call_async(Trigger.Request())
    await until(lambda: side.asked == ["release"], "release")
    presses.publish(Bool(data=True))
    await until(lambda: side.asked == ["release", "stop"], "stop by the topic")
    stopping = stops.call_async(Trigger.Request())
    await until(stopping.done, "stop by the service")
    assert not releasing.done()
    side.released.set()
    await until(releasing.done, "answer of the release")


@pytest.mark.asyncio
async def test_a_stop_from_ros_is_pressed_and_false_is_no_release(side: Side) -> None:
    node = side.listener.node
    button = node.create_publisher(Bool, "/headland/emergency_stop", EVERY)
    await side.listener.until(lambda: button.get_subscription_count() > 0, "reader of the button")
    button.publish(Bool(data=False))
    button.publish(Bool(data=True))
    await side.listener.until(lambda: side.asked == ["stop"], "stop")
    client = node.create_client(Trigger, "/headland/release")
    await side.listener.until(client.service_is_ready, "service")
    answer = client.call_async(Trigger.Request())
    await side.listener.until(answer.done, "answer")
    said: Any = answer.result()
    assert said.success is False and "key" in said.message
    assert side.asked == ["stop", "release"]


def _pose(x_m: float, y_m: float, speed_m_s: float, course_rad: float) -> Pose:
    return Pose(x_m, y_m, course_rad, speed_m_s, 1, False, 0)


def _beat(state: str) -> Heartbeat:
    number = list(State).index(State[state])
    return Heartbeat(1, number, state == "EMERGENCY_STOP", False, True, False, 1.0, 0, 0)
