"""That tasks wait less: when what is planned is planned better, and what nothing may overtake.

Insertion one by one leaves ways that cross. While more tasks wait than there are robots, robots look now
and then for a plan of the same tasks in which these wait less in sum
(`agent/delivery/plan_negotiation.py`). What has waited for long is not of that plan any more: it
stays where it is, and with it all that is before it.
"""

from collections.abc import Sequence

from agent.interface.config import S

EVERY_US = 30 * S  # between two such rounds: three times as often gained one hundredth more
REPLAN_US = 1 * S  # of search
PATIENCE_US = (
    1_200 * S
)  # what has waited for so long nothing overtakes: costs one hundredth of the mean


class WaitingPolicy:
    def __init__(self, now_us: int) -> None:
        self._born_us = now_us
        self._known_us: dict[int, int] = {}  # tasks that were told after the start
        self._round_us, self._added = now_us, 0

    def known(self, task: int, now_us: int) -> None:
        self._known_us.setdefault(task, now_us)

    def held(self, tasks: Sequence[int], now_us: int) -> int:
        """How many of an itinerary, from its first on, stay before what comes now."""
        old = [now_us - self._known_us.get(task, self._born_us) >= PATIENCE_US for task in tasks]
        return max((k + 1 for k, is_old in enumerate(old) if is_old), default=0)

    def planned(self, now_us: int, added: int) -> None:
        """A round has begun, with so many changes of the task book known."""
        self._round_us, self._added = now_us, added

    def due(self, now_us: int, added: int, waiting: int, robots: int) -> bool:
        """Whether to call a round: tasks have come since the last one, and one waits behind another."""
        return now_us - self._round_us >= EVERY_US and added > self._added and waiting > robots > 1
