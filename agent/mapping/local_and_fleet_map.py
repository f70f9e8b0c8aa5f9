"""A robot's two maps: what its own rays say, and what the fleet knows; and the news that it sends.

The own map is private evidence, and paths are planned on it. News are cells without a record in the
fleet's map, or with a record that our own observation outranks. A patch of 4 x 4 cells is sent when
no more news of it is expected: when it is complete, or some time after its first new cell.
"""

from collections.abc import Iterable
from math import isfinite

import numpy as np

from agent.interface.config import MS
from agent.interface.observation import Observation
from agent.mapping.occupancy_grid import OccupancyGrid
from agent.mapping.ray_evidence import LEAST, MOST
from crdt.occupancy import CELLS, SIDE, Geometry, OccupancyMap, patch_of
from crdt.sighting import FREE, OBSTACLE, UNKNOWN, base, level_of
from protocol.sync.map_sync import MapSync, Values

LOOK_US = 200 * MS  # period of the search for news
# Confidence after one observation, and after as many as evidence can count.
SEEN, SURE = level_of(0.6), level_of(0.9)


class LocalAndFleetMap:
    """The two maps of one robot. Arrays are (rows, columns) of `geometry`, row 0 in the south."""

    def __init__(
        self, sync: MapSync | None, geometry: Geometry, body_radius_m: float, range_m: float,
        grid: OccupancyGrid | None = None,
    ) -> None:  # fmt: skip
        """`sync`: shares the fleet's map; None if nothing is shared. `geometry`: of both maps.
        `body_radius_m`: of our body. `range_m`: up to which rays are used. `grid`: our own map;
        None for one without known walls.
        """
        self.sync, self.geometry, self.range_m = sync, geometry, range_m
        rows, columns, origin, cell_m = geometry
        if grid is None:
            grid = OccupancyGrid(rows, columns, origin, body_radius_m, cell_m=cell_m, walled=True)
        self.grid = grid
        self.fleet = OccupancyMap(geometry) if sync is None else sync.chart
        self.told = np.zeros((rows, columns), dtype=np.bool_)  # walls that others have reported
        self._looked_at_us = -LOOK_US
        self._first_seen_at_us: dict[int, int] = {}  # patch -> when its first new cell was seen
        self._version = -1

    def observe(self, here: Observation, others: Iterable[tuple[float, float, float]]) -> None:
        """Take one scan into our own map.

        `others`: x, y and radius of robots, metres; their echoes are no obstacles.
        """
        if here.ranges_m:
            at = (here.x_m, here.y_m)
            self.grid.observe(at, here.heading_rad, here.ranges_m, self.range_m, list(others))

    def own(self) -> Values:
        """What our own rays say: FREE, OBSTACLE or UNKNOWN of `crdt/sighting.py` a cell."""
        free = np.where(self.grid.evidence < 0, FREE, UNKNOWN)
        return np.where(self.grid.seen, OBSTACLE, free)

    def values(self) -> Values:
        """What our own rays say, and where they say nothing, what the fleet knows."""
        own = self.own()
        return np.where(own != UNKNOWN, own, self.fleet.values())

    def seen_by(self) -> Values:
        """The slot of each record in the fleet's map, -1 if there is none."""
        return np.where(self.fleet.values() != UNKNOWN, self.fleet.observers(), -1)

    def admits(self, at: tuple[float, float]) -> bool:
        """Whether a robot may be sent to (x, y) metres, as far as is known."""
        return self.geometry.holds(at) and not self.grid.tight.blocked[self.geometry.cell(at)]

    def take_fleet_walls(self) -> None:
        """Take walls of the fleet's map into our own, so that paths avoid them."""
        if self.fleet.version != self._version:
            self._version = self.fleet.version
            self.grid.wall((self.fleet.values() == OBSTACLE) & (self.grid.evidence >= 0))

    def share_news(self, here: Observation, now_us: int) -> None:
        """Look for news near by, and give patches that are ready to the sync."""
        if self.sync is None or now_us < self._looked_at_us + min(LOOK_US, self.sync.hold_for_us):
            return
        if not isfinite(here.x_m + here.y_m):
            return
        self._looked_at_us = now_us
        row, column = self.geometry.cell((here.x_m, here.y_m))
        reach = int(self.range_m / self.geometry.cell_m) + 2
        rows, columns, _, _ = self.geometry
        low_r, low_c = max(row - reach, 0) // SIDE * SIDE, max(column - reach, 0) // SIDE * SIDE
        high_r, high_c = min(row + reach, rows - 1), min(column + reach, columns - 1)
        if high_r < low_r or high_c < low_c:
            return
        window = (slice(low_r, high_r + 1), slice(low_c, high_c + 1))
        time = self.sync.clock.read(now_us)
        new = self._news(window, time, self.sync.slot)
        for r, c in np.unique(np.argwhere(new) // SIDE, axis=0).tolist():
            self._ripen(low_r + SIDE * r, low_c + SIDE * c, new[4 * r : 4 * r + 4, 4 * c : 4 * c + 4],
                        now_us)  # fmt: skip

    def _news(self, window: tuple[slice, slice], time: int, slot: int) -> Values:
        """Values of the cells in a window that are news to the fleet, UNKNOWN elsewhere.

        `time`: of the fleet's clock. `slot`: ours.
        """
        evidence, seen = self.grid.evidence[window], self.grid.seen[window]
        own = np.where(seen, OBSTACLE, np.where(evidence < 0, FREE, UNKNOWN))
        known = self.fleet.keys()[window]
        sure = np.where(seen, evidence == MOST, evidence == LEAST)
        # What contradicts a record must be certain and outrank it. Otherwise two robots would
        # overwrite each other's records for ever.
        mine = base(self.fleet.order, SURE, time, slot) | own
        worth = (known == 0) | (((known & 3) != own) & sure & (mine > known))
        return np.where((own != UNKNOWN) & worth, own, UNKNOWN)

    def _ripen(self, row: int, column: int, new: Values, now_us: int) -> None:
        patch = patch_of(row, column)
        values = np.zeros((SIDE, SIDE), dtype=np.int64)
        values[: new.shape[0], : new.shape[1]] = new
        known = self.fleet.patch(patch).reshape(SIDE, SIDE) > 0
        assert self.sync is not None
        complete = int(np.count_nonzero(known | (values != UNKNOWN))) == CELLS
        first_at_us = self._first_seen_at_us.setdefault(patch, now_us)
        if not complete and now_us < first_at_us + self.sync.hold_for_us:
            return
        del self._first_seen_at_us[patch]
        area = (slice(row, row + SIDE), slice(column, column + SIDE))
        evidence = self.grid.evidence[area]
        told = values[: evidence.shape[0], : evidence.shape[1]] != UNKNOWN
        sure = (evidence == MOST) | (evidence == LEAST)
        level = SURE if bool((sure | ~told).all()) or bool((known & (values > 0)).any()) else SEEN
        self.sync.see(patch, values.reshape(CELLS), level)
