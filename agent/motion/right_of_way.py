"""Our share of the mutual avoidance: half, or less for a working robot that meets a travelling one.

Both robots derive the shares from the states in their beats. The two shares must sum to at least 1
at all times. So the yielding robot changes first and reverts last, and the other changes last and
reverts first. This holds if beats transport a state within the times below. Without fresh beats
each robot takes half.
"""

from typing import Final

from agent.interface.config import MS, S
from agent.interface.lifecycle import State

HALF, LESS, MORE = 0.5, 0.25, 0.75
YIELD_AFTER_US: Final = 500 * MS  # after the two states were unchanged for this long
# Ten beats of the largest fleet. At a loss of 30 %, all ten are lost once in 170,000 times.
TRUST_AFTER_US: Final = 2 * S
YIELD_ON_US: Final = 1_500 * MS  # keep yielding this long after the states have changed
FRESH_US: Final = 300 * MS  # older beats are ignored
assert YIELD_AFTER_US + YIELD_ON_US <= TRUST_AFTER_US


class RightOfWay:
    """One robot's view of the right of way against each other robot."""

    def __init__(self) -> None:
        self._since: dict[int, tuple[int, int]] = {}  # slot -> which robot goes first, since when
        self._yield_ends_at_us: dict[int, int] = {}

    def share(self, slot: int, ours: int, theirs: int, age_us: int, now_us: int) -> float:
        """Our share of the avoidance of one moving robot: `LESS`, `HALF` or `MORE`.

        `slot`: the other robot. `ours`, `theirs`: lifecycle states from beats. `age_us`: age of its
        beat.
        """
        first = (ours == State.WORKING) - (theirs == State.WORKING)
        before, start_at_us = self._since.get(slot, (0, now_us))
        if first != before or slot not in self._since:
            if before < 0:
                self._yield_ends_at_us[slot] = now_us + YIELD_ON_US
            self._since[slot] = first, now_us
            start_at_us = now_us
        if first > 0 and now_us - start_at_us >= TRUST_AFTER_US and age_us < FRESH_US:
            return LESS
        yields = first < 0 and now_us - start_at_us >= YIELD_AFTER_US
        return MORE if yields or now_us < self._yield_ends_at_us.get(slot, 0) else HALF
