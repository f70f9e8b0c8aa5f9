"""What stands in the world: fences and blocked cells that stay, boxes and discs that come and go.

Fixed segments are bucketed in square cells, so that a query tests only those nearby. Everything is
packed in two arrays, `floats` and `ints`, because each argument of a compiled function costs time.

    floats[0]    west, south, side of the buckets, -
    floats[1]    west, south, side of the blocked cells, 1 if there are any
    floats[2+k]  segment k: x, y, and from there to its end: dx, dy
    ints         segments, columns, rows, stamp; then for each bucket where it begins among the
                 items; the items; and the stamp of the last scan that met each segment
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from agent.interface.geometry import Point

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

BUCKETS_MAX = 250_000  # 1 MB of offsets; larger worlds get larger buckets
OBSTACLES_MAX = 256  # each ray tests each of them; if there are more, put them into the map
FIRST, STAMP, HEAD = 2, 3, 4  # first segment of `floats`; the stamp, the first bucket of `ints`
FREE, BOX, DISC = 0.0, 1.0, 2.0
SHAPE, AT_X, AT_Y, HALF_X, HALF_Y, COS, SIN = range(7)  # a row of obstacles
OBSTACLE_COLUMNS = 7  # the radius of a disc is its HALF_X


class Grid(NamedTuple):
    """Blocked cells of a map: `blocked[row, column]`, row 0 in the south."""

    blocked: NDArray[np.bool_]
    west_m: float
    south_m: float
    cell_m: float

    def edges(self) -> Iterator[tuple[Point, Point]]:
        """The borders between blocked and free cells, merged where they are straight."""
        padded = np.pad(self.blocked, 1)
        for flat, solid in ((True, padded), (False, padded.T)):
            rows, columns = np.nonzero(solid[1:, :] != solid[:-1, :])
            for row in np.unique(rows):
                line = columns[rows == row]
                for run in np.split(line, np.flatnonzero(np.diff(line) > 1) + 1):
                    a, b, c = int(run[0]) - 1, int(run[-1]), int(row)
                    ends = ((a, c), (b, c)) if flat else ((c, a), (c, b))
                    yield self._corner(*ends[0]), self._corner(*ends[1])

    def _corner(self, column: int, row: int) -> Point:
        return self.west_m + column * self.cell_m, self.south_m + row * self.cell_m

    def is_blocked(self, x_m: float, y_m: float) -> bool:
        """Whether the cell with this point is blocked. Outside of the map nothing is."""
        column = int(np.floor((x_m - self.west_m) / self.cell_m))
        row = int(np.floor((y_m - self.south_m) / self.cell_m))
        rows, columns = self.blocked.shape
        return 0 <= row < rows and 0 <= column < columns and bool(self.blocked[row, column])


def ring_edges(rings: Iterable[Sequence[Point]]) -> Iterator[tuple[Point, Point]]:
    """The sides of closed outlines, whether or not they repeat their first point at the end."""
    for ring in rings:
        points = [(float(p[0]), float(p[1])) for p in ring]
        for a, b in zip(points, [*points[1:], points[0]], strict=True):
            if a != b:
                yield a, b


class Walls:
    """Segments that stay, and the blocked grid if there is one."""

    def __init__(self, edges: Iterable[tuple[Point, Point]], grid: Grid | None = None) -> None:
        segments = np.array([(*a, b[0] - a[0], b[1] - a[1]) for a, b in edges]).reshape(-1, 4)
        self.floats: Floats = np.zeros((FIRST + len(segments), 4))
        self.floats[FIRST:] = segments
        self.blocked = np.zeros((1, 1), dtype=np.bool_)
        if grid is not None:
            self.floats[1] = (grid.west_m, grid.south_m, grid.cell_m, 1.0)
            self.blocked = np.ascontiguousarray(grid.blocked)
        self.ints: Ints = np.array([0, 1, 1, 0, 0, 0], dtype=np.int32)
        if len(segments):
            self._bucket(segments)

    def _bucket(self, segments: Floats) -> None:
        ends = segments[:, :2] + segments[:, 2:]
        low = np.minimum(segments[:, :2], ends).min(axis=0) - 1.0
        size = np.maximum(segments[:, :2], ends).max(axis=0) + 1.0 - low
        area = float(size[0] * size[1])
        # About one segment a bucket if they were spread evenly; a robot's width at the least.
        side_m = max(1.0, (area / len(segments)) ** 0.5 / 2, (area / BUCKETS_MAX) ** 0.5)
        columns, rows = (int(n) for n in np.ceil(size / side_m))
        self.floats[0] = (low[0], low[1], side_m, 0.0)
        counts = np.zeros(columns * rows + 1, dtype=np.int32)
        _fill(self.floats, columns, rows, counts, np.empty(0, dtype=np.int32))
        offsets = np.concatenate(([0], np.cumsum(counts[:-1]))).astype(np.int32)
        items = np.empty(int(offsets[-1]), dtype=np.int32)
        cursor = offsets.copy()
        _fill(self.floats, columns, rows, cursor, items)
        head = np.array([len(segments), columns, rows, 0], dtype=np.int32)
        stamps = np.zeros(FIRST + len(segments), dtype=np.int32)
        self.ints = np.concatenate((head, offsets, items, stamps))


@njit(cache=True)
def _fill(floats, columns, rows, cursor, items):  # type: ignore[no-untyped-def]
    """Without items, count each bucket's segments in `cursor`; with items, write them there."""
    west, south, side, _ = floats[0]
    half = side / 2 * (1 + 1e-9)
    for k in range(FIRST, floats.shape[0]):
        x, y, dx, dy = floats[k]
        first_c, last_c = int((min(x, x + dx) - west) / side), int((max(x, x + dx) - west) / side)
        first_r, last_r = int((min(y, y + dy) - south) / side), int((max(y, y + dy) - south) / side)
        for r in range(max(first_r, 0), min(last_r, rows - 1) + 1):
            for c in range(max(first_c, 0), min(last_c, columns - 1) + 1):
                mx, my = west + (c + 0.5) * side, south + (r + 0.5) * side
                if abs((mx - x) * dy - (my - y) * dx) > half * (abs(dx) + abs(dy)):
                    continue  # the line does not cross the bucket
                bucket = r * columns + c
                if items.size:
                    items[cursor[bucket]] = k
                cursor[bucket] += 1
