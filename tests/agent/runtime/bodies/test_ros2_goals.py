"""The body `ros2` on a robot that takes no velocities, but Nav2's NavigateToPose: a server of rclpy."""

import asyncio
import os
import threading
import time
from collections.abc import AsyncIterator, Callable
from math import cos, hypot, pi, sin
from secrets import randbelow
from typing import Any

import pytest
import pytest_asyncio

pytest.importorskip("rclpy", reason="ROS 2 is not installed (pip install 'headland[ros2]')")

import rclpy
from geometry_msgs.msg import Twist
from rclpy.action.server import ActionServer, CancelResponse
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import try_shutdown

from agent.interface.config import CONTROL_PERIOD_US
from agent.interface.effects import HALT, Drive, GatedDrive
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.runtime.bodies.ros2_body import Ros2Body
from agent.runtime.robot_body import DeclaredMachine
from agent.runtime.ros2_goals import AHEAD_S
from sim.machines.ros2_machine import Ros2Machine
from tests.nav2_types import nav2_types

WAIT_S = 120.0  # the first velocity compiles its kernels
STEP_S = 0.05
SPEED_M_S = 1.0
THERE_M = 0.1
BRAKING_M = 1.0  # of the base, and a cancellation on its way


@pytest.fixture(scope="module", autouse=True)
def types() -> None:
    nav2_types()


class Navigator:
    """A server of the action, with one goal at a time as Nav2 has it, that drives a base by cmd_vel."""

    def __init__(self, machine: Ros2Machine, domain: int) -> None:
        from nav2_msgs.action import NavigateToPose

        self.machine, self.kind = machine, NavigateToPose
        self.frames: set[str] = set()
        self.goals = self.cancelled = 0
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.node = Node("bt_navigator", context=self.context, namespace="/robot_4")
        self._commands = self.node.create_publisher(Twist, "cmd_vel", 10)
        self._goal: Any = None
        self._server = ActionServer(
            self.node, NavigateToPose, "navigate_to_pose", lambda handle: NavigateToPose.Result(),
            handle_accepted_callback=self._take,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
        )  # fmt: skip
        self.node.create_timer(STEP_S, self._step)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._closing = False
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        while not self._closing:
            self._executor.spin_once(timeout_sec=0.1)

    def _take(self, handle: Any) -> None:
        self.goals += 1
        self.frames.add(handle.request.pose.header.frame_id)
        before, self._goal = self._goal, handle
        if before is not None:
            before.execute(lambda old: self._ended(old, old.abort))

    def _ended(self, handle: Any, end: Callable[[], None]) -> Any:
        end()
        return self.kind.Result()

    def _step(self) -> None:
        goal, twist = self._goal, Twist()
        if goal is not None and goal.is_cancel_requested:
            self.cancelled += 1
            self._goal = None
            goal.execute(lambda handle: self._ended(handle, handle.canceled))
        elif goal is not None:
            to = goal.request.pose.pose.position
            dx_m, dy_m = to.x - self.machine.x_m, to.y - self.machine.y_m
            left_m, heading_rad = hypot(dx_m, dy_m), self.machine.heading_rad
            if left_m < THERE_M:
                self._goal = None
                goal.execute(lambda handle: self._ended(handle, handle.succeed))
            else:
                share = SPEED_M_S / left_m
                twist.linear.x = share * (cos(heading_rad) * dx_m + sin(heading_rad) * dy_m)
                twist.linear.y = share * (cos(heading_rad) * dy_m - sin(heading_rad) * dx_m)
        self._commands.publish(twist)

    def hang(self) -> None:
        """It is there, and answers nothing any more."""
        self._closing = True
        self._thread.join()

    def close(self) -> None:
        self.hang()
        self._executor.shutdown()
        self._server.destroy()
        self.node.destroy_node()
        try_shutdown(context=self.context)


class Robot:
    """Its odometry begins at (5, 3) in the field, and looks north there."""

    def __init__(self) -> None:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        self.domain = domain = 1 + randbelow(100)
        self.machine = Ros2Machine("/robot_4", domain, 0.0, 0.0, 0.0)
        self.machine.start()
        self.navigator = Navigator(self.machine, domain)
        self.body = Ros2Body(
            4, domain=domain, navigate="navigate_to_pose", x_m=5.0, y_m=3.0, heading_rad=pi / 2
        )
        self.body.declare(DeclaredMachine(Vehicle(0.5, SPEED_M_S, 1.5, DriveTrain.MECANUM), None))

    async def drive(self, command: Drive, holds: Callable[[], bool]) -> None:
        """Renew a command every control period until something holds."""
        ends_s = time.monotonic() + WAIT_S
        while not holds():
            assert time.monotonic() < ends_s, (self.machine.x_m, self.machine.y_m)
            self.body.drive(GatedDrive(command), _now_us())
            await _period()

    async def until(self, holds: Callable[[], bool]) -> None:
        async with asyncio.timeout(WAIT_S):
            while not holds():
                await _period()


@pytest_asyncio.fixture
async def robot() -> AsyncIterator[Robot]:
    one = Robot()
    await one.body.open()
    yield one
    one.body.close()
    one.navigator.close()
    one.machine.close()


@pytest.mark.slow
@pytest.mark.asyncio
async def test_a_course_is_a_chain_of_places_ahead_and_a_halt_cancels_it(robot: Robot) -> None:
    """North in the field is ahead in the frame of this odometry."""
    at, navigator = robot.machine, robot.navigator
    await robot.drive(Drive(0.0, SPEED_M_S), lambda: at.x_m > 4.0)
    assert abs(at.y_m) < 0.1, "straight ahead"
    assert navigator.frames == {"odom"}, "places are in the frame of its odometry"
    assert 3 <= navigator.goals <= 40, "a place for each half second, not for each period"
    await robot.drive(Drive(SPEED_M_S, 0.0), lambda: at.y_m < -2.0)
    turned_at_m = at.x_m
    robot.body.drive(HALT, _now_us())
    await robot.until(lambda: navigator.cancelled > 0 and at.speed_m_s == 0.0)
    assert abs(at.x_m - turned_at_m) < BRAKING_M and at.y_m > -2.0 - BRAKING_M
    seen = robot.body.sense(_now_us())
    assert seen is not None and abs(seen.x_m - (5.0 - at.y_m)) < 0.01


@pytest.mark.asyncio
async def test_a_course_that_nobody_renews_is_cancelled(robot: Robot) -> None:
    at = robot.machine
    await robot.drive(Drive(0.0, SPEED_M_S), lambda: at.speed_m_s > 0.8)
    from_m = at.x_m
    await robot.until(lambda: at.speed_m_s == 0.0)
    assert robot.navigator.cancelled >= 1, "on a busy machine it also lapses before"
    assert at.x_m - from_m < AHEAD_S * SPEED_M_S + BRAKING_M


@pytest.mark.asyncio
async def test_a_server_that_ends_before_it_answers_is_asked_again_when_it_is_back(
    robot: Robot,
) -> None:
    """The robot stood for ever: the answer that it waited for had gone with Nav2."""
    goals = robot.body.goals
    assert goals is not None
    robot.navigator.hang()
    await robot.drive(Drive(0.0, SPEED_M_S), lambda: goals.sent > 0)
    robot.navigator.close()
    robot.navigator = Navigator(robot.machine, robot.domain)
    await robot.drive(Drive(0.0, SPEED_M_S), lambda: robot.machine.speed_m_s > 0.5)
    robot.body.drive(HALT, _now_us())
    await robot.until(lambda: robot.machine.speed_m_s == 0.0)


def _now_us() -> int:
    return time.monotonic_ns() // 1000


async def _period() -> None:
    """One control period of a robot in real time."""
    over = asyncio.Event()
    asyncio.get_running_loop().call_later(CONTROL_PERIOD_US / 1e6, over.set)
    await over.wait()
