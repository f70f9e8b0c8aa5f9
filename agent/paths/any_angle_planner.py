"""Any-angle paths over a grid of blocked and free cells.

A cell is a square of side 1 around its (row, column) centre. A path never enters a blocked cell
and never squeezes between two that touch at a corner, so a path exists exactly where 4-connected
free cells join the cells of start and goal.

The default planner searches the convex corners of the grid (`agent.paths.corner_graph`), as Theta* over
subgoal graphs does (Uras and Koenig, SoCS 2015), with edges found on demand and kept; its paths are
shortest ones. Basic Theta* over cell centres stands beside it.
"""

from collections.abc import Iterable
from itertools import pairwise
from math import floor, hypot

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import GridPoint
from agent.paths.corner_cache import CornerMemory
from agent.paths.regions import regions_of
from agent.paths.theta_star import GridSearch, sees

Waypoints = list[GridPoint]
Grid = NDArray[np.bool_]
Change = tuple[int, int, bool]  # row, column, blocked from now on
Cells = NDArray[np.int64]  # (n, 3), a change a row


class Planner:
    """A grid and the memory of its searches, for many queries and small changes between them."""

    def __init__(self, blocked: Grid) -> None:
        """`blocked`: (rows, columns), True where the inflated grid is blocked; copied."""
        self.blocked: Grid = np.array(blocked, dtype=np.bool_, order="C")
        assert self.blocked.ndim == 2
        self._corners = CornerMemory(self.blocked)
        self._plain: GridSearch | None = None  # 150 bytes a cell: created only on request
        self._regions: NDArray[np.int32] | None = None  # made at the first query without a path

    def update(self, change: Grid | Cells | Iterable[Change]) -> int:
        """Another state of the whole grid, or single cells; returns how many cells changed."""
        if isinstance(change, np.ndarray) and change.dtype == np.bool_:
            grid = np.asarray(change, dtype=np.bool_)
            assert grid.shape == self.blocked.shape
            changed = self._corners.replace(grid)
            self.blocked[:] = grid
        else:
            known = isinstance(change, np.ndarray)
            cells = np.array(change if known else list(change), dtype=np.int64).reshape(-1, 3)
            changed = self._corners.change(cells)
            self.blocked[cells[:, 0], cells[:, 1]] = cells[:, 2]  # later ones win here, too
        if changed:
            self._regions = None
        return changed

    def plan(self, start: GridPoint, goal: GridPoint) -> Waypoints | None:
        """Waypoints from start to goal, both included as given, or None where there is no way."""
        if self._regions is not None and not self._joined(start, goal):
            return None
        way = self._corners.way(start, goal)
        if way is not None:
            return [start, *way, goal]
        if self._regions is None:
            self._regions = regions_of(self.blocked)
            if not self._joined(start, goal):
                return None
        # Never seen: the corner search compares rounded lengths, the regions know for certain.
        cells = self.plan_plain(start, goal)
        assert cells is not None
        return [start, *cells[1:-1], goal]

    def plan_plain(self, start: GridPoint, goal: GridPoint) -> Waypoints | None:
        """Basic Theta* over cell centres; start and goal count as the centres of their cells."""
        a, b = self._cell(start), self._cell(goal)
        return None if a is None or b is None else self._over_cells(a, b)

    def forget(self) -> None:
        """Drop the cached edges; the next queries find them again."""
        self._corners.forget()

    def sees(self, a: tuple[int, int], b: tuple[int, int]) -> bool:
        """Whether the straight line between two cell centres touches free cells only."""
        return bool(sees(self.blocked, a[0], a[1], b[0], b[1]))

    def _cell(self, point: GridPoint) -> tuple[int, int] | None:
        """The free cell of a point, None where it is blocked or outside."""
        row, column = floor(point[0] + 0.5), floor(point[1] + 0.5)
        rows, columns = self.blocked.shape
        inside = 0 <= row < rows and 0 <= column < columns
        return (row, column) if inside and not self.blocked[row, column] else None

    def _joined(self, start: GridPoint, goal: GridPoint) -> bool:
        """Whether two points are in free cells of one region."""
        a, b = self._cell(start), self._cell(goal)
        assert self._regions is not None
        return a is not None and b is not None and bool(self._regions[a] == self._regions[b])

    def _over_cells(self, start: tuple[int, int], goal: tuple[int, int]) -> Waypoints | None:
        if self._plain is None:
            self._plain = GridSearch(self.blocked)
        cells = self._plain.cells(start, goal)
        return None if cells is None else [(float(row), float(column)) for row, column in cells]


def plan(blocked: Grid, start: GridPoint, goal: GridPoint) -> Waypoints | None:
    """A path over a boolean array, True where blocked: waypoints (row, column), or None.

    >>> wall = np.zeros((5, 5), dtype=bool); wall[2, :4] = True
    >>> plan(wall, (0, 0), (4, 0)) is not None
    True
    """
    return Planner(blocked).plan(start, goal)


def length(path: Waypoints) -> float:
    """The length of a path in sides of a cell, along its straight pieces."""
    return sum(hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(path))
