"""Which way round the bar of an implement swings at the corners of a leg.

The bar is at right angles to the motion, so it turns with it, by the shorter way. A robot that is pushed
back at a corner may turn the other way round: the bar then passes over the two quarters of the disc
that the leg does not need, and ground beside the corner is left.

A course is the direction of a move of `COURSE_M`. Where such moves begin decides what a small detour is,
and nobody can say where a real bar begins to follow. So several courses are followed, each begun a little
later, and all of them have to agree.
"""

from itertools import pairwise
from math import atan2, ceil, hypot, inf, pi, radians
from typing import Final

from agent.interface.geometry import Point

# Shorter moves have no reliable direction: slip, and coming to rest.
COURSE_M: Final = 0.05
BEGUN_EACH_M: Final = 0.005
COURSES: Final = 10
# A turn of more than 170 degrees is reversing, at which the bar does not swing.
REVERSED_COS: Final = -0.985
# Reversing leaves out what such a turn has less than half a turn. More than this in all is ground left.
LEFT_OUT_RAD: Final = radians(5.0)
# A course that is nearer to the line than this tells how often the bar has turned; at right angles to
# the line it could be either of two ways.
NEAR_COS: Final = 0.7
# So near to a corner of its leg a robot follows its courses. Before it, each is taken at least once.
WATCHED_M: Final = 0.5
# On a shorter side of the leg a course belongs to several sides, so the turns are compared behind it.
SIDE_M: Final = 4 * COURSE_M
# A longer step is a jump of the place, or a pause.
STEP_MAX_M: Final = 0.3
assert COURSES * BEGUN_EACH_M <= COURSE_M < WATCHED_M / 2


class Course:
    """The turns of one bar along one leg."""

    def __init__(self, begins_m: float) -> None:
        """`begins_m`: after so much motion, metres."""
        self._left_m = begins_m
        self._from: Point | None = None
        self._course: Point | None = None
        self._turned_rad = 0.0  # more than the line at its beginning
        self._half_turns: int | None = None  # more than the line here
        self._forwards_on: Line | None = None  # the segment on which it last drove forwards

    def moves(self, at: Point, moved_m: float, line: "Line", first: "Line") -> bool:
        """Whether the bar has turned the long way round since the last call, or left out an angle.

        `at`: where the robot is now, (x, y) metres. `moved_m`: since the last call. `line`: where it
        is on its leg, and `first`: the beginning of that."""
        if self._from is None:
            self._left_m -= moved_m
            if self._left_m <= 0.0:
                self._from = at
            return False
        dx_m, dy_m = at[0] - self._from[0], at[1] - self._from[1]
        way_m = hypot(dx_m, dy_m)
        if way_m < COURSE_M:
            return False
        cx, cy = dx_m / way_m, dy_m / way_m
        self._from = at
        if self._course is None:
            self._turned_rad = _turn_rad(first[1], first[2], cx, cy)
        else:
            was_x, was_y = self._course
            if was_x * cx + was_y * cy > REVERSED_COS:
                self._turned_rad += _turn_rad(was_x, was_y, cx, cy)
        self._course = cx, cy
        line_rad, ux, uy, behind_sharp, length_m = line
        if length_m < SIDE_M:
            return False
        along = ux * cx + uy * cy
        if abs(along) < NEAR_COS:
            return False
        if along > 0.0:
            self._forwards_on = line
        elif behind_sharp and self._forwards_on is not line:
            return False  # it has not turned yet: towards such a corner is backwards on its segment
        # Seen along the line, whether the robot drives forwards or backwards.
        off_rad = atan2((ux * cy - uy * cx) / along, 1.0)
        more_rad = self._turned_rad - line_rad - off_rad
        before, self._half_turns = self._half_turns, round(more_rad / pi)
        left_out = abs(more_rad - self._half_turns * pi) > LEFT_OUT_RAD
        return left_out or (before is not None and before != self._half_turns)


# A segment: the angle by which the leg has turned since its beginning, its direction, a unit vector, and
# whether the corner before it is so sharp that a robot on its way there seems to drive backwards on it,
# and its length in metres.
Line = tuple[float, float, float, bool, float]


class BarSwing:
    """The turns of the bar at the corners of one leg, from the places of the robot."""

    def __init__(self, points: list[Point]) -> None:
        """`points`: of the leg, (x, y) metres."""
        self._line: list[Line] = []  # by segment
        self._corners_m: list[float] = []
        turned_rad = was_x = was_y = ux = uy = along_m = 0.0
        side_x = side_y = 0.0  # the direction of the last segment on which the turns are compared
        for (ax, ay), (bx, by) in pairwise(points):
            length_m = hypot(bx - ax, by - ay)
            if length_m > 0.0:
                was_x, was_y, ux, uy = ux, uy, (bx - ax) / length_m, (by - ay) / length_m
                turned_rad += _turn_rad(was_x, was_y, ux, uy)
            sharp = min(was_x * ux + was_y * uy, side_x * ux + side_y * uy) < -NEAR_COS
            self._line.append((turned_rad, ux, uy, sharp, length_m))
            if length_m >= SIDE_M:
                side_x, side_y = ux, uy
            self._corners_m.append(along_m)
            along_m += length_m
        self._corners_m = self._corners_m[1:]
        self._first = next(
            (line for line in self._line if line[1] or line[2]), (0.0, 1.0, 0.0, False, inf)
        )
        self.wrongly = False  # it has turned the long way round a corner
        self._at: Point | None = None
        self._courses: list[Course] = []

    def restart(self) -> None:
        """The implement was up: nothing before counts."""
        self.wrongly = False
        self._at = None

    def observe(self, piece: int, along_m: float, x_m: float, y_m: float) -> None:
        """Take account of the place of the robot, `along_m` on segment `piece` of the leg."""
        if not any(abs(corner_m - along_m) < WATCHED_M for corner_m in self._corners_m):
            self._at = None
            return
        was_x_m, was_y_m = self._at or (inf, inf)
        dx_m, dy_m = x_m - was_x_m, y_m - was_y_m
        moved_m = hypot(dx_m, dy_m)
        self._at = x_m, y_m
        if moved_m > STEP_MAX_M:
            self._courses = [Course(k * BEGUN_EACH_M) for k in range(COURSES)]
            return
        line = self._line[min(piece, len(self._line) - 1)]
        parts = ceil(moved_m / BEGUN_EACH_M)
        for part in range(1, parts + 1):
            at = was_x_m + dx_m * part / parts, was_y_m + dy_m * part / parts
            for course in self._courses:
                if course.moves(at, moved_m / parts, line, self._first):
                    self.wrongly = True


def _turn_rad(was_x: float, was_y: float, ux: float, uy: float) -> float:
    """The angle between two directions, positive to the left, by the shorter way."""
    return atan2(was_x * uy - was_y * ux, was_x * ux + was_y * uy)
