"""What ROS is told of a robot that has told no place; no ROS is needed."""

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip("rosbags", reason="the extra `ros` is not installed")

from agent.interface.lifecycle import State
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Member, Pose
from sim.fleet.virtual_clock import elapse, run_virtual
from tools.inspect.inspector import SILENT_S
from tools.ros2.bag_messages import jazzy, kinds_of
from tools.ros2.graph import KINDS
from tools.ros2.ros2_feed import Ros2Feed


class Topics:
    """A graph that nobody reads: the newest message of each topic."""

    def __init__(self) -> None:
        self.store = jazzy()
        self.kinds = kinds_of(self.store, KINDS)
        self.newest = dict[str, Any]()

    def publisher(self, kind: str, topic: str, quality: object) -> Any:
        def publish(message: Any) -> None:
            self.newest[topic] = message

        return SimpleNamespace(publish=publish)

    def hear(self, *given: object) -> None:
        """Nobody speaks."""

    serve = hear

    def stamp(self) -> Any:
        return self.store.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)

    def close(self) -> None:
        """Nothing is held."""


def test_a_robot_that_has_told_no_place_has_no_marker() -> None:
    """It stood at the origin of the map, and its diagnostics said so."""

    async def story() -> None:
        graph = Topics()

        async def never() -> None:
            raise AssertionError("nobody asks")

        feed = Ros2Feed(cast(Any, graph), None, never, never)
        for slot in (0, 1):
            feed.hear(1.0, encode(Member(slot, 1, 0), 0x80 + slot))
        feed.hear(1.0, encode(Pose(3.0, 4.0, 0.0, 0.0, 1, False, 255), 0x81))
        feed.tell()
        (marker,) = graph.newest["markers"].markers
        assert (marker.id, marker.pose.position.x) == (1, 3.0)
        told = [
            {each.key: each.value for each in status.values}["x_m"]
            for status in graph.newest["/diagnostics"].status
        ]
        assert told == ["", "3.00"]
        feed.close()

    asyncio.run(story())


def test_a_fleet_that_nobody_hears_is_not_told_as_stopped() -> None:
    """Where the bus was lost `/headland/stopped` stayed true, whatever robots did from then on."""

    async def story() -> None:
        graph = Topics()

        async def never() -> None:
            raise AssertionError("nobody asks")

        feed, loop = Ros2Feed(cast(Any, graph), None, never, never), asyncio.get_running_loop()
        feed.hear(loop.time(), encode(Member(0, 1, 0), 0x80))
        latched = State.EMERGENCY_STOP.value
        feed.hear(loop.time(), encode(Pose(3.0, 4.0, 0.0, 0.0, latched, True, 255), 0x80))
        feed.tell()
        assert graph.newest["stopped"].data is True
        await elapse(SILENT_S + 0.1)
        feed.tell()
        assert graph.newest["stopped"].data is False
        feed.close()

    run_virtual(story())
