"""When to re-optimise to cut waiting time, and which old tasks must keep their position.

Inserting tasks one by one leads to crossing routes. While more tasks wait than there are robots, the
robots periodically search for a plan of the same tasks with less total waiting time
(`agent/delivery/plan_negotiation.py`). A task that has waited for long is excluded: it keeps its
position, and so do all tasks before it.
"""

from collections.abc import Sequence

from agent.interface.config import S

EVERY_US = 30 * S  # between two such rounds; three times as often gained only 1 % more
REPLAN_US = 1 * S  # duration of the search
PATIENCE_US = (
    1_200 * S
)  # a task that has waited this long is not overtaken; this costs 1 % of the mean


class WaitingPolicy:
    def __init__(self, now_us: int) -> None:
        self._born_us = now_us
        self._known_us: dict[int, int] = {}  # task -> when received, for tasks after the start
        self._round_us, self._added = now_us, 0

    def known(self, task: int, now_us: int) -> None:
        self._known_us.setdefault(task, now_us)

    def held(self, tasks: Sequence[int], now_us: int) -> int:
        """How many tasks at the front of an itinerary keep their position."""
        old = [now_us - self._known_us.get(task, self._born_us) >= PATIENCE_US for task in tasks]
        return max((k + 1 for k, is_old in enumerate(old) if is_old), default=0)

    def planned(self, now_us: int, added: int) -> None:
        """A round has begun. `added`: change counter of the task book at that time."""
        self._round_us, self._added = now_us, added

    def due(self, now_us: int, added: int, waiting: int, robots: int) -> bool:
        """Whether to call a round: tasks have come since the last one, and one waits behind another."""
        return now_us - self._round_us >= EVERY_US and added > self._added and waiting > robots > 1
