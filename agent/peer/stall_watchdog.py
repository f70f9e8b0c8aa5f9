"""A robot that wants to drive and gets nowhere: when to plan again, and when to say so on the bus.

Whatever holds it (a leg too near a wall, two robots with one wish, a wheel that does not turn), it
must not stand silently for ever. The same watch serves every mission:
`agent/peer/control_cycle.py` asks it once a control period, tells the mission to plan again, and
says the word.
"""

from enum import IntEnum
from math import hypot
from typing import Final

from agent.interface.config import CONTROL_PERIOD_US, S

Point = tuple[float, float]

WANTS_M_S: Final = 0.05  # a robot that wants less than this is not held up
GOT_ON_M: Final = 0.4  # moved this far: no stall; at creep speed that takes 4 s
ALONE_US: Final = 5 * S  # nobody near: nothing that time alone would change
CROWDED_US: Final = 14 * S  # somebody near: a refuge lasts 10 s, and waiting for the other 4 s more
TOLD_AFTER: Final = 2  # so many plans in one place did not help: people are told
FORGET_US: Final = 2 * CONTROL_PERIOD_US  # not asked for longer: it was not allowed to drive


class Advice(IntEnum):
    REPLAN = 1
    TELL = 2  # plan again, and say so


class Stall:
    """One robot's."""

    def __init__(self) -> None:
        self.plans = 0  # made since it last got on
        self.seen = 0  # stalls in all
        self._anchor: Point = (0.0, 0.0)
        self._since_us = self._asked_us = 0

    def look(self, at: Point, wants_m_s: float, crowded: bool, now_us: int) -> Advice | None:
        """Each control period in which it may drive. `crowded`: somebody near may be waited for."""
        lapsed = now_us - self._asked_us > FORGET_US
        self._asked_us = now_us
        moved_m = hypot(at[0] - self._anchor[0], at[1] - self._anchor[1])
        if moved_m > GOT_ON_M or wants_m_s < WANTS_M_S or lapsed:
            self._anchor, self._since_us = at, now_us
            if moved_m > GOT_ON_M:
                self.plans = 0
            return None
        if now_us - self._since_us < (CROWDED_US if crowded else ALONE_US):
            return None
        self._since_us = now_us
        self.seen += self.plans == 0
        self.plans += 1
        return Advice.TELL if self.plans % TOLD_AFTER == 0 else Advice.REPLAN
