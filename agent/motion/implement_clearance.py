"""When the implement has to be up, and how much clearance a working robot needs.

A lowered implement is a bar at right angles to the course. A raised one is folded and no wider than
the body. A working robot knows the positions of other bodies from their beats. It raises its
implement before it hits one, and the units that it passes meanwhile are worked again. To avoid
this, others keep as far from a working robot as the bar reaches. Robots that are nearer already, as
at the start, come no nearer.
"""

from collections.abc import Sequence
from math import hypot
from typing import Final

from agent.interface.geometry import Point
from agent.interface.observation import Observation
from agent.motion.deadlock_yield import NEAR_M, NearbyRobot

# A stretch is entered this far before its first unit and left this far after its last one. A robot
# arrives at a point only within centimetres; without a lead that much of the work would be left out.
LEAD_M: Final = 0.3
DEPTH_M: Final = 0.25  # of the bar along the course, before and behind the middle
# How far two robots close in on each other in a control period, plus the rounding of poses.
AHEAD_M: Final = 0.3
ASIDE_M: Final = 0.1  # the rounding of poses, and a robot's cross-track error
COMING_M: Final = 0.15  # how far a robot moves in a control period, with the rounding of its pose
MOVES_M_S: Final = 0.2  # slower robots keep their last course, and soon take the requested one
# A robot that is pushed about slowly turns its bar with its course, which is noise then. So the bar is
# up if it would meet a body with any of its last courses.
STEADY_M_S: Final = 0.6  # a faster robot cannot turn its course about within a few periods
COURSES: Final = 3
EQUAL_COS: Final = 0.95  # of two courses that are nearly equal
# Robots that travel keep this much more from a working robot than makes its bar go up. Avoidance plans
# for the course of a moment, and bars turn with their courses.
KEEP_M: Final = 0.4
NOT_NEARER_M: Final = 0.02  # a robot that is too near already keeps its distance less this


class Implement:
    """The bar that a robot carries: how far others keep from it, and when it has to be raised."""

    def __init__(self, half_m: float, radius_m: float) -> None:
        """`half_m`: from the middle of the robot to an end of the bar; 0 if there is no bar.
        `radius_m`: radius of every body.
        """
        self.has = half_m > radius_m
        self._bar_m = half_m
        self._half_m, self._depth_m = half_m + ASIDE_M, DEPTH_M + AHEAD_M
        self._radius_m = radius_m
        self._courses: tuple[Point, ...] = ()  # the last ones, without those that are nearly equal
        self.aside_m = self._half_m + radius_m  # past a working robot, from line to line
        # A robot that keeps this clearance may be stalled at a gap this wide.
        self.near_m = max(NEAR_M, self.aside_m - 2 * radius_m + ASIDE_M) if self.has else NEAR_M
        # A unit whose line is this far from a body can be worked.
        self.reach_m = hypot(self._half_m, self._depth_m) + radius_m + LEAD_M if self.has else 0.0

    def combined_m(self, apart_m: float, bodies_m: float) -> float:
        """Distance to keep from a working robot, middle to middle, for a robot that travels.

        `apart_m`: the distance now. `bodies_m`: the distance to keep without a bar.
        """
        return (
            max(bodies_m, min(self.aside_m + KEEP_M, apart_m - NOT_NEARER_M))
            if self.has
            else bodies_m
        )

    def must_be_up(
        self,
        here: Observation,
        wanted: tuple[float, float],
        others: Sequence[NearbyRobot],
        slot: int = 0,
    ) -> bool:
        """Whether a body is, or may come within a control period, where the bar is, or whether it
        meets the bar of a working robot with a lower slot, which keeps its bar down.

        `wanted`: the velocity that the mission wants, (x, y) metres a second. `others`: the robots
        near by. `slot`: ours.
        """
        if not self.has:
            return False
        speed_m_s, wanted_m_s = hypot(here.vx_m_s, here.vy_m_s), hypot(*wanted)
        if speed_m_s > MOVES_M_S:
            ux, uy = here.vx_m_s / speed_m_s, here.vy_m_s / speed_m_s
            slow = speed_m_s < STEADY_M_S
            apart = [c for c in self._courses if slow and c[0] * ux + c[1] * uy < EQUAL_COS]
            self._courses = ((ux, uy), *apart[: COURSES - 1])
        courses = [*self._courses]
        if speed_m_s <= MOVES_M_S and wanted_m_s > 0.0:
            courses.append((wanted[0] / wanted_m_s, wanted[1] / wanted_m_s))
        return any(
            self._meets(course, other)
            or (other.slot < slot and other.at_work and self._crosses(course, other))
            for other in others
            for course in courses
        )

    def _crosses(self, course: tuple[float, float], other: NearbyRobot) -> bool:
        """Whether our bar overlaps that of a working robot: no line along one of their sides
        separates them.
        """
        ux, uy, vx, vy = *course, other.ux, other.uy
        if vx == vy == 0.0 or abs(other.dx_m) + abs(other.dy_m) > 4 * self._bar_m:
            return False
        along, across = abs(ux * vx + uy * vy), abs(ux * vy - uy * vx)
        half_m, depth_m = self._bar_m, DEPTH_M + COMING_M
        aligned_m = depth_m + along * depth_m + across * half_m
        beside_m = half_m + along * half_m + across * depth_m
        dx, dy = other.dx_m, other.dy_m
        return (
            abs(dx * ux + dy * uy) < aligned_m
            and abs(dx * uy - dy * ux) < beside_m
            and abs(dx * vx + dy * vy) < aligned_m
            and abs(dx * vy - dy * vx) < beside_m
        )

    def _meets(self, course: tuple[float, float], other: NearbyRobot) -> bool:
        ux, uy = course
        ahead_m = abs(other.dx_m * ux + other.dy_m * uy) - self._depth_m
        aside_m = abs(other.dx_m * uy - other.dy_m * ux) - self._half_m
        return hypot(max(ahead_m, 0.0), max(aside_m, 0.0)) < self._radius_m
