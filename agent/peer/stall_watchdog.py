"""Detects a robot that wants to drive and makes no progress: when to replan, when to report it.

Whatever holds the robot (a leg too near a wall, two robots that want the same place, a wheel that
does not turn), it must not stand still unnoticed for ever. The same watchdog serves every mission:
`agent/peer/control_cycle.py` calls it once a control period, makes the mission replan, and sends the
report.
"""

from collections.abc import Callable
from enum import IntEnum
from math import hypot
from typing import Final

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.geometry import Point

WANTS_M_S: Final = 0.05  # a robot that wants less than this is not held up
GOT_ON_M: Final = 0.4  # a robot that has moved this far is not stalled; at creep speed it takes 4 s
ALONE_US: Final = 5 * S  # with no robot near, waiting longer would change nothing
CROWDED_US: Final = 14 * S  # with a robot near: a refuge lasts 10 s, waiting for the other 4 s more
TOLD_AFTER: Final = 2  # after this many replans in one place, people are notified
FORGET_US: Final = 2 * CONTROL_PERIOD_US  # a longer gap between calls: it was not allowed to drive


class Advice(IntEnum):
    """What to do about a stall."""

    REPLAN = 1
    TELL = 2  # plan again, and report the stall on the bus


class Stall:
    """The stall watchdog of one robot."""

    def __init__(self) -> None:
        self.plans = 0  # replans since it last made progress
        self.seen = 0  # total number of stalls
        self._anchor: Point = (0.0, 0.0)
        self._anchor_at_us = self._asked_at_us = 0

    def look(
        self, at: Point, wants_m_s: float, crowded: Callable[[], bool], now_us: int
    ) -> Advice | None:
        """What to do now; None if the robot is not stalled.

        Call it in each control period in which the robot may drive. `at`: its position, (x, y)
        metres. `crowded`: whether another robot is near; asked only if the robot did not move.
        """
        lapsed = now_us - self._asked_at_us > FORGET_US
        self._asked_at_us = now_us
        moved_m = hypot(at[0] - self._anchor[0], at[1] - self._anchor[1])
        if moved_m > GOT_ON_M or wants_m_s < WANTS_M_S or lapsed:
            self._anchor, self._anchor_at_us = at, now_us
            if moved_m > GOT_ON_M:
                self.plans = 0
            return None
        stood_for_us = now_us - self._anchor_at_us
        if stood_for_us < min(ALONE_US, CROWDED_US):
            return None
        if stood_for_us < (CROWDED_US if crowded() else ALONE_US):
            return None
        self._anchor_at_us = now_us
        self.seen += self.plans == 0
        self.plans += 1
        return Advice.TELL if self.plans % TOLD_AFTER == 0 else Advice.REPLAN
