"""Follows a sampled path with a steered body: forward speed and turn rate.

The steering looks ahead by the time that it takes to turn the wheels. So the wheels are turned when
an arc begins. A cross-track error is closed within a fixed length, not within a fixed time. So the
path is the same at any speed.
"""

from itertools import pairwise
from math import atan2, cos, hypot, inf, pi, remainder, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.interface.config import CONTROL_PERIOD_US, S

# Length in which a cross-track error is closed, critically damped. It is longer by `CLOSE_1_M` times
# speed divided by steering rate, because wheels take time to turn.
CLOSE_M = 0.6
CLOSE_1_M = 0.33
CLOSE_RAD_MAX = 0.5  # largest angle to the path while an error is closed
LATERAL_M_S2 = 1.0  # lateral acceleration that is comfortable, and far from tipping or slipping
WINDOW_M = 1.2  # a bend may begin over this length: an arc is then 5 cm off at its ends
WINDOW_ROWS = round(WINDOW_M / 0.1)
WINDOW_ENDS_M = -WINDOW_M / 2, WINDOW_M / 2
SLOWEST_M_S = 0.4  # bends are not planned slower than this
BACK_M_S = 0.9  # highest speed backward
# Where it has just stood, the body waits until its wheels are turned to within this curvature. A speed
# tells the chassis which way to turn them. The body moves by 4 cm meanwhile, at most.
TURNED_1_M, HOLD_M_S = 0.05, 0.02
QUICK_1_M_S = 2.0  # wheels that turn faster than this are not waited for
# This near to where it changed its gear, and not faster than this, the body has stood.
STOOD_M, STOOD_M_S = 0.1, 0.2
CREEP_M_S = 0.15  # lowest speed that is commanded
ARRIVED_M = 0.08  # this near to the end, the path is driven
LOST_M, LOST_RAD = 0.8, 1.2  # further off than this, the mission plans another path
BEND_HALF_M = 0.6  # a bend of a swath is rounded over this length on both sides
SEARCH = 40  # samples searched ahead of the last position
# Before the end of a path no error is allowed: work begins behind a run-up of 1.5 m.
SETTLED_M = 2.0
GEAR = 4  # column of the gear: 1 forward, -1 backward


class SteeringManner(NamedTuple):
    """How a path is steered: at work exactly, on the way soon."""

    share: float  # of the steering rate that plans use; the rest is for corrections
    preview_for_s: float  # the command is for the place where the body is after this
    preview_share: float  # or after this part of the time that the wheels take, if that is longer
    astray_rad: float  # off the path by more, the body slows down
    astray_m: float


AT_WORK = SteeringManner(0.7, 0.25, 0.0, 0.0, 0.0)
# The preview is half the time from lock to straight, and the delay of the command. Where wheels are
# turned, a path of arcs is left by 0.2 rad at any speed.
ON_THE_WAY = SteeringManner(0.85, 0.35, 0.4, 0.2, 0.1)


class SteeringLimits:
    """What the chassis allows: speed, deceleration, and rate of steering."""

    def __init__(self, speed_m_s: float, deceleration_m_s2: float, steer_1_m_s: float) -> None:
        """`steer_1_m_s`: change of curvature (1/m) in a second."""
        self.speed_m_s, self.deceleration_m_s2 = speed_m_s, deceleration_m_s2
        self.steer_1_m_s = steer_1_m_s


class SteeredWheels:
    """The curvature to which the wheels of a body are turned, from the commands that it was given.

    A path begins with the wheels as the one before left them, so this outlives a path.
    """

    def __init__(self, steer_1_m_s: float, lock_1_m: float = inf) -> None:
        """`steer_1_m_s`: change of curvature (1/m) in a second. `lock_1_m`: the greatest curvature."""
        self._change_1_m = steer_1_m_s * CONTROL_PERIOD_US / S
        self._lock_1_m = lock_1_m
        self.curvature_1_m = self.speed_m_s = 0.0

    def command(self, speed_m_s: float, turn_rad_s: float) -> None:
        """The command of a control period, metres (negative: backward) and radians a second."""
        self.speed_m_s = speed_m_s
        if speed_m_s == 0.0:
            return  # they stay as they are
        wanted_1_m = min(max(turn_rad_s / speed_m_s, -self._lock_1_m), self._lock_1_m)
        change_1_m = wanted_1_m - self.curvature_1_m
        self.curvature_1_m += min(max(change_1_m, -self._change_1_m), self._change_1_m)


class TractorTracker:
    """Progress along a sampled path, from its first row to its last.

    Call `locate` once each control period, then read `arrived`, `lost` and `command`.
    """

    def __init__(
        self, way: NDArray[np.float64], limits: SteeringLimits, end_m_s: float = 0.0,
        manner: SteeringManner = AT_WORK, wheels: SteeredWheels | None = None,
    ) -> None:  # fmt: skip
        """`way`: (n, 5) rows of x, y in metres, heading in radians, curvature in 1/m, and gear (1
        or -1), as `tractor_route.sampled` makes them; at least two. `limits`: of the chassis.
        `end_m_s`: speed at the end, for a path that another one continues. `manner`: how bends
        are steered. `wheels`: of the body, told by another part what is commanded; None: straight
        at the beginning, and all commands are ours.
        """
        assert way.shape[0] >= 2
        self.way, self.limits, self.manner = way, limits, manner
        gaps = np.hypot(np.diff(way[:, 0]), np.diff(way[:, 1]))
        self.along = np.concatenate([[0.0], np.cumsum(gaps)])
        self.total_m = float(self.along[-1])
        self.speeds = _speeds(way, self.along, limits, end_m_s, manner.share)
        self.points = [(float(x), float(y)) for x, y in way[[0, -1], :2]]
        self._own_wheels = SteeredWheels(limits.steer_1_m_s)
        self.wheels = wheels or self._own_wheels
        self.row = 0
        self._stood_m = 0.0  # along the way, where it last changed its gear
        self._holds = False  # it waits until its wheels are turned
        self.along_m = self.off_m = self.off_rad = self.gap_m = 0.0
        self.arrived = False

    @property
    def remaining_path(self) -> list[tuple[float, float]]:
        """The points that we have not passed, (x, y) metres, about one a metre."""
        rest = self.way[self.row + 1 :, :2]
        metre = max(1, round(rest.shape[0] / max(self.total_m - self.along_m, 1.0)))
        return [(float(x), float(y)) for x, y in (*rest[:-1:metre], *rest[-1:])]

    def locate(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """Find the nearest place on the path, not beyond the next change of gear and never back.

        It sets `row`, `along_m` (metres from the start), `off_m` (positive to the left), `off_rad`,
        `gap_m` and `arrived`.
        """
        way = self.way
        last = min(self.row + SEARCH, way.shape[0] - 1)
        shift = np.flatnonzero(way[self.row : last + 1, GEAR] != way[self.row, GEAR])
        end = self.row + int(shift[0]) - 1 if shift.size else last
        part = way[self.row : end + 1]
        row = self.row + int(np.argmin(np.hypot(part[:, 0] - x_m, part[:, 1] - y_m)))
        while True:
            px, py, heading, _, gear = way[row].tolist()
            t_m = gear * ((x_m - px) * cos(heading) + (y_m - py) * sin(heading))
            at_shift = row + 1 < way.shape[0] and float(way[row + 1, GEAR]) != gear
            if at_shift and t_m >= -ARRIVED_M:  # here the gear changes
                row += 1
                self.row, self._stood_m = row, float(self.along[row])
                continue
            break
        self.row = row
        self.gap_m = hypot(x_m - px, y_m - py)
        self.off_m = -(x_m - px) * sin(heading) + (y_m - py) * cos(heading)
        self.off_rad = remainder(heading_rad - heading, 2 * pi)
        self.along_m = min(max(float(self.along[row]) + t_m, 0.0), self.total_m)
        self.arrived = row >= way.shape[0] - 2 and self.total_m - self.along_m <= ARRIVED_M

    @property
    def aside_m(self) -> float:
        """The distance from the path, whose bends are round."""
        return abs(self.off_m)

    @property
    def lost(self) -> bool:
        """Whether the body is so far off that another path has to be planned."""
        return self.gap_m > LOST_M or abs(self.off_rad) > LOST_RAD

    def command(self) -> tuple[float, float]:
        """Speed (negative: backward) and turn rate, metres and radians a second; call `locate`
        first.
        """
        gear = float(self.way[self.row, GEAR])
        speed_m_s = float(self.speeds[self.row])
        if self.row + 1 < self.speeds.size:
            speed_m_s = min(speed_m_s, float(self.speeds[self.row + 1]) + 0.1)
        allowed_rad, allowed_m = self.manner.astray_rad, self.manner.astray_m
        if self.total_m - self.along_m < SETTLED_M:
            allowed_rad = allowed_m = 0.0
        astray = 1.5 * max(abs(self.off_rad) - allowed_rad, 0.0)
        astray = min(astray + max(abs(self.off_m) - allowed_m, 0.0), 0.7)
        speed_m_s = max(speed_m_s * (1.0 - astray), CREEP_M_S)
        close_m = CLOSE_M + CLOSE_1_M / self.limits.steer_1_m_s * speed_m_s
        curvature = self._curvature_ahead_1_m(speed_m_s, gear)
        steer = min(max(self.off_m / close_m, -CLOSE_RAD_MAX), CLOSE_RAD_MAX)
        # e' = v sin(psi): the angle to the way wanted is -steer ahead, +steer backing up.
        wanted_rad = -gear * steer
        turn = gear * speed_m_s * curvature
        turn += speed_m_s * 2.0 / close_m * (wanted_rad - self.off_rad)
        self._holds = (
            (self._holds or self._stands(gear))
            and self.limits.steer_1_m_s < QUICK_1_M_S
            and abs(curvature - self.wheels.curvature_1_m) > TURNED_1_M
        )
        if self._holds:
            speed_m_s, turn = HOLD_M_S, gear * HOLD_M_S * curvature
        self._own_wheels.command(gear * speed_m_s, turn)
        return gear * speed_m_s, turn

    def _curvature_ahead_1_m(self, speed_m_s: float, gear: float) -> float:
        """The curvature of the path where the body is when its wheels have followed a command."""
        ahead = self.way[self.row : self.row + WINDOW_ROWS]
        shifts = np.flatnonzero(ahead[:, GEAR] != gear)
        bends = ahead[: shifts[0] if shifts.size else None, 3].tolist()
        change_1_m = max(abs(bend_1_m - bends[0]) for bend_1_m in bends)
        preview_for_s = max(
            self.manner.preview_for_s,
            self.manner.preview_share * change_1_m / self.limits.steer_1_m_s,
        )
        return float(bends[min(1 + int(speed_m_s * preview_for_s / 0.1), len(bends) - 1)])

    def _stands(self, gear: float) -> bool:
        """Whether the body is where it changed its gear, or where a path from a stand begins."""
        return self.along_m - self._stood_m < STOOD_M and gear * self.wheels.speed_m_s < STOOD_M_S


def _speeds(
    way: NDArray[np.float64],
    along: NDArray[np.float64],
    limits: SteeringLimits,
    end_m_s: float,
    steer_share: float,
) -> NDArray[np.float64]:
    """Allowed speed at each sample (n,), metres a second: bends, changes of curvature and of gear,
    and braking for them.
    """
    count = way.shape[0]
    bend = np.sqrt(LATERAL_M_S2 / np.maximum(np.abs(way[:, 3]), 1e-6))
    speeds = np.minimum(bend, limits.speed_m_s)
    speeds[way[:, GEAR] < 0.0] = np.minimum(speeds[way[:, GEAR] < 0.0], BACK_M_S)
    # Curvature may change only as fast as the wheels are turned, and some of that is kept in reserve.
    # At a change of gear the body stands while they turn.
    shifts = [k for k in range(1, count) if way[k, GEAR] != way[k - 1, GEAR]]
    for first, end in pairwise([0, *shifts, count]):
        at, bends = along[first:end], way[first:end, 3]
        before, after = (np.interp(at + ahead_m, at, bends) for ahead_m in WINDOW_ENDS_M)
        rate = np.abs(after - before) / WINDOW_M
        most = steer_share * limits.steer_1_m_s / np.maximum(rate, 1e-6)
        speeds[first:end] = np.minimum(speeds[first:end], most)
    speeds = np.maximum(speeds, SLOWEST_M_S)
    for k in shifts:
        speeds[k - 1] = 0.0
    speeds[-1] = min(speeds[-1], end_m_s)
    for k in range(count - 2, -1, -1):
        reach = sqrt(
            speeds[k + 1] ** 2 + 2.0 * limits.deceleration_m_s2 * (along[k + 1] - along[k])
        )
        speeds[k] = min(speeds[k], reach)
    return speeds


def smooth_way(points: list[tuple[float, float]], half_m: float) -> NDArray[np.float64]:
    """A polyline of (x, y) points as a path ahead, with corners rounded over `half_m` to both
    sides.

    The result has rows as in `TractorTracker`, about every 0.1 m; the end points stay where they
    are.
    """
    line = np.array(points, dtype=np.float64)
    gaps = np.hypot(np.diff(line[:, 0]), np.diff(line[:, 1]))
    keep = np.concatenate([[True], gaps > 1e-6])
    line, gaps = line[keep], gaps[gaps > 1e-6]
    along = np.concatenate([[0.0], np.cumsum(gaps)])
    total = float(along[-1])
    count = max(3, int(total / 0.1) + 1)
    at = np.linspace(0.0, total, count)
    half = np.minimum(half_m, np.minimum(at, total - at))  # the ends stay where they are
    shares = np.linspace(-1.0, 1.0, 13)
    x = np.mean([np.interp(at + half * s, along, line[:, 0]) for s in shares], axis=0)
    y = np.mean([np.interp(at + half * s, along, line[:, 1]) for s in shares], axis=0)
    dx, dy = np.gradient(x), np.gradient(y)
    heading = np.unwrap(np.arctan2(dy, dx))
    curvature = np.gradient(heading) / np.maximum(np.hypot(dx, dy), 1e-6)
    return np.column_stack([x, y, heading, curvature, np.ones(count)])


def bend_speed_m_s(speed_m_s: float, radius_m: float) -> float:
    """The speed in an arc of this radius, for a body that drives straight at `speed_m_s`."""
    return min(speed_m_s, sqrt(LATERAL_M_S2 * radius_m))


def heading_of(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Direction from a to b, radians counter-clockwise from east."""
    return atan2(b[1] - a[1], b[0] - a[0])
