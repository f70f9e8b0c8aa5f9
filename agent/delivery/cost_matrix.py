"""What it costs to go between points of interest: a matrix made once, and rows added while running.

The points are pickups, dropoffs and charger bays. One search of the planning map gives a row. A
start that is not in the matrix, such as the position of a robot, gets a row of its own, which is
kept for a while.
"""

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.delivery.routing_problem import Power, Whole, Workload
from agent.interface.geometry import Point
from agent.paths.nav_mesh import Mesh

FULL = 1_000_000  # energy is counted in millionths of a full battery
ROOM = 16  # when the table grows, it grows by this many points and an eighth
FIELDS_KEPT = 64  # recent searches of the mesh: robots stand or wait at one place for a while


class Carrier(NamedTuple):
    """What every robot of the fleet can do, for planning."""

    speed_m_s: float  # mean speed on a path, turns and braking included
    handle_s: float  # to load, and the same to unload
    battery_m: float = 0.0  # a full battery drives this far and does nothing else; 0: no limit
    battery_s: float = 0.0  # standby time of a full battery; 0: no limit
    dock_s: float = 10.0  # fixed time of each charge
    charge_s: float = 60.0  # additional time to charge an empty battery
    reserve: float = 0.1  # share of a battery that plans never touch

    @property
    def runs_dry(self) -> bool:
        """Whether batteries are limited, by distance or by time."""
        return self.battery_m > 0 or self.battery_s > 0

    def time_ms(self, way_m: NDArray[np.float64]) -> Whole:
        """Driving times for lengths, in whole milliseconds, so that all peers compute the same.

        `way_m` has any shape, and the result has the same. Lengths are cut off at 1,000 km.
        """
        return np.rint(np.minimum(way_m, 1e6) / self.speed_m_s * 1000).astype(np.int64)

    def energy(self, way_m: NDArray[np.float64], time_ms: Whole) -> Whole:
        """Millionths of a battery for ways, rounded up.

        `way_m` and `time_ms` have one shape, and the result has the same.
        """
        found = np.zeros(way_m.shape)
        if self.battery_m > 0:
            found += np.minimum(way_m, 1e6) / self.battery_m
        if self.battery_s > 0:
            found += time_ms / (1000 * self.battery_s)
        return np.ceil(found * FULL).astype(np.int64)

    @property
    def handle_ms(self) -> int:
        """Time to load, and the same to unload, milliseconds."""
        return round(self.handle_s * 1000)


class CostMatrix:
    """Shortest ways between points of interest, (x, y) metres, on a navigation mesh."""

    def __init__(self, mesh: Mesh, points: Sequence[Point] = ()) -> None:
        self.mesh = mesh
        self._fields: dict[Point, NDArray[np.float64]] = {}  # metres to every waypoint
        self._number: dict[Point, int] = {}
        self._places = np.zeros((0, 2))
        self._boxes = np.zeros(0, dtype=np.int64)
        # The waypoints in sight of each point, one list after the other, and where each list begins.
        self._onto = np.zeros(0, dtype=np.int64)
        self._onto_m = np.zeros(0)
        self._begins = np.zeros(0, dtype=np.int64)
        self._table = np.zeros((0, 0))  # has more room than there are points
        self.extend(points)

    def __len__(self) -> int:
        return len(self._number)

    @property
    def between_m(self) -> NDArray[np.float64]:
        """(points, points) metres in the order in which points were added; read only."""
        count = len(self._number)
        return self._table[:count, :count]

    def twin(self) -> "CostMatrix":
        """A copy for another peer: it knows as much, and what is added later is not shared."""
        other = copy(self)
        other._table = self._table.copy()
        other._fields, other._number = dict(self._fields), dict(self._number)
        return other

    def extend(self, points: Sequence[Point]) -> None:
        """Add points of interest; known ones cost nothing."""
        new = [point for point in dict.fromkeys(points) if point not in self._number]
        if not new:
            return
        count = len(self._number)
        self._number.update({point: count + k for k, point in enumerate(new)})
        attached = [self.mesh.onto(point) for point in new]
        sizes = np.array([len(nodes) for nodes, _ in attached], dtype=np.int64)
        self._begins = np.append(self._begins, len(self._onto) + np.cumsum(sizes) - sizes)
        self._onto = np.concatenate((self._onto, *(nodes for nodes, _ in attached)))
        self._onto_m = np.concatenate((self._onto_m, *(metres for _, metres in attached)))
        self._places = np.concatenate((self._places, np.array(new)))
        self._boxes = np.append(self._boxes, [self.mesh.box(point) for point in new])
        total = count + len(new)
        if total > len(self._table):  # seldom: to copy all takes longer than to add two points
            larger = np.zeros((total + total // 8 + ROOM,) * 2)
            larger[:count, :count] = self._table[:count, :count]
            self._table = larger
        for k, point in enumerate(new, start=count):
            self._table[k, :total] = self._table[:total, k] = self._row(point)

    def metres(self, starts: Sequence[Point], goals: Sequence[Point]) -> NDArray[np.float64]:
        """Shortest ways (starts, goals) in metres, inf where there is none.

        Goals must be points of interest, otherwise KeyError is raised. Starts may be any places.
        """
        if not starts or not goals:
            return np.zeros((len(starts), len(goals)))
        columns = np.array([self._number[goal] for goal in goals], dtype=np.int64)
        rows = [self._known(start)[columns] for start in starts]
        found: NDArray[np.float64] = np.stack(rows)
        return found

    def _known(self, start: Point) -> NDArray[np.float64]:
        number = self._number.get(start)
        if number is None:
            return self._row(start)
        row: NDArray[np.float64] = self.between_m[number]
        return row

    def _row(self, start: Point) -> NDArray[np.float64]:
        """Shortest ways from a place to every point of interest (points,), metres."""
        if not len(self._onto):  # one polygon, and no portal anywhere
            straight: NDArray[np.float64] = np.hypot(*(self._places - start).T)
            return straight
        field = np.append(self._field(start)[self._onto] + self._onto_m, np.inf)
        row: NDArray[np.float64] = np.minimum.reduceat(field, self._begins)
        row[np.diff(self._begins, append=len(self._onto)) == 0] = np.inf  # a polygon by itself
        same = self._boxes == self.mesh.box(start)
        row[same] = np.hypot(*(self._places[same] - start).T)
        return row

    def _field(self, point: Point) -> NDArray[np.float64]:
        field = self._fields.get(point)
        if field is None:
            field = self._fields[point] = self.mesh.field_m(point)
            while len(self._fields) > FIELDS_KEPT:
                del self._fields[next(iter(self._fields))]
        return field


class Trip(NamedTuple):
    """A task as geometry: from where to where, (x, y) metres."""

    pickup: Point
    dropoff: Point


def workload(
    costs: CostMatrix,
    carrier: Carrier,
    trips: Sequence[Trip],
    starts: Sequence[Point],
    ready_ms: Sequence[int],
    bays: Sequence[Point] = (),
    left: Sequence[int] = (),
) -> Workload:
    """The frozen problem of a round: times and energies between starts, tasks and bays.

    `starts`: where each robot is when it is free, (x, y) metres. `ready_ms`: when that is. `bays`:
    charger bays, (x, y) metres. `left`: energy of each robot then, millionths of a battery. Trips
    and bays are added to `costs`.
    """
    costs.extend([point for trip in trips for point in trip] + list(bays))
    pickups, dropoffs = [t.pickup for t in trips], [t.dropoff for t in trips]
    loaded_m = np.array([costs.metres([t.pickup], [t.dropoff])[0, 0] for t in trips])
    lead_m, link_m = costs.metres(starts, pickups), costs.metres(dropoffs, pickups)
    both_ms = 2 * carrier.handle_ms

    def whole(way_m: NDArray[np.float64]) -> tuple[Whole, Whole]:
        """Time and energy of an empty way and the task behind it."""
        time_ms = carrier.time_ms(way_m + loaded_m) + both_ms
        return time_ms, carrier.energy(way_m + loaded_m, time_ms)

    lead_ms, lead = whole(lead_m)
    link_ms, link = whole(link_m)
    power = None
    if carrier.runs_dry and bays:
        from_ms, from_e = whole(costs.metres(bays, pickups))
        lead_bay_m, to_bay_m = costs.metres(starts, bays), costs.metres(dropoffs, bays)
        lead_bay_ms, to_bay_ms = carrier.time_ms(lead_bay_m), carrier.time_ms(to_bay_m)
        # A bay may turn out to be dead. So the next bay must be within reach from each.
        spare = spare_energy(costs, carrier, bays)
        to_bay = carrier.energy(to_bay_m, to_bay_ms) + spare
        power = Power(
            capacity=round((1 - carrier.reserve) * FULL),
            dock_ms=round(carrier.dock_s * 1000),
            ms_per_unit=carrier.charge_s * 1000 / FULL,
            left=np.array(left, dtype=np.int64) - round(carrier.reserve * FULL),
            lead=lead, link=link, home=to_bay.min(axis=1, initial=FULL), lead_bay_ms=lead_bay_ms,
            lead_bay=carrier.energy(lead_bay_m, lead_bay_ms) + spare, to_bay_ms=to_bay_ms, to_bay=to_bay,
            from_bay_ms=from_ms, from_bay=from_e,
        )  # fmt: skip
    return Workload(np.array(ready_ms, dtype=np.int64), lead_ms, link_ms, power)


def spare_energy(costs: CostMatrix, carrier: Carrier, bays: Sequence[Point]) -> Whole:
    """Energy from each bay to the next one, (bays,) millionths of a battery; 0 if there is only
    one.

    A robot needs it if a bay turns out to be dead. `bays`: (x, y) metres.
    """
    costs.extend(bays)
    way_m = costs.metres(bays, bays)
    if len(bays) < 2:
        return np.zeros(len(bays), dtype=np.int64)
    np.fill_diagonal(way_m, np.inf)
    nearest_m = way_m.min(axis=1)
    return carrier.energy(nearest_m, carrier.time_ms(nearest_m))
