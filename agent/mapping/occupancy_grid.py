"""A robot's map: cells seen by its range sensors, obstacles reported by peers, and path planning.

    grid = OccupancyGrid(rows, columns, (x_m, y_m), body_radius_m)
    grid.observe((x_m, y_m), heading_rad, ranges_m, range_max_m)       every scan
    grid.place(Obstacle(...)), grid.expire(now_us)                     what peers report, for a time
    grid.plan(start, goal)                                             waypoints in metres, or None

Cells have a side of `CELL_M` by default. Cell (row 0, column 0) has its south-western corner at the
origin; x is east and counts columns. Unseen cells count as free, because a robot that plans through
them observes them on the way. Solid cells come from sensors, a fixed map, or an obstacle that has
not expired yet.
"""

import zlib
from collections.abc import Sequence
from itertools import pairwise
from math import hypot, isfinite
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import Cell, Point
from agent.mapping.inflation import Changes, Grid, Inflation, cell_of
from agent.mapping.ray_evidence import LEAST, MOST, SOLID, room_for, weigh_scan
from agent.paths.any_angle_planner import Waypoints

Floats = NDArray[np.float64]
CELL_M = 0.20
INFLATION_M = 0.10  # kept from everything solid, beyond the body's radius
SOFT_M = 0.30  # a further margin that paths avoid if they can: tracking and wheels are not perfect
SOFT_COST = 0.5  # a metre in that margin costs this share more; a detour is taken only if it pays
REACH_CELLS_MAX = 64  # of a saved map: beyond this a solid cell blocks more than 12,000 others
CELLS_MAX = 1 << 24  # of a saved map: 16 MB of evidence, 800 m x 800 m
EDGE = 1e-9  # share of a cell: a place on the far edge of the grid is moved in by this
_HEAD = Struct("<4sIIdddddI")  # magic, rows, columns, origin, cell, body, inflation, obstacles
_OBSTACLE = Struct("<dddqqII")
MAGIC = b"HLM1"
SCANS_MAX = (1 << 16) - 1  # scans that stamps can distinguish: 55 minutes at 20 Hz
NO_DISCS = np.empty((0, 3))


# Evidence, whether the cell is solid by it, and the last scan that weighed the cell.
Memory = tuple[NDArray[np.int8], Grid, NDArray[np.uint16]]


def memory_of(shape: tuple[int, ...]) -> Memory:
    """An empty memory for a grid of this (rows, columns) shape."""
    return np.zeros(shape, np.int8), np.zeros(shape, np.bool_), np.zeros(shape, np.uint16)


class Obstacle(NamedTuple):
    """A temporary obstacle: a disc, its reporter, and from when until when it is valid."""

    x_m: float
    y_m: float
    radius_m: float
    born_at_us: int
    expires_at_us: int
    owner: int  # slot of the robot that saw or placed it
    number: int  # (owner, number) identifies the obstacle

    def stands(self, now_us: int) -> bool:
        """Whether it is valid at this time."""
        return self.born_at_us <= now_us < self.expires_at_us


class OccupancyGrid:
    """One robot's map. Places are (x, y) metres, arrays are (rows, columns)."""

    def __init__(
        self,
        rows: int,
        columns: int,
        origin_m: Point,
        body_radius_m: float,
        fixed: Grid | None = None,
        *,
        cell_m: float = CELL_M,
        inflation_m: float = INFLATION_M,
        memory: Memory | None = None,
        walled: bool = False,
    ) -> None:
        """`origin_m`: south-western corner, (x, y). `body_radius_m`: of our body. `fixed`: (rows,
        columns), True for known walls, which no ray erases. `inflation_m`: margin beyond the
        radius. `memory`: arrays to keep evidence, seen cells and stamps in, all zero; None: new
        ones. `walled`: whether the edge of the grid is a wall.
        """
        assert rows > 0 and columns > 0 and cell_m > 0 and body_radius_m >= 0 and inflation_m >= 0
        self.origin_m, self.cell_m = origin_m, cell_m
        self.body_radius_m, self.inflation_m = body_radius_m, inflation_m
        shape = rows, columns
        self.fixed: Grid = np.zeros(shape, np.bool_) if fixed is None else fixed.astype(np.bool_)
        assert self.fixed.shape == shape
        # Evidence has an array of its own, because of most cells a scan reads nothing else.
        self.evidence, self._seen, self._stamps = memory or memory_of(shape)
        self.obstacles: dict[tuple[int, int], Obstacle] = {}
        self._told = np.zeros(shape, dtype=np.int32)  # number of obstacles on each cell
        self._placed: set[tuple[int, int]] = set()
        self.scan = 0  # number of the scan, 1 to SCANS_MAX in a cycle
        self._room = (0, 0.0)  # number of rays and range for which `_toggled` has room
        self._toggled: Changes = np.empty((0, 3), dtype=np.int64)  # cells that a scan changes
        self.solid: Grid = self.fixed.copy()
        self.changes = 0  # how many cells became solid or free since the beginning
        self._layer(walled)

    def _layer(self, walled: bool) -> None:
        reach_m = self.body_radius_m + self.inflation_m
        self.tight = Inflation(self.solid, reach_m / self.cell_m, walled)
        self.wide = Inflation(self.solid, (reach_m + SOFT_M) / self.cell_m, walled)

    # ---------------------------------------------------------------- what is there

    def observe(self, at: Point, heading_rad: float, ranges_m: Sequence[float] | Floats,
                range_max_m: float, others: Sequence[tuple[float, float, float]] | Floats = (),
                ) -> int:  # fmt: skip
        """Take in one scan. Returns how many cells became solid or free.

        `at`: position of the sensor. `ranges_m`: at equal angles counter-clockwise from the
        heading. `range_max_m`: from here on a range is no hit. `others`: x, y and radius in metres
        of robots that are known to be there. Their echoes are not obstacles of the map: they drive
        away, and ORCA keeps from them. A scan without a finite pose or without rays changes
        nothing.
        """
        assert range_max_m > 0
        x_m, y_m = at
        ranges = np.asarray(ranges_m, dtype=np.float64)
        count = ranges.size
        if not isfinite(x_m + y_m + heading_rad) or count == 0:
            return 0
        room = self._room
        if count > room[0] or range_max_m > room[1]:
            room = self._make_room(count, range_max_m)
        discs = np.asarray(others, dtype=np.float64) if len(others) else NO_DISCS
        self.scan = self.scan % SCANS_MAX + 1
        changed = weigh_scan(self.evidence, self._seen, self._stamps, self.scan, *self.origin_m,
                             self.cell_m, x_m, y_m, heading_rad, ranges, range_max_m, discs,
                             self._toggled)  # fmt: skip
        return self.settle(self._toggled[:changed]) if changed else 0

    def _make_room(self, rays: int, range_max_m: float) -> tuple[int, float]:
        room = room_for(rays, range_max_m / self.cell_m, *self.evidence.shape)
        self._toggled = np.empty((room, 3), dtype=np.int64)
        self._room = rays, range_max_m
        return self._room

    @property
    def seen(self) -> Grid:
        """(rows, columns): solid by our own sensors; read only."""
        return self._seen

    def forget(self, cells: Changes) -> int:
        """Make these cells (n, 2) unknown to our own sensors. Returns how many became free."""
        self.evidence[cells[:, 0], cells[:, 1]] = 0
        self._seen[cells[:, 0], cells[:, 1]] = False
        return self.settle(cells)

    def doubt(self, row: int, column: int) -> None:
        """Make a free cell unknown: three more scans through it make it free again."""
        self.evidence[row, column] = max(self.evidence[row, column], 0)

    def unseen(self, scans: int) -> Changes:
        """Cells (n, 2) that are solid by our own sensors and that none of the last `scans` scans
        has touched.
        """
        age = (self.scan - self._stamps.astype(np.int64)) % SCANS_MAX
        return np.argwhere(self._seen & (age >= scans))

    def wall(self, cells: Grid) -> int:
        """Replace the fixed walls by these (rows, columns). Returns how many cells became solid or
        free.
        """
        other = np.argwhere(cells != self.fixed)
        self.fixed[:] = cells
        return self.settle(other)

    def place(self, obstacle: Obstacle, now_us: int) -> int:
        """Add an obstacle, or another state of a known one. Returns how many cells became solid or
        free.
        """
        changed = self._lift(obstacle.owner, obstacle.number)
        self.obstacles[obstacle.owner, obstacle.number] = obstacle
        return changed + self.expire(now_us)

    def remove(self, owner: int, number: int) -> int:
        """Remove an obstacle, if it is known. Returns how many cells became free."""
        changed = self._lift(owner, number)
        self.obstacles.pop((owner, number), None)
        return changed

    def expire(self, now_us: int) -> int:
        """Add obstacles that are valid by now and remove those that have expired; call it
        regularly.

        Returns how many cells became solid or free.
        """
        changed = 0
        for name, obstacle in list(self.obstacles.items()):
            if obstacle.expires_at_us <= now_us:
                changed += self.remove(*name)
            elif obstacle.stands(now_us) and name not in self._placed:
                self._placed.add(name)
                changed += self._stand(obstacle, 1)
        return changed

    def _lift(self, owner: int, number: int) -> int:
        if (owner, number) not in self._placed:
            return 0
        self._placed.discard((owner, number))
        return self._stand(self.obstacles[owner, number], -1)

    def _stand(self, obstacle: Obstacle, way: int) -> int:
        """Count one obstacle more (`way` 1) or less (-1) on the cells that it touches."""
        x, y = self._cells((obstacle.x_m, obstacle.y_m))
        radius = obstacle.radius_m / self.cell_m
        rows, columns = self.solid.shape
        low_r, high_r = max(int(y - radius), 0), min(int(y + radius), rows - 1)
        low_c, high_c = max(int(x - radius), 0), min(int(x + radius), columns - 1)
        if low_r > high_r or low_c > high_c:
            return 0
        r, c = np.mgrid[low_r : high_r + 1, low_c : high_c + 1].reshape(2, -1)
        gap = np.hypot(x - np.clip(x, c, c + 1), y - np.clip(y, r, r + 1))
        cells = np.column_stack((r, c))[gap <= radius]
        self._told[cells[:, 0], cells[:, 1]] += way
        return self.settle(cells)

    def settle(self, cells: Changes) -> int:
        """Bring `solid` and both inflations in line at these cells (n, 2 or more columns: row,
        column, ...).

        Returns how many cells became solid or free.
        """
        r, c = cells[:, 0], cells[:, 1]
        now = self.fixed[r, c] | self._seen[r, c] | (self._told[r, c] > 0)
        other = now != self.solid[r, c]
        if not other.any():
            return 0
        toggled = np.column_stack((r, c, now))[other].astype(np.int64)
        self.solid[toggled[:, 0], toggled[:, 1]] = toggled[:, 2] != 0
        self.changes += len(toggled)
        self.tight.toggle(toggled)
        self.wide.toggle(toggled)
        return len(toggled)

    # ---------------------------------------------------------------- paths

    def plan(self, start: Point, goal: Point) -> list[Point] | None:
        """Waypoints in metres from start to goal, both included; None if there is no path.

        It is the cheaper (`cost_m`) of two paths: the shortest, and the shortest that keeps
        `SOFT_M` more from everything solid. A start or goal in the inflation is joined by the
        shortest line out of it, because a path through it could pass a corner nearer than the body
        is wide. If there is no such line, the inflation round it counts as free.
        """
        a, b = self._point(start), self._point(goal)
        here, there = cell_of(a), cell_of(b)
        rows, columns = self.solid.shape
        if not all(0 <= r < rows and 0 <= c < columns for r, c in (here, there)):
            return None
        if self.solid[there] and here != there:
            return None
        # Nothing can be under the robot's body, even if the map says so.
        body_cells = self.body_radius_m / self.cell_m
        out, into = (
            self.tight.way_out(here, self.solid, body_cells),
            self.tight.way_out(there, self.solid, 0.0),
        )
        near = hypot(goal[0] - start[0], goal[1] - start[1]) < 2 * self.cell_m
        if out is not None and out != here and not near:
            rest = self.plan(self._centre(out), goal)
            return None if rest is None else [start, *rest]
        if into is not None and into != there and not near:
            way = self.plan(start, self._centre(into))
            return None if way is None else [*way, goal]
        carved = self.tight.carve(here, self.solid, body_cells)
        carved += self.tight.carve(there, self.solid)
        shortest = self.tight.plan(a, b, carved)
        if shortest is None:
            return None
        best = self._metres(shortest, start, goal)
        cost_m = self.cost_m(best)
        if cost_m > sum(hypot(q[0] - p[0], q[1] - p[1]) for p, q in pairwise(best)):
            carved += self.wide.carve(here, self.tight.blocked)
            carved += self.wide.carve(there, self.tight.blocked)
            roomy = self.wide.plan(a, b, carved)
            if (
                roomy is not None
                and self.cost_m(other := self._metres(roomy, start, goal)) < cost_m
            ):
                return other
        return best

    def cost_m(self, path: Sequence[Point]) -> float:
        """Length of a path; a metre near something solid counts `1 + SOFT_COST`."""
        total = 0.0
        rows, columns = self.solid.shape
        for p, q in pairwise(path):
            length_m = hypot(q[0] - p[0], q[1] - p[1])
            steps = max(1, int(2 * length_m / self.cell_m))  # two samples a cell
            t = (np.arange(steps) + 0.5) / steps
            (x, y), (dx, dy) = self._cells(p), ((q[0] - p[0]), (q[1] - p[1]))
            c = np.clip((x + t * dx / self.cell_m).astype(np.int64), 0, columns - 1)
            r = np.clip((y + t * dy / self.cell_m).astype(np.int64), 0, rows - 1)
            total += length_m * (1.0 + SOFT_COST * float(np.mean(self.wide.blocked[r, c])))
        return total

    def _cells(self, at: Point) -> Point:
        """A place as (columns, rows) from the corner of the grid, in cells."""
        return (at[0] - self.origin_m[0]) / self.cell_m, (at[1] - self.origin_m[1]) / self.cell_m

    def _point(self, at: Point) -> Point:
        """A place as (row, column) of the planner, whole numbers at cell centres."""
        x, y = self._cells(at)
        rows, columns = self.solid.shape
        if y == rows or x == columns:
            x, y = min(x, columns - EDGE), min(y, rows - EDGE)
        return y - 0.5, x - 0.5

    def _centre(self, cell: Cell) -> Point:
        """The middle of a cell, (x, y) metres."""
        x_m, y_m = self.origin_m
        return x_m + (cell[1] + 0.5) * self.cell_m, y_m + (cell[0] + 0.5) * self.cell_m

    def _metres(self, path: Waypoints, start: Point, goal: Point) -> list[Point]:
        inner = [
            (
                self.origin_m[0] + (column + 0.5) * self.cell_m,
                self.origin_m[1] + (row + 0.5) * self.cell_m,
            )
            for row, column in path[1:-1]
        ]
        return [start, *inner, goal]

    # ---------------------------------------------------------------- saved

    def to_bytes(self) -> bytes:
        """The whole map for `from_bytes`: evidence, obstacles and fixed walls."""
        rows, columns = self.solid.shape
        head = _HEAD.pack(MAGIC, rows, columns, *self.origin_m, self.cell_m, self.body_radius_m,
                          self.inflation_m, len(self.obstacles))  # fmt: skip
        told = b"".join(_OBSTACLE.pack(*obstacle) for obstacle in self.obstacles.values())
        walls = np.packbits(self.fixed).tobytes()
        seen = np.packbits(self._seen).tobytes()
        return head + zlib.compress(told + walls + seen + self.evidence.tobytes(), 6)

    @classmethod
    def from_bytes(cls, data: bytes, now_us: int) -> "OccupancyGrid":
        """The map that `to_bytes` has saved, without obstacles that have expired by `now_us`.

        Raises ValueError if the data are damaged or are not such a map.
        """
        if len(data) < _HEAD.size or data[:4] != MAGIC:
            raise ValueError("this is not a saved map")
        _, rows, columns, x, y, cell_m, body_m, inflation_m, told = _HEAD.unpack_from(data)
        sizes = (cell_m, body_m, inflation_m, x, y)
        sound = all(map(isfinite, sizes)) and cell_m > 0 and min(body_m, inflation_m) >= 0
        if not sound or not 0 < rows * columns <= CELLS_MAX:
            raise ValueError("the head of the map is damaged")
        if body_m + inflation_m + SOFT_M > REACH_CELLS_MAX * cell_m:
            raise ValueError("the head of the map is damaged")
        bits = (rows * columns + 7) // 8
        size = told * _OBSTACLE.size + 2 * bits + rows * columns
        try:
            unpacker = zlib.decompressobj()
            body = unpacker.decompress(data[_HEAD.size :], size + 1)
        except zlib.error as problem:
            raise ValueError(f"the map is damaged: {problem}") from None
        if len(body) != size or not unpacker.eof:
            raise ValueError("the map is damaged: its length is not what its head says")
        walls, seen, weights = (
            np.frombuffer(body, np.uint8, bits, size - rows * columns - 2 * bits),
            np.frombuffer(body, np.uint8, bits, size - rows * columns - bits),
            np.frombuffer(body, np.int8, rows * columns, size - rows * columns),
        )
        shape = rows, columns
        fixed = np.unpackbits(walls, count=rows * columns).astype(np.bool_).reshape(shape)
        grid = cls(rows, columns, (x, y), body_m, fixed, cell_m=cell_m, inflation_m=inflation_m)
        grid.evidence[:] = np.clip(weights, LEAST, MOST).reshape(shape)
        was = np.unpackbits(seen, count=rows * columns).astype(np.bool_).reshape(shape)
        grid._seen[:] = (grid.evidence >= SOLID) | (was & (grid.evidence >= 0))
        grid.settle(np.argwhere(grid._seen))
        for k in range(told):
            obstacle = Obstacle(*_OBSTACLE.unpack_from(body, k * _OBSTACLE.size))
            if all(map(isfinite, obstacle[:3])) and obstacle.radius_m >= 0:
                grid.obstacles[obstacle.owner, obstacle.number] = obstacle
        grid.expire(now_us)
        return grid
