"""When to re-optimise to cut waiting time, and which old tasks must keep their position.

Inserting tasks one by one leads to routes that cross. While more tasks wait than there are robots,
the robots periodically search for a plan of the same tasks with less total waiting time
(`agent/delivery/plan_negotiation.py`). A task that has waited for long is excluded: it keeps its
position, and so do all tasks before it.
"""

from collections.abc import Sequence

from agent.interface.config import S

EVERY_US = 30 * S  # between two such rounds; three times as often gained only 1 % more
REPLAN_US = 1 * S  # duration of the search
# A task that has waited this long is not overtaken. This costs 1 % of the mean waiting time.
PATIENCE_US = 1_200 * S


class WaitingPolicy:
    """Since when tasks are known, and when the last round to cut waiting time began."""

    def __init__(self, now_us: int) -> None:
        self._born_at_us = now_us
        self._known_at_us: dict[int, int] = {}  # task -> when received, for tasks after the start
        self._round_at_us, self._added = now_us, 0

    def known(self, task: int, now_us: int) -> None:
        """A task was received now; tasks given before the start count from the start."""
        self._known_at_us.setdefault(task, now_us)

    def held(self, tasks: Sequence[int], now_us: int) -> int:
        """How many tasks at the front of an itinerary keep their position: all up to the last old
        one.
        """
        old = [
            now_us - self._known_at_us.get(task, self._born_at_us) >= PATIENCE_US for task in tasks
        ]
        return max((k + 1 for k, is_old in enumerate(old) if is_old), default=0)

    def planned(self, now_us: int, added: int) -> None:
        """A round has begun. `added`: `TaskRegistry.added` at that time."""
        self._round_at_us, self._added = now_us, added

    def due(self, now_us: int, added: int, waiting: int, robots: int) -> bool:
        """Whether to call a round: tasks have come since the last one, and at least one waits
        behind another.

        `added`: `TaskRegistry.added`. `waiting`: planned tasks that no robot has begun. `robots`:
        live ones.
        """
        return (
            now_us - self._round_at_us >= EVERY_US and added > self._added and waiting > robots > 1
        )
