"""From a wish to a drive: neighbours, limits, and the velocity that harms nobody.

The pipeline of one control period ends here, except for the safety gate, which comes after and is
the last word. Neighbours are believed where their last beat puts them, moved on by its age, with a
margin for what the wire rounds off.
"""

from collections.abc import Mapping
from math import cos, hypot, sin
from typing import NamedTuple

from agent.config import CONTROL_PERIOD_US, NEIGHBOUR_RANGE_M
from agent.effects import Drive
from agent.membership import Neighbour
from agent.mission import Wish
from agent.orca import Avoidance
from agent.ports import Observation

ROUNDING_M = 0.05  # POSE carries 0.05 m; half of it each way, twice
AGE_MAX_US = 1_000_000  # an older pose is taken as standing still where it was last seen
COAST_RANGE_M = NEIGHBOUR_RANGE_M  # beyond, nobody is a danger within the horizon at our speeds


class Limits(NamedTuple):
    """What the body can do, with its safety margin inside `radius_m`."""

    radius_m: float
    speed_m_s: float
    acceleration_m_s2: float


class Motion:
    def __init__(self, slot: int, limits: Limits) -> None:
        self.slot, self.limits = slot, limits
        self.avoidance = Avoidance(limits.radius_m + ROUNDING_M, limits.speed_m_s)

    def drive(
        self, here: Observation, wish: Wish, neighbours: Mapping[int, Neighbour], now_us: int
    ) -> Drive:
        reach_m = max(COAST_RANGE_M, 3.0 * self.limits.speed_m_s)
        rows = []
        for slot, (pose, heard_us) in neighbours.items():
            dx_m, dy_m = pose.x_m - here.x_m, pose.y_m - here.y_m
            if dx_m * dx_m + dy_m * dy_m > reach_m * reach_m:
                continue
            rows.append(self._row(slot, pose, now_us - heard_us))
        vx_m_s, vy_m_s = self._limited(here, wish)
        if rows:
            vx_m_s, vy_m_s = self.avoidance.velocity(here, (vx_m_s, vy_m_s), rows)
        return Drive(vx_m_s, vy_m_s, wish.turn_rad_s, wish.tool_on)

    def _row(self, slot: int, pose: object, age_us: int) -> tuple[float, ...]:
        raise NotImplementedError

    def _limited(self, here: Observation, wish: Wish) -> tuple[float, float]:
        """The wish within what the body can reach in one period."""
        vx_m_s, vy_m_s = wish.vx_m_s, wish.vy_m_s
        speed_m_s = hypot(vx_m_s, vy_m_s)
        if speed_m_s > self.limits.speed_m_s:
            vx_m_s *= self.limits.speed_m_s / speed_m_s
            vy_m_s *= self.limits.speed_m_s / speed_m_s
        return vx_m_s, vy_m_s


_ = (cos, sin, CONTROL_PERIOD_US)
