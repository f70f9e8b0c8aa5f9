"""How a drive command becomes motion: wheels with limits and slip, for three kinds of drive train.

`agent/motion/wheel_kinematics.py` says how a command becomes wheel speeds. What the body then does is the
inverse of the wheels, with slip: the grip of each wheel wanders with a correlation time of `GRIP_S`. Its
chance is a hash of (robot's key, step, wheel), so it depends on nothing else that happens in the world.
"""

from math import cos, exp, hypot, sin, sqrt, tan
from struct import Struct
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from agent.interface.vehicle import DriveTrain
from agent.motion.wheel_kinematics import (
    MARGIN,
    ackermann_body,
    ackermann_wheels,
    differential_body,
    differential_wheels,
    mecanum_body,
    mecanum_wheels,
    pivot_course,
    tractor_course,
)

Floats = NDArray[np.float64]

STEP_US = 10_000
STEP_S = STEP_US / 1_000_000
GRIP_S = 0.2  # half a metre of ground at field speed
_KEEP = exp(-STEP_S / GRIP_S)
_FRESH = sqrt(1.0 - _KEEP * _KEEP)
# 0.7 g, rubber on dry ground: a robot that shoves another pushes with this at most.
TRACTION_M_S2 = 7.0
SPIN_RAD_S2 = 70.0  # the same, with wheels a decimetre from the middle


class Chassis(NamedTuple):
    """Dimensions and limits of a body on wheels."""

    wheel_radius_m: float = 0.10
    half_base_m: float = 0.30  # L
    half_track_m: float = 0.25  # W
    speed_m_s: float = 2.5
    acceleration_m_s2: float = 2.0
    slip: float = 0.02  # standard deviation of each wheel's grip
    braking_m_s2: float = 3.0  # on a command to stand, or when commands cease
    kind: DriveTrain = DriveTrain.MECANUM
    # Ackermann: how far ahead of the axle the point that follows the course lies.
    lead_m: float = 0.5
    steer_rad: float = 0.7  # Ackermann: full lock
    steer_rad_s: float = 0.8  # Ackermann: how fast the wheels are turned
    reverse_m_s: float = 1.0  # Ackermann: backing up

    @property
    def turn_radius_m(self) -> float:
        """Radius of the tightest circle; 0 for bodies that turn on the spot."""
        return (
            2 * self.half_base_m / tan(self.steer_rad) if self.kind is DriveTrain.ACKERMANN else 0.0
        )

    @property
    def stopping_for_s(self) -> float:
        """Upper limit of the time from full speed to standing wheels after a command to stand."""
        margin = 1.0 if self.kind is DriveTrain.ACKERMANN else MARGIN
        braking_m_s2 = min(margin * self.braking_m_s2, TRACTION_M_S2)
        return margin * self.speed_m_s / braking_m_s2 + 3 * STEP_S


TRACTOR = Chassis(0.4, 0.6, 0.5, 2.5, 1.0, 0.01, 3.0, DriveTrain.ACKERMANN, 1.2)

# One row of floats a robot. What is commanded, what the wheels do, and what they can do.
WANT_X, WANT_Y, WANT_TURN, WANT_TOOL, EXPIRES_US = range(5)
WHEEL, GRIP = 5, 9  # four each: front left, front right, rear left, rear right; or left, right; or
# axle, steering angle
TOOL, BACKING, COMMANDED_US = 13, 14, 15  # implement down; last step told to move
KIND, R, L, W, LIMIT, GAIN, BRAKE, SLIP, LEAD, STEER, STEER_S, REVERSE = range(16, 28)
JAMMED = 28  # an implement that is down stays down
COLUMNS = 29
COMMAND = Struct("5d").pack_into  # the first five, with a buffer and where the row begins
# One row of motion: the first six as the physics engine has them.
X, Y, HEADING, VX, VY, TURN, RADIUS = range(7)
MOTION = Struct("7d")


def row_of(chassis: Chassis) -> list[float]:
    """A robot's row before its first command."""
    margin = 1.0 if chassis.kind is DriveTrain.ACKERMANN else MARGIN
    row = [0.0] * COLUMNS
    row[EXPIRES_US] = row[COMMANDED_US] = -1.0
    row[KIND:JAMMED] = [
        float(chassis.kind),
        chassis.wheel_radius_m, chassis.half_base_m, chassis.half_track_m,
        margin * chassis.speed_m_s / chassis.wheel_radius_m,
        margin * chassis.acceleration_m_s2 / chassis.wheel_radius_m,
        margin * chassis.braking_m_s2 / chassis.wheel_radius_m,
        chassis.slip, chassis.lead_m, chassis.steer_rad, chassis.steer_rad_s, chassis.reverse_m_s,
    ]  # fmt: skip
    return row


@njit(cache=True, error_model="numpy")
def _noise(key, step, wheel):  # type: ignore[no-untyped-def]
    """Mean 0, deviation 1, within 3.5: four 16-bit numbers of one splitmix64 hash, added."""
    z = key + (np.uint64(step) * np.uint64(4) + np.uint64(wheel)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    low = np.uint64(0xFFFF)
    a, b, c, d = z & low, z >> np.uint64(16) & low, z >> np.uint64(32) & low, z >> np.uint64(48)
    return (float(a + b + c + d) / 65535.0 - 2.0) * 1.7320508075688772


@njit(cache=True, error_model="numpy")
def _wanted(row, ahead, left, turn):  # type: ignore[no-untyped-def]
    """Four wheel numbers for a body-frame command, within the wheels' limits."""
    kind = row[KIND]
    d = 0.0
    c = 0.0
    if kind == 0.0:
        a, b, c, d = mecanum_wheels(row[R], row[L] + row[W], ahead, left, turn)
    elif kind == 1.0:
        speed = hypot(ahead, left)
        forward = 0.0
        if speed > 1e-9:
            forward, turn, row[BACKING] = pivot_course(row[BACKING], speed, ahead, left, turn)
        a, b = differential_wheels(row[R], row[W], forward, turn)
    else:
        speed = hypot(ahead, left)
        if speed < 1e-9:
            return 0.0, row[WHEEL + 1], 0.0, 0.0
        forward, turn, row[BACKING] = tractor_course(
            row[BACKING], row[WANT_TOOL], row[REVERSE], row[LEAD], speed, ahead, left, turn
        )
        a, b = ackermann_wheels(row[R], row[L], forward, turn)
        a = min(max(a, -row[LIMIT]), row[LIMIT])
        return a, min(max(b, -row[STEER]), row[STEER]), 0.0, 0.0
    fastest = max(abs(a), abs(b), abs(c), abs(d))
    scale = row[LIMIT] / fastest if fastest > row[LIMIT] else 1.0
    return a * scale, b * scale, c * scale, d * scale


@njit(cache=True, error_model="numpy")
def _turn_wheels(row, a, b, c, d, still):  # type: ignore[no-untyped-def]
    """The wheels follow their wanted speeds as far as the torque of one step allows."""
    change = (row[BRAKE] if still else row[GAIN]) * STEP_S
    w = WHEEL
    if row[KIND] == 2.0:
        row[w] += min(max(a - row[w], -change), change)
        most = row[STEER_S] * STEP_S
        row[w + 1] += min(max(b - row[w + 1], -most), most)
        return
    da, db, dc, dd = a - row[w], b - row[w + 1], c - row[w + 2], d - row[w + 3]
    furthest = max(abs(da), abs(db), abs(dc), abs(dd))
    if furthest <= change:
        row[w], row[w + 1], row[w + 2], row[w + 3] = a, b, c, d
        return
    part = change / furthest
    row[w] += da * part
    row[w + 1] += db * part
    row[w + 2] += dc * part
    row[w + 3] += dd * part


@njit(cache=True, error_model="numpy")
def _push(m, vx, vy, turn, push):  # type: ignore[no-untyped-def]
    """The acceleration towards the motion of the wheels, as far as the tyres grip."""
    ax, ay, spin = (vx - m[VX]) / STEP_S, (vy - m[VY]) / STEP_S, (turn - m[TURN]) / STEP_S
    strength = hypot(ax, ay)
    part = TRACTION_M_S2 / strength if strength > TRACTION_M_S2 else 1.0
    push[0], push[1] = ax * part, ay * part
    push[2] = min(max(spin, -SPIN_RAD_S2), SPIN_RAD_S2)


@njit(cache=True, error_model="numpy")
def roll(rows, motion, keys, now_us, push):  # type: ignore[no-untyped-def]
    """One step of every robot's wheels, from the commands in force at `now_us`.

    `rows` holds a row of commands and limits for each robot, `motion` (robots, 7) its motion,
    `keys` (robots,) the seed of its slip. Writes the accelerations that follow (field frame: x, y,
    turn; m/s2 and rad/s2), one row of `push` a robot; returns how many implements went up or down.
    """
    step = now_us // STEP_US
    switched = 0
    for i in range(rows.shape[0]):
        row, m = rows[i], motion[i]
        live = now_us < row[EXPIRES_US]
        vx, vy, turn = (row[WANT_X], row[WANT_Y], row[WANT_TURN]) if live else (0.0, 0.0, 0.0)
        tool = row[WANT_TOOL] if live else 0.0
        if row[JAMMED] != 0.0 and row[TOOL] != 0.0:
            tool = row[TOOL]
        if tool != row[TOOL]:
            row[TOOL] = tool
            switched += 1
        still = vx == 0.0 and vy == 0.0 and turn == 0.0
        if not still:
            row[COMMANDED_US] = now_us
        cos_h, sin_h = cos(m[HEADING]), sin(m[HEADING])
        if still:
            a, b, c, d = 0.0, row[WHEEL + 1] if row[KIND] == 2.0 else 0.0, 0.0, 0.0
        else:
            a, b, c, d = _wanted(row, cos_h * vx + sin_h * vy, cos_h * vy - sin_h * vx, turn)
        _turn_wheels(row, a, b, c, d, still)
        slip = row[SLIP]
        if slip > 0.0:
            for k in range(4):
                row[GRIP + k] = _KEEP * row[GRIP + k] + _FRESH * slip * _noise(keys[i], step, k)
        g = GRIP
        fl, fr = row[WHEEL] * (1 + row[g]), row[WHEEL + 1] * (1 + row[g + 1])
        left = 0.0
        if row[KIND] == 0.0:
            rl, rr = row[WHEEL + 2] * (1 + row[g + 2]), row[WHEEL + 3] * (1 + row[g + 3])
            ahead, left, turn = mecanum_body(row[R], row[L] + row[W], fl, fr, rl, rr)
        elif row[KIND] == 1.0:
            ahead, turn = differential_body(row[R], row[W], fl, fr)
        else:
            ahead, turn = ackermann_body(row[R], row[L], fl, fr)
        vx, vy = cos_h * ahead - sin_h * left, sin_h * ahead + cos_h * left
        _push(m, vx, vy, turn, push[i])
    return switched
