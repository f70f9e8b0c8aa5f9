"""Where a robot's centre may be: solid cells grown by a reach, kept up to date, with a planner.

A cell is blocked if any point of it is nearer than the reach to any point of a solid cell. So a
path anywhere in free cells, also along their borders, keeps the reach. Each cell has a count of the
solid cells that block it, so a solid cell that goes takes only its own part away.
"""

from math import ceil, hypot

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import Cell, GridPoint
from agent.kernels.kernel import njit
from agent.paths.any_angle_planner import Planner, Waypoints

Changes = NDArray[np.int64]  # (n, 3): row, column, 1 if solid or blocked now, else 0
Grid = NDArray[np.bool_]


@njit(cache=True, error_model="numpy")
def _grow(counts: NDArray[np.int32], stencil: Changes, toggled: Changes, changes: Changes) -> int:
    """Add the solid cells that came and take off those that went.

    `counts` (rows, columns): how many solid cells block each cell. `stencil` (k, 2): offsets that a
    solid cell blocks. `toggled` (n, 3): row, column, 1 if it came. `changes`: room for n * k rows
    of the same form; the cells that became blocked or free. Returns how many of its rows are
    filled.
    """
    rows, columns = counts.shape
    filled = 0
    for n in range(toggled.shape[0]):
        way = 1 if toggled[n, 2] else -1
        for k in range(stencil.shape[0]):
            r, c = toggled[n, 0] + stencil[k, 0], toggled[n, 1] + stencil[k, 1]
            if not (0 <= r < rows and 0 <= c < columns):
                continue
            before = counts[r, c]
            counts[r, c] = before + way
            if before == 0 or before + way == 0:
                changes[filled, 0], changes[filled, 1], changes[filled, 2] = r, c, way > 0
                filled += 1
    return filled


def disc(reach_cells: float) -> NDArray[np.int64]:
    """Offsets (n, 2) of the cells that have a point nearer than `reach_cells` to a point of cell
    (0, 0).
    """
    side = ceil(reach_cells) + 1
    offsets = [
        (i, j)
        for i in range(-side, side + 1)
        for j in range(-side, side + 1)
        if (i, j) == (0, 0) or hypot(max(abs(i) - 1, 0), max(abs(j) - 1, 0)) < reach_cells
    ]
    return np.array(offsets, dtype=np.int64)


class Inflation:
    """The cells that are blocked at one reach, and the planner that works on them."""

    def __init__(self, solid: Grid, reach_cells: float, walled: bool = False) -> None:
        """`solid`: (rows, columns). `reach_cells`: in cells, not negative; 0 blocks the solid cells
        alone. `walled`: whether the edge of the grid is solid, too.
        """
        assert reach_cells >= 0
        self.reach_cells = reach_cells
        self._stencil = disc(reach_cells)
        self._counts = np.zeros(solid.shape, dtype=np.int32)
        rows, columns = np.nonzero(solid)
        _grow(self._counts, self._stencil, *self._room(rows, columns))
        if walled:
            edge = ceil(reach_cells)  # rows and columns with a point nearer than the reach
            inside = np.zeros(solid.shape, dtype=np.bool_)
            inside[edge : solid.shape[0] - edge, edge : solid.shape[1] - edge] = True
            self._counts[~inside] += 1
        self.planner = Planner(self._counts > 0)

    def _room(self, rows: Changes, columns: Changes) -> tuple[Changes, Changes]:
        toggled = np.column_stack((rows, columns, np.ones_like(rows)))
        return toggled, np.empty((len(toggled) * len(self._stencil), 3), dtype=np.int64)

    @property
    def blocked(self) -> Grid:
        """(rows, columns), True where blocked; read only."""
        return self.planner.blocked

    def toggle(self, toggled: Changes) -> int:
        """Update for solid cells that came or went. Returns how many cells became blocked or free.

        `toggled` (n, 3): row, column, 1 if it came and 0 if it went; each change once.
        """
        changes = np.empty((len(toggled) * len(self._stencil), 3), dtype=np.int64)
        filled = _grow(self._counts, self._stencil, toggled, changes)
        return self.planner.update(changes[:filled])

    def plan(self, start: GridPoint, goal: GridPoint, carved: list[Cell]) -> Waypoints | None:
        """Waypoints from start to goal, (row, column) with whole numbers at cell centres; None if
        no path exists.

        `carved`: blocked cells that count as free in this query alone.
        """
        if not carved:
            return self.planner.plan(start, goal)
        cells = np.unique(np.array(carved, dtype=np.int64), axis=0)
        cells = cells[self.blocked[cells[:, 0], cells[:, 1]]]
        self.planner.update(np.column_stack((cells, np.zeros(len(cells), dtype=np.int64))))
        path = self.planner.plan(start, goal)
        self.planner.update(np.column_stack((cells, np.ones(len(cells), dtype=np.int64))))
        return path

    def way_out(self, at: Cell, solid: Grid, body_cells: float) -> Cell | None:
        """The nearest free cell that a straight line joins with `at` without crossing a solid cell.

        It is `at` itself if that is free, and None if there is no such cell within the reach and a
        body. `solid`: (rows, columns). `body_cells`: radius round `at`, in cells, within which
        cells count as free because our body is there.
        """
        if not self.blocked[at]:
            return at
        rows, columns = self.blocked.shape
        offsets = disc(self.reach_cells + body_cells + 1.0)
        order = np.argsort(np.hypot(offsets[:, 0], offsets[:, 1]), kind="stable")
        for i, j in offsets[order].tolist():
            r, c = at[0] + i, at[1] + j
            if not (0 <= r < rows and 0 <= c < columns) or self.blocked[r, c]:
                continue
            steps = 2 * max(abs(i), abs(j))
            t = np.arange(steps + 1) / steps
            line_r = np.floor(at[0] + t * i + 0.5).astype(np.int64)
            line_c = np.floor(at[1] + t * j + 0.5).astype(np.int64)
            beyond = t * hypot(i, j) > body_cells
            if not (solid[line_r, line_c] & beyond).any():
                return r, c
        return None

    def carve(self, at: Cell, keep: Grid, body_cells: float = -1.0) -> list[Cell]:
        """Cells to free round a place that lies in the inflation, as far as the inflation reaches.

        The list is empty if the place is free. Cells of `keep` (rows, columns) stay blocked, except
        within `body_cells` of the place.
        """
        if not self.blocked[at]:
            return []
        rows, columns = self.blocked.shape
        found = []
        for i, j in disc(self.reach_cells + 1.0).tolist():
            r, c = at[0] + i, at[1] + j
            inside = 0 <= r < rows and 0 <= c < columns
            if inside and self.blocked[r, c] and (not keep[r, c] or hypot(i, j) <= body_cells):
                found.append((r, c))
        return found


def cell_of(point: GridPoint) -> Cell:
    """The (row, column) cell of a point given as row and column, with whole numbers at centres."""
    return int(np.floor(point[0] + 0.5)), int(np.floor(point[1] + 0.5))
