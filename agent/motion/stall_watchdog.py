"""A robot that wants to drive and gets nowhere: when to plan again, and when to say so on the bus.

Whatever holds it (a leg too near a wall, two robots with one wish, a wheel that does not turn), it
must not stand silently for ever. The same watch serves every mission: `agent/peer/control_cycle.py` asks it once a
control period, tells the mission to plan again, and says the word.
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


class Headway:
    """Whether work gets on: something of it is done, or less way to it is left than ever.

    Who has neither for a while is the wrong robot in the wrong place, whatever the reason: it gives the
    section back, and the raised epoch lets another one take it.
    """

    NONE_US: Final = 20 * S  # as long as a silent owner keeps its sections
    AGAIN_US: Final = 6 * S  # before that it plans again, so often: it may move and yet not get on
    ROUNDS: Final = 3  # over all that is left, without a unit more, may each begin far away
    LESS_M: Final = 1.0  # of way left that counts as getting on

    def __init__(self) -> None:
        self._left_m = float("inf")
        self._idle_us = self._asked_us = self._planned_us = self._rounds = 0

    @property
    def lost(self) -> bool:
        return self._idle_us >= self.NONE_US

    def begin(self) -> None:
        """Another section."""
        self._left_m, self._idle_us, self._planned_us = float("inf"), 0, 0
        self._rounds = 0

    def again(self) -> None:
        """The legs are driven, not all is done, and another round begins."""
        self._rounds += 1
        if self._rounds <= self.ROUNDS:
            self._left_m = float("inf")

    def look(self, done: bool, left_m: float, now_us: int) -> bool:
        """Each control period at work: whether to plan again. Only time between two of them counts."""
        passed_us = now_us - self._asked_us
        self._asked_us = now_us
        if done or left_m < self._left_m - self.LESS_M:
            self._left_m = left_m if not done else float("inf")
            self._idle_us = self._planned_us = 0
            self._rounds = 0 if done else self._rounds
        elif passed_us <= FORGET_US:
            self._idle_us += passed_us
        if self._idle_us - self._planned_us < self.AGAIN_US:
            return False
        self._planned_us = self._idle_us
        return True
