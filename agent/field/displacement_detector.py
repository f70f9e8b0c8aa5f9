"""Detects that the robot was displaced: it could not have driven here since the last control
period.

The units in between were passed without work, even on a straight line. A robot that is pushed along
its row must not count the push as driving.
"""

from math import hypot
from typing import Final

from agent.interface.config import CONTROL_PERIOD_US, S

Point = tuple[float, float]

LEAP_M: Final = 0.1  # a jump longer than this plus the way at 1.5 times full speed is no driving
LEAP_SHARE: Final = 1.5


class DisplacementDetector:
    """Compares each position of one robot with the one before."""

    def __init__(self) -> None:
        self._seen: tuple[float, float, int] | None = None

    def observe(self, at: Point, now_us: int, speed_m_s: float) -> bool:
        """Whether the robot was displaced since the last call. Call it in every control period at
        work.

        `at`: (x, y) metres. `speed_m_s`: the highest speed of the robot.
        """
        before, self._seen = self._seen, (*at, now_us)
        if before is None:
            return False
        passed_for_us = max(now_us - before[2], CONTROL_PERIOD_US)
        reach_m = LEAP_SHARE * speed_m_s * passed_for_us / S + LEAP_M
        return hypot(at[0] - before[0], at[1] - before[1]) > reach_m
