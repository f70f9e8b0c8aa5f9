"""What stands in a building for a while that its plan does not show: boxes, carts, bodies of the unheard.

    hazards.look(here, robots, now_us)      each control period: our own rays, and what others told
    hazards.path(at, goal)                  round all that is believed to stand now

What is seen is told to the fleet through its map (`crdt/occupancy.py`, the latest look wins), cell by
cell: the record's observer is the owner, its time the birth, and after `BELIEVED_S` without another
look it expires. Who sees that a thing has gone says so. A grid of our own (`agent/occupancy.py`) is made
when something first turns up; as long as nothing does, ways are planned on the plan that all robots
share.
"""

from collections.abc import Iterable, Sequence
from math import hypot, sqrt

import numpy as np
from scipy.ndimage import binary_dilation

from agent.config import CONTROL_PERIOD_US, S
from agent.floor import Floor
from agent.occupancy import Obstacle, OccupancyGrid
from agent.ports import Observation
from agent.ray_evidence import LEAST, MOST
from agent.sensed import BODY_M, Sensed
from agent.survey_map import SURE, SurveyMap
from crdt.occupancy import Geometry
from crdt.sighting import FREE, OBSTACLE, TIME_MAX, UNKNOWN, VALUE, base, unpack
from protocol.map_sync import MapSync, Values

XY = tuple[float, float]
RANGE_M = 4.0  # that range sensors are believed: further away rays lie more than a robot apart
BELIEVED_S = 30  # what nobody has looked at for so long may have gone: go and see
REFRESH_S = BELIEVED_S // 2  # what still stands is told again, before others forget it
WALL_CELLS = 1  # echoes this near to a wall are the wall: errors of range and of place
FORGET_US = 1 * S  # how often old sights are looked for
UNSEEN_SCANS = BELIEVED_S * S // CONTROL_PERIOD_US


def geometry_of(floor: Floor) -> Geometry:
    """Cells of the fleet's map: those that ways are planned on."""
    rows, columns = floor.fine.shape
    return Geometry(rows, columns, floor.origin, floor.fine_m)


class Hazards:
    def __init__(self, floor: Floor, sync: MapSync | None = None) -> None:
        """`sync`: None where nothing is shared."""
        self.floor, self.sync = floor, sync
        self.sensed = Sensed(floor.fences, floor.radius_m)
        self.hits: list[XY] = []  # what our rays hit just now and neither wall nor robot explains
        self.map: HazardMap | None = None
        self._version = 0

    def look(
        self, here: Observation, reach_m: float, robots: Iterable[Sequence[float]], now_us: int
    ) -> None:
        """One control period; `robots`: x, y of those that were heard."""
        known = list(robots)
        self.hits = self.sensed.strange(here, reach_m, known)
        told = self.sync is not None and self.sync.chart.version != self._version
        if self.map is None:
            if not (self.hits or told):
                return
            self.map = HazardMap(self.floor, self.sync)
        elif not (self.hits or told or self.map.awake):
            return  # nothing is there, and nothing has come: looks would change nothing
        if self.sync is not None:
            self._version = self.sync.chart.version
        self.map.take_in(here, known, now_us, told)

    @property
    def standing(self) -> bool:
        """Whether anything is believed to stand anywhere."""
        return self.map is not None and self.map.standing

    @property
    def changes(self) -> int:
        """Other than before where something came or went."""
        return 0 if self.map is None else self.map.grid.changes

    def told(self) -> list[XY]:
        """Middles of what others say stands."""
        if self.map is None:
            return []
        return [(o.x_m, o.y_m) for o in self.map.grid.obstacles.values()]

    def path(self, at: XY, goal: XY) -> tuple[XY, ...] | None:
        """Round everything; None: there is no way at present."""
        if self.map is None or not self.map.standing:
            return self.floor.route.path(at, goal)
        found = self.map.grid.plan(at, goal)
        return None if found is None else tuple(found)


class HazardMap(SurveyMap):
    """The two maps of one robot, less the walls that everybody knows."""

    def __init__(self, floor: Floor, sync: MapSync | None) -> None:
        # The plan's ways keep the radius and the margin from walls with the middles of their cells.
        inflation_m = max(floor.margin_m - floor.fine_m / 2, 0.0)
        rows, columns = floor.fine.shape
        grid = OccupancyGrid(
            rows, columns, floor.origin, floor.radius_m, floor.fine, cell_m=floor.fine_m,
            inflation_m=inflation_m,
        )  # fmt: skip
        super().__init__(sync, geometry_of(floor), floor.radius_m, RANGE_M, grid)
        self.radius_m = floor.radius_m
        self._forgot_us = 0
        self._walls = int(np.count_nonzero(floor.fine))
        self._open = ~binary_dilation(floor.fine, iterations=WALL_CELLS)
        self._records = np.zeros(floor.fine.shape, dtype=np.int64)  # as they were when last read
        self._standing = (0, False)  # at that count of changes, whether anything stands
        self._told = (-1, False)  # at that version of the chart, whether it says that anything does

    @property
    def standing(self) -> bool:
        changes = self.grid.changes
        if changes != self._standing[0]:
            self._standing = changes, int(np.count_nonzero(self.grid.solid)) > self._walls
        return self._standing[1]

    @property
    def awake(self) -> bool:
        """Whether there is anything to keep up to date: what stands, or what somebody says stands."""
        if self.standing or self.grid.obstacles:
            return True
        if self.sync is None:
            return False
        version = self.sync.chart.version
        if version != self._told[0]:
            self._told = version, bool(((self.fleet.keys() & VALUE) == OBSTACLE).any())
        return self._told[1]

    def take_in(
        self, here: Observation, robots: list[Sequence[float]], now_us: int, told: bool
    ) -> None:
        bodies = [(x, y, self.radius_m + BODY_M) for x, y in robots]
        self.look(here, bodies)
        if now_us - self._forgot_us >= FORGET_US:
            self._forgot_us = now_us
            self.grid.forget(self.grid.unseen(UNSEEN_SCANS))
        if told:
            self.hear_all(now_us)
        self.grid.expire(now_us)
        self._no_robots(robots)
        self._no_longer()
        self.tell(here, now_us)

    def hear_all(self, now_us: int) -> None:
        """Take what others say stands, or has gone, into our own grid as temporary obstacles."""
        assert self.sync is not None
        keys = self.fleet.keys()
        for row, column in np.argwhere((keys != self._records) & self._open).tolist():
            cell = row * self.geometry.columns + column
            before, now = int(self._records[row, column]), int(keys[row, column])
            if before:
                self.grid.remove(unpack(before).observer, cell)
            record = unpack(now)
            age_us = max(self.sync.clock.read(now_us) - record.time, 0) * self.sync.clock.tick_us
            if record.observer == self.sync.slot or record.value != OBSTACLE:
                continue
            x_m, y_m = self.geometry.centre(row, column)
            born_us = now_us - age_us
            obstacle = Obstacle(
                x_m, y_m, self.geometry.cell_m / 4, born_us, born_us + BELIEVED_S * S,
                record.observer, cell,
            )  # fmt: skip
            self.grid.place(obstacle, now_us)
            self.grid.doubt(row, column)  # it was free when we looked; has it been since?
        self._records = keys.copy()

    def _no_robots(self, robots: list[Sequence[float]]) -> None:
        """Where a robot that is heard stands, nothing else does: it was seen before it was heard."""
        if not self.standing:
            return
        cell_m = self.geometry.cell_m
        for x_m, y_m in robots:
            reach_m = self.radius_m + cell_m * sqrt(0.5)
            (low_r, low_c), (high_r, high_c) = (
                self.geometry.cell((x_m + d, y_m + d)) for d in (-reach_m, reach_m)
            )
            area = (slice(max(low_r, 0), high_r + 1), slice(max(low_c, 0), high_c + 1))
            if self.grid.seen[area].any():
                corner = np.array((area[0].start, area[1].start))
                cells = np.argwhere(self.grid.seen[area]) + corner
                west, south = self.geometry.origin_m
                x, y = west + (cells[:, 1] + 0.5) * cell_m, south + (cells[:, 0] + 0.5) * cell_m
                self.grid.forget(cells[np.hypot(x - x_m, y - y_m) < reach_m])
            for (owner, number), o in list(self.grid.obstacles.items()):
                if hypot(o.x_m - x_m, o.y_m - y_m) < self.radius_m + BODY_M:
                    self.grid.remove(owner, number)

    def _no_longer(self) -> None:
        """What we look at ourselves we need not be told of."""
        for owner, cell in list(self.grid.obstacles):
            row, column = divmod(cell, self.geometry.columns)
            if self.grid.evidence[row, column] == LEAST:
                self.grid.remove(owner, cell)

    def _news(self, window: tuple[slice, slice], time: int, slot: int) -> Values:
        """Things off the walls that the fleet does not know of, or has not heard of lately, and
        things that have gone."""
        evidence, seen = self.grid.evidence[window], self.grid.seen[window]
        known = self.fleet.keys()[window]
        stands = seen & self._open[window] & (evidence == MOST)
        own = np.where(stands, OBSTACLE, np.where(evidence == LEAST, FREE, UNKNOWN))
        was = known & VALUE
        old = (time - (known >> 11 & TIME_MAX)) >= REFRESH_S
        worth = np.where(own == OBSTACLE, (was != OBSTACLE) | old, was == OBSTACLE)
        mine = base(self.fleet.order, SURE, time, slot) | own
        return np.where(worth & (mine > known), own, UNKNOWN)
