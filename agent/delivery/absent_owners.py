"""Whether an owner counts as gone: silent or stopped for longer than the lease, or it stands.

A robot that is stopped, because it lost its memory or because a person stopped it, may stay so for
hours. So may one whose wheels do not turn. Tasks that it has not picked up yet are left to others; a
parcel aboard stays with it.
"""

from collections.abc import Sequence
from functools import partial
from typing import Final

from agent.claims.standing_owners import STANDS_US, StandingOwners
from agent.interface.config import LEASE_US, S
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView

STAYS_M: Final = 1.0  # an owner that moves further than this does not stand


class AbsentOwners:
    """Since when each robot reports that it is stopped, or stands, and what follows for its tasks."""

    def __init__(self, handle_for_us: int = 0) -> None:
        """`handle_for_us`: how long a robot stands to load a parcel; it keeps its task meanwhile."""
        self._standing = StandingOwners(STAYS_M, max(STANDS_US, handle_for_us + LEASE_US))
        self._stopped_at_us: dict[int, int] = {}  # slot -> since when it reports "stopped"
        # Task that was given back after its pickup -> since when its last carrier does not plan it.
        self._unplanned_at_us: dict[int, int] = {}

    def observe(self, view: FleetView) -> None:
        """Update from the newest beats; call it a few times a second."""
        stopped = {
            slot
            for slot, neighbour in view.neighbours.items()
            if neighbour.pose.stopped or neighbour.pose.state == State.EMERGENCY_STOP
        }
        self._stopped_at_us = {slot: self._stopped_at_us.get(slot, view.now_us) for slot in stopped}

    def watch(self, view: FleetView) -> None:
        """Once each control period in which we may drive: which owners stand."""
        self._standing.observe(view, partial(_units_done, view))

    def leaves(self, owner: int, task: int, view: FleetView) -> bool:
        """Whether others may take this task from its owner (a slot).

        They may if the owner has been silent for `LEASE_US`. If it has not picked the parcel up, they
        may also if it has been stopped for `LEASE_US`, or stands.
        """
        if owner not in view.live:
            return self.silent(owner, view)
        picked_up = bool(view.progress.bits(task, 0) & 1)
        stopped_at_us = self._stopped_at_us.get(owner, view.now_us)
        gone = view.now_us - stopped_at_us >= LEASE_US or self._standing.stands(owner)
        return not picked_up and gone

    def began(self, task: int) -> None:
        """A robot has begun this task: what `drops` knows of it is past."""
        self._unplanned_at_us.pop(task, None)

    def drops(self, carrier: int, task: int, planned: bool, view: FleetView) -> bool:
        """Whether others may take a task that a live robot has given back after its pickup.

        `carrier`: the slot of that robot. `planned`: whether the task is in its itinerary. A robot with
        the parcel aboard plans to go on. One that was to fetch it from a dead robot, and cannot reach
        it, does not: others may take the task after `LEASE_US`.
        """
        if planned or carrier not in view.live or carrier in self._stopped_at_us:
            self._unplanned_at_us.pop(task, None)
            return False
        start_at_us = self._unplanned_at_us.setdefault(task, view.now_us)
        return view.now_us - start_at_us >= LEASE_US

    def silent(self, owner: int, view: FleetView) -> bool:
        """Whether the robot of the slot `owner` has been silent for `LEASE_US`. One that charges stands
        for long, so others may take no more than this as a reason to take its bay."""
        silent_at_us = view.fell_silent_at_us.get(owner, -LEASE_US)
        return owner not in view.live and view.now_us - silent_at_us >= LEASE_US

    def why(self, owner: int) -> str:
        """Why a task is taken from this owner, for the trace."""
        if not self._standing.stands(owner):
            return ""
        return f"robot {owner} stands for {self._standing.stands_for_us // S} s"


def _units_done(view: FleetView, sections: Sequence[int]) -> int:
    return sum(view.progress.bits(section, 0).bit_count() for section in sections)
