"""An explorer's path to its station: planned on its own map, and again when something solid turns
up.
"""

from collections.abc import Sequence
from itertools import pairwise
from math import ceil, dist, hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from agent.exploration.exploration_task import AT_M
from agent.interface.config import S
from agent.interface.geometry import Cell, Point
from agent.interface.mission import STILL, FleetView, MotionRequest
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.mapping.local_and_fleet_map import LocalAndFleetMap

Cells = tuple[NDArray[np.intp], NDArray[np.intp]]  # rows, columns
SAMPLES = 2  # of a path for each cell, so that only corners of cells are left out
TURN_RAD_S = 0.8  # a robot turns as it drives, so that its rays leave no cell between them
STUCK_US = 8 * S  # a target fails if the robot gets no nearer by `NEARER_M` for this long
NEARER_M = 0.1
TURN_ROUND = STILL._replace(turn_rad_s=TURN_RAD_S)


class FrontierPath:
    """The path of one robot to its current station. Places are (x, y) metres."""

    def __init__(self, chart: LocalAndFleetMap, limits: BodyLimits) -> None:
        self.chart, self.limits = chart, limits
        self.station: Point | None = None
        self.arrived_at_us = 0  # when the station was reached; 0: not yet
        self.rest: list[Point] = []  # waypoints still to come
        self._open: Cells = np.empty(0, np.intp), np.empty(0, np.intp)
        self._nearest_m, self._nearest_at_us = np.inf, 0

    def cell(self, at: Point) -> Cell:
        """The (row, column) cell at a place, or the nearest one on the map."""
        rows, columns, _, _ = self.chart.geometry
        row, column = self.chart.geometry.cell(at)
        return min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)

    def head_for(self, station: Point, view: FleetView) -> None:
        """Go to another station: plan a path from here."""
        self.station, self.arrived_at_us = station, 0
        self._nearest_m = np.inf
        self.has_time(view.now_us)
        self.plan(view.here)

    def plan(self, here: Observation) -> None:
        """Plan again to the same station; without a path `rest` is empty."""
        assert self.station is not None
        self.chart.take_fleet_walls()
        path = self.chart.grid.plan((here.x_m, here.y_m), self.station) or []
        self.rest = path[1:]
        rows, columns = self._along(path)
        free = ~self.chart.grid.tight.blocked[rows, columns]  # a start may be carved out
        self._open = rows[free], columns[free]

    def _along(self, path: Sequence[Point]) -> Cells:
        """Rows and columns of the cells under a path, some of them twice."""
        if len(path) < 2:
            return np.empty(0, np.intp), np.empty(0, np.intp)
        rows, columns, (west_m, south_m), cell_m = self.chart.geometry
        points = np.concatenate([
            np.linspace(a, b, ceil(dist(a, b) / cell_m * SAMPLES) + 1) for a, b in pairwise(path)
        ])  # fmt: skip
        row, column = ((points - (west_m, south_m)) / cell_m).T[::-1].astype(np.intp)
        return row.clip(0, rows - 1), column.clip(0, columns - 1)

    def end(self) -> None:
        """There is no station any more."""
        self.station, self.rest = None, []

    def has_time(self, now_us: int) -> None:
        """From now on it may take `STUCK_US` to get nearer."""
        self._nearest_at_us = now_us

    def stuck(self, now_us: int) -> bool:
        """Whether the robot got no nearer for `STUCK_US`."""
        return now_us > self._nearest_at_us + STUCK_US

    @property
    def blocked(self) -> bool:
        """Whether something solid has turned up on the path since it was planned."""
        return bool(self.rest) and bool(self.chart.grid.tight.blocked[self._open].any())

    def drive(self, view: FleetView) -> MotionRequest:
        """The motion along the path, always turning. It sets `arrived_at_us` at the station and turns
        there.
        """
        here = view.here
        if self.station is None:
            return TURN_ROUND
        if hypot(self.station[0] - here.x_m, self.station[1] - here.y_m) < AT_M:
            if not self.arrived_at_us:
                self.arrived_at_us = view.now_us
            return TURN_ROUND
        while len(self.rest) > 1 and self._near(self.rest[0], here):
            self.rest.pop(0)
        if not self.rest:
            return TURN_ROUND
        x, y = self.rest[0]
        dx_m, dy_m = x - here.x_m, y - here.y_m
        next_m = max(hypot(dx_m, dy_m), 1e-6)
        rest_m = next_m + sum(
            hypot(b[0] - a[0], b[1] - a[1]) for a, b in zip(self.rest, self.rest[1:], strict=False)
        )
        if rest_m < self._nearest_m - NEARER_M:
            self._nearest_m, self._nearest_at_us = rest_m, view.now_us
        speed_m_s = min(self.limits.speed_m_s, sqrt(self.limits.acceleration_m_s2 * rest_m))
        return MotionRequest(dx_m / next_m * speed_m_s, dy_m / next_m * speed_m_s, TURN_RAD_S)

    @staticmethod
    def _near(at: Point, here: Observation) -> bool:
        return hypot(at[0] - here.x_m, at[1] - here.y_m) < AT_M
