"""When a carrier has to charge, at which bay, and whether the bay works."""

from collections.abc import Callable, Container
from enum import Enum

from agent.delivery.cost_matrix import Trip
from agent.delivery.task_registry import TASKS_MAX
from agent.delivery.warehouse import CarrierState, Warehouse
from agent.interface.config import S
from agent.interface.geometry import Point
from agent.interface.mission import ClaimRequest
from crdt import FieldAllocationCRDT

FULL_AT = 0.99  # share of a battery from which on it counts as full
GIVES_US = 5 * S  # a bay that charges less than `GAIN` of a battery within this time is dead
# Period of the check whether a battery lasts: each check searches the planning map.
SHORT_US = 1 * S
GAIN = 0.002


class ChargerState(Enum):
    """What a robot at a charger bay finds."""

    CHARGES = 0
    FULL = 1
    DEAD = 2  # the bay does not charge


class Charging:
    """One robot's decisions about its battery, and its watch on the bay that it is at."""

    def __init__(self, house: Warehouse) -> None:
        self.house = house
        self._level = 0.0  # of the battery when we last looked
        self._look_at_us: int | None = None
        self._check_at_us = 0  # when we look next whether the battery lasts

    @property
    def _needed(self) -> bool:
        return self.house.carrier.runs_dry and bool(self.house.bays)

    def before(self, standing: CarrierState, trip: Trip) -> bool:
        """Whether to charge before a task: after it the battery would not reach a bay any more.

        `standing`: when, where and with what charge the robot begins.
        """
        then = self.house.after(standing, trip, False)
        return self._needed and then.left < self.house.home(trip.dropoff)

    def beyond(self, standing: CarrierState, trip: Trip) -> bool:
        """Whether a task has to wait although there are bays: the battery does not last for it now, and
        would not if it were full at any bay.

        `standing`: as in `before`.
        """
        return self.before(standing, trip) and not self.house.lasts(trip)

    def due(self, now_us: int) -> bool:
        """Whether it is time to call `falls_short`; True at most once in `SHORT_US`."""
        if not self._needed or now_us < self._check_at_us:
            return False
        self._check_at_us = now_us + SHORT_US
        return True

    def falls_short(self, standing: CarrierState, trip: Trip, loaded: bool) -> bool:
        """Whether the battery would not last for the rest of the task and the way to a bay.

        This happens after an unplanned delay or a restart. `loaded`: the parcel is aboard. Half of
        the reserve is left for inaccuracy.
        """
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
        gone: Callable[[int], bool],
    ) -> ClaimRequest | None:
        """The claim of the free bay that is least out of the way; None if all are taken.

        `at`: where we are. `onward`: where we go after charging, or None. `shunned`: sections not
        to choose, `TASKS_MAX` + bay. `gone`: whether the robot of a slot is silent for so long that
        its bay is taken if no other one is free: it may stand there. The bid is a tenth of the way in
        metres, at most 31.
        """
        best = None
        for bay, place in enumerate(self.house.bays):
            section = self.house.visit(bay, allocation)
            owner = None if section is None else allocation.owner_of(section)
            if section is None or not (owner is None or gone(owner)):
                continue
            if TASKS_MAX + bay in shunned:
                continue
            way_m = self.house.way_m(at, place)
            way_m += 0.0 if onward is None else self.house.way_m(place, onward)
            found = (owner is not None, way_m, section)
            if best is None or found < best:
                best = found
        return None if best is None else ClaimRequest(best[2], min(int(best[1] / 10), 31), best[0])

    def begin(self, battery: float) -> None:
        """We have arrived at a bay. `battery`: share of a full charge."""
        self._level, self._look_at_us = battery, None

    def observe(self, battery: float, now_us: int) -> ChargerState:
        """Once each control period at a bay: whether it charges, is done, or is dead.

        `battery`: share of a full charge.
        """
        if battery >= FULL_AT:
            return ChargerState.FULL
        if self._look_at_us is None:
            self._look_at_us = now_us + round(self.house.carrier.dock_s * S) + GIVES_US
        if now_us > self._look_at_us:
            if battery <= self._level + GAIN:
                return ChargerState.DEAD
            self._look_at_us, self._level = now_us + GIVES_US, battery
        return ChargerState.CHARGES
