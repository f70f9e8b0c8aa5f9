"""Theta*: any-angle paths over a grid of blocked and free cells.

A cell is a square of side 1 around its (row, column) centre. A path never enters a blocked cell
and never squeezes between two that touch at a corner, so a path exists exactly where 4-connected
free cells join the cells of start and goal.
"""

from collections.abc import Iterable
from itertools import pairwise
from math import hypot

import numpy as np
from numpy.typing import NDArray

from agent.grid_search import GridSearch, sees

Point = tuple[float, float]  # row, column; a pair of integers is the centre of that cell
Waypoints = list[Point]
Grid = NDArray[np.bool_]
Change = tuple[int, int, bool]  # row, column, blocked from now on


class Planner:
    """A grid and the memory of its searches, for many queries and small changes between them."""

    def __init__(self, blocked: Grid) -> None:
        """`blocked`: (rows, columns), True where the inflated grid is blocked; copied."""
        self.blocked: Grid = np.array(blocked, dtype=np.bool_, order="C")
        assert self.blocked.ndim == 2
        self._search = GridSearch(self.blocked)

    def update(self, change: Grid | Iterable[Change]) -> int:
        """Another state of the whole grid, or single cells; returns how many cells changed."""
        if isinstance(change, np.ndarray):
            assert change.shape == self.blocked.shape
            changed = int(np.count_nonzero(change != self.blocked))
            self.blocked[:] = change
            return changed
        changed = 0
        for row, column, blocked in change:
            changed += bool(self.blocked[row, column]) != blocked
            self.blocked[row, column] = blocked
        return changed

    def plan(self, start: Point, goal: Point) -> Waypoints | None:
        """Waypoints from start to goal, both included as given, or None where there is no way."""
        return self.plan_plain(start, goal)

    def plan_plain(self, start: Point, goal: Point) -> Waypoints | None:
        """Basic Theta* over cell centres; start and goal count as the centres of their cells."""
        return self._over_cells(start, goal, lazy=False)

    def plan_lazy(self, start: Point, goal: Point) -> Waypoints | None:
        """Lazy Theta* over cell centres."""
        return self._over_cells(start, goal, lazy=True)

    def sees(self, a: tuple[int, int], b: tuple[int, int]) -> bool:
        """Whether the straight line between two cell centres touches free cells only."""
        return bool(sees(self.blocked, a[0], a[1], b[0], b[1]))

    def _cell(self, point: Point) -> tuple[int, int] | None:
        """The free cell of a point, None where it is blocked or outside."""
        row, column = int(np.floor(point[0] + 0.5)), int(np.floor(point[1] + 0.5))
        rows, columns = self.blocked.shape
        inside = 0 <= row < rows and 0 <= column < columns
        return (row, column) if inside and not self.blocked[row, column] else None

    def _over_cells(self, start: Point, goal: Point, lazy: bool) -> Waypoints | None:
        a, b = self._cell(start), self._cell(goal)
        if a is None or b is None:
            return None
        cells = self._search.cells(a, b, lazy)
        return None if cells is None else [(float(row), float(column)) for row, column in cells]


def plan(blocked: Grid, start: Point, goal: Point) -> Waypoints | None:
    """A path over a boolean array, True where blocked: waypoints (row, column), or None.

    >>> wall = np.zeros((5, 5), dtype=bool); wall[2, :4] = True
    >>> plan(wall, (0, 0), (4, 0)) is not None
    True
    """
    return Planner(blocked).plan(start, goal)


def length(path: Waypoints) -> float:
    """In cells."""
    return sum(hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(path))
