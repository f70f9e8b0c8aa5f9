"""How much of the avoiding is ours: half, or less for who works where the other only travels.

Both take it from what both have said in their beats. Nobody may count on a share that the other has
not taken yet, so who yields begins early and ends late, and who is yielded to begins late and ends at
once: at every instant the two shares make one at least, as long as no state is news for longer than
the times below. Where beats are not fresh, it is half each.
"""

from typing import Final

from agent.interface.config import MS, S
from agent.interface.lifecycle import State

HALF, LESS, MORE = 0.5, 0.25, 0.75
YIELD_AFTER_US: Final = 500 * MS  # of the same two states
TRUST_AFTER_US: Final = (
    2 * S
)  # ten beats of the largest fleet: 30 % lost all of them once in 170,000
YIELD_ON_US: Final = 1_500 * MS  # after they have changed
FRESH_US: Final = 300 * MS  # a beat older than this is not counted on
assert YIELD_AFTER_US + YIELD_ON_US <= TRUST_AFTER_US


class RightOfWay:
    """One robot's view of all others."""

    def __init__(self) -> None:
        self._since: dict[int, tuple[int, int]] = {}  # slot: who goes first, since when
        self._yield_until_us: dict[int, int] = {}

    def share(self, slot: int, ours: int, theirs: int, age_us: int, now_us: int) -> float:
        """Ours of the avoiding between us and a moving robot. States as said; `age_us`: of its beat."""
        first = (ours == State.WORKING) - (theirs == State.WORKING)
        before, since_us = self._since.get(slot, (0, now_us))
        if first != before or slot not in self._since:
            if before < 0:
                self._yield_until_us[slot] = now_us + YIELD_ON_US
            self._since[slot] = first, now_us
            since_us = now_us
        if first > 0 and now_us - since_us >= TRUST_AFTER_US and age_us < FRESH_US:
            return LESS
        yields = first < 0 and now_us - since_us >= YIELD_AFTER_US
        return MORE if yields or now_us < self._yield_until_us.get(slot, 0) else HALF
