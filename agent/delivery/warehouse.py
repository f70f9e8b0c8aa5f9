"""The configuration of every robot in a delivery fleet: the building and its travel costs."""

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from functools import cached_property
from math import isfinite
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from agent.delivery.cost_matrix import FULL, Carrier, CostMatrix, Trip, spare_energy, workload
from agent.delivery.routing_problem import Whole, Workload
from agent.delivery.task_registry import TASKS_MAX, WITHDRAWN, TransportTask
from agent.interface.geometry import Point
from agent.mapping.building import Floor
from agent.paths.nav_mesh import Mesh
from crdt import FieldAllocationCRDT, Phase

SECTIONS_END = 0x8000  # sections are below; names begin there
# Visits of bays from here on are given back and claimed again, so charges do not run out: 4,096 are
# recorded as done, and a million follow.
USED_AGAIN = 0x7000
assert SECTIONS_END > USED_AGAIN > TASKS_MAX
T_MAX = 4  # up to this many new tasks are inserted; more are replanned


class CarrierState(NamedTuple):
    """When and where a robot is free for its next task, and with what charge."""

    slot: int
    at: Point
    ready_ms: int
    left: int  # millionths of a battery


class Warehouse:
    """The building, the robots' abilities, the bays and the first tasks: equal at all peers of a
    fleet.
    """

    def __init__(
        self,
        floor: Floor,
        carrier: Carrier,
        bays: Sequence[Point] = (),
        tasks: Mapping[int, TransportTask] | None = None,
        t_max: int = T_MAX,
    ) -> None:
        """`bays`: charger bays, (x, y) metres. `tasks`: those known before the start, by number.
        `t_max`: this many new tasks are inserted one by one; more are planned together.
        """
        self.floor, self.carrier, self.bays = floor, carrier, tuple(bays)
        self.tasks, self.t_max = dict(tasks or {}), t_max

    @cached_property
    def costs(self) -> CostMatrix:
        """Ways between all places known before the start; others are added when they come."""
        floor = self.floor
        mesh = Mesh(floor.inflated, floor.origin, floor.fine_m)
        known = [self.place(cell) for order in self.tasks.values() for cell in order]
        return CostMatrix(mesh, [*self.bays, *known])

    def twin(self) -> "Warehouse":
        """A copy for another peer, as in a process of its own."""
        other = copy(self)
        other.costs = self.costs.twin()
        return other

    @property
    def check(self) -> int:
        """A 24-bit hash: peers with another building, other tasks or other carriers are not of this
        fleet.
        """
        text = f"{self.floor.check} {self.carrier} {self.bays} {sorted(self.tasks.items())}"
        return crc32(text.encode()) & 0xFFFFFF

    # ---------------------------------------------------------------- places

    def place(self, cell: int) -> Point:
        """The middle of a cell of the map, (x, y) metres; cells are counted row by row from the
        south-west.
        """
        floor = self.floor
        row, column = divmod(cell, floor.walls.shape[1] - 2)
        return (column + 0.5) * floor.cell_m, (row + 0.5) * floor.cell_m

    def cell(self, at: Point) -> int | None:
        """The cell at a place; None if no robot can stand there."""
        floor = self.floor
        north, east = at[1] // floor.cell_m, at[0] // floor.cell_m
        rows, columns = (n - 2 for n in floor.walls.shape)
        if not (0 <= north < rows and 0 <= east < columns):  # also of what is no integer
            return None
        row, column = int(north), int(east)
        cell = row * columns + column
        return cell if cell < WITHDRAWN and not floor.walls[row + 1, column + 1] else None

    def known(self, order: TransportTask) -> bool:
        """Whether the cells of an order are places of this building: of one taken back, its dropoff."""
        return all(
            self.place(cell)[1] < self.floor.cell_m * (self.floor.walls.shape[0] - 2)
            and self.cell(self.place(cell)) == cell
            for cell in ((order.dropoff,) if order.withdrawn else order)
        )

    def trip(self, order: TransportTask) -> Trip:
        """The places of an order. The pickup of one that was taken back is lost: it is the dropoff."""
        dropoff = self.place(order.dropoff)
        return Trip(dropoff if order.withdrawn else self.place(order.pickup), dropoff)

    # ---------------------------------------------------------------- costs

    def way_m(self, a: Point, b: Point) -> float:
        """Shortest way from a to b, metres; inf if there is none."""
        self.costs.extend([b])
        return float(self.costs.metres([a], [b])[0, 0])

    def work(self, trips: Sequence[Trip], robots: Sequence[CarrierState]) -> Workload:
        """The frozen problem of these tasks and robots; see `workload`."""
        return workload(
            self.costs, self.carrier, trips, [r.at for r in robots], [r.ready_ms for r in robots],
            self.bays, [r.left for r in robots],
        )  # fmt: skip

    def after(self, standing: CarrierState, trip: Trip, loaded: bool) -> CarrierState:
        """The state of a robot after one more task. `loaded`: the parcel is aboard already."""
        way_m = self.way_m(standing.at, trip.dropoff if loaded else trip.pickup)
        handle_ms = self.carrier.handle_ms
        if not loaded:
            way_m += self.way_m(trip.pickup, trip.dropoff)
            handle_ms *= 2
        time_ms = int(self.carrier.time_ms(_array(way_m))[0]) + handle_ms
        energy = int(self.carrier.energy(_array(way_m), _array(time_ms).astype("int64"))[0])
        return CarrierState(
            standing.slot, trip.dropoff, standing.ready_ms + time_ms, standing.left - energy
        )

    def home(self, at: Point) -> int:
        """Energy from (x, y) metres to a bay, and to the next bay if that one is dead, plus the
        reserve.

        The unit is millionths of a battery.
        """
        if not self.bays:
            return self.reserve
        self.costs.extend(self.bays)
        way_m = self.costs.metres([at], self.bays)[0]
        energy = self.carrier.energy(way_m, self.carrier.time_ms(way_m)) + self._spare
        return int(energy.min()) + self.reserve

    def lasts(self, trip: Trip) -> bool:
        """Whether a battery that is full at some bay lasts for a task and the way to a bay again."""
        for bay in self.bays:
            if not isfinite(self.way_m(bay, trip.pickup)):
                continue
            done = self.after(CarrierState(0, bay, 0, FULL), trip, False)
            if done.left >= self.home(trip.dropoff):
                return True
        return False

    @cached_property
    def _spare(self) -> Whole:
        return spare_energy(self.costs, self.carrier, self.bays)

    @property
    def reserve(self) -> int:
        """Millionths of a battery that plans never use."""
        return round(self.carrier.reserve * FULL)

    # ---------------------------------------------------------------- bays

    def charged_between(
        self, standing: CarrierState, tasks: Iterable[int], orders: Mapping[int, TransportTask]
    ) -> list[int]:
        """The stops of an itinerary: its tasks, and `TASKS_MAX` + bay wherever the robot has to
        charge first.

        A robot that gets there decides by the same rule.
        """
        found: list[int] = []
        for task in tasks:
            trip = self.trip(orders[task])
            then = self.after(standing, trip, False)
            if self.carrier.runs_dry and self.bays and then.left < self.home(trip.dropoff):
                bay = min(
                    range(len(self.bays)),
                    key=lambda b: (
                        self.way_m(standing.at, self.bays[b])
                        + self.way_m(self.bays[b], trip.pickup)
                    ),
                )
                found.append(TASKS_MAX + bay)
                then = self.after(CarrierState(standing.slot, self.bays[bay], 0, FULL), trip, False)
            found.append(task)
            standing = then
        return found

    def visit(self, bay: int, allocation: FieldAllocationCRDT) -> int | None:
        """The section of the next visit of a bay; None after about a million charges at all bays
        together.

        A visit is claimed like a task. When the robot leaves the bay it is DONE, or FREE again where
        `used_again` says so.
        """
        section = TASKS_MAX + bay
        while section < SECTIONS_END:
            if allocation.phase_of(section) is not Phase.DONE:
                return section
            section += len(self.bays)
        return None

    def used_again(self, section: int, allocation: FieldAllocationCRDT) -> bool:
        """Whether a section from `visit` is given back when the robot leaves the bay."""
        return section >= USED_AGAIN and not allocation.stays(section)

    def bay_of(self, section: int) -> int:
        """The bay of a section from `visit`."""
        return (section - TASKS_MAX) % len(self.bays)


def _array(value: float) -> NDArray[np.float64]:
    return np.array([value], dtype=np.float64)
