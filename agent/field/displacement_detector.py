"""Somebody has moved the robot: it is where nobody could have driven to since the last control period.

What lies between was passed without work, however straight the line: who is pushed along its row must not
take that for driving.
"""

from math import hypot
from typing import Final

from agent.interface.config import CONTROL_PERIOD_US, S

Point = tuple[float, float]

LEAP_M: Final = 0.1  # further than at one and a half times the full speed, nobody drove here
LEAP_SHARE: Final = 1.5


class DisplacementDetector:
    def __init__(self) -> None:
        self._seen: tuple[float, float, int] | None = None

    def noticed(self, at: Point, now_us: int, speed_m_s: float) -> bool:
        """Asked in every control period at work."""
        before, self._seen = self._seen, (*at, now_us)
        if before is None:
            return False
        passed_us = max(now_us - before[2], CONTROL_PERIOD_US)
        reach_m = LEAP_SHARE * speed_m_s * passed_us / S + LEAP_M
        return hypot(at[0] - before[0], at[1] - before[1]) > reach_m
