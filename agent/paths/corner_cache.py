"""The memory behind `agent.paths.corner_graph`: a padded grid, its runs and corners, and their
changes.

`cells` (rows, columns) says with its padding which cells are blocked; `changes` (n, 3) holds row,
column without the padding, and 1 for blocked or 0 for free. `grid`, `index` and `corners` are those
of `agent.paths.corner_graph`. `spare` holds how many rows of `corners` are free, then their
numbers.
"""

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import GridPoint
from agent.kernels.kernel import njit
from agent.paths.corner_graph import (
    COLUMNS,
    CORNER_COLUMNS,
    EMPTY,
    EXPANDED,
    HEAD,
    HEAP_FULL,
    HEAP_SIZE,
    KIND,
    LIST,
    LISTS,
    LOG_SIZE,
    LOGGED,
    NO_PATH,
    POOL_FULL,
    ROWS,
    SEEN,
    SEEN_MAX,
    USED,
    VIEW_FULL,
    VIEW_SIZE,
    place,
    query,
)
from agent.paths.line_of_sight import kind, rerun

SIDE_MAX = 32_000  # rows or columns: fits int16, and products of positions fit int64
LOG_MAX = 1024  # rectangles of changed cells in the log; beyond this the edges are forgotten
POOL_MAX = 1 << 24  # edges cached (64 MB); beyond this they are forgotten
REACH = 2  # cells; changes this near to each other share one rectangle, so a box is one entry
OUTSIDE = -2
VIEW, HEAP, POOL = 256, 1024, 1024  # initial sizes, doubled when one is too small
Flags = NDArray[np.bool_]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Runs = NDArray[np.int16]


@njit(cache=True, error_model="numpy")
def _build(cells: Flags, grid: Runs, index: Ints, corners: Ints) -> int:
    """Fill runs and corners from a whole grid; returns the number of corners.

    It may be more than `corners` has rows: then they must be built again with more.
    """
    rows, width = cells.shape
    area = 2 * rows * width
    runs = grid[:area].reshape((2, rows, width))
    columns = grid[area:].reshape((2, width, rows))
    for r in range(rows):
        rerun(runs, r, 0, width, cells)
    for c in range(width):
        rerun(columns, c, 0, rows, cells.T)
    count = 0
    for i in range(1, rows):
        for j in range(1, width):
            found = kind(cells, i, j)
            index[i, j] = -1
            if found:
                if count < corners.shape[0]:
                    place(corners, count, i, j, found)
                    index[i, j] = count
                count += 1
    return count


@njit(cache=True, error_model="numpy")
def _repair(
    cells: Flags,
    grid: Runs,
    index: Ints,
    corners: Ints,
    spare: Ints,
    top: int,
    bottom: int,
    left: int,
    right: int,
) -> bool:
    """Update runs and corners after cells changed inside a rectangle; False if `corners` has too
    few rows.

    The row of a corner that is gone may be used again immediately, because every list that names it
    touches the rectangle.
    """
    rows, width = cells.shape
    area = 2 * rows * width
    runs = grid[:area].reshape((2, rows, width))
    columns = grid[area:].reshape((2, width, rows))
    for r in range(top, bottom + 1):
        rerun(runs, r, 0, width, cells)
    for c in range(left, right + 1):
        rerun(columns, c, 0, rows, cells.T)
    for i in range(top, bottom + 2):
        for j in range(left, right + 2):
            found, k = kind(cells, i, j), index[i, j]
            if found == 0 and k >= 0:
                spare[0] += 1
                spare[spare[0]] = k
                index[i, j] = -1
            elif found and k < 0:
                if spare[0] == 0:
                    return False
                k = spare[spare[0]]
                spare[0] -= 1
                place(corners, k, i, j, found)
                index[i, j] = k
            elif found and corners[k, KIND] != found:
                place(corners, k, i, j, found)
    return True


@njit(cache=True, error_model="numpy")
def _set(cells: Flags, changes: Longs, found: Longs) -> tuple[int, int]:
    """Set cells; returns how many changed, and how many rectangles round them are in `found`, (n,
    4).

    A rectangle is top, bottom, left and right with the padding. Their number is -1 if `found` is
    too small.
    """
    changed, count = 0, 0
    for n in range(changes.shape[0]):
        r, c, blocked = changes[n, 0] + 1, changes[n, 1] + 1, changes[n, 2] != 0
        if cells[r, c] == blocked:
            continue
        cells[r, c] = blocked
        changed += 1
        near = count < 0
        for k in range(count):
            above, below = found[k, 0] - REACH, found[k, 1] + REACH
            if above <= r <= below and found[k, 2] - REACH <= c <= found[k, 3] + REACH:
                found[k, 0], found[k, 1] = min(found[k, 0], r), max(found[k, 1], r)
                found[k, 2], found[k, 3] = min(found[k, 2], c), max(found[k, 3], c)
                near = True
                break
        if not near and count == found.shape[0]:
            count = -1
        elif not near:
            found[count, 0] = found[count, 1] = r
            found[count, 2] = found[count, 3] = c
            count += 1
    return changed, count


@njit(cache=True, error_model="numpy")
def _change(
    cells: Flags,
    grid: Runs,
    index: Ints,
    corners: Ints,
    spare: Ints,
    log: Ints,
    logged: int,
    changes: Longs,
) -> tuple[int, int]:
    """Set cells and repair what depends on them; returns how many changed, and the entries in the
    log.

    The number of entries is -1 where `corners` or the log is too small: everything must be built
    again. It is OUTSIDE, and nothing is done, where a cell is outside of the grid.
    """
    rows, width = cells.shape[0] - 2, cells.shape[1] - 2
    for n in range(changes.shape[0]):
        if not (0 <= changes[n, 0] < rows and 0 <= changes[n, 1] < width):
            return 0, OUTSIDE
    found = np.empty((SEEN_MAX, 4), np.int64)
    changed, count = _set(cells, changes, found)
    if count < 0 or logged + count > log.shape[0]:
        return changed, -1
    for k in range(count):
        top, bottom, left, right = found[k]
        if not _repair(cells, grid, index, corners, spare, top, bottom, left, right):
            return changed, -1
        log[logged + k] = found[k]
    return changed, logged + count


class CornerMemory:
    """A grid with a padding of one blocked cell, and the corners and edges that queries over it
    found."""

    def __init__(self, blocked: NDArray[np.bool_]) -> None:
        """`blocked`: (rows, columns), copied."""
        assert max(blocked.shape) + 2 <= SIDE_MAX
        rows, columns = blocked.shape[0] + 2, blocked.shape[1] + 2
        self.cells = np.ones((rows, columns), dtype=np.bool_)
        self.cells[1:-1, 1:-1] = blocked
        self._grid = np.empty(4 * rows * columns, dtype=np.int16)
        self._index = np.full((rows, columns), -1, dtype=np.int32)
        self._corners = np.empty((64, CORNER_COLUMNS), dtype=np.int32)
        self._view, self._heap, self._pool = VIEW, HEAP, POOL
        self._ints = np.zeros(HEAD, dtype=np.int32)
        self._ints[ROWS], self._ints[COLUMNS] = rows, columns
        self._log = self._edges = 0  # where log and edges begin in `_ints`
        self._build()

    @property
    def expanded(self) -> int:
        """Corners that the last query expanded."""
        return int(self._ints[EXPANDED])

    def way(self, start: GridPoint, goal: GridPoint) -> list[GridPoint] | None:
        """The corners at which a shortest path bends; None where there is no path or an end is not
        free.

        Points are row and column of `blocked`, anywhere in a cell.
        """
        while True:
            self._ints[EXPANDED] = 0
            code = query(self._grid, self._index, self._corners, self._ints, self._floats,
                         *map(float, (*start, *goal)))  # fmt: skip
            if code >= 0:
                at = 2 * len(self._corners)
                numbers = iter(self._floats[at : at + 2 * code].tolist())
                return list(zip(numbers, numbers, strict=True))
            if code == NO_PATH:
                return None
            self._grow(code)

    def forget(self) -> None:
        """Drop every cached edge."""
        self._corners[:, LISTS + SEEN] = self._corners[:, LISTS + LIST + SEEN] = EMPTY
        self._ints[USED] = self._ints[LOGGED] = 0

    def replace(self, blocked: NDArray[np.bool_]) -> int:
        """Set all cells, (rows, columns); returns how many have changed."""
        other = np.argwhere(self.cells[1:-1, 1:-1] != blocked)
        return self.change(np.column_stack((other, blocked[other[:, 0], other[:, 1]])))

    def change(self, changes: NDArray[np.int64]) -> int:
        """Set cells and repair what depends on them; returns how many have changed.

        `changes`: (n, 3), row, column, blocked (1) or free (0); later rows win.
        """
        if len(changes) == 0:
            return 0
        if self._ints[LOGGED] + SEEN_MAX > LOG_MAX:
            self.forget()
        log = self._ints[self._log : self._log + 4 * LOG_MAX].reshape(-1, 4)
        changed, logged = _change(self.cells, self._grid, self._index, self._corners, self._spare,
                                  log, int(self._ints[LOGGED]), changes)  # fmt: skip
        assert logged != OUTSIDE, "a cell outside of the grid"
        if logged < 0:
            self._build()
        else:
            self._ints[LOGGED] = logged
        return int(changed)

    def _build(self) -> None:
        """Make everything from the cells; no edge is known then."""
        count = int(_build(self.cells, self._grid, self._index, self._corners))
        if count > len(self._corners):
            size = count + count // 4 + 64  # room for the corners of changed cells
            self._corners = np.empty((size, CORNER_COLUMNS), dtype=np.int32)
            count = int(_build(self.cells, self._grid, self._index, self._corners))
        size = len(self._corners)
        self._spare = np.empty(size + 1, dtype=np.int32)
        self._spare[0] = size - count
        self._spare[1 : 1 + size - count] = np.arange(count, size)
        self.forget()
        self._lay()

    def _grow(self, code: int) -> None:
        """Double what a query has run out of."""
        assert code in (POOL_FULL, HEAP_FULL, VIEW_FULL), code
        if code == VIEW_FULL:
            self._view *= 2
        elif code == HEAP_FULL:
            self._heap *= 2
        elif self._pool < POOL_MAX:
            self._pool *= 2
        else:
            self.forget()
        self._lay()

    def _lay(self) -> None:
        """Allocate scratch memory of the present sizes; the log and the edges are copied into it."""
        used, logged = int(self._ints[USED]), int(self._ints[LOGGED])
        log = HEAD + 4 * self._view + self._heap
        pool = log + 4 * LOG_MAX
        ints = np.zeros(pool + self._pool, dtype=np.int32)
        ints[:HEAD] = self._ints[:HEAD]
        if logged:
            ints[log : log + 4 * logged] = self._ints[self._log : self._log + 4 * logged]
        if used:
            ints[pool : pool + used] = self._ints[self._edges : self._edges + used]
        ints[VIEW_SIZE], ints[HEAP_SIZE], ints[LOG_SIZE] = self._view, self._heap, LOG_MAX
        self._ints, self._log, self._edges = ints, log, pool
        self._floats = np.empty(2 * (len(self._corners) + self._view) + self._heap)
