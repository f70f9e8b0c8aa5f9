"""Whether work on a section makes progress; if not, it is released and another robot may take it."""

from typing import Final

from agent.interface.config import CONTROL_PERIOD_US, S

FORGET_US: Final = 2 * CONTROL_PERIOD_US  # a longer gap does not count: it was not allowed to drive


class Headway:
    """Whether work makes progress: a unit is done, or the remaining distance reaches a new minimum.

    A robot without either for `NONE_US` releases the section, for any reason. The
    raised epoch of the register lets another robot take it.
    """

    NONE_US: Final = 20 * S  # as long as a silent owner keeps its sections
    # Until then it replans after this time, and after twice as long again, which suffices to go back
    # to the begin of a unit and to complete it: it may move without making progress.
    AGAIN_US: Final = 6 * S
    # So often it may begin again with all that is left, perhaps far away, without a further unit.
    ROUNDS: Final = 3
    LESS_M: Final = 1.0  # decrease of the remaining distance that counts as progress

    def __init__(self, lost_after_for_us: int = NONE_US) -> None:
        """`lost_after_for_us`: the limit, if this mission has another one."""
        self.lost_after_for_us = lost_after_for_us
        self._left_m = float("inf")
        self._idle_for_us = self._asked_at_us = self._planned_for_us = self._rounds = 0

    @property
    def lost(self) -> bool:
        """Whether the section has to be released."""
        return self._idle_for_us >= self.lost_after_for_us

    def begin(self) -> None:
        """Work on another section begins."""
        self._left_m, self._idle_for_us, self._planned_for_us = float("inf"), 0, 0
        self._rounds = 0

    def again(self) -> None:
        """Another round over the units that are left begins, from further back."""
        self._rounds += 1
        if self._rounds <= self.ROUNDS:
            self._left_m = float("inf")

    def observe(self, done: bool, left_m: float, now_us: int) -> bool:
        """Once each control period at work; returns whether to replan. Other time does not count.

        `done`: a unit was completed. `left_m`: remaining distance of all legs.
        """
        passed_for_us = now_us - self._asked_at_us
        self._asked_at_us = now_us
        if done or left_m < self._left_m - self.LESS_M:
            self._left_m = left_m if not done else float("inf")
            self._idle_for_us = self._planned_for_us = 0
            self._rounds = 0 if done else self._rounds
        elif passed_for_us <= FORGET_US:
            self._idle_for_us += passed_for_us
        if self._idle_for_us < 2 * self._planned_for_us + self.AGAIN_US:
            return False
        self._planned_for_us = self._idle_for_us
        return True


NO_HEADWAY: Final = f"no headway for {Headway.NONE_US // S} s"  # for the trace
