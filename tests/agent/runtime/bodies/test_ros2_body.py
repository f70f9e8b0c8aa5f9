"""The body `ros2` on a simulated robot that is a plain rclpy node, with an integrator of its own."""

import asyncio
import os
import time
from collections.abc import AsyncIterator, Callable
from math import hypot, inf, nan, pi
from secrets import randbelow

import pytest
import pytest_asyncio

pytest.importorskip("rclpy", reason="ROS 2 is not installed (pip install 'headland[ros2]')")

from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from agent.interface.config import ACTUATOR_TTL_US, CONTROL_PERIOD_US
from agent.interface.effects import HALT, Drive, GatedDrive
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.runtime.bodies import ros2_body
from agent.runtime.bodies.ros2_body import Ros2Body
from agent.runtime.robot_body import DeclaredMachine
from sim.machines.ros2_machine import Ros2Machine

WAIT_S = 20.0
PERIOD_S = CONTROL_PERIOD_US / 1e6


def now_us() -> int:
    return time.monotonic_ns() // 1000


class Robot:
    def __init__(self, drive: DriveTrain, heading_rad: float = 0.0, scan: bool = False) -> None:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        domain = 1 + randbelow(100)
        self.machine = Ros2Machine("/robot_4", domain, 2.0, 3.0, heading_rad, scan=scan)
        self.machine.start()
        self.body = Ros2Body(
            4, domain=domain, scan="scan" if scan else "", rays=8, implement_state="implement_state"
        )
        self.body.declare(DeclaredMachine(Vehicle(0.5, 1.5, 1.5, drive), None))

    async def drive(self, command: Drive, holds: Callable[[], bool]) -> None:
        """Renew a command every control period until something holds."""
        ends_s = time.monotonic() + WAIT_S
        while not holds():
            assert time.monotonic() < ends_s, self.body.sense(now_us())
            self.body.drive(GatedDrive(command), now_us())
            await _period()

    async def until(self, holds: Callable[[], bool]) -> None:
        async with asyncio.timeout(WAIT_S):
            while not holds():
                await _period()


@pytest_asyncio.fixture
async def robot(request: pytest.FixtureRequest) -> AsyncIterator[Robot]:
    one = Robot(*request.param)
    await one.body.open()
    yield one
    one.body.close()
    one.machine.close()


@pytest.mark.asyncio
@pytest.mark.parametrize("robot", [(DriveTrain.MECANUM, pi / 2)], indirect=True)
async def test_places_are_sensed_and_velocities_of_the_field_are_driven(robot: Robot) -> None:
    seen = robot.body.sense(now_us())
    assert seen is not None and abs(seen.x_m - 2.0) < 0.01 and abs(seen.heading_rad - pi / 2) < 0.01
    assert 0 <= now_us() - seen.sensed_at_us < 2_000_000, "on the clock of the robot"
    await robot.drive(Drive(1.0, 0.0, tool_on=True), lambda: robot.machine.x_m > 3.0)
    assert abs(robot.machine.y_m - 3.0) < 0.05, "east, although it looks north"
    assert any(point.implement for point in robot.machine.trace)
    moving = robot.body.sense(now_us())
    assert moving is not None and moving.vx_m_s > 0.3 and abs(moving.vy_m_s) < 0.1


@pytest.mark.asyncio
@pytest.mark.parametrize("robot", [(DriveTrain.DIFFERENTIAL,)], indirect=True)
async def test_a_command_that_nobody_renews_is_over_and_the_robot_stands(robot: Robot) -> None:
    await robot.drive(Drive(1.0, 0.0, tool_on=True), lambda: robot.machine.speed_m_s > 0.5)
    heard = robot.machine.heard
    await robot.until(lambda: robot.machine.speed_m_s == 0.0)
    assert robot.machine.heard > heard or ACTUATOR_TTL_US == 100_000, "the node said zero itself"
    assert robot.machine.trace[-1].implement is False, "and the implement is up"


@pytest.mark.asyncio
@pytest.mark.parametrize("robot", [(DriveTrain.DIFFERENTIAL,)], indirect=True)
async def test_an_implement_that_was_up_for_a_moment_is_sensed(robot: Robot) -> None:
    def down() -> bool | None:
        seen = robot.body.sense(now_us())
        return None if seen is None else seen.implement_down

    await robot.drive(Drive(1.0, 0.0, tool_on=True), lambda: down() is True)
    await robot.until(lambda: not robot.machine.trace[-1].implement)  # nobody renews the command
    await robot.until(lambda: robot.body._down is False)  # on a busy machine it comes later
    await robot.drive(Drive(1.0, 0.0, tool_on=True), lambda: robot.body._down is True)
    assert down() is False, "it was up since the last look"
    assert down() is True


@pytest.mark.slow
@pytest.mark.asyncio
@pytest.mark.parametrize("robot", [(DriveTrain.DIFFERENTIAL,)], indirect=True)
async def test_a_differential_robot_turns_to_its_course(robot: Robot) -> None:
    at = robot.machine
    await robot.drive(Drive(0.0, 1.0), lambda: at.y_m > 5.0)
    assert abs(at.heading_rad - pi / 2) < 0.2 and abs(at.velocity[1]) < 1e-6, "no way sideways"
    robot.body.drive(HALT, now_us())
    await robot.until(lambda: at.speed_m_s == 0.0)


@pytest.mark.asyncio
@pytest.mark.parametrize("robot", [(DriveTrain.MECANUM, 0.0, True)], indirect=True)
async def test_a_laser_scan_is_one_ray_for_each_sector_from_the_front_on(robot: Robot) -> None:
    other = robot.machine
    other.others.append(_Echo(2.0, 7.0))  # 4 m to the left
    await robot.until(lambda: min(_rays(robot)) < inf)
    rays = _rays(robot)
    assert len(rays) == 8 and abs(rays[2] - 4.0) < 0.1
    assert all(ray == inf for k, ray in enumerate(rays) if k != 2)


@pytest.mark.asyncio
@pytest.mark.parametrize("robot", [(DriveTrain.MECANUM, 0.0, True)], indirect=True)
@pytest.mark.parametrize("angles", [{"angle_min": nan}, {"angle_increment": inf}])
async def test_a_scan_whose_angles_are_no_numbers_is_no_scan(
    robot: Robot, angles: dict[str, float]
) -> None:
    """It ended the thread of the node, and with it each place."""
    scan = LaserScan(range_min=0.1, range_max=9.0, angle_increment=0.1, ranges=[1.0] * 8)
    for name, value in angles.items():
        setattr(scan, name, value)
    before = _rays(robot)
    robot.body._scanned(scan)
    assert _rays(robot) == before


@pytest.mark.asyncio
@pytest.mark.parametrize("robot", [(DriveTrain.MECANUM,)], indirect=True)
@pytest.mark.parametrize("turn", [{"w": 0.0}, {"y": 1e200}, {"z": nan}])
async def test_odometry_whose_orientation_is_no_rotation_is_no_place(
    robot: Robot, turn: dict[str, float]
) -> None:
    """One that nobody had filled was a heading of 0, and a huge one ended the thread of the node, and
    with it what stops a robot whose commands are not renewed."""
    odometry = Odometry()
    odometry.pose.pose.position.x = 77.0
    for name, value in turn.items():
        setattr(odometry.pose.pose.orientation, name, value)
    robot.body._placed(odometry)
    seen = robot.body.sense(now_us())
    assert seen is not None and seen.x_m != 77.0


@pytest.mark.asyncio
@pytest.mark.parametrize("robot", [(DriveTrain.MECANUM, 0.0, True)], indirect=True)
async def test_a_scanner_that_dies_gives_no_scan_and_the_place_goes_on(robot: Robot) -> None:
    """The body repeated the last scan for ever, and its robot drove on blind."""

    def scan() -> tuple[float, ...]:
        seen = robot.body.sense(now_us())
        return () if seen is None else seen.ranges_m

    assert len(scan()) == 8
    publisher, robot.machine._scan = robot.machine._scan, None
    await robot.until(lambda: not scan())
    placed = robot.body.sense(now_us())
    assert placed is not None and now_us() - placed.sensed_at_us < 2_000_000
    robot.machine._scan = publisher
    await robot.until(lambda: len(scan()) == 8)


@pytest.mark.asyncio
async def test_a_robot_without_odometry_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros2_body, "FIRST_S", 0.2)
    body = Ros2Body(1, namespace="/nobody", domain=1 + randbelow(100))
    body.declare(DeclaredMachine(Vehicle(), None))
    with pytest.raises(OSError, match=r"ROS 2: nothing on /nobody/odom in 0 s"):
        await body.open()


class _Echo(Ros2Machine):
    def __init__(self, x_m: float, y_m: float) -> None:
        self.x_m, self.y_m = x_m, y_m


def _rays(robot: Robot) -> tuple[float, ...]:
    seen = robot.body.sense(now_us())
    assert seen is not None
    assert hypot(seen.x_m - 2.0, seen.y_m - 3.0) < 0.01
    return seen.ranges_m or (inf,)


async def _period() -> None:
    """One control period of a robot in real time."""
    over = asyncio.Event()
    asyncio.get_running_loop().call_later(PERIOD_S, over.set)
    await over.wait()
