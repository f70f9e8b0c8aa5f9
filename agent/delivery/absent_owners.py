"""Who is away for good, as far as it matters for its tasks: silent, or standing stopped, for a lease.

A robot that stands stopped, after it has lost its memory or because a person wants it so, may stand for
hours. What it has not picked up yet is left to others; what it has aboard stays with it.
"""

from agent.interface.config import LEASE_US
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView


class AbsentOwners:
    def __init__(self) -> None:
        self._stopped_us: dict[int, int] = {}  # slot: since when it says that it stands stopped

    def look(self, view: FleetView) -> None:
        stopped = {
            slot
            for slot, neighbour in view.neighbours.items()
            if neighbour.pose.stopped or neighbour.pose.state == State.EMERGENCY_STOP
        }
        self._stopped_us = {slot: self._stopped_us.get(slot, view.now_us) for slot in stopped}

    def leaves(self, owner: int, task: int, view: FleetView) -> bool:
        """Whether others may take one of its tasks."""
        if owner not in view.live:
            return view.now_us - view.silent_since_us.get(owner, -LEASE_US) >= LEASE_US
        picked_up = bool(view.progress.bits(task, 0) & 1)
        stopped_us = self._stopped_us.get(owner, view.now_us)
        return not picked_up and view.now_us - stopped_us >= LEASE_US
