"""Ways through a field or a building in metres: the any-angle planner behind a grid."""

import itertools
from collections.abc import Sequence
from math import dist, hypot

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import Point
from agent.paths.any_angle_planner import Planner
from agent.paths.lane_ways import LaneWays
from agent.paths.regions import regions_of

SAME_M = 1e-3  # places nearer to each other than this are one
OPEN_SEARCH_CELLS = 12  # greatest distance by which a start or goal on a blocked cell is moved


class Route:
    """Paths over a grid `blocked` (row, column) whose cell (0, 0) has its corner at the origin.

    A path may pass anywhere in a free cell, along its border too. So the grid must block every cell
    of which a part is too near to something.
    """

    def __init__(
        self, blocked: NDArray[np.bool_], origin_x_m: float, origin_y_m: float, cell_m: float,
        lanes: Sequence[Sequence[Point]] = (),
    ) -> None:  # fmt: skip
        """`lanes`: lines through ground that is too narrow for cells, metres; they meet at ends."""
        self.blocked, self.cell_m = blocked, cell_m
        self.origin_x_m, self.origin_y_m = origin_x_m, origin_y_m
        self.planner = Planner(blocked)
        self.lanes = LaneWays(lanes)
        self._regions: NDArray[np.int32] | None = None  # made when a lane is needed

    def round(self, bodies: Sequence[Point], reach_m: float) -> "Route":
        """The same route with a disc of `reach_m` blocked round each standing body.

        No path comes nearer to a body than `reach_m`. It is another grid: make it when something
        comes or goes, not for every path.
        """
        blocked, reach = self.blocked.copy(), int(reach_m / self.cell_m) + 1
        for body_x_m, body_y_m in bodies:
            row, column = self._cell((body_x_m, body_y_m))
            top, left = max(row - reach, 0), max(column - reach, 0)
            window = blocked[top : row + reach + 1, left : column + reach + 1]
            y_m = self.origin_y_m + (top + np.arange(window.shape[0]) + 0.5) * self.cell_m
            x_m = self.origin_x_m + (left + np.arange(window.shape[1]) + 0.5) * self.cell_m
            half_m = self.cell_m / 2  # the gap is that of the nearest point of a cell
            gap_x_m = np.maximum(np.abs(x_m - body_x_m) - half_m, 0.0)
            gap_y_m = np.maximum(np.abs(y_m - body_y_m) - half_m, 0.0)
            gap2 = gap_x_m[None, :] ** 2 + gap_y_m[:, None] ** 2
            window |= gap2 < reach_m * reach_m
        lanes = self.lanes.without(bodies, reach_m)
        return Route(blocked, self.origin_x_m, self.origin_y_m, self.cell_m, lanes)

    def admits(self, point: Point) -> bool:
        """Whether a robot's centre may be there."""
        row = (point[1] - self.origin_y_m) // self.cell_m
        column = (point[0] - self.origin_x_m) // self.cell_m
        rows, columns = self.blocked.shape
        if not (0 <= row < rows and 0 <= column < columns):  # infinity, too
            return False
        return not self.blocked[int(row), int(column)]

    def path(self, start: Point, goal: Point) -> tuple[Point, ...]:
        """Waypoints from start to goal, both included exactly; the straight line where no path is
        found.

        Start and goal may lie on blocked cells, as for a robot at the fence. The path then goes
        through the nearest free cell.
        """
        over = self.lanes.lines and self._over_lanes(start, goal)
        if over:
            return over
        return self._over_cells(start, goal) or (start, goal)

    def _over_cells(self, start: Point, goal: Point) -> tuple[Point, ...] | None:
        a, b = self._open(self._cell(start)), self._open(self._cell(goal))
        if a is None or b is None:
            return None
        cells = self.planner.plan(a, b)
        if cells is None:
            return None
        inner = [self._point(cell) for cell in cells[1:-1]]
        # A start moved to an open cell must be visited, or the first leg could cut a corner.
        if a != self._cell(start):
            inner.insert(0, self._point(a))
        if b != self._cell(goal):
            inner.append(self._point(b))
        return (start, *inner, goal)

    def _over_lanes(self, start: Point, goal: Point) -> tuple[Point, ...] | None:
        """The way over lanes, if cells do not join the two places; None: they do, or there is none."""
        if self._regions is None:
            self._regions = regions_of(self.blocked)
        from_region, to_region = self._region(start), self._region(goal)
        if from_region == to_region != 0:
            return None
        ends = {end: self._region(end) for end in self.lanes.ends}
        legs = self.lanes.legs(start, from_region, goal, to_region, ends)
        if legs is None:
            return None
        way = [start]
        for leg in legs:
            on = leg.points if leg.is_lane else self._over_cells(leg.points[0], leg.points[-1])
            way += [at for at in on or leg.points if dist(at, way[-1]) > SAME_M]
        return (start, *way[1:-1], goal) if dist(way[-1], goal) <= SAME_M else (*way, goal)

    def _region(self, point: Point) -> int:
        """The region of free cells from which a place is reached; 0 if that is a lane."""
        assert self._regions is not None
        cell = self._cell(point)
        opened = self._open(cell)
        if opened is None:
            return 0
        if opened != cell and self.lanes.off_m(point) < dist(point, self._point(opened)):
            return 0
        return int(self._regions[opened])

    def straight(self, start: Point, goal: Point) -> bool:
        """Whether the straight line between two places is free."""
        return self.planner.sees(self._cell(start), self._cell(goal))

    def opened(self, point: Point) -> Point:
        """The point itself, or the middle of the nearest free cell if it lies on a blocked one."""
        cell = self._cell(point)
        opened = self._open(cell)
        return point if opened is None or opened == cell else self._point(opened)

    def length_m(self, start: Point, goal: Point) -> float:
        """The length of `path`; of the straight line where none is found."""
        points = self.path(start, goal)
        return sum(hypot(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(points))

    def _cell(self, point: Point) -> tuple[int, int]:
        row = int((point[1] - self.origin_y_m) // self.cell_m)
        column = int((point[0] - self.origin_x_m) // self.cell_m)
        rows, columns = self.blocked.shape
        return min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)

    def _point(self, cell: tuple[float, float]) -> Point:
        return (
            self.origin_x_m + (cell[1] + 0.5) * self.cell_m,
            self.origin_y_m + (cell[0] + 0.5) * self.cell_m,
        )

    def _open(self, cell: tuple[int, int]) -> tuple[int, int] | None:
        if not self.blocked[cell]:
            return cell
        row, column = cell
        r = OPEN_SEARCH_CELLS
        top, left = max(row - r, 0), max(column - r, 0)
        rows, columns = np.nonzero(~self.blocked[top : row + r + 1, left : column + r + 1])
        if rows.size == 0:
            return None
        nearest = np.argmin((rows + top - row) ** 2 + (columns + left - column) ** 2)
        return int(rows[nearest] + top), int(columns[nearest] + left)
