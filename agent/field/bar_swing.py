"""Which way round the bar of an implement swings at the corners of a leg.

The bar is at right angles to the motion, so it turns with it, by the shorter way. A robot that is pushed
back at a corner may turn the other way round: the bar then passes over the two quarters of the disc
that the leg does not need, and ground beside the corner is left.
"""

from itertools import pairwise
from math import atan2, hypot, pi
from typing import Final

from agent.field.section_shares import Point

# Shorter moves have no reliable direction: slip, and coming to rest.
COURSE_M: Final = 0.05
# A turn of more than 170 degrees is reversing, at which the bar does not swing.
REVERSED_COS: Final = -0.985
# A course that is nearer to the line than this tells how often the bar has turned; at right angles to
# the line it could be either of two ways.
NEAR_COS: Final = 0.7


class BarSwing:
    """The turns of the bar along one leg, from the velocity of the body."""

    def __init__(self, points: list[Point]) -> None:
        """`points`: of the leg, (x, y) metres."""
        # By segment: the angle by which the line has turned since its beginning, and its direction.
        self._line: list[tuple[float, float, float]] = []
        turned_rad = ux = uy = 0.0
        for (ax, ay), (bx, by) in pairwise(points):
            length_m = hypot(bx - ax, by - ay)
            if length_m > 0.0:
                was_x, was_y, ux, uy = ux, uy, (bx - ax) / length_m, (by - ay) / length_m
                turned_rad += _turn_rad(was_x, was_y, ux, uy)
            self._line.append((turned_rad, ux, uy))
        self._first = next((line for line in self._line if line[1] or line[2]), (0.0, 1.0, 0.0))
        self.wrongly = False  # it has turned the long way round a corner
        self._x_m = self._y_m = 0.0  # moved since the course was taken
        self._course: Point | None = None
        self._turned_rad = 0.0  # more than the line at its beginning
        self._half_turns: int | None = None  # more than the line here

    def restart(self) -> None:
        """The implement was up: nothing before counts."""
        self._x_m = self._y_m = 0.0
        self._course = self._half_turns = None
        self.wrongly = False

    def observe(self, piece: int, vx_m_s: float, vy_m_s: float, for_s: float) -> None:
        """Take account of the motion of `for_s` seconds on segment `piece` of the leg."""
        self._x_m += vx_m_s * for_s
        self._y_m += vy_m_s * for_s
        moved_m = hypot(self._x_m, self._y_m)
        if moved_m < COURSE_M:
            return
        cx, cy = self._x_m / moved_m, self._y_m / moved_m
        self._x_m = self._y_m = 0.0
        if self._course is None:
            self._turned_rad = _turn_rad(self._first[1], self._first[2], cx, cy)
        else:
            was_x, was_y = self._course
            if was_x * cx + was_y * cy > REVERSED_COS:
                self._turned_rad += _turn_rad(was_x, was_y, cx, cy)
        self._course = cx, cy
        line_rad, ux, uy = self._line[min(piece, len(self._line) - 1)]
        along = ux * cx + uy * cy
        if abs(along) < NEAR_COS:
            return
        # Seen along the line, whether the robot drives forwards or backwards.
        off_rad = atan2((ux * cy - uy * cx) / along, 1.0)
        half_turns = round((self._turned_rad - line_rad - off_rad) / pi)
        if self._half_turns is not None and half_turns != self._half_turns:
            self.wrongly = True
        self._half_turns = half_turns


def _turn_rad(was_x: float, was_y: float, ux: float, uy: float) -> float:
    """The angle between two directions, positive to the left, by the shorter way."""
    return atan2(was_x * uy - was_y * ux, was_x * ux + was_y * uy)
