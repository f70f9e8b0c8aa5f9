"""When a carrier has to charge, at which bay, and whether the bay works."""

from collections.abc import Container
from enum import Enum

from agent.delivery.cost_matrix import Trip
from agent.delivery.task_registry import TASKS_MAX
from agent.delivery.warehouse import CarrierState, Warehouse
from agent.interface.config import S
from agent.interface.mission import ClaimRequest
from agent.paths.nav_mesh import Point
from crdt import FieldAllocationCRDT

FULL_AT = 0.99  # of a battery
GIVES_US = 5 * S  # a bay that does not charge within this time is dead
SHORT_US = (
    1 * S
)  # between two looks at whether a battery lasts: each is a search of the planning map
GAIN = 0.002  # of a battery, in that time


class ChargerState(Enum):
    CHARGES = 0
    FULL = 1
    DEAD = 2  # it gives nothing


class Charging:
    def __init__(self, house: Warehouse) -> None:
        self.house = house
        self._level = 0.0  # of the battery when we last looked
        self._look_us: int | None = None
        self._short_us = 0  # when we look next whether the battery lasts

    @property
    def _needed(self) -> bool:
        return self.house.carrier.runs_dry and bool(self.house.bays)

    def before(self, standing: CarrierState, trip: Trip) -> bool:
        """Before it is needed: behind the task a bay must still be within reach."""
        then = self.house.after(standing, trip, False)
        return self._needed and then.left < self.house.home(trip.dropoff)

    def due(self, now_us: int) -> bool:
        """Whether it is time to ask `falls_short`."""
        if not self._needed or now_us < self._short_us:
            return False
        self._short_us = now_us + SHORT_US
        return True

    def falls_short(self, standing: CarrierState, trip: Trip, loaded: bool) -> bool:
        """Whether the battery would not last for the rest of the task and the way to a bay.

        This happens after an unplanned delay or a restart. Half of the reserve is for inaccuracy."""
        if not self._needed:
            return False
        then = self.house.after(standing, trip, loaded)
        return then.left < self.house.home(trip.dropoff) - self.house.reserve // 2

    def visit(
        self,
        at: Point,
        onward: Point | None,
        allocation: FieldAllocationCRDT,
        shunned: Container[int],
    ) -> ClaimRequest | None:
        """Of the bay that is least out of the way; None: all are taken. `shunned`: TASKS_MAX and bays."""
        best = None
        for bay, place in enumerate(self.house.bays):
            section = self.house.visit(bay, allocation)
            if section is None or allocation.owner_of(section) is not None:
                continue
            if TASKS_MAX + bay in shunned:
                continue
            way_m = self.house.way_m(at, place)
            way_m += 0.0 if onward is None else self.house.way_m(place, onward)
            if best is None or way_m < best[0]:
                best = (way_m, section)
        return None if best is None else ClaimRequest(best[1], min(int(best[0] / 10), 31))

    def begin(self, battery: float) -> None:
        self._level, self._look_us = battery, None

    def look(self, battery: float, now_us: int) -> ChargerState:
        """Each control period at a bay."""
        if battery >= FULL_AT:
            return ChargerState.FULL
        if self._look_us is None:
            self._look_us = now_us + round(self.house.carrier.dock_s * S) + GIVES_US
        if now_us > self._look_us:
            if battery <= self._level + GAIN:
                return ChargerState.DEAD
            self._look_us, self._level = now_us + GIVES_US, battery
        return ChargerState.CHARGES
