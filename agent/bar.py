"""The implement of a robot that turns on the spot: a bar across its way, and where all of it has worked.

The bar lies at right angles to the robot's motion. Where a robot comes onto its line from the side, one
end of the bar is ahead of the middle and the other behind: what an end has not passed is not worked,
wherever the middle is.
"""

from math import hypot, inf
from typing import Final

from agent.config import CONTROL_PERIOD_US, S

Point = tuple[float, float]

STROKE_M: Final = 0.05  # a shorter move has no direction worth a name
LEAP_M: Final = 0.1  # further than at one and a half times the full speed, nobody drove here
LEAP_SHARE: Final = 1.5


class Bar:
    def __init__(self, width_m: float) -> None:
        self.half_m = width_m / 2
        self.down_from_m = inf  # along the leg; from there on all of it has worked, without a gap
        self.slant_m = self.half_m  # how far one end is behind the middle, along the line
        self._from: Point | None = None  # of the stroke under way, with the implement down
        self._seen: tuple[float, float, int] | None = None

    def leaps(self, at: Point, now_us: int, speed_m_s: float) -> bool:
        """Asked every control period: somebody has moved the robot, over ground that was not worked."""
        before, self._seen = self._seen, (*at, now_us)
        if before is None:
            return False
        passed_us = max(now_us - before[2], CONTROL_PERIOD_US)
        reach_m = LEAP_SHARE * speed_m_s * passed_us / S + LEAP_M
        return hypot(at[0] - before[0], at[1] - before[1]) > reach_m

    def lower(self, at: Point) -> None:
        """The implement comes down here."""
        self.down_from_m, self.slant_m, self._from = inf, self.half_m, at

    def draw(self, at: Point, along_m: float, course: Point) -> None:
        """It was down all the way to here; the line goes there, as a unit vector."""
        begun = at if self._from is None else self._from
        dx_m, dy_m = at[0] - begun[0], at[1] - begun[1]
        length_m = hypot(dx_m, dy_m)
        if length_m < STROKE_M:
            return
        self._from = at
        across_m = abs(dx_m * course[1] - dy_m * course[0])
        self.slant_m = self.half_m * across_m / length_m
        begun_m = along_m - (dx_m * course[0] + dy_m * course[1])
        if begun_m + self.slant_m < self.down_from_m:
            self.down_from_m = begun_m + self.slant_m
