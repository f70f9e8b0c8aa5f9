"""The fleet in ROS 2 without ROS: keys, tokens and messages as a session that is not ours reads them.

Messages are taken apart by rclpy and its type support, and hashes of types compared with those of rclpy,
where it is installed. rmw_zenoh itself is in no package index; its keys are those of its design document.
"""

import asyncio
import os
import time
from collections.abc import AsyncIterator, Callable
from importlib import import_module
from math import sin
from secrets import randbelow
from typing import Any

import pytest
import pytest_asyncio

pytest.importorskip("zenoh", reason="the extra `backbone` is not installed")
pytest.importorskip("rosbags", reason="the extra `ros` is not installed")

import zenoh
import zenoh.ext

from agent.interface.lifecycle import State
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.messages import Message
from protocol.links.zenoh_link import LinkError, configure
from tools.bench.vda5050.counterparts import free_port
from tools.ros2.graph import KINDS
from tools.ros2.ros2_feed import Ros2Feed
from tools.ros2.zenoh_graph import ZenohGraph, attachment

WAIT_S = 30.0
DOMAIN = 7
SCENE = {
    "rings": [[[0.0, 0.0], [20.0, 0.0], [20.0, 10.0]]], "width_m": 2.0, "radius_m": 0.8,
    "sections": [{"id": 0, "swaths": [[[1.0, 1.0], [19.0, 1.0]]]}],
}  # fmt: skip


class Side:
    """A router, a feed that joins by it, and a session of the test."""

    def __init__(self) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.router = zenoh.open(configure([], [self.endpoint]))
        self.other = zenoh.open(configure([self.endpoint], [], "client"))
        self.asked: list[str] = []

    async def join(self) -> None:
        self.graph = await ZenohGraph.open(self.endpoint, "headland", "headland", DOMAIN)
        self.feed = Ros2Feed(self.graph, SCENE, self._stop, self._stop)

    async def _stop(self) -> tuple[bool, str]:
        self.asked.append("stop")
        return True, "stopped: [0]"

    def say(self, message: Message, source: int = 128) -> None:
        self.feed.hear(asyncio.get_running_loop().time(), encode(message, source))

    async def until(self, holds: Callable[[], Any], what: str) -> None:
        ends_s = time.monotonic() + WAIT_S
        while not holds():
            assert time.monotonic() < ends_s, f"no {what} in {WAIT_S:.0f} s"
            await asyncio.to_thread(lambda: None)

    def close(self) -> None:
        self.feed.close()
        self.other.close()
        self.router.close()


@pytest_asyncio.fixture
async def side() -> AsyncIterator[Side]:
    one = Side()
    await one.join()
    yield one
    one.close()


@pytest.mark.asyncio
async def test_poses_on_the_bus_are_odometry_on_the_key_of_rmw_zenoh(side: Side) -> None:
    rclpy = pytest.importorskip("rclpy.serialization", reason="ROS 2 is not installed")
    from nav_msgs.msg import Odometry

    heard: list[Any] = []
    side.other.declare_subscriber(f"{DOMAIN}/headland/robot_3/odom/**", heard.append)
    side.say(Member(3, 1, 7))

    def first() -> bool:  # until routes are made
        side.say(_pose(-1.0, 0.0, 0.0, 0.0))
        return bool(heard)

    await side.until(first, "odometry")
    for number in range(100):
        side.say(_pose(number / 10, -2.5, 1.5, 0.5))
    await side.until(lambda: _x(rclpy, Odometry, heard[-1]) == 9.9, "the last of 100")
    told = [_x(rclpy, Odometry, sample) for sample in heard]
    assert [x_m for x_m in told if x_m >= 0.0] == [k / 10 for k in range(100)]
    newest = rclpy.deserialize_message(heard[-1].payload.to_bytes(), Odometry)
    assert newest.header.frame_id == "map" and newest.child_frame_id == "robot_3"
    assert abs(newest.pose.pose.orientation.z - sin(0.25)) < 0.01
    *_, kind, check = str(heard[-1].key_expr).split("/")
    assert kind == "nav_msgs::msg::dds_::Odometry_" and check.startswith("RIHS01_")
    numbers = [int.from_bytes(s.attachment.to_bytes()[:8], "little") for s in heard]
    assert numbers == list(range(numbers[0], numbers[0] + len(heard))), "none is lost or repeated"
    about = heard[-1].attachment.to_bytes()
    assert len(about) == 33 and about[16] == 16, "as rmw_zenoh writes a fixed array"
    assert abs(int.from_bytes(about[8:16], "little") - time.time_ns()) < 60e9


def _x(rclpy: Any, kind: Any, sample: Any) -> float:
    message = rclpy.deserialize_message(sample.payload.to_bytes(), kind)
    return round(float(message.pose.pose.position.x), 3)


@pytest.mark.asyncio
async def test_late_readers_get_states_and_grids_that_rclpy_can_read(side: Side) -> None:
    rclpy = pytest.importorskip("rclpy.serialization", reason="ROS 2 is not installed")
    side.say(Member(0, 1, 7))
    side.say(_pose(5.0, 1.0, 0.0, 0.0))
    side.say(_beat("IDLE"))
    side.feed.tell()
    wanted = {
        "robot_0/state": ("std_msgs.msg", "String"), "coverage": ("nav_msgs.msg", "OccupancyGrid"),
        "markers": ("visualization_msgs.msg", "MarkerArray"), "stopped": ("std_msgs.msg", "Bool"),
    }  # fmt: skip
    got: dict[str, list[Any]] = {topic: [] for topic in wanted}
    for topic, samples in got.items():
        zenoh.ext.declare_advanced_subscriber(
            side.other, f"{DOMAIN}/headland/{topic}/*/*", samples.append,
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        )  # fmt: skip
    await side.until(lambda: all(got.values()), "one of each")
    read = {
        topic: rclpy.deserialize_message(
            got[topic][-1].payload.to_bytes(), getattr(import_module(package), kind)
        )
        for topic, (package, kind) in wanted.items()
    }
    assert read["robot_0/state"].data == "IDLE" and read["stopped"].data is False
    assert set(read["coverage"].data) == {-1, 0} and read["coverage"].info.resolution == 0.5
    kinds = {(m.ns, m.id) for m in read["markers"].markers}
    assert kinds == {("outlines", 0), ("robots", 0)}


@pytest.mark.asyncio
async def test_tokens_name_the_node_and_its_topics_as_the_design_document_does(side: Side) -> None:
    def tokens() -> list[list[str]]:
        replies = side.other.liveliness().get(f"@ros2_lv/{DOMAIN}/**")
        return [str(reply.ok.key_expr).split("/") for reply in replies if reply.ok is not None]

    await side.until(lambda: len(tokens()) >= 8, "tokens")
    found = {(each[5], each[9] if len(each) > 9 else ""): each for each in tokens()}
    assert found["NN", ""][6:] == ["%", "%headland", "headland"]
    stopped = found["MP", "%headland%stopped"]
    assert stopped[10] == "std_msgs::msg::dds_::Bool_" and stopped[12] == ":1:,1:,:,:,,"
    assert found["MP", "%tf"][10] == "tf2_msgs::msg::dds_::TFMessage_"
    assert found["MS", "%headland%emergency_stop"][12] == "::,10:,:,:,,"
    assert len({each[4] for each in found.values()}) == len(found), "each entity has its number"


@pytest.mark.asyncio
async def test_a_stop_that_a_node_publishes_is_pressed_and_noise_is_not(side: Side) -> None:
    rclpy = pytest.importorskip("rclpy.serialization", reason="ROS 2 is not installed")
    from std_msgs.msg import Bool

    check = side.graph._store.hash_rihs01("std_msgs/msg/Bool")
    key = f"{DOMAIN}/headland/emergency_stop/std_msgs::msg::dds_::Bool_/{check}"
    button = side.other.declare_publisher(key)
    about = attachment(1, time.time_ns(), bytes(16))
    for payload in (b"", b"\x00", b"\xff" * 40, rclpy.serialize_message(Bool(data=False))):
        button.put(payload, attachment=about)

    def pressed() -> bool:
        button.put(rclpy.serialize_message(Bool(data=True)), attachment=about)
        return bool(side.asked)

    await side.until(pressed, "stop")


@pytest.mark.parametrize("name", KINDS)
def test_hashes_of_types_are_those_of_rclpy(name: str) -> None:
    """A reader of another hash does not match: its key is another one."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node

    from tools.ros2.bag_messages import jazzy

    package, _, kind = name.split("/")
    try:
        made = getattr(import_module(f"{package}.msg"), kind)
    except ModuleNotFoundError:
        pytest.skip(f"{package} is in no package index")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = Context()
    rclpy.init(args=[], context=context, domain_id=1 + randbelow(100))
    node = Node("hashes", context=context)
    node.create_publisher(made, "it", 1)
    (told,) = node.get_publishers_info_by_topic("it")
    check = told.topic_type_hash.value
    node.destroy_node()
    context.try_shutdown()
    assert jazzy().hash_rihs01(name) == f"RIHS01_{bytes(check).hex()}"


@pytest.mark.slow
@pytest.mark.asyncio
async def test_no_router_is_one_line() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(LinkError, match=f"no router of Zenoh at {endpoint}: "):
        await ZenohGraph.open(endpoint, "headland", "headland", None)


def _pose(x_m: float, y_m: float, speed_m_s: float, course_rad: float) -> Pose:
    return Pose(x_m, y_m, course_rad, speed_m_s, 1, False, 0)


def _beat(state: str) -> Heartbeat:
    number = list(State).index(State[state])
    return Heartbeat(1, number, state == "EMERGENCY_STOP", False, True, False, 1.0, 0, 0)
