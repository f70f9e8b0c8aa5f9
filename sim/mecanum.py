"""How a drive command becomes motion: four mecanum wheels with rollers at 45 degrees.

Wheel speeds from body velocity (x forward, y left, turn counter-clockwise), thesis section 5.2:

    w_fl = (vx - vy - (L + W) turn) / R      w_fr = (vx + vy + (L + W) turn) / R
    w_rl = (vx + vy - (L + W) turn) / R      w_rr = (vx - vy + (L + W) turn) / R

with wheel radius R and half the wheel base and track L and W. The wheels, not the body, have the
limits: speed and acceleration. What the body then does is the inverse, with slip.
"""

from math import cos, sin
from random import Random
from typing import NamedTuple

Wheels = tuple[float, float, float, float]  # front left, front right, rear left, rear right, rad/s


class Chassis(NamedTuple):
    wheel_radius_m: float = 0.10
    half_base_m: float = 0.30  # L
    half_track_m: float = 0.25  # W
    speed_m_s: float = 2.5  # straight ahead with every wheel at its limit
    acceleration_m_s2: float = 2.0
    slip: float = 0.02  # standard deviation of each wheel's grip


def wheel_speeds(chassis: Chassis, vx_m_s: float, vy_m_s: float, turn_rad_s: float) -> Wheels:
    arm_m_s = (chassis.half_base_m + chassis.half_track_m) * turn_rad_s
    r = chassis.wheel_radius_m
    return (
        (vx_m_s - vy_m_s - arm_m_s) / r, (vx_m_s + vy_m_s + arm_m_s) / r,
        (vx_m_s + vy_m_s - arm_m_s) / r, (vx_m_s - vy_m_s + arm_m_s) / r,
    )  # fmt: skip


def body_velocity(chassis: Chassis, wheels: Wheels) -> tuple[float, float, float]:
    """The least-squares inverse: what four rolling wheels make the body do."""
    fl, fr, rl, rr = wheels
    quarter = chassis.wheel_radius_m / 4
    arm_m = chassis.half_base_m + chassis.half_track_m
    return (
        quarter * (fl + fr + rl + rr),
        quarter * (-fl + fr + rl - rr),
        quarter * (-fl + fr - rl + rr) / arm_m,
    )


class Mecanum:
    """The wheels of one robot: they follow commands within their limits, and slip."""

    def __init__(self, chassis: Chassis, rng: Random) -> None:
        self.chassis, self._rng = chassis, rng
        self.wheels: Wheels = (0.0, 0.0, 0.0, 0.0)

    def step(
        self, heading_rad: float, vx_m_s: float, vy_m_s: float, turn_rad_s: float, dt_s: float
    ) -> tuple[float, float, float]:
        """Field-frame command to field-frame velocity after one step."""
        c, s = cos(heading_rad), sin(heading_rad)
        chassis = self.chassis
        wanted = wheel_speeds(
            chassis, c * vx_m_s + s * vy_m_s, -s * vx_m_s + c * vy_m_s, turn_rad_s
        )
        # Both axes at once may ask a wheel for more than straight ahead does: the whole command is
        # scaled, which keeps its direction.
        limit = 1.5 * chassis.speed_m_s / chassis.wheel_radius_m
        fastest = max(abs(w) for w in wanted)
        scale = limit / fastest if fastest > limit else 1.0
        change = 1.5 * chassis.acceleration_m_s2 / chassis.wheel_radius_m * dt_s
        furthest = max(abs(w * scale - now) for w, now in zip(wanted, self.wheels, strict=True))
        part = change / furthest if furthest > change else 1.0
        fl, fr, rl, rr = (
            now + (w * scale - now) * part for w, now in zip(wanted, self.wheels, strict=True)
        )
        self.wheels = (fl, fr, rl, rr)
        if max(abs(fl), abs(fr), abs(rl), abs(rr)) < 1e-9:
            return 0.0, 0.0, 0.0
        slip, gauss = chassis.slip, self._rng.gauss
        gripped = self.wheels
        if slip > 0.0:
            gripped = (
                fl * (1 + gauss(0.0, slip)), fr * (1 + gauss(0.0, slip)),
                rl * (1 + gauss(0.0, slip)), rr * (1 + gauss(0.0, slip)),
            )  # fmt: skip
        forward, left, turn = body_velocity(chassis, gripped)
        return c * forward - s * left, s * forward + c * left, turn
