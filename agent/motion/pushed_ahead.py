"""How a robot gets out of the way of a working robot that pushes it ahead.

A working robot has the right of way. A robot before it that wants to go the other way is driven back
as fast as the working robot comes, by ORCA. Between that robot's row and a fence it cannot step aside,
and it would be pushed to the end of the row. So after a while it drives ahead aslant, to the side that
has room, until the implement can pass.
"""

from collections.abc import Sequence
from math import ceil, cos, hypot, radians, sin
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.avoidance.fence_distance import way_gap_m
from agent.interface.config import S
from agent.interface.geometry import Point
from agent.motion.deadlock_yield import NearbyRobot

PUSHED_M_S: Final = 0.3  # a robot that drives back this fast, against its wish, is pushed
PUSHED_US: Final = 2 * S  # longer than making way for one that crosses
ASIDE_US: Final = 6 * S  # for the width of an implement and of two bodies, aslant
# From the course of the robot that pushes. At 25 degrees a tenth of the speed is lost ahead.
ASLANT_RAD: Final = radians(25.0)
STEP_M: Final = 0.5  # sampling step on the way aside
CLEAR_M: Final = 0.15  # from fences, beside the body


class PushedAhead:
    """One robot that a working robot may push ahead of it."""

    def __init__(
        self, radius_m: float, speed_m_s: float, aside_m: float, fences: NDArray[np.float64]
    ) -> None:
        """`radius_m`: of our body. `speed_m_s`: the highest of ours. `aside_m`: from its line to ours
        when its implement passes us. `fences`: segments (n, 4) of ax, ay, bx, by in metres.
        """
        self.radius_m, self.speed_m_s, self.aside_m = radius_m, speed_m_s, aside_m
        self.fences = fences
        self._began_at_us: int | None = None
        self._ends_at_us = 0
        self._side = 0.0  # 1: to the left of its course, -1: to the right

    def observe(self, wanted: Point, driven: Point, now_us: int) -> None:
        """Once each control period: the velocity that we want and the one that we drive, (x, y)
        metres a second.
        """
        along_m_s = (wanted[0] * driven[0] + wanted[1] * driven[1]) / max(hypot(*wanted), 0.1)
        if along_m_s > -PUSHED_M_S:
            self._began_at_us = None
        elif self._began_at_us is None:
            self._began_at_us = now_us
        elif now_us - self._began_at_us >= PUSHED_US:
            self._ends_at_us, self._began_at_us, self._side = now_us + ASIDE_US, None, 0.0

    def wish(self, at: Point, others: Sequence[NearbyRobot], now_us: int) -> Point | None:
        """The velocity aslant, (x, y) metres a second; None for a robot that is not pushed, or that
        has no room on either side. `at`: our position, metres.
        """
        if now_us >= self._ends_at_us:
            return None
        behind = [o for o in others if o.at_work and o.dx_m * o.ux + o.dy_m * o.uy < 0.0]
        if not behind:
            self._ends_at_us = 0
            return None
        other = min(behind, key=lambda o: o.distance_m)
        left_m = other.dx_m * other.uy - other.dy_m * other.ux  # of its line
        if abs(left_m) >= self.aside_m:
            self._ends_at_us = 0
            return None
        near = 1.0 if left_m > 0.0 else -1.0
        if self._side == 0.0:
            sides = [side for side in (near, -near) if self._has_room(at, other, side, left_m)]
            if not sides:
                self._ends_at_us = 0
                return None
            self._side = sides[0]
        angle_rad = self._side * ASLANT_RAD
        ahead_m_s, left_m_s = self.speed_m_s * cos(angle_rad), self.speed_m_s * sin(angle_rad)
        ux, uy = other.ux, other.uy
        return ux * ahead_m_s - uy * left_m_s, uy * ahead_m_s + ux * left_m_s

    def _has_room(self, at: Point, other: NearbyRobot, side: float, left_m: float) -> bool:
        """Whether no fence is on the way aslant to where the implement passes us."""
        if self.fences.size == 0:
            return True
        way_m = (self.aside_m - side * left_m) / sin(ASLANT_RAD)
        c, s = cos(side * ASLANT_RAD), sin(side * ASLANT_RAD)
        ux, uy = other.ux * c - other.uy * s, other.uy * c + other.ux * s
        gap_m: float = way_gap_m(at[0], at[1], ux, uy, STEP_M, ceil(way_m / STEP_M), self.fences)
        return gap_m > self.radius_m + CLEAR_M
