"""The maps of many robots at once, for simulations: all their scans weighed in one kernel.

Each robot's map is its own, and what it would be if it had taken each scan in by itself
(`OccupancyGrid.observe`, with the other robots as `others`); only the calls are fewer. Beside it,
`tools/bench/kernels/orca_fleet.py` does the same for velocities.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from agent.interface.geometry import Point
from agent.mapping.inflation import Grid
from agent.mapping.occupancy_grid import SCANS_MAX, OccupancyGrid, memory_of
from agent.mapping.ray_evidence import room_for, weigh_scan


@njit(cache=True, error_model="numpy")
def weigh_scans(  # type: ignore[no-untyped-def]
    evidence, solid, stamps, scan, corner_x, corner_y, cell, places, ranges, range_max, radius,
    toggled, ends,
):  # fmt: skip
    """`weigh_scan` of every robot: `places` (n, 3: x, y, heading), `ranges` (n, rays).

    `evidence`, `solid` and `stamps` (n, rows, columns) are the maps; `corner_x`, `corner_y`,
    `cell`, `range_max` and `radius` are metres. Robot k's cells are in rows `ends[k]` to `ends[k +
    1]` of `toggled`. No echo within `radius` of another robot counts.
    """
    count = places.shape[0]
    discs = np.empty((count, 3))
    discs[:, 2] = radius
    reach = range_max + radius
    ends[0] = 0
    for k in range(count):
        x, y, near = places[k, 0], places[k, 1], 0
        for j in range(count):
            dx, dy = places[j, 0] - x, places[j, 1] - y
            if j != k and dx * dx + dy * dy < reach * reach:
                discs[near, 0], discs[near, 1] = places[j, 0], places[j, 1]
                near += 1
        ends[k + 1] = ends[k] + weigh_scan(
            evidence[k], solid[k], stamps[k], scan, corner_x, corner_y, cell, x, y, places[k, 2],
            ranges[k], range_max, discs[:near], toggled[ends[k] :],
        )  # fmt: skip


class OccupancyFleet:
    """The occupancy grids of many robots in one piece of memory, which take their scans together."""

    def __init__(
        self, count: int, fixed: Grid, origin_m: Point, body_radius_m: float, ignored_m: float
    ) -> None:
        """`fixed`: walls that are known, of all; `ignored_m`: echoes this near to another robot's
        middle are that robot."""
        rows, columns = fixed.shape
        self._memory = memory_of((count, rows, columns))
        evidence, seen, stamps = self._memory
        self.grids = [
            OccupancyGrid(
                rows, columns, origin_m, body_radius_m, fixed,
                memory=(evidence[k], seen[k], stamps[k]),
            )
            for k in range(count)
        ]  # fmt: skip
        self.ignored_m = ignored_m
        self._ends = np.zeros(count + 1, dtype=np.int64)
        self._toggled = np.empty((0, 3), dtype=np.int64)

    def observe(
        self,
        places: NDArray[np.float64],
        ranges_m: NDArray[np.float32] | NDArray[np.float64],
        range_max_m: float,
    ) -> list[int]:
        """A scan of every robot: `ranges_m` (robots, rays) from `places` (robots, 3: x, y,
        heading). Returns how many cells of each changed state."""
        first, (count, rays) = self.grids[0], ranges_m.shape
        assert count == len(self.grids) and range_max_m > 0 and bool(np.isfinite(places).all())
        room = count * room_for(rays, range_max_m / first.cell_m, *first.solid.shape)
        if len(self._toggled) < room:
            self._toggled = np.empty((room, 3), dtype=np.int64)
        scan = first.scan % SCANS_MAX + 1
        weigh_scans(*self._memory, scan, *first.origin_m, first.cell_m, np.ascontiguousarray(places),
                    ranges_m.astype(np.float64), range_max_m, self.ignored_m, self._toggled,
                    self._ends)  # fmt: skip
        ends, news = self._ends.tolist(), []
        for k, grid in enumerate(self.grids):
            grid.scan = scan
            cells = self._toggled[ends[k] : ends[k + 1]]
            news.append(grid.settle(cells) if len(cells) else 0)
        return news
