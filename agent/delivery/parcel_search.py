"""Where a robot looks for a parcel that it is to fetch, one place after the other.

Mostly the parcel lies at its pickup. If the robot that carried it died, the parcel is where that
robot was last received. If that was before a network split, the place is unknown. Then the search
visits unknown obstacles found by range sensors, the dropoff, and in the end the whole building. The
arm's scanner tells whether the parcel is at a place.
"""

from functools import cached_property
from math import hypot

from agent.delivery.task_registry import TaskRegistry
from agent.delivery.warehouse import Warehouse
from agent.interface.geometry import Point
from agent.interface.mission import FleetView
from agent.mapf.lattice import Lattice
from agent.mapping.dynamic_obstacles import DynamicObstacles
from agent.navigation.silent_robots import SilentRobots

LOOKED_M = 0.8  # a place this near to a searched one need not be searched
SPOT_HOPS = 2  # in lattice hops: range sensors detect a body this far from a search position


class ParcelSearch:
    """Where one robot expects each parcel, and where it has looked without success."""

    def __init__(
        self, house: Warehouse, book: TaskRegistry, hazards: DynamicObstacles, bodies: SilentRobots
    ) -> None:
        self.house, self.book, self.hazards, self.bodies = house, book, hazards, bodies
        self._looked: dict[int, list[Point]] = {}  # task: places where its parcel was not

    def likeliest(self, task: int, workers: list[int], view: FleetView) -> Point:
        """The most probable place of a task's parcel, (x, y) metres; see `next`."""
        return self._places(task, workers, view)[0]

    def next(self, task: int, workers: list[int], view: FleetView) -> Point:
        """Where to look for a task's parcel now, (x, y) metres.

        `workers`: slots of robots that had begun with it, oldest first. A parcel that the scanner
        sees is where the scanner says.
        """
        seen = view.here.parcels.get(task)
        if seen is not None:
            return seen.x_m, seen.y_m
        places = self._places(task, workers, view)
        looked = self._looked.get(task)
        if not looked:
            return places[0]
        at = view.here.x_m, view.here.y_m
        found = next((p for p in places if _new(p, looked)), None)
        found = found or min(
            (p for p in (*self.hazards.things(), *self._spots) if _new(p, looked)),
            key=lambda p: hypot(p[0] - at[0], p[1] - at[1]),
            default=None,
        )
        return found or places[0]

    def searching(self, task: int) -> bool:
        """Whether the parcel was not where it was first expected."""
        return task in self._looked

    def looked(self, task: int, place: Point) -> bool:
        """The parcel is not at this place, (x, y) metres.

        False: there is no place left. The search for this task begins from the start next time.
        """
        looked = self._looked.setdefault(task, [])
        looked.append(place)
        if any(_new(p, looked) for p in self._spots):
            return True
        del self._looked[task]
        return False

    def _places(self, task: int, workers: list[int], view: FleetView) -> list[Point]:
        trip = self.house.trip(self.book.tasks[task])
        dead = self.bodies.dead
        carriers = [w for w in reversed(workers) if w in dead]
        carriers += [slot for slot in dead if slot not in carriers]
        bodies = [dead[slot] for slot in carriers]
        if view.progress.bits(task, 0) & 1:
            return [*bodies, trip.dropoff, trip.pickup]
        return [trip.pickup, *bodies, trip.dropoff]

    @cached_property
    def _spots(self) -> list[Point]:
        """Nodes of the lattice from which together the whole floor is seen, (x, y) metres."""
        lattice = self.house.floor.lattice
        left, found = set(range(len(lattice))), list[Point]()
        for node in range(len(lattice)):
            if node in left:
                found.append(lattice.point(node))
                left -= _around(lattice, node)
        return found


def _around(lattice: Lattice, node: int) -> set[int]:
    near = {node}
    for _ in range(SPOT_HOPS):
        near |= {int(n) for k in near for n in lattice.near[k] if n >= 0}
    return near


def _new(place: Point, looked: list[Point]) -> bool:
    return all(hypot(place[0] - x_m, place[1] - y_m) > LOOKED_M for x_m, y_m in looked)
