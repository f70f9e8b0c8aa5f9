"""The ground that a lowered bar sweeps until the robot can stand.

The bar lies through the middle of its robot, at right angles to the course. So it sweeps a strip ahead,
and at a corner the two quarters between its old and its new direction. A robot that is nearly at rest may
turn its course anyhow, so its bar may sweep the whole disc. That of a steered body sweeps a bend.
"""

from collections.abc import Sequence
from math import ceil, cos, hypot, sin
from typing import Final

from agent.interface.geometry import Point
from agent.motion.implement_clearance import COMING_M, DEPTH_M, MOVES_M_S

# Beyond the ends of the bar: a person who walks comes this much nearer until the bar is up.
ASIDE_M: Final = 0.3
BEFORE_M: Final = 0.15  # and this much more ahead of it
STEP_M: Final = 0.25  # between the places on a bend
LEAST_1_M: Final = 0.01  # a bend of less curvature is straight: 3 cm off in 2.5 m
# At a turn of more than 170 degrees the bar does not swing: the robot reverses.
REVERSED_COS: Final = -0.985


class SweptGround:
    """What the bar of one robot may sweep, as offsets from its middle."""

    def __init__(
        self, half_m: float, motions: Sequence[Point], way_m: float, bend_1_m: float
    ) -> None:
        """`half_m`: of the bar. `motions`: velocities that the body has or may have next, (x, y) metres
        a second. `way_m`: until it can stand. `bend_1_m`: curvature of its way, positive to the left.
        """
        self.side_m, self.depth_m = half_m + ASIDE_M, DEPTH_M + COMING_M
        self.ahead_m = way_m + DEPTH_M + BEFORE_M
        self._way_m, self._bend_1_m = way_m, bend_1_m
        self._courses: list[Point] = []
        slowest_m_s = MOVES_M_S
        for vx_m_s, vy_m_s in motions:
            speed_m_s = hypot(vx_m_s, vy_m_s)
            if speed_m_s > 0.0:
                self._courses.append((vx_m_s / speed_m_s, vy_m_s / speed_m_s))
            slowest_m_s = min(slowest_m_s, speed_m_s)
        self._may_turn = not self._courses or slowest_m_s < MOVES_M_S
        bends = abs(bend_1_m) > LEAST_1_M
        reach_m = self.ahead_m if not bends else way_m + self.side_m
        self.reach_m = hypot(reach_m, self.side_m)  # no point is further away

    def has(self, dx_m: float, dy_m: float) -> bool:
        """Whether this point may be swept."""
        far_m = hypot(dx_m, dy_m)
        if far_m > self.reach_m:
            return False
        if self._may_turn and far_m <= self.side_m:
            return True
        for ux, uy in self._courses:
            along_m, across_m = dx_m * ux + dy_m * uy, dy_m * ux - dx_m * uy
            if -self.depth_m <= along_m <= self.ahead_m and abs(across_m) <= self.side_m:
                return True
            if abs(self._bend_1_m) > LEAST_1_M and self._is_on_bend(along_m, across_m):
                return True
        return far_m <= self.side_m and self._swings_over(dx_m, dy_m)

    def _is_on_bend(self, along_m: float, across_m: float) -> bool:
        """Whether the bar of a steered body comes there. `along_m`, `across_m`: from its middle."""
        count = ceil(self._way_m / STEP_M)
        for k in range(1, count + 1):
            turned_rad = self._bend_1_m * self._way_m * k / count
            c, s = cos(turned_rad), sin(turned_rad)
            ahead_m, aside_m = along_m - s / self._bend_1_m, across_m - (1.0 - c) / self._bend_1_m
            before_m = abs(ahead_m * c + aside_m * s)
            # The outer end of the bar is faster than the middle.
            step_m = STEP_M * (1.0 + self.side_m * abs(self._bend_1_m)) / 2
            if (
                before_m <= max(self.depth_m, step_m)
                and abs(aside_m * c - ahead_m * s) <= self.side_m
            ):
                return True
        return False

    def _swings_over(self, dx_m: float, dy_m: float) -> bool:
        """Whether the bar passes over this point near by when the course turns the shorter way."""
        if len(self._courses) < 2:
            return False
        (ux, uy), (vx, vy) = self._courses[0], self._courses[-1]
        if ux * vx + uy * vy < REVERSED_COS:
            return False
        return (dx_m * ux + dy_m * uy) * (dx_m * vx + dy_m * vy) <= 0.0
