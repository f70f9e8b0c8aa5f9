"""When the implement has to be up, and how much clearance a working robot needs.

A lowered implement is a bar at right angles to the course; raised, it is folded and no wider than
the body. A working robot knows the positions of other bodies from their beats and raises its
implement before it hits one; the units it passes meanwhile are worked again. To avoid this, others
keep as far from a working robot as the bar reaches. Robots that are nearer already, as at the start,
come no nearer.
"""

from collections.abc import Sequence
from math import hypot
from typing import Final

from agent.interface.ports import Observation
from agent.motion.deadlock_yield import NEAR_M, NearbyRobot

LEAD_M: Final = (
    0.3  # a stretch is entered before its first unit and left after its last: arriving at a
)


DEPTH_M: Final = 0.25  # along the course, before and behind the middle
AHEAD_M: Final = (
    0.3  # what two robots close in on each other in a period, and the rounding of poses
)
ASIDE_M: Final = 0.1  # the rounding of poses, and a robot's cross-track error
MOVES_M_S: Final = 0.2  # slower robots keep their last course, and soon take the requested one
NOT_NEARER_M: Final = 0.02  # within the distance that is there


class Implement:
    def __init__(self, half_m: float, radius_m: float) -> None:
        """`half_m`: from the middle of the robot to an end of the bar; 0 if there is no bar.
        `radius_m`: radius of every body."""
        self.has = half_m > radius_m
        self._half_m, self._depth_m = half_m + ASIDE_M, DEPTH_M + AHEAD_M
        self._radius_m = radius_m
        self._course = 0.0, 0.0  # the last one
        self._aside_m = self._half_m + radius_m
        # A robot that keeps this clearance may be stalled at a gap this wide.
        self.near_m = max(NEAR_M, self._aside_m - 2 * radius_m + ASIDE_M) if self.has else NEAR_M
        # A unit whose line is this far from a body can be worked.
        self.reach_m = hypot(self._half_m, self._depth_m) + radius_m + LEAD_M if self.has else 0.0

    def combined_m(self, apart_m: float, bodies_m: float) -> float:
        """Distance to keep from a working robot, for a robot that travels `apart_m` away from it."""
        return max(bodies_m, min(self._aside_m, apart_m - NOT_NEARER_M)) if self.has else bodies_m

    def must_be_up(
        self, here: Observation, wanted: tuple[float, float], others: Sequence[NearbyRobot]
    ) -> bool:
        """Whether a body is, or may come within a period, where the bar is."""
        if not self.has:
            return False
        speed_m_s, wanted_m_s = hypot(here.vx_m_s, here.vy_m_s), hypot(*wanted)
        if speed_m_s > MOVES_M_S:
            self._course = here.vx_m_s / speed_m_s, here.vy_m_s / speed_m_s
        courses = [self._course]
        if speed_m_s <= MOVES_M_S and wanted_m_s > 0.0:
            courses.append((wanted[0] / wanted_m_s, wanted[1] / wanted_m_s))
        return any(self._meets(course, other) for other in others for course in courses)

    def _meets(self, course: tuple[float, float], other: NearbyRobot) -> bool:
        ux, uy = course
        ahead_m = abs(other.dx_m * ux + other.dy_m * uy) - self._depth_m
        aside_m = abs(other.dx_m * uy - other.dy_m * ux) - self._half_m
        return hypot(max(ahead_m, 0.0), max(aside_m, 0.0)) < self._radius_m
