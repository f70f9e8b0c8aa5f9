"""Whether an owner counts as gone: silent or stopped for longer than the lease.

A robot that is stopped, because it lost its memory or because a person stopped it, may stay so for
hours. Tasks that it has not picked up yet are left to others; a parcel aboard stays with it.
"""

from agent.interface.config import LEASE_US
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView


class AbsentOwners:
    """Since when each robot reports that it is stopped, and what follows for its tasks."""

    def __init__(self) -> None:
        self._stopped_at_us: dict[int, int] = {}  # slot -> since when it reports "stopped"

    def observe(self, view: FleetView) -> None:
        """Update from the newest beats; call it a few times a second."""
        stopped = {
            slot
            for slot, neighbour in view.neighbours.items()
            if neighbour.pose.stopped or neighbour.pose.state == State.EMERGENCY_STOP
        }
        self._stopped_at_us = {slot: self._stopped_at_us.get(slot, view.now_us) for slot in stopped}

    def leaves(self, owner: int, task: int, view: FleetView) -> bool:
        """Whether others may take this task from its owner (a slot).

        They may if the owner has been silent for `LEASE_US`, or if it has been stopped for
        `LEASE_US` and has not picked the parcel up.
        """
        if owner not in view.live:
            return view.now_us - view.fell_silent_at_us.get(owner, -LEASE_US) >= LEASE_US
        picked_up = bool(view.progress.bits(task, 0) & 1)
        stopped_at_us = self._stopped_at_us.get(owner, view.now_us)
        return not picked_up and view.now_us - stopped_at_us >= LEASE_US
