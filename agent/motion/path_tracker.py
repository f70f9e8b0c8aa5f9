"""Follows a polyline: computes the progress along it and the velocity that stays on it.

It is for a body that can move in any direction. The wanted velocity is along the line, plus what
closes the distance to it. The speed allows to stop at the end. The cross-track error decides
whether a unit counts as worked, so the correction is stiff.
"""

import itertools
from collections.abc import Sequence
from math import atan2, hypot, pi, sin, sqrt
from typing import Final, Protocol

from agent.interface.geometry import Point

POINT_M: Final = 1e-9  # a segment shorter than this is a point
# The cross-track error is closed with this rate. Control at 20 Hz is stable below about 10.
CLOSE_GAIN_1_S: Final = 2.0
ARRIVED_M: Final = 0.06  # a few centimetres: what a body at creep speed covers in a control period
ALIGN_M: Final = 0.12  # this far off the line, the robot does not advance before it is back
BESIDE_M: Final = 0.3  # passing the end further away than this is not arriving
SWING_M: Final = 0.03  # how far a body may swing out at a corner; a third of the usual tolerance
BEND_M: Final = 2.0  # corners further apart than this do not make a bend
# Share of the acceleration that goes into following a bend; the rest is for staying on it.
BEND_SHARE: Final = 0.5
# So much of acceleration is how far ahead of its speed the wanted one may be: a few control periods.
STEER_S: Final = 0.25
STEER_M: Final = 2.0  # a body at a few metres a second needs no longer way for it
SAMPLE_M: Final = 0.25  # sampling step of the line ahead: less than the width of any body
CREEP_M_S: Final = 0.1  # minimum approach speed at the end, so that arrival takes finite time


class FollowedWay(Protocol):
    """What trackers of any body tell of the way that they follow, metres."""

    points: list[Point]  # the last one is the end
    total_m: float
    along_m: float  # arc length of the nearest place
    off_m: float  # cross-track distance, positive to the left
    gap_m: float  # to the nearest place
    arrived: bool

    @property
    def aside_m(self) -> float:
        """The distance from the line; at a corner, from the nearer of both segments."""

    @property
    def remaining_path(self) -> list[Point]:
        """The points that we have not passed yet, (x, y) metres."""


class PathTracker:
    """Progress along one polyline of (x, y) points in metres."""

    def __init__(self, points: list[Point], speed_m_s: float, deceleration_m_s2: float) -> None:
        """`points`: at least one. `speed_m_s`: the highest speed. `deceleration_m_s2`: with which
        the body brakes for corners and the end.
        """
        assert len(points) >= 1
        self.points = points
        self.speed_m_s, self.deceleration_m_s2 = speed_m_s, deceleration_m_s2
        self.lengths_m = [hypot(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(points)]
        self._pieces = [  # where each segment begins, its direction, its length
            (a[0], a[1], (b[0] - a[0]) / length_m, (b[1] - a[1]) / length_m, length_m)
            if length_m >= POINT_M
            else (a[0], a[1], 0.0, 0.0, length_m)
            for (a, b), length_m in zip(itertools.pairwise(points), self.lengths_m, strict=True)
        ]
        self.starts_m = [0.0]
        for length_m in self.lengths_m:
            self.starts_m.append(self.starts_m[-1] + length_m)
        self.total_m = self.starts_m[-1]
        self.passing_m_s = self._passing_speeds()
        self.piece = 0  # the segment we are on; it only grows
        self.along_m = 0.0  # arc length of our projection
        self.off_m = 0.0  # cross-track distance, positive to the left
        self.gap_m = 0.0  # to the segment we are on, also before its beginning and after its end
        self.aside_m = 0.0  # from its line, or near its beginning from that of the segment before
        self.arrived = False

    def locate(self, x_m: float, y_m: float) -> None:
        """Project a position on the line; sets `along_m`, `off_m`, `gap_m`, `aside_m` and `arrived`.

        It may move on to later segments, never back to earlier ones.
        """
        while self.piece < len(self.lengths_m):
            ax, ay, ux, uy, length_m = self._pieces[self.piece]
            if length_m < POINT_M:
                self.piece += 1
                continue
            t_m = (x_m - ax) * ux + (y_m - ay) * uy
            self.off_m = (y_m - ay) * ux - (x_m - ax) * uy
            last = self.piece == len(self._pieces) - 1
            if t_m >= length_m - ARRIVED_M and not last:
                self.piece += 1
                continue
            beyond_m = -t_m if t_m < 0.0 else t_m - length_m if t_m > length_m else 0.0
            self.gap_m = hypot(self.off_m, beyond_m) if beyond_m else abs(self.off_m)
            self.aside_m = abs(self.off_m)
            if t_m < ARRIVED_M and self.piece:
                bx, by, vx, vy, before_m = self._pieces[self.piece - 1]
                if before_m >= POINT_M:
                    self.aside_m = min(self.aside_m, abs((y_m - by) * vx - (x_m - bx) * vy))
            t_m = 0.0 if t_m < 0.0 else length_m if t_m > length_m else t_m
            self.along_m = self.starts_m[self.piece] + t_m
            at_end = last and self.total_m - self.along_m <= ARRIVED_M
            x_end, y_end = self.points[-1]
            self.arrived = at_end and hypot(x_m - x_end, y_m - y_end) <= BESIDE_M
            return
        x_end, y_end = self.points[-1]  # nothing but a point is left
        self.off_m = self.gap_m = self.aside_m = hypot(x_m - x_end, y_m - y_end)
        self.arrived = self.off_m <= ARRIVED_M
        self.along_m = self.total_m if self.arrived else max(0.0, self.total_m - 2 * ARRIVED_M)

    @property
    def direction(self) -> Point:
        """The unit vector of the segment we are on; (0, 0) if only a point is left."""
        return self._pieces[self.piece][2:4] if self.piece < len(self._pieces) else (0.0, 0.0)

    @property
    def remaining_path(self) -> list[Point]:
        """The points that we have not passed yet, (x, y) metres."""
        return self.points[self.piece + 1 :]

    @property
    def next_corner(self) -> Point:
        """The end of the segment we are on, (x, y) metres."""
        return self.points[min(self.piece + 1, len(self.points) - 1)]

    def towards_corner(self, x_m: float, y_m: float) -> Point:
        """The velocity straight to the end of our segment, (x, y) metres a second; `locate` first."""
        x_end, y_end = self.next_corner
        dx_m, dy_m = x_end - x_m, y_end - y_m
        distance_m = hypot(dx_m, dy_m)
        if distance_m < POINT_M or self.piece >= len(self._pieces):
            return self._towards(x_m, y_m, self.points[-1])
        speed_m_s = self._speed(distance_m)
        return dx_m / distance_m * speed_m_s, dy_m / distance_m * speed_m_s

    def velocity(self, x_m: float, y_m: float, moving: Point | None = None) -> Point:
        """The wanted velocity here, (x, y) metres a second; call `locate` first.

        `moving`: our velocity now. If it is given, the body behind a corner first ends its motion
        across the line, and gains speed along it with what is left of its acceleration.
        """
        if self.piece >= len(self._pieces):
            return self._towards(x_m, y_m, self.points[-1])
        ax, ay, ux, uy, length_m = self._pieces[self.piece]
        t_m = (x_m - ax) * ux + (y_m - ay) * uy
        if abs(self.off_m) > 1.0 or t_m < -1.0 or t_m > length_m:  # far: go where it can be joined
            join_m = min(max(t_m, 0.0) + 0.5, length_m)
            return self._towards(x_m, y_m, (ax + ux * join_m, ay + uy * join_m))
        close_m_s = -CLOSE_GAIN_1_S * self.off_m
        close_m_s = min(max(close_m_s, -self.speed_m_s), self.speed_m_s)
        room_m_s = sqrt(self.speed_m_s**2 - close_m_s**2)
        aligned = max(0.0, 1.0 - abs(self.off_m) / ALIGN_M)
        forward_m_s = min(self._speed(length_m - t_m) * aligned, room_m_s)
        if moving is not None and self.piece and t_m < STEER_M:
            now_m_s, aside_m_s = moving[0] * ux + moving[1] * uy, moving[1] * ux - moving[0] * uy
            gain_m_s = self.deceleration_m_s2 * STEER_S - abs(close_m_s - aside_m_s)
            forward_m_s = min(forward_m_s, max(now_m_s, 0.0) + max(gain_m_s, CREEP_M_S))
        return ux * forward_m_s - uy * close_m_s, uy * forward_m_s + ux * close_m_s

    def ahead(self, reach_m: float) -> list[tuple[float, float, float, float]]:
        """Samples of the line from our projection on, every `SAMPLE_M` up to `reach_m`.

        Each is x, y in metres and the unit vector ux, uy of the line's direction there.
        """
        found: list[tuple[float, float, float, float]] = []
        along_m = self.along_m
        for piece in range(self.piece, len(self.lengths_m)):
            start_m = self.starts_m[piece]
            ax, ay, ux, uy, length_m = self._pieces[piece]
            if length_m < POINT_M:
                continue
            while along_m <= start_m + length_m:
                if along_m > self.along_m + reach_m:
                    return found
                t_m = along_m - start_m
                found.append((ax + ux * t_m, ay + uy * t_m, ux, uy))
                along_m += SAMPLE_M
        return found

    def _speed(self, left_m: float) -> float:
        """The highest speed that still allows to brake for the corners and the end ahead."""
        pass_m_s = self.passing_m_s[self.piece + 1]
        brake_m_s = sqrt(pass_m_s**2 + 2.0 * self.deceleration_m_s2 * max(left_m - 0.02, 0.0))
        return max(min(self.speed_m_s, brake_m_s), CREEP_M_S)

    def _passing_speeds(self) -> list[float]:
        """Allowed speed at each point: the body swings out at a corner by less than `SWING_M`, and
        it can brake for the next slower point.
        """
        count = len(self.points)
        speeds = [self.speed_m_s] * count
        speeds[-1] = 0.0
        for k in range(1, count - 1):
            turn_rad = abs(turn_at(*self.points[k - 1 : k + 2]))
            swing_m_s = sqrt(2.0 * self.deceleration_m_s2 * SWING_M)
            if turn_rad < 1e-3:
                continue
            # A corner by itself, or one of many that make a bend: the bend's curvature counts then.
            swing = swing_m_s / sin(min(turn_rad, pi / 2))
            bend_m = min(self.lengths_m[k - 1] + self.lengths_m[k], BEND_M) / 2
            bend = sqrt(BEND_SHARE * self.deceleration_m_s2 * bend_m / turn_rad)
            speeds[k] = min(self.speed_m_s, swing, bend)
        for k in range(count - 2, -1, -1):
            reach_m_s = sqrt(speeds[k + 1] ** 2 + 2.0 * self.deceleration_m_s2 * self.lengths_m[k])
            speeds[k] = min(speeds[k], reach_m_s)
        return speeds

    def _towards(self, x_m: float, y_m: float, target: Point) -> Point:
        dx_m, dy_m = target[0] - x_m, target[1] - y_m
        distance_m = hypot(dx_m, dy_m)
        if distance_m < 1e-6:
            return 0.0, 0.0
        speed_m_s = min(self.speed_m_s, sqrt(2.0 * self.deceleration_m_s2 * distance_m))
        speed_m_s = min(max(speed_m_s, CREEP_M_S), distance_m / 0.05)
        return dx_m / distance_m * speed_m_s, dy_m / distance_m * speed_m_s


def turn_at(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> float:
    """How far a way from a over b to c turns at b: radians, positive to the left, -pi to pi."""
    turn_rad = atan2(c[1] - b[1], c[0] - b[0]) - atan2(b[1] - a[1], b[0] - a[0])
    return (turn_rad + pi) % (2 * pi) - pi
