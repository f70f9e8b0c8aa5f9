"""Wheel speeds and steering angles from body velocities, and back, for three kinds of drive train.

Body frame: x forward, y left, turn counter-clockwise. Wheel radius R, half the wheel base L, half
the track W, metres; wheels in rad/s.

* Mecanum, rollers at 45 degrees (thesis section 5.2); goes anywhere without turning:

      w_fl = (vx - vy - (L + W) turn) / R      w_fr = (vx + vy + (L + W) turn) / R
      w_rl = (vx + vy - (L + W) turn) / R      w_rr = (vx - vy + (L + W) turn) / R

* Differential: w_left = (vx - W turn) / R, w_right = (vx + W turn) / R. It turns to the commanded
  course on the spot, front or back foremost, whichever is nearer, and drives as far as it points
  there: slower than commanded, but never off the course.
* Ackermann (a tractor): rear axle driven, front wheels steered, angle = atan(2 L turn / vx). It
  turns to the commanded course as fast as its steering allows and never on the spot. It backs up
  only when told to go almost straight back with the implement raised.

Limits belong to the wheels, not to the body: a command that asks too much of one wheel is scaled as
a whole, which keeps its direction. The simulator's bodies and the drivers of machines use these.
"""

from math import atan, atan2, cos, hypot, pi, radians, sin, tan
from typing import Any, Final, NamedTuple

from agent.interface.effects import Drive
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.kernels.kernel import njit

MARGIN = 1.5  # wheels can do this much more than straight ahead asks: a diagonal needs 1.41
BACK_RAD, FORTH_RAD = 2.6, 2.0  # further off its course a tractor backs up; nearer it goes forward
# A differential drive; between the two it keeps its present direction.
BACK_FOREMOST_RAD, FRONT_FOREMOST_RAD = 1.8, 1.3
PIVOT_PER_S = 4.0  # a differential drive turns this share of its course error per second
CREEP = 0.4  # share of the wanted speed that a tractor keeps while it turns towards its course
REVERSE_M_S: Final = 1.0  # an Ackermann body that backs up
LEAD_M: Final = 1.2  # Ackermann: how far ahead of the axle the point that follows the course lies


@njit(cache=True, error_model="numpy")
def mecanum_wheels(r: float, arm_m: float, vx: float, vy: float, turn: float) -> Any:
    """Wheel speeds from body velocity; `arm_m` is L + W."""
    a = arm_m * turn
    return (vx - vy - a) / r, (vx + vy + a) / r, (vx + vy - a) / r, (vx - vy + a) / r


@njit(cache=True, error_model="numpy")
def mecanum_body(r: float, arm_m: float, fl: float, fr: float, rl: float, rr: float) -> Any:
    """Body velocity (forward m/s, left m/s, turn rad/s) from wheel speeds in rad/s: the
    least-squares inverse. `r` is the wheel radius, metres; `fl`, `fr`, `rl`, `rr` are front and
    rear, left and right."""
    q = r / 4
    return q * (fl + fr + rl + rr), q * (-fl + fr + rl - rr), q * (-fl + fr - rl + rr) / arm_m


@njit(cache=True, error_model="numpy")
def differential_wheels(r: float, half_track_m: float, vx: float, turn: float) -> Any:
    """Speeds of the left and the right wheel, rad/s, for `vx` in m/s and `turn` in rad/s. `r` is
    the wheel radius, metres."""
    return (vx - half_track_m * turn) / r, (vx + half_track_m * turn) / r


@njit(cache=True, error_model="numpy")
def differential_body(r: float, half_track_m: float, left: float, right: float) -> Any:
    """Speed ahead, m/s, and turn rate, rad/s, of two wheels with radius `r` metres that turn with
    `left` and `right` rad/s."""
    return r * (left + right) / 2, r * (right - left) / (2 * half_track_m)


@njit(cache=True, error_model="numpy")
def ackermann_wheels(r: float, half_base_m: float, vx: float, turn: float) -> Any:
    """Axle speed in rad/s and steering angle in radians for `vx` in m/s and `turn` in rad/s;
    straight ahead where it stands. `r` is the wheel radius, metres."""
    steer = atan(2 * half_base_m * turn / vx) if abs(vx) > 1e-9 else 0.0
    return vx / r, steer


@njit(cache=True, error_model="numpy")
def ackermann_body(r: float, half_base_m: float, axle: float, steer: float) -> Any:
    """Speed ahead, m/s, and turn rate, rad/s, for an axle with radius `r` metres that turns with
    `axle` rad/s, and a steering angle `steer` in radians."""
    return r * axle, r * axle * tan(steer) / (2 * half_base_m)


@njit(cache=True, error_model="numpy")
def tractor_course(
    backing: float, tool: float, reverse_m_s: float, lead_m: float,
    speed: float, ahead: float, left: float, turn: float,
) -> Any:  # fmt: skip
    """Forward speed, m/s, and turn rate, rad/s, of an Ackermann body for a commanded course, and
    whether it backs up from now on (1.0 or 0.0).

    `speed` (m/s) and `turn` (rad/s) are those of the command; `ahead` and `left` are its velocity in
    the body frame, m/s. `backing`: 1.0 if it backs up so far. `tool`: 1.0 if the implement is down.
    """
    off = atan2(left, ahead)
    if backing == 0.0 and abs(off) > BACK_RAD and tool == 0.0:
        backing = 1.0
    elif backing == 1.0 and (abs(off) < FORTH_RAD or tool != 0.0):
        backing = 0.0
    if backing == 1.0:
        off = off - pi if off > 0.0 else off + pi
        speed = min(speed, reverse_m_s)
    along = max(cos(off), CREEP) * speed
    across = sin(off) if abs(off) < pi / 2 else (1.0 if off > 0.0 else -1.0)
    turn += speed * across / lead_m
    return (-along if backing == 1.0 else along), turn, backing


@njit(cache=True, error_model="numpy")
def pivot_course(backing: float, speed: float, ahead: float, left: float, turn: float) -> Any:
    """Forward speed, m/s, and turn rate, rad/s, of a differential body for a commanded course, and
    whether its back is foremost from now on (1.0 or 0.0).

    `speed` (m/s) and `turn` (rad/s) are those of the command; `ahead` and `left` are its velocity in
    the body frame, m/s. `backing`: 1.0 if its back is foremost so far.
    """
    off = atan2(left, ahead)
    if backing == 0.0 and abs(off) > BACK_FOREMOST_RAD:
        backing = 1.0
    elif backing == 1.0 and abs(off) < FRONT_FOREMOST_RAD:
        backing = 0.0
    if backing == 1.0:
        off = off - pi if off > 0.0 else off + pi
    along = speed * cos(2 * off) if abs(off) < pi / 4 else 0.0
    return (-along if backing == 1.0 else along), turn + PIVOT_PER_S * off, backing


class WheelBase(NamedTuple):
    """Dimensions and limits of the wheels of a vehicle."""

    drive: DriveTrain
    wheel_radius_m: float
    half_base_m: float  # L: front to rear axle, halved
    half_track_m: float  # W: left to right wheel, halved
    fastest_rad_s: float  # of a wheel
    steer_rad: float = radians(40.0)  # Ackermann: full lock
    lead_m: float = LEAD_M
    reverse_m_s: float = REVERSE_M_S

    @classmethod
    def of(cls, vehicle: Vehicle, wheel_radius_m: float) -> "WheelBase":
        """The wheels of a declared vehicle."""
        margin = MARGIN if vehicle.drive is DriveTrain.MECANUM else 1.0
        return cls(
            vehicle.drive, wheel_radius_m, vehicle.wheelbase_m / 2, vehicle.track_m / 2,
            margin * vehicle.speed_m_s / wheel_radius_m, vehicle.steer_rad,
        )  # fmt: skip


class WheelSpeeds(NamedTuple):
    """A command in terms of one drive train, for the controller of its motors."""

    wheels_rad_s: tuple[
        float, ...
    ]  # front left, front right, rear left, rear right; or left, right; or axle
    steer_rad: float = 0.0  # Ackermann: angle of the front wheels, left positive


class WheelDrive:
    """Turns each command in the field frame into wheel speeds. It remembers which way round it drives."""

    def __init__(self, base: WheelBase) -> None:
        self.base = base
        self._backing = 0.0
        self._steer_rad = 0.0

    @property
    def still(self) -> WheelSpeeds:
        """Wheels that do not turn; the front wheels of an Ackermann body keep their angle."""
        count = {DriveTrain.MECANUM: 4, DriveTrain.DIFFERENTIAL: 2, DriveTrain.ACKERMANN: 1}
        return WheelSpeeds((0.0,) * count[self.base.drive], self._steer_rad)

    def speeds(self, command: Drive, heading_rad: float) -> WheelSpeeds:
        """The wheel speeds of a command for a body with this heading, counter-clockwise from east."""
        base = self.base
        vx, vy, turn = command.vx_m_s, command.vy_m_s, command.turn_rad_s
        if vx == 0.0 and vy == 0.0 and (turn == 0.0 or base.drive is DriveTrain.ACKERMANN):
            return self.still
        cos_h, sin_h = cos(heading_rad), sin(heading_rad)
        ahead, left, speed = cos_h * vx + sin_h * vy, cos_h * vy - sin_h * vx, hypot(vx, vy)
        r = base.wheel_radius_m
        if base.drive is DriveTrain.MECANUM:
            wheels = mecanum_wheels(r, base.half_base_m + base.half_track_m, ahead, left, turn)
            return WheelSpeeds(_scaled(wheels, base.fastest_rad_s))
        if base.drive is DriveTrain.DIFFERENTIAL:
            forward = 0.0
            if speed > 0.0:
                forward, turn, self._backing = pivot_course(self._backing, speed, ahead, left, turn)
            wheels = differential_wheels(r, base.half_track_m, forward, turn)
            return WheelSpeeds(_scaled(wheels, base.fastest_rad_s))
        forward, turn, self._backing = tractor_course(
            self._backing, float(command.tool_on), base.reverse_m_s, base.lead_m, speed, ahead, left, turn
        )  # fmt: skip
        axle, steer = ackermann_wheels(r, base.half_base_m, forward, turn)
        self._steer_rad = min(max(steer, -base.steer_rad), base.steer_rad)
        return WheelSpeeds(_scaled((axle,), base.fastest_rad_s), self._steer_rad)


def _scaled(wheels: tuple[float, ...], fastest_rad_s: float) -> tuple[float, ...]:
    """All of them slower by the same share if one is asked for more than it can do."""
    most = max(abs(each) for each in wheels)
    return tuple(each * fastest_rad_s / most for each in wheels) if most > fastest_rad_s else wheels
