"""From a wish to a drive: neighbours, limits, and the velocity that harms nobody.

The pipeline of one control period ends here, except for the safety gate, which comes after and is
the last word. Neighbours are believed where their last beat puts them, moved on by its age, with a
margin for what the wire rounds off. A neighbour that stands takes no share: we avoid it alone.
"""

from collections.abc import Mapping
from math import cos, hypot, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.config import CONTROL_PERIOD_US, MS, NEIGHBOURS_MAX, S
from agent.effects import Drive
from agent.membership import Neighbour
from agent.mission import Wish
from agent.orca import Avoidance
from agent.ports import Observation

MARGIN_M = 0.15  # POSE rounds to 0.05 m, a drive takes a period to act, wheels slip
HORIZON_S = 4.0  # how far ahead two moving robots agree to be clear of each other
STANDING_M_S = 0.05  # slower than this a neighbour cannot be relied on to give way
AGE_MAX_US = 1 * S  # an older pose is not moved on: the robot may have stopped
FENCE_M = 0.1  # kept from fences and holes
WANTS_M_S = 0.1  # a robot that wants less than this is not stalled
GOT_ON_M = 0.3  # moved this far: no stall
PATIENCE_US = 2 * S
PATIENCE_STEP_US = 150 * MS  # by slot: one of two begins, and often the other need not
NEAR_M = 1.5  # a gap wider than this does not stall anybody
DETOUR_US = 3 * S
DETOUR_RAD = 1.2
DETOUR_SHARE = 0.5  # of full speed
AGAIN_US = 10 * S


class Limits(NamedTuple):
    """What the body is and can do."""

    radius_m: float
    speed_m_s: float
    acceleration_m_s2: float


class Motion:
    def __init__(self, slot: int, limits: Limits, fences: NDArray[np.float64]) -> None:
        """`fences`: segments nobody passes, (n, 4): ax, ay, bx, by in metres."""
        self.slot, self.limits = slot, limits
        self.avoidance = Avoidance(
            limits.radius_m + FENCE_M, limits.speed_m_s, 0.5 * limits.acceleration_m_s2,
            HORIZON_S, CONTROL_PERIOD_US / S, fences,
        )  # fmt: skip
        # Nobody further away can be met within the horizon, both at full speed.
        self.reach_m = 2 * limits.speed_m_s * HORIZON_S + 2 * limits.radius_m
        self.detours = 0
        self._anchor = (0.0, 0.0)  # where we were when we last got on
        self._anchor_us = 0
        self._detour_us = 0  # we go round somebody until then
        self._side = -1.0  # right

    def drive(
        self, here: Observation, wish: Wish, neighbours: Mapping[int, Neighbour], now_us: int
    ) -> Drive:
        rows = self._rows(here, neighbours, now_us)
        wanted = self._limited(wish)
        tool_on = wish.tool_on
        if self._stalled(here, wanted, rows, now_us):
            wanted, tool_on = self._round(wanted), False
        vx_m_s, vy_m_s = self.avoidance.velocity(
            (here.x_m, here.y_m), (here.vx_m_s, here.vy_m_s), wanted, rows
        )
        return Drive(vx_m_s, vy_m_s, wish.turn_rad_s, tool_on)

    def _stalled(
        self, here: Observation, wanted: tuple[float, float], rows: list[tuple[float, ...]], now_us: int
    ) -> bool:
        """Two that stand nose to nose both go round to the right; the next time to the other side."""
        if now_us < self._detour_us:
            return True
        away_m = hypot(here.x_m - self._anchor[0], here.y_m - self._anchor[1])
        if away_m > GOT_ON_M or hypot(*wanted) < WANTS_M_S:
            self._anchor, self._anchor_us = (here.x_m, here.y_m), now_us
            return False
        if now_us - self._anchor_us < PATIENCE_US + self.slot * PATIENCE_STEP_US:
            return False
        near_m = 2 * self.limits.radius_m + NEAR_M
        if not any(row[0] * row[0] + row[1] * row[1] < near_m * near_m for row in rows):
            return False
        if now_us - self._detour_us < AGAIN_US:
            self._side = -self._side  # it did not help: try the other side
        self._detour_us, self._anchor_us = now_us + DETOUR_US, now_us + DETOUR_US
        self.detours += 1
        return True

    def _round(self, wanted: tuple[float, float]) -> tuple[float, float]:
        speed_m_s = max(hypot(*wanted), 1e-9)
        scale = DETOUR_SHARE * self.limits.speed_m_s / speed_m_s
        c, s = cos(DETOUR_RAD), self._side * sin(DETOUR_RAD)
        return (c * wanted[0] - s * wanted[1]) * scale, (s * wanted[0] + c * wanted[1]) * scale

    def _rows(
        self, here: Observation, neighbours: Mapping[int, Neighbour], now_us: int
    ) -> list[tuple[float, ...]]:
        near: list[tuple[float, ...]] = []
        combined_m = 2 * self.limits.radius_m + MARGIN_M
        for pose, heard_us in neighbours.values():
            dx_m, dy_m = pose.x_m - here.x_m, pose.y_m - here.y_m
            if abs(dx_m) > self.reach_m or abs(dy_m) > self.reach_m:
                continue
            speed_m_s, share = pose.speed_m_s, 1.0
            vx_m_s = vy_m_s = 0.0
            age_us = now_us - heard_us
            if speed_m_s > STANDING_M_S and age_us < AGE_MAX_US and not pose.stopped:
                vx_m_s, vy_m_s = speed_m_s * cos(pose.course_rad), speed_m_s * sin(pose.course_rad)
                dx_m, dy_m = dx_m + vx_m_s * age_us / S, dy_m + vy_m_s * age_us / S
                share = 0.5
            near.append((dx_m, dy_m, vx_m_s, vy_m_s, combined_m, share))
        near.sort(key=lambda row: row[0] * row[0] + row[1] * row[1])
        return near[:NEIGHBOURS_MAX]

    def _limited(self, wish: Wish) -> tuple[float, float]:
        speed_m_s = hypot(wish.vx_m_s, wish.vy_m_s)
        if speed_m_s <= self.limits.speed_m_s:
            return wish.vx_m_s, wish.vy_m_s
        scale = self.limits.speed_m_s / speed_m_s
        return wish.vx_m_s * scale, wish.vy_m_s * scale
