"""Live owners of sections that stand still: after a while, other robots may take their sections.

A robot that may drive gives back by itself what it makes no progress with
(`agent/claims/claim_headway.py`). A robot that may not drive cannot: its wheels do not turn, its
place is lost, or something stands before it. It is live, so no lease ends.
"""

from collections.abc import Callable, Iterator, Sequence
from math import hypot
from typing import Final

from agent.interface.config import CONTROL_PERIOD_US, MS, S
from agent.interface.geometry import Point
from agent.interface.mission import FleetView

UnitsOf = Callable[[Sequence[int]], int]

STANDS_US: Final = 60 * S  # a live owner that stands still keeps its sections this long: 3 leases
STANDS: Final = f"stands for {STANDS_US // S} s"  # for the trace
LOOK_US: Final = 500 * MS  # between two looks: less than a hundredth of `STANDS_US`
# A longer gap between two looks does not count: we were stopped, and so were others, it may be.
FORGET_US: Final = LOOK_US + 2 * CONTROL_PERIOD_US


class StandingOwners:
    """For how long each live owner of sections has stood in one place without a further unit."""

    def __init__(self, stays_m: float, stands_for_us: int = STANDS_US) -> None:
        """`stays_m`: an owner that moves further than this does not stand still. `stands_for_us`: a live
        owner that stands still keeps its sections this long, if this mission has another limit.
        """
        self.stays_m, self.stands_for_us = stays_m, stands_for_us
        # Slot -> position, units done, and for how long it has stood there.
        self._stands: dict[int, tuple[Point, int, int]] = {}
        self._asked_at_us = 0

    def observe(self, view: FleetView, units_of: UnitsOf) -> None:
        """Call it in each control period in which we may drive. `units_of`: how many units of these
        sections are done.

        Only this time counts, because a fleet stop halts all robots.
        """
        if 0 <= view.now_us - self._asked_at_us < LOOK_US:
            return
        passed_for_us, self._asked_at_us = view.now_us - self._asked_at_us, view.now_us
        seen: dict[int, tuple[Point, int, int]] = {}
        for slot in view.live - {view.slot}:
            neighbour, owned = view.neighbours.get(slot), view.allocation.assigned_sections(slot)
            if neighbour is None or not owned:
                continue
            at = neighbour.pose.x_m, neighbour.pose.y_m
            units = units_of(owned)
            was, had, stood_for_us = self._stands.get(slot, (at, units, 0))
            if had != units or hypot(at[0] - was[0], at[1] - was[1]) > self.stays_m:
                was, stood_for_us = at, 0
            stood_for_us += passed_for_us if passed_for_us <= FORGET_US else 0
            seen[slot] = was, units, stood_for_us
        self._stands = seen

    def stands(self, slot: int) -> bool:
        """Whether this live owner has stood for `stands_for_us`."""
        return slot in self._stands and self._stands[slot][2] >= self.stands_for_us

    def standing(self) -> Iterator[int]:
        """The slots of all owners that have, ascending."""
        return (slot for slot in sorted(self._stands) if self.stands(slot))

    def forget(self, slot: int) -> None:
        """We take a section of it: its time begins again."""
        self._stands.pop(slot, None)
