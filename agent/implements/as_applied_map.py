"""The ground that is worked, in cells, as the shared progress of all task controllers of a field.

A cell is done when all of it is worked; each cell has 25 parts, which only the controller of that
implement knows. A row of cells is a section of `crdt/progress.py` and a cell one of its units, so the
map is replicated, made equal and stored as all work of a fleet is.
"""

from collections.abc import Iterable, Sequence
from math import ceil
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon

from crdt import Progress
from crdt.progress import UNITS_MAX

CELL_M: Final = (
    0.25  # finer cells cost more of the bus: two sprayers of 24 m at 3 m/s take 4 % with these
)
PARTS: Final = 5  # of a cell in each direction
WHOLE: Final = (1 << PARTS * PARTS) - 1
ROWS_MAX: Final = 1 << 15
EDGE_M: Final = 1.0  # around the field
PARTS_MAX: Final = 1 << 22  # painted at once: 400 MB for a moment; a boom of 100 m aslant has half

Points = NDArray[np.float64]  # n x 2, metres east and north


class AsAppliedMap:
    """The worked ground of one field as one task controller knows it."""

    def __init__(self, field: Polygon, progress: Progress, area: Polygon | None = None) -> None:
        """`field`: its outline, metres; equal at all controllers of the fleet. `area`: the part of it
        that the implements of this controller are sent to; None: all of it."""
        x0, y0, x1, y1 = field.bounds
        size_m = max((x1 - x0 + 2 * EDGE_M) / UNITS_MAX, (y1 - y0 + 2 * EDGE_M) / ROWS_MAX)
        self.cell_m = CELL_M * max(1, ceil(size_m / CELL_M))
        self.part_m = self.cell_m / PARTS
        self.origin = np.array((x0 - EDGE_M, y0 - EDGE_M))
        self.area, self.progress = field if area is None else area, progress
        shapely.prepare(self.area)
        self.too_large = 0  # pieces of ground that were not painted
        self._parts: dict[int, int] = {}  # cell -> parts that we have worked
        self._done: set[int] = set()  # cells that are whole and not in the progress yet

    def paint(self, corners: Points) -> list[tuple[int, int]]:
        """Ground between two places of a section was worked. Returns (row, column) of new whole cells.

        `corners`: left and right end before, then right and left end now.
        """
        lattice = self._lattice(corners)
        if not len(lattice):
            return []
        middle = self.origin + (lattice + 0.5) * self.part_m
        inside = _in_triangle(middle, corners[[0, 1, 2]]) | _in_triangle(middle, corners[[0, 2, 3]])
        cells, masks = _grouped(lattice[inside])
        whole = []
        for cell, mask in zip(cells.tolist(), masks.tolist(), strict=True):
            before = self._parts.get(cell, 0)
            if before == WHOLE or before | mask == before:
                continue
            self._parts[cell] = before | mask
            if before | mask == WHOLE:
                row, column = cell >> 16, cell & 0xFFFF
                self._done.add(cell)
                if not self.progress.has(row, column):
                    whole.append((row, column))
        return whole

    def take_back(self, cells: Iterable[tuple[int, int]]) -> None:
        """These cells, as (row, column), are not worked: the implement that was to work them was off."""
        for row, column in cells:
            self._done.discard(row << 16 | column)
            self._parts.pop(row << 16 | column, None)

    def needs(self, points: Points) -> NDArray[np.bool_]:
        """Whether ground is to be worked and not worked yet, (n,). `points`: (n, 2), metres."""
        lattice = np.floor((points - self.origin) / self.part_m).astype(np.int64)
        keys, bits = _keys(lattice), _bits(lattice)
        cells, where = np.unique(keys, return_inverse=True)
        known = np.array([self._known(cell) for cell in cells.tolist()], dtype=np.int64)
        free = (known[where] >> bits & 1) == 0
        if free.any():
            at = points[free]
            free[free] = shapely.contains_xy(self.area, at[:, 0], at[:, 1])
        return np.asarray(free)

    def area_m2(self) -> float:
        """The ground in whole cells that anybody has worked."""
        rows = {row for row, _, _ in self.progress.entries()}
        return float(sum(self.progress.covered(row) for row in rows) * self.cell_m**2)

    def _known(self, cell: int) -> int:
        if cell in self._done or (cell >= 0 and self.progress.has(cell >> 16, cell & 0xFFFF)):
            return WHOLE
        return self._parts.get(cell, 0)

    def _lattice(self, corners: Points) -> NDArray[np.int64]:
        """The parts of cells in the box around these corners, as columns and rows; none beside the map,
        and none if they are more than `PARTS_MAX`."""
        low = np.floor((corners.min(axis=0) - self.origin) / self.part_m).astype(np.int64)
        high = np.floor((corners.max(axis=0) - self.origin) / self.part_m).astype(np.int64)
        low = np.maximum(low, 0)
        high = np.minimum(high, np.array((UNITS_MAX, ROWS_MAX)) * PARTS - 1)
        if (high < low).any():
            return np.empty((0, 2), np.int64)
        if int(np.prod(high - low + 1)) > PARTS_MAX:
            self.too_large += 1
            return np.empty((0, 2), np.int64)
        columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        return np.column_stack((columns.ravel(), rows.ravel()))


def by_row(cells: Iterable[tuple[int, int]]) -> dict[int, tuple[int, ...]]:
    """Row -> its columns among these cells."""
    found: dict[int, list[int]] = {}
    for row, column in cells:
        found.setdefault(row, []).append(column)
    return {row: tuple(columns) for row, columns in found.items()}


def _keys(lattice: NDArray[np.int64]) -> NDArray[np.int64]:
    column, row = lattice[:, 0] // PARTS, lattice[:, 1] // PARTS
    inside = (column >= 0) & (row >= 0) & (column < UNITS_MAX) & (row < ROWS_MAX)
    return np.where(inside, row << 16 | column, -1)


def _bits(lattice: NDArray[np.int64]) -> NDArray[np.int64]:
    return (lattice[:, 1] % PARTS) * PARTS + lattice[:, 0] % PARTS


def _grouped(lattice: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cells of these parts, and which parts of each."""
    if not len(lattice):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    keys, masks = _keys(lattice), np.left_shift(1, _bits(lattice))
    order = np.argsort(keys, kind="stable")
    keys, masks = keys[order], masks[order]
    first = np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]])
    return keys[first], np.bitwise_or.reduceat(masks, first)


def _in_triangle(points: Points, corners: Points) -> NDArray[np.bool_]:
    """Whether each point is in a triangle; the edges that two triangles share belong to both."""
    sides: Sequence[NDArray[np.float64]] = []
    for k in range(3):
        edge = corners[(k + 1) % 3] - corners[k]
        off = points - corners[k]
        sides = [*sides, edge[0] * off[:, 1] - edge[1] * off[:, 0]]
    a, b, c = sides
    inside: NDArray[np.bool_] = ((a >= 0) & (b >= 0) & (c >= 0)) | ((a <= 0) & (b <= 0) & (c <= 0))
    return inside
