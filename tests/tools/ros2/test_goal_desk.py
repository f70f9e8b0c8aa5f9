"""Goals and transports as actions of ROS 2, asked by a client of rclpy, and done by launched robots."""

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from math import hypot
from pathlib import Path
from secrets import randbelow
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed (pip install 'headland[ros2]')")

import rclpy
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from rclpy.action.client import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import try_shutdown

from tests.nav2_types import nav2_types
from tests.tools import launching
from tests.tools.launching import ROOT, robots_up, said, start

WAIT_S = 180.0  # for what takes ten seconds on a quiet machine
ARRIVED_M = 1.0
FIRST, SECOND = (-10.0, -5.0), (20.0, -10.0)  # in the field `small`, metres east and north
NOT_ADMITTED = (0.0, 0.0)  # robots cannot stand there


@pytest.fixture(scope="module")
def types() -> str:
    return nav2_types()


class Client:
    """A node of the test with its own context: nothing of ours is in it."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.node = Node("client", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.feedback: list[Any] = []

    async def until(self, holds: Callable[[], bool], what: str) -> None:
        ends_s = time.monotonic() + WAIT_S
        while not holds():
            assert time.monotonic() < ends_s, f"no {what} in {WAIT_S:.0f} s"
            await asyncio.to_thread(self.executor.spin_once, 0.01)

    async def sent(self, client: Any, goal: Any) -> Any:
        """The handle of a goal, as soon as it is accepted or rejected."""
        await self.until(client.server_is_ready, "server")
        answer = client.send_goal_async(goal, self.feedback.append)
        await self.until(answer.done, "answer")
        return answer.result()

    async def ended(self, handle: Any) -> Any:
        """Status and result of a goal."""
        result = handle.get_result_async()
        await self.until(result.done, "result")
        return result.result()

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        try_shutdown(context=self.context)


@asynccontextmanager
async def fleet(
    folder: Path, types: str, monkeypatch: pytest.MonkeyPatch, *words: str
) -> AsyncIterator[Client]:
    """Launched robots with keys, the door beside them, and a client."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    path = os.pathsep.join(filter(None, (str(ROOT), types)))
    environment = {"PYTHONPATH": path, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    monkeypatch.setattr(launching, "ENVIRONMENT", launching.ENVIRONMENT | environment)
    domain, running = 101 + randbelow(100), []
    client = Client(domain)
    try:
        running.append(await start(folder, "launch", *words, "--fresh"))
        await robots_up(running[0], 2)
        running.append(await start(folder, "ros2", "--domain", str(domain)))
        await said(running[1], "(node /)")
        reading = [asyncio.create_task(process.communicate()) for process in running]
        try:
            yield client
        except AssertionError:
            running[1].send_signal(signal.SIGINT)
            print((await reading[1])[0].decode())  # why the door refused
            raise
        for process in running[::-1]:
            process.send_signal(signal.SIGINT)
        for each in reading:
            await each
    finally:
        client.close()
        for process in running:
            if process.returncode is None:
                process.kill()
                await process.wait()


def _pose(x_m: float, y_m: float, frame: str = "map") -> PoseStamped:
    made = PoseStamped()
    made.header.frame_id = frame
    made.pose.position.x, made.pose.position.y = x_m, y_m
    return made


@pytest.mark.slow
@pytest.mark.asyncio
async def test_a_goal_of_ros_is_an_order_that_a_robot_reaches_and_gives_up(
    tmp_path: Path, types: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from nav2_msgs.action import NavigateToPose

    async with fleet(tmp_path, types, monkeypatch, "small", "--robots", "2") as client:
        actions = ActionClient(client.node, NavigateToPose, "/headland/robot_0/navigate_to_pose")
        handle = await client.sent(actions, NavigateToPose.Goal(pose=_pose(*FIRST, "odom")))
        assert not handle.accepted, "places are in the frame of the fleet"
        handle = await client.sent(actions, NavigateToPose.Goal(pose=_pose(*NOT_ADMITTED)))
        told = await client.ended(handle)
        assert told.status == GoalStatus.STATUS_ABORTED, "the robot refuses it"
        handle = await client.sent(actions, NavigateToPose.Goal(pose=_pose(*FIRST)))
        assert handle.accepted
        told = await client.ended(handle)
        assert told.status == GoalStatus.STATUS_SUCCEEDED and told.result.error_code == 0
        newest = client.feedback[-1].feedback
        assert newest.distance_remaining < client.feedback[0].feedback.distance_remaining
        at = newest.current_pose.pose.position
        assert hypot(at.x - FIRST[0], at.y - FIRST[1]) < ARRIVED_M, (at.x, at.y)
        client.feedback.clear()
        handle = await client.sent(actions, NavigateToPose.Goal(pose=_pose(*SECOND)))
        await client.until(lambda: bool(client.feedback), "feedback")
        taken_back = handle.cancel_goal_async()
        await client.until(taken_back.done, "answer to the cancellation")
        assert len(taken_back.result().goals_canceling) == 1
        told = await client.ended(handle)
        assert told.status == GoalStatus.STATUS_CANCELED


# The warehouse that ships without its 30 tasks: they would come first, and take two robots ten minutes.
TWO_TASKS = """
name = "hall"
mission = "delivery"
[warehouse]
map = "{hall}"
tasks = "tasks.csv"
[fleet]
robots = 2
[run]
time_limit_s = 1800.0
"""


@pytest.mark.slow
@pytest.mark.asyncio
async def test_two_poses_of_ros_are_a_transport_that_is_delivered_or_taken_back(
    tmp_path: Path, types: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from nav2_msgs.action import NavigateThroughPoses

    hall = ROOT / "sim" / "warehouses" / "warehouse.map"
    (tmp_path / "hall.toml").write_text(TWO_TASKS.format(hall=hall))
    columns = "pickup_x_m,pickup_y_m,dropoff_x_m,dropoff_y_m,at_s\n"
    (tmp_path / "tasks.csv").write_text(columns + "20.5,8.5,32.5,8.5,0\n14.5,14.5,1.5,6.5,0\n")
    async with fleet(tmp_path, types, monkeypatch, "hall.toml") as client:
        actions = ActionClient(client.node, NavigateThroughPoses, "/headland/transport")
        goal = NavigateThroughPoses.Goal(poses=[_pose(9.5, 2.5)])
        assert not (await client.sent(actions, goal)).accepted, "one place is no transport"
        goal.poses = [_pose(9.5, 2.5), _pose(1.5, 8.5)]
        handle = await client.sent(actions, goal)
        assert handle.accepted
        told = await client.ended(handle)
        assert told.status == GoalStatus.STATUS_SUCCEEDED
        left = [each.feedback.number_of_poses_remaining for each in client.feedback]
        assert left == sorted(left, reverse=True) and set(left) == {2, 1}, left
        client.feedback.clear()
        goal.poses = [_pose(32.5, 8.5), _pose(9.5, 2.5)]
        handle = await client.sent(actions, goal)
        await client.until(lambda: bool(client.feedback), "feedback")
        taken_back = handle.cancel_goal_async()
        await client.until(taken_back.done, "answer to the cancellation")
        assert len(taken_back.result().goals_canceling) == 1
        assert (await client.ended(handle)).status == GoalStatus.STATUS_CANCELED
