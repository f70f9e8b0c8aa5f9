"""Areas as square cells, for checkers that count."""

from math import ceil
from typing import NamedTuple

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon

Floats = NDArray[np.float64]

CELLS_MAX = 64_000_000  # 64 MB of flags; a larger field needs a coarser raster

# For a field that is judged: 20 bytes each. 0.25 m up to 1 km x 1 km, 1 m up to 4 km, 2 m for 6.5
# km.
CELLS_JUDGED_MAX = 16_000_000


class Raster(NamedTuple):
    """`cells[row, column]`, row 0 in the south, True where a cell's centre is in the area."""

    cells: NDArray[np.bool_]
    west_m: float
    south_m: float
    cell_m: float

    @property
    def area_m2(self) -> float:
        """Area of all cells that are True."""
        return float(np.count_nonzero(self.cells)) * self.cell_m**2

    def centres(self, flags: NDArray[np.bool_]) -> Floats:
        """Centres of the cells that are True in `flags` (rows, columns), as an array (n, 2): x, y
        in metres."""
        row, column = np.nonzero(flags)
        x_m = self.west_m + (column + 0.5) * self.cell_m
        return np.column_stack((x_m, self.south_m + (row + 0.5) * self.cell_m))


def fitting_m(area: Polygon | MultiPolygon, cell_m: float) -> float:
    """`cell_m`, doubled until the bounds of the area have at most `CELLS_JUDGED_MAX` cells."""
    if area.is_empty:
        return cell_m
    west, south, east, north = area.bounds
    while ceil((east - west) / cell_m) * ceil((north - south) / cell_m) > CELLS_JUDGED_MAX:
        cell_m *= 2
    return cell_m


def rasterise(area: Polygon | MultiPolygon, cell_m: float) -> Raster:
    """The cells whose centres are in an area. An empty area gives a single False cell. The number
    of cells is asserted to be at most `CELLS_MAX`."""
    if area.is_empty:
        return Raster(np.zeros((1, 1), dtype=np.bool_), 0.0, 0.0, cell_m)
    west, south, east, north = area.bounds
    columns, rows = ceil((east - west) / cell_m), ceil((north - south) / cell_m)
    assert columns * rows <= CELLS_MAX, "more cells than memory is planned for: a coarser raster"
    rings = shapely.get_parts(shapely.boundary(area))
    points, ring = shapely.get_coordinates(rings, return_index=True)
    edges = np.hstack((points[:-1], points[1:]))[ring[:-1] == ring[1:]]
    cells = np.zeros((rows, columns), dtype=np.bool_)
    _fill(edges, west, south, cell_m, cells)
    return Raster(cells, west, south, cell_m)


@njit(cache=True)
def _fill(edges, west, south, side, cells):  # type: ignore[no-untyped-def]
    """Even-odd rule: each edge flips everything east of it in the rows it passes."""
    rows, columns = cells.shape
    for k in range(edges.shape[0]):
        ax, ay, bx, by = edges[k]
        first = max(int((min(ay, by) - south) / side) - 1, 0)
        last = min(int((max(ay, by) - south) / side) + 1, rows - 1)
        for r in range(first, last + 1):
            y = south + (r + 0.5) * side
            if (ay > y) != (by > y):
                x = ax + (bx - ax) * (y - ay) / (by - ay)
                c = max(int(np.ceil((x - west) / side - 0.5)), 0)
                if c < columns:
                    cells[r, c] = not cells[r, c]
    for r in range(rows):
        inside = False
        for c in range(columns):
            inside = inside != cells[r, c]
            cells[r, c] = inside
