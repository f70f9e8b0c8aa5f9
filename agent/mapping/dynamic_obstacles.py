"""Temporary obstacles not on the building plan: boxes, carts, silent robots.

    hazards.look(here, robots, now_us)      each control period: our own rays, and others' reports
    hazards.path(at, goal)                  round all obstacles that are believed to stand now

Observations are shared through the fleet's map (`crdt/occupancy.py`), cell by cell; the latest one
wins, and the clock of the map has no end (`crdt/passing_map.py`). A record's observer is the owner of
the obstacle, and its time is the birth. After
`BELIEVED_S` without another observation it expires. A robot that sees that an obstacle has gone
announces it. A grid of our own (`agent/mapping/occupancy_grid.py`) is made when the first obstacle
turns up. Until then, paths are planned on the building plan that all robots share.
"""

from collections.abc import Iterable, Mapping, Sequence
from math import hypot, inf, sqrt

import numpy as np
import scipy
from numpy.typing import NDArray

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.geometry import Point
from agent.interface.instants import FOREVER_US
from agent.interface.observation import Observation
from agent.mapping.building import Floor
from agent.mapping.local_and_fleet_map import SURE, LocalAndFleetMap
from agent.mapping.occupancy_grid import Obstacle, OccupancyGrid
from agent.mapping.ray_evidence import LEAST, MOST
from agent.motion.unexplained_echoes import BODY_M, UnexplainedEchoes
from crdt.occupancy import Geometry
from crdt.passing_map import FIRST_LEVEL
from crdt.sighting import FREE, OBSTACLE, RECORD_BITS, UNKNOWN, VALUE, unpack
from protocol.sync.map_sync import MapSync, Values

RANGE_M = 4.0  # range up to which echoes are used; beyond it rays are more than a robot apart
BELIEVED_S = 30  # an obstacle not observed for this long may have gone: paths lead there again
# An obstacle that expired and was found again is kept twice as long each time, at most 16 minutes. A
# robot with paths blocked in several places would otherwise drive between them for ever.
DOUBLINGS_MAX = 5
BLOCK_M = 1.0  # belief is kept for squares of this side: rays find another face of the same thing
REFRESH_S = BELIEVED_S // 2  # remaining obstacles are sent again before others forget them
WALL_CELLS = 1  # echoes this near to a wall are the wall: errors of range and position
FORGET_US = 1 * S  # period of the search for expired observations
BODY = -1  # the obstacle number of a silent member; others are numbered by their cell
IMPASSABLE = -2  # the number of a place that we could not pass; its owner is NOBODY_SLOT
NOBODY_SLOT = -1
NOBODY: Mapping[int, Point] = {}
assert SURE == FIRST_LEVEL
UNSEEN_SCANS = BELIEVED_S * S // CONTROL_PERIOD_US


def geometry_of(floor: Floor) -> Geometry:
    """The geometry of the fleet's map: the cells on which paths are planned."""
    rows, columns = floor.fine.shape
    return Geometry(rows, columns, floor.origin, floor.fine_m)


class DynamicObstacles:
    """The temporary obstacles that one robot knows, and paths round them; (x, y) metres."""

    def __init__(self, floor: Floor, sync: MapSync | None = None, reach_m: float = 0.0) -> None:
        """`sync`: shares the fleet's map; None if nothing is shared. `reach_m`: if an obstacle
        stands on a goal, a place this near to the goal is good enough.
        """
        self.floor, self.sync, self.reach_m = floor, sync, reach_m
        self.sensed = UnexplainedEchoes(floor.fences, floor.radius_m)
        self.hits: list[
            Point
        ] = []  # echoes of this period that neither a wall nor a robot explains
        self.map: ObstacleMap | None = None
        self._geometry = geometry_of(floor)
        self._version = 0

    def observe(
        self, here: Observation, reach_m: float, robots: Iterable[Sequence[float]], now_us: int,
        bodies: Mapping[int, Point] = NOBODY,
    ) -> None:  # fmt: skip
        """Once each control period: take in a scan and what others have reported.

        `reach_m`: up to which echoes count. `robots`: x, y of received robots. `bodies`: positions
        of silent robots by slot.
        """
        known = list(robots)
        self.hits = self.sensed.strange(here, reach_m, known)
        told = self.sync is not None and self.sync.chart.version != self._version
        if self.map is None:
            if not (self.hits or told or bodies):
                return
            self.map = ObstacleMap(self.floor, self.sync)
        elif not (self.hits or told or self.map.awake):
            return  # there is no obstacle and no news, so an update would change nothing
        if self.sync is not None:
            self._version = self.sync.chart.version
        self.map.stand(bodies, now_us)
        self.map.take_in(here, known, now_us, told)

    def on_map(self, at: Point) -> bool:
        """Whether a place (x, y), in metres, is on the map of the building, walls included."""
        return self._geometry.holds(at)

    def avoid(self, at: Point, now_us: int) -> None:
        """Avoid a place for `BELIEVED_S`, because we were held up there and see no obstacle."""
        if self.map is None:
            self.map = ObstacleMap(self.floor, self.sync)
        self.map.avoid(at, now_us)

    @property
    def standing(self) -> bool:
        """Whether any temporary obstacle is known."""
        return self.map is not None and self.map.standing

    @property
    def changes(self) -> int:
        """A counter that differs from before if an obstacle appeared or went."""
        return 0 if self.map is None else self.map.grid.changes

    def reported(self) -> list[Point]:
        """Middles of the obstacles that others report, and of silent robots."""
        if self.map is None:
            return []
        return [(o.x_m, o.y_m) for o in self.map.grid.obstacles.values()]

    def things(self) -> list[Point]:
        """Middles of all obstacles that are not walls."""
        return [] if self.map is None else self.map.things()

    def stands_near(self, points: Sequence[Point], reach_m: float) -> bool:
        """Whether an obstacle that is not on the plan is nearer than `reach_m` to one of the
        points.
        """
        return self.map is not None and self.map.stands_near(points, reach_m)

    def path(self, at: Point, goal: Point) -> tuple[Point, ...] | None:
        """A path round all obstacles, start and goal included; None if there is none at present.

        If the goal is taken and `reach_m` allows it, the path ends at the nearest free place.
        """
        if self.map is None or not self.map.standing:
            return self.floor.route.path(at, goal)
        found = self.map.grid.plan(at, goal)
        if found is None and self.reach_m:
            (place,) = self.places(at, [goal], self.map.parts())
            found = None if place is None else self.map.grid.plan(at, place)
        return None if found is None else tuple(found)

    def reaches(self, at: Point, goals: Sequence[Point], on_plan: bool = False) -> list[bool]:
        """For each goal, whether it can be reached, or approached near enough, round all current
        obstacles. `on_plan`: round the walls of the plan alone.
        """
        standing = self.map is not None and self.map.standing and not on_plan
        parts = self.map.parts() if standing and self.map is not None else self.floor.parts
        mine, there = self._beside(at, parts), np.zeros(len(goals), dtype=np.bool_)
        if len(goals) and len(mine):  # most are in our own region: one lookup for all of them
            _, _, origin, cell_m = self._geometry
            c, r = ((np.array(goals) - origin) // cell_m).astype(np.int64).T
            rows, columns = parts.shape
            inside = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
            there[inside] = np.isin(parts[r[inside], c[inside]], mine)
        left = [k for k, known in enumerate(there.tolist()) if not known]
        for k, place in zip(left, self.places(at, [goals[k] for k in left], parts), strict=True):
            there[k] = place is not None
        found: list[bool] = there.tolist()
        return found

    def _beside(self, at: Point, parts: NDArray[np.int32]) -> NDArray[np.int32]:
        """The numbers of the regions that a robot at `at` is in; empty where an obstacle is right
        beside it.
        """
        floor = self.floor
        _, own = self._disc(at, floor.radius_m + floor.margin_m + floor.fine_m)
        mine: NDArray[np.int32] = np.unique(parts[own[:, 0], own[:, 1]])
        return mine[mine > 0]

    def places(
        self, at: Point, goals: Sequence[Point], parts: NDArray[np.int32]
    ) -> list[Point | None]:
        """For each goal, the reachable place nearest to it within `reach_m`; None if there is none.

        `parts`: (rows, columns) regions as in `Floor.parts`. A goal itself is returned if an
        obstacle is so near to us that our region is not known.
        """
        floor, mine = self.floor, self._beside(at, parts)
        found: list[Point | None] = []
        for goal in goals:
            gaps, cells = self._disc(goal, max(self.reach_m, floor.fine_m))
            ours = np.isin(parts[cells[:, 0], cells[:, 1]], mine)
            if not len(mine):
                found.append(goal)  # something stands right beside us: we cannot tell from here
            elif not ours.any():
                found.append(None)
            else:
                best = int(np.argmin(np.where(ours, gaps, inf)))
                found.append(self._geometry.centre(*cells[best].tolist()))
        return found

    def _disc(self, at: Point, reach_m: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Distances (n,) in metres and cells (n, 2) of the cells whose middles are within `reach_m`
        of a place.
        """
        rows, columns, (west, south), cell_m = self._geometry
        low, high = (self._geometry.cell((at[0] + d, at[1] + d)) for d in (-reach_m, reach_m))
        first_r, first_c = max(low[0], 0), max(low[1], 0)
        r, c = np.mgrid[
            first_r : max(min(high[0] + 1, rows), first_r),
            first_c : max(min(high[1] + 1, columns), first_c),
        ].reshape(2, -1)
        gaps = np.hypot(west + (c + 0.5) * cell_m - at[0], south + (r + 0.5) * cell_m - at[1])
        near = gaps <= reach_m
        return gaps[near], np.column_stack((r, c))[near]


class ObstacleMap(LocalAndFleetMap):
    """A robot's two maps of obstacles that are not on the building plan."""

    def __init__(self, floor: Floor, sync: MapSync | None) -> None:
        # Paths of the plan keep radius and margin from walls by the middles of cells.
        inflation_m = max(floor.margin_m - floor.fine_m / 2, 0.0)
        rows, columns = floor.fine.shape
        grid = OccupancyGrid(
            rows, columns, floor.origin, floor.radius_m, floor.fine, cell_m=floor.fine_m,
            inflation_m=inflation_m,
        )  # fmt: skip
        super().__init__(sync, geometry_of(floor), floor.radius_m, RANGE_M, grid)
        self.radius_m = floor.radius_m
        self._forgot_at_us = 0
        self._walls = int(np.count_nonzero(floor.fine))
        self._open = ~scipy.ndimage.binary_dilation(floor.fine, iterations=WALL_CELLS)
        self._bodies: dict[int, Point] = {}
        self._block = max(round(BLOCK_M / floor.fine_m), 1)  # cells
        blocks = tuple(-(-cells // self._block) for cells in (rows, columns))
        # For each block: how often its time of belief was doubled, and whether it has expired and
        # was not observed since.
        self._doublings = np.zeros(blocks, dtype=np.int8)
        self._forgotten = np.zeros(blocks, dtype=np.bool_)
        self._records = np.zeros(floor.fine.shape, dtype=np.int64)  # as they were when last read
        # Caches, each with the counter for which it is valid: middles of solid cells off the walls,
        # whether any obstacle stands, and whether the fleet's map says so.
        self._cells_of, self._centres = -1, np.empty((0, 2))
        self._standing = (0, False)
        self._told = (-1, False)

    @property
    def standing(self) -> bool:
        """Whether any cell off the plan's walls is solid."""
        changes = self.grid.changes
        if changes != self._standing[0]:
            self._standing = changes, int(np.count_nonzero(self.grid.solid)) > self._walls
        return self._standing[1]

    @property
    def awake(self) -> bool:
        """Whether there is anything to update: an obstacle that we or other robots know."""
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
        """Update both maps with one scan, and send what is news to the fleet.

        `robots`: x, y of received robots. `told`: the fleet's map has changed since the last call.
        """
        bodies = [(x, y, self.radius_m + BODY_M) for x, y in robots]
        self.observe(here, bodies)
        if now_us - self._forgot_at_us >= FORGET_US:
            self._forgot_at_us = now_us
            self._forget_old()
        if told:
            self.hear_all(now_us)
        self.grid.expire(now_us)
        self._no_robots(robots)
        self._no_longer()
        self.share_news(here, now_us)

    def _forget_old(self) -> None:
        """Forget obstacles that were not observed for their time of belief: they may have gone.

        A block in which an obstacle is found again keeps it for twice as long the next time.
        """
        seen = np.argwhere(self.grid.seen)
        blocks = seen // self._block
        again = self._forgotten[blocks[:, 0], blocks[:, 1]]
        for row, column in {(int(r), int(c)) for r, c in blocks[again]}:
            self._forgotten[row, column] = False
            self._doublings[row, column] = min(self._doublings[row, column] + 1, DOUBLINGS_MAX)
        for row, column in np.argwhere((self._doublings > 0) & ~self._forgotten).tolist():
            n = self._block
            window = (slice(row * n, row * n + n), slice(column * n, column * n + n))
            if not self.grid.seen[window].any() and (self.grid.evidence[window] == LEAST).any():
                self._doublings[row, column] = 0  # it has gone
        old = self.grid.unseen(UNSEEN_SCANS)
        if not len(old):
            return
        levels = self._doublings[old[:, 0] // self._block, old[:, 1] // self._block]
        for level in range(int(levels.max()) + 1):
            cells = old[levels == level] if level == 0 else self._unseen_at(level)
            if len(cells):
                self._forgotten[cells[:, 0] // self._block, cells[:, 1] // self._block] = True
                self.grid.forget(cells)

    def _unseen_at(self, level: int) -> NDArray[np.int64]:
        """Cells (n, 2) of blocks with this many doublings that were not observed for their time of
        belief.
        """
        cells = self.grid.unseen(UNSEEN_SCANS << level)
        levels = self._doublings[cells[:, 0] // self._block, cells[:, 1] // self._block]
        kept: NDArray[np.int64] = cells[levels == level]
        return kept

    def things(self) -> list[Point]:
        """Middles of the connected obstacles off the walls, (x, y) metres."""
        parts, count = scipy.ndimage.label(
            self.grid.solid & self._open, np.ones((3, 3), dtype=np.int8)
        )
        if not count:
            return []
        middles = scipy.ndimage.center_of_mass(parts > 0, parts, range(1, count + 1))
        west, south = self.geometry.origin_m
        cell_m = self.geometry.cell_m
        return [(west + (c + 0.5) * cell_m, south + (r + 0.5) * cell_m) for r, c in middles]

    def stands_near(self, points: Sequence[Point], reach_m: float) -> bool:
        """Whether a solid cell off the walls is nearer than `reach_m` to one of the points."""
        if not points or not self.standing:
            return False
        if self._cells_of != self.grid.changes:
            self._cells_of = self.grid.changes
            (west, south), cell_m = self.geometry.origin_m, self.geometry.cell_m
            cells = np.argwhere(self.grid.solid & self._open)
            self._centres = np.array((west, south)) + (cells[:, ::-1] + 0.5) * cell_m
        gaps = self._centres[None, :, :] - np.array(points)[:, None, :]
        return bool((np.hypot(gaps[..., 0], gaps[..., 1]) < reach_m).any())

    def parts(self) -> NDArray[np.int32]:
        """Regions that no path joins at present, (rows, columns), numbered from 1; 0 where no
        middle may be.
        """
        parts: NDArray[np.int32] = scipy.ndimage.label(~self.grid.tight.blocked)[0]
        return parts

    def stand(self, bodies: Mapping[int, Point], now_us: int) -> None:
        """Place silent members as obstacles, by slot.

        Each stands until the member is received, or until we see that its place is free. A place that
        somebody tells beside the map is in nobody's way.
        """
        bodies = {slot: at for slot, at in bodies.items() if self.geometry.holds(at)}
        if bodies == self._bodies:
            return
        for slot in self._bodies.keys() - bodies.keys():
            self.grid.remove(slot, BODY)
        for slot, (x_m, y_m) in bodies.items():
            if self._bodies.get(slot) != (x_m, y_m):
                body = Obstacle(x_m, y_m, self.radius_m, 0, FOREVER_US, slot, BODY)
                self.grid.place(body, now_us)
        self._bodies = bodies

    def avoid(self, at: Point, now_us: int) -> None:
        """Avoid one place for `BELIEVED_S`; it replaces the place of the last call."""
        self.grid.remove(NOBODY_SLOT, IMPASSABLE)
        cell_m = self.geometry.cell_m
        expires_at_us = now_us + BELIEVED_S * S
        self.grid.place(
            Obstacle(*at, cell_m, now_us, expires_at_us, NOBODY_SLOT, IMPASSABLE), now_us
        )

    def hear_all(self, now_us: int) -> None:
        """Take others' reports of obstacles into our own grid as temporary obstacles."""
        assert self.sync is not None
        keys = self.fleet.keys()
        for row, column in np.argwhere((keys != self._records) & self._open).tolist():
            cell = row * self.geometry.columns + column
            before, now = int(self._records[row, column]), int(keys[row, column])
            if before:
                self.grid.remove(unpack(before).observer, cell)
            if not now:
                continue  # so old that the map has dropped it
            record, time = unpack(now), now >> RECORD_BITS
            age_us = max(self.sync.clock.read(now_us) - time, 0) * self.sync.clock.tick_period_us
            if record.observer == self.sync.slot or record.value != OBSTACLE:
                continue
            x_m, y_m = self.geometry.centre(row, column)
            born_at_us = now_us - age_us
            obstacle = Obstacle(
                x_m, y_m, self.geometry.cell_m / 4, born_at_us, born_at_us + BELIEVED_S * S,
                record.observer, cell,
            )  # fmt: skip
            self.grid.place(obstacle, now_us)
            self.grid.doubt(row, column)  # that we once saw it free does not count any more
        self._records = keys.copy()

    def _no_robots(self, robots: list[Sequence[float]]) -> None:
        """Remove obstacles where a received robot stands: it was seen before it was received."""
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
        """Remove others' obstacles from cells that our own rays see to be free."""
        for (owner, cell), standing in list(self.grid.obstacles.items()):
            if cell == IMPASSABLE or not self.geometry.holds((standing.x_m, standing.y_m)):
                continue
            row, column = self.geometry.cell((standing.x_m, standing.y_m))
            if self.grid.evidence[row, column] == LEAST:
                self.grid.remove(owner, cell)

    def _news(self, window: tuple[slice, slice], time: int, slot: int) -> Values:
        """Obstacles off the walls that are new to the fleet or due to be sent again, and those that
        have gone.
        """
        evidence, seen = self.grid.evidence[window], self.grid.seen[window]
        known = self.fleet.keys()[window]
        stands = seen & self._open[window] & (evidence == MOST)
        own = np.where(stands, OBSTACLE, np.where(evidence == LEAST, FREE, UNKNOWN))
        was = known & VALUE
        old = (time - (known >> RECORD_BITS)) >= REFRESH_S
        worth = np.where(own == OBSTACLE, (was != OBSTACLE) | old, was == OBSTACLE)
        mine = self.fleet.base(SURE, time, slot) | own
        return np.where(worth & (mine > known), own, UNKNOWN)
