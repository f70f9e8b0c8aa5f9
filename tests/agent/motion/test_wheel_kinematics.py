"""Wheel speeds of a command: driven by an integrator of its own, a body goes where it was told."""

from math import atan2, cos, hypot, pi, remainder, sin, tan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.interface.effects import HALT, Drive
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.motion.wheel_kinematics import WheelBase, WheelDrive, WheelSpeeds

angle = st.floats(-pi, pi)
STEP_S = 0.05
RADIUS_M = 0.1


def moved(base: WheelBase, told: WheelSpeeds, heading_rad: float) -> tuple[float, float, float]:
    """Velocity in the field and turn rate of a body whose wheels do at once what they are told."""
    wheels = [each * base.wheel_radius_m for each in told.wheels_rad_s]
    left_m_s = 0.0
    if base.drive is DriveTrain.MECANUM:
        fl, fr, rl, rr = wheels
        ahead_m_s, left_m_s = sum(wheels) / 4, (fr - fl + rl - rr) / 4
        turn_rad_s = (fr + rr - fl - rl) / 4 / (base.half_base_m + base.half_track_m)
    elif base.drive is DriveTrain.DIFFERENTIAL:
        ahead_m_s, turn_rad_s = sum(wheels) / 2, (wheels[1] - wheels[0]) / 2 / base.half_track_m
    else:
        ahead_m_s = wheels[0]
        turn_rad_s = ahead_m_s * tan(told.steer_rad) / 2 / base.half_base_m
    c, s = cos(heading_rad), sin(heading_rad)
    return ahead_m_s * c - left_m_s * s, ahead_m_s * s + left_m_s * c, turn_rad_s


@pytest.mark.parametrize("drive", DriveTrain)
@settings(deadline=None)  # the first call compiles
@given(course_rad=angle, heading_rad=angle, speed_m_s=st.floats(0.2, 2.0))
def test_a_body_reaches_its_course(
    drive: DriveTrain, course_rad: float, heading_rad: float, speed_m_s: float
) -> None:
    base = WheelBase.of(Vehicle(drive=drive), RADIUS_M)
    wheels = WheelDrive(base)
    command = Drive(speed_m_s * cos(course_rad), speed_m_s * sin(course_rad), tool_on=True)
    vx = vy = 0.0
    for _ in range(round(30 / speed_m_s / STEP_S)):
        vx, vy, turn_rad_s = moved(base, wheels.speeds(command, heading_rad), heading_rad)
        heading_rad += turn_rad_s * STEP_S
    assert hypot(vx, vy) == pytest.approx(speed_m_s, rel=0.02)
    assert abs(remainder(atan2(vy, vx) - course_rad, 2 * pi)) < 0.02


@settings(deadline=None)
@given(
    vx=st.floats(-9, 9), vy=st.floats(-9, 9), turn=st.floats(-9, 9), heading_rad=angle
)  # fmt: skip
def test_wheels_at_their_limit_keep_the_direction(
    vx: float, vy: float, turn: float, heading_rad: float
) -> None:
    base = WheelBase.of(Vehicle(drive=DriveTrain.MECANUM), RADIUS_M)
    told = WheelDrive(base).speeds(Drive(vx, vy, turn), heading_rad)
    assert max(map(abs, told.wheels_rad_s)) <= base.fastest_rad_s * (1 + 1e-12)
    got = moved(base, told, heading_rad)
    share = max(
        (abs(g / w) for g, w in zip(got, (vx, vy, turn), strict=True) if abs(w) > 1e-3), default=0
    )
    assert got == pytest.approx([share * each for each in (vx, vy, turn)], abs=2e-2)


@pytest.mark.parametrize("drive", DriveTrain)
def test_halt_is_still_wheels(drive: DriveTrain) -> None:
    wheels = WheelDrive(WheelBase.of(Vehicle(drive=drive), RADIUS_M))
    told = wheels.speeds(HALT, 1.0)
    assert set(told.wheels_rad_s) == {0.0} and told == wheels.still


def test_a_tractor_that_stands_keeps_its_steering_angle() -> None:
    wheels = WheelDrive(WheelBase.of(Vehicle(drive=DriveTrain.ACKERMANN), RADIUS_M))
    steer_rad = wheels.speeds(Drive(0.0, 1.0), 0.0).steer_rad
    assert steer_rad > 0.1 and wheels.speeds(HALT, 0.0).steer_rad == steer_rad
