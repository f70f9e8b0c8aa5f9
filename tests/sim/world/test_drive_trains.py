"""Wheel equations against their inverses, limits of wheels, slip, and the kinds of drive train."""

from itertools import pairwise, product
from math import atan2, cos, hypot, pi, remainder, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.interface.effects import Drive
from agent.interface.vehicle import DriveTrain
from agent.motion.wheel_kinematics import (
    ackermann_body,
    ackermann_wheels,
    differential_body,
    differential_wheels,
    mecanum_body,
    mecanum_wheels,
)
from sim.world.drive_trains import STEP_US, TRACTOR, Chassis
from sim.world.world import World

velocity = st.floats(-12.0, 12.0)
length = st.floats(0.05, 3.0)


def thesis_matrix(arm_m: float) -> np.ndarray:
    """As printed in section 5.2 of the thesis, front left, front right, rear left, rear right."""
    return np.array([[1, -1, -arm_m], [1, 1, arm_m], [1, 1, -arm_m], [1, -1, arm_m]])


@settings(deadline=None)  # the first call compiles
@given(velocity, velocity, velocity, length, length)
def test_mecanum_wheels_are_the_thesis_matrix(
    vx: float, vy: float, turn: float, r: float, arm_m: float
) -> None:
    wanted = thesis_matrix(arm_m) @ (vx, vy, turn) / r
    assert mecanum_wheels(r, arm_m, vx, vy, turn) == pytest.approx(tuple(wanted), abs=1e-9)


@settings(deadline=None)  # the first call compiles
@given(velocity, velocity, velocity, length, length)
def test_mecanum_inverse(vx: float, vy: float, turn: float, r: float, arm_m: float) -> None:
    wheels = mecanum_wheels(r, arm_m, vx, vy, turn)
    assert mecanum_body(r, arm_m, *wheels) == pytest.approx((vx, vy, turn), abs=1e-9)


@settings(deadline=None)  # the first call compiles
@given(st.tuples(velocity, velocity, velocity, velocity), length, length)
def test_mecanum_inverse_is_least_squares(
    wheels: tuple[float, float, float, float], r: float, arm_m: float
) -> None:
    best = np.linalg.lstsq(thesis_matrix(arm_m) / r, np.array(wheels), rcond=None)[0]
    assert mecanum_body(r, arm_m, *wheels) == pytest.approx(tuple(best), abs=1e-6)


@settings(deadline=None)  # the first call compiles
@given(velocity, velocity, length, length)
def test_differential_inverse(vx: float, turn: float, r: float, half_m: float) -> None:
    wheels = differential_wheels(r, half_m, vx, turn)
    assert differential_body(r, half_m, *wheels) == pytest.approx((vx, turn), abs=1e-9)


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.1, 12.0), st.floats(-1.0, 1.0), length, length)
def test_ackermann_inverse(vx: float, turn: float, r: float, half_m: float) -> None:
    for speed in (vx, -vx):
        wheels = ackermann_wheels(r, half_m, speed, turn)
        assert ackermann_body(r, half_m, *wheels) == pytest.approx((speed, turn), abs=1e-9)


def drive(
    chassis: Chassis, command: Drive, seconds: float, heading_rad: float = 0.0, seed: int = 1
) -> tuple[World, list[tuple[float, float, float, float, float]]]:
    """A robot alone on a plain, one command kept up: x, y, heading, vx, vy of each step."""
    world = World([], seed)
    body = world.add_robot(0, (0.0, 0.0), 0.5, chassis, heading_rad)
    way = []
    for t_us in range(0, round(seconds * 1e6), STEP_US):
        body.drive(command, t_us)
        world.advance(t_us + STEP_US)
        x, y, heading, vx, vy = world.motion[0, :5].tolist()
        way.append((x, y, heading, vx, vy))
    return world, way


@pytest.mark.parametrize("heading_rad", [0.0, 1.0, -2.5])
@pytest.mark.parametrize("course_rad", [k * pi / 6 for k in range(12)])
def test_mecanum_goes_anywhere_without_turning(course_rad: float, heading_rad: float) -> None:
    wanted = Drive(2.5 * cos(course_rad), 2.5 * sin(course_rad))
    _, way = drive(Chassis(slip=0.0), wanted, 3.0, heading_rad)
    x, y, heading, vx, vy = way[-1]
    assert (vx, vy) == pytest.approx((wanted.vx_m_s, wanted.vy_m_s), abs=1e-9)
    assert heading == pytest.approx(heading_rad, abs=1e-9)
    assert remainder(atan2(y, x) - course_rad, 2 * pi) == pytest.approx(0.0, abs=1e-9)


def test_wheels_limit_speed_and_acceleration() -> None:
    chassis = Chassis(slip=0.0, speed_m_s=2.0, acceleration_m_s2=1.0)
    _, way = drive(chassis, Drive(100.0, 0.0), 5.0)
    speeds = [0.0, *(row[3] for row in way)]
    assert max(speeds) == pytest.approx(1.5 * 2.0), "wheels have half as much again in hand"
    rates = np.diff(speeds) / 0.01
    assert rates.max() == pytest.approx(1.5 * 1.0)


def test_a_command_too_fast_for_one_wheel_keeps_its_direction() -> None:
    _, way = drive(Chassis(slip=0.0), Drive(30.0, 10.0, 0.0), 2.0)
    assert all(vy / vx == pytest.approx(1 / 3) for *_, vx, vy in way)


@pytest.mark.parametrize("kind", DriveTrain)
def test_slip_has_the_stated_deviation_and_its_own_seed(kind: DriveTrain) -> None:
    slip = 0.05
    chassis = Chassis(slip=slip, kind=kind, acceleration_m_s2=5.0)
    speeds = []
    for seed in range(12):
        _, way = drive(chassis, Drive(2.0, 0.0), 8.0, seed=seed)
        speeds += [hypot(vx, vy) for *_, vx, vy in way[100:]]
    # Speed is the mean of the driven wheels: four, two, or one axle.
    wheels = {DriveTrain.MECANUM: 4, DriveTrain.DIFFERENTIAL: 2, DriveTrain.ACKERMANN: 1}[kind]
    assert np.mean(speeds) == pytest.approx(2.0, rel=0.01)
    assert np.std(speeds) / 2.0 == pytest.approx(slip / wheels**0.5, rel=0.2)
    _, same = drive(chassis, Drive(2.0, 0.0), 0.5, seed=3)
    _, again = drive(chassis, Drive(2.0, 0.0), 0.5, seed=3)
    _, other = drive(chassis, Drive(2.0, 0.0), 0.5, seed=4)
    assert same == again and same != other


@pytest.mark.parametrize("course_rad", [0.0, 1.0, 2.0, 3.0, -1.5, -3.1])
@pytest.mark.parametrize("kind", [DriveTrain.DIFFERENTIAL, DriveTrain.ACKERMANN])
def test_those_that_cannot_go_sideways_come_round_to_the_course(
    kind: DriveTrain, course_rad: float
) -> None:
    chassis = Chassis(slip=0.0, kind=kind, reverse_m_s=1.0)
    wanted = Drive(cos(course_rad), sin(course_rad), tool_on=True)  # a tractor at work never backs
    _, way = drive(chassis, wanted, 40.0)
    *_, heading, vx, vy = way[-1]
    if kind is DriveTrain.ACKERMANN:
        assert remainder(heading - course_rad, 2 * pi) == pytest.approx(0.0, abs=0.02)
    assert (vx, vy) == pytest.approx((wanted.vx_m_s, wanted.vy_m_s), abs=0.03)
    sideways = [abs(-sin(a[2]) * b[3] + cos(a[2]) * b[4]) for a, b in pairwise(way)]
    assert max(sideways) < 0.02, "the wheels roll, they do not slide"


def test_a_tractor_turns_no_tighter_than_its_lock() -> None:
    chassis = TRACTOR._replace(slip=0.0)
    _, way = drive(chassis, Drive(-1.0, 0.01, tool_on=True), 30.0)
    tightest_m = min(
        hypot(vx, vy) * 0.01 / abs(b - a)
        for (_, _, a, _, _), (_, _, b, vx, vy) in pairwise(way[300:])
        if abs(b - a) > 1e-6
    )
    assert tightest_m == pytest.approx(chassis.turn_radius_m, rel=0.02)


def test_a_tractor_backs_up_only_with_its_implement_raised() -> None:
    for tool_on, backing in ((False, True), (True, False)):
        _, way = drive(TRACTOR._replace(slip=0.0), Drive(-0.5, 0.0, 0.0, tool_on), 3.0)
        _, _, heading, vx, vy = way[-1]
        ahead = cos(heading) * vx + sin(heading) * vy
        assert (ahead < -0.4) == backing
        assert (abs(heading) < 0.05) == backing


def test_a_tractor_cannot_turn_on_the_spot() -> None:
    _, way = drive(TRACTOR, Drive(0.0, 0.0, 1.0), 2.0)
    assert way[-1] == (0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("kind", "speed"), list(product(DriveTrain, (0.5, 2.5))))
def test_stands_within_the_stated_time(kind: DriveTrain, speed: float) -> None:
    chassis = Chassis(kind=kind, slip=0.02)
    world, _ = drive(chassis, Drive(9.0 * speed, 0.0), 4.0)
    begin_at_us = world.now_us
    world.body(0).drive(Drive(0.0, 0.0), begin_at_us)
    world.advance(begin_at_us + round(chassis.stopping_for_s * 1e6))
    assert hypot(*world.motion[0, 3:5]) < 1e-3
