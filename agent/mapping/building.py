"""A building as robots know it before they start: a grid of walls, and what follows from it.

Moving AI maps (Sturtevant 2012, "Benchmarks for Grid-Based Pathfinding") are read as they are. For
tests a drawing of the same characters is enough. Row 0 of the grid is the south, the last line of
text.
"""

from functools import cached_property
from itertools import pairwise
from math import ceil
from zlib import crc32

import numpy as np
import scipy
from numpy.typing import NDArray

from agent.interface.geometry import Point
from agent.mapf.lattice import Lattice
from agent.paths.route import Route

OPEN = frozenset(".GS")  # Moving AI: free ground; the rest (@, O, T, W, #) is blocked
STRAY_M = 0.1  # a body this near to a node of the lattice counts as being there
FINE_M = 0.2  # cells of the path grid are at most this wide


class FloorError(ValueError):
    """A map that cannot be read; the message is one line for its author."""


class Floor:
    """The walls of one floor, and the grids, routes and fences that are derived from them.

    Arrays are indexed [row, column]: rows go north, columns go east. `origin` is the south-western
    corner of the wall that is added round the map, (x, y) metres.
    """

    def __init__(
        self, blocked: NDArray[np.bool_], cell_m: float, radius_m: float, margin_m: float = 0.1
    ) -> None:
        """`blocked`: (rows, columns), True for a wall; a wall is added all round. `cell_m`: side of
        its cells. `radius_m`: of every body. `margin_m`: what paths keep from walls beyond the
        radius, for the rounding of POSE and the cross-track error.
        """
        self.walls = np.pad(np.asarray(blocked, dtype=np.bool_), 1, constant_values=True)
        self.cell_m, self.radius_m, self.margin_m = cell_m, radius_m, margin_m
        self.origin: Point = (-cell_m, -cell_m)
        self._parts = ceil(cell_m / FINE_M - 1e-9) | 1  # odd: a row of them along the middle
        self.fine_m = cell_m / self._parts

    @classmethod
    def drawn(cls, text: str, cell_m: float, radius_m: float, margin_m: float = 0.1) -> "Floor":
        """The floor of a Moving AI map, with or without its header.

        Raises FloorError if there are no lines or if their lengths differ.
        """
        lines = [line.rstrip() for line in text.strip().splitlines()]
        if "map" in lines[:5]:
            lines = lines[lines.index("map") + 1 :]
        if not lines or len({len(line) for line in lines}) != 1:
            raise FloorError("a map needs lines, all of the same length")
        rows = [[character not in OPEN for character in line] for line in reversed(lines)]
        return cls(np.array(rows), cell_m, radius_m, margin_m)

    @cached_property
    def fine(self) -> NDArray[np.bool_]:
        """The walls in cells of `fine_m`, (rows, columns)."""
        return np.repeat(np.repeat(self.walls, self._parts, axis=0), self._parts, axis=1)

    @cached_property
    def inflated(self) -> NDArray[np.bool_]:
        """The path grid, cells as in `fine`: True where the middle of a body may not be."""
        gap_m = (scipy.ndimage.distance_transform_edt(~self.fine) - 0.5) * self.fine_m
        blocked: NDArray[np.bool_] = gap_m < self.radius_m + self.margin_m - 1e-9
        return blocked

    @cached_property
    def parts(self) -> NDArray[np.int32]:
        """Regions that no path joins, numbered from 1, cells as in `fine`; 0 where no middle of a
        body may be.
        """
        parts: NDArray[np.int32] = scipy.ndimage.label(~self.inflated)[0]
        return parts

    @property
    def cells(self) -> int:
        """Number of cells of the map as it was drawn."""
        rows, columns = self.walls.shape
        return int((rows - 2) * (columns - 2))

    def holds(self, x_m: float, y_m: float) -> bool:
        """Whether the middle of a body may be at x, y."""
        row = int((y_m - self.origin[1]) // self.fine_m)
        column = int((x_m - self.origin[0]) // self.fine_m)
        rows, columns = self.inflated.shape
        return 0 <= row < rows and 0 <= column < columns and not self.inflated[row, column]

    @cached_property
    def route(self) -> Route:
        """The path planner of the floor without temporary obstacles."""
        return Route(self.inflated, *self.origin, self.fine_m)

    @cached_property
    def lattice(self) -> Lattice:
        """The lattice for joint plans.

        Its pitch has room for two bodies with the margins of avoidance, and is at least a cell of
        the map.
        """
        from agent.motion.holonomic_motion import MARGIN_M

        pitch_m = max(2 * self.radius_m + MARGIN_M + STRAY_M, self.cell_m)
        return Lattice(self.inflated, self.origin, self.fine_m, ceil(pitch_m / self.fine_m - 1e-9))

    @cached_property
    def fences(self) -> NDArray[np.float64]:
        """The faces of walls as segments (n, 4) of ax, ay, bx, by in metres."""
        found = []
        for flat, solid in ((True, self.walls), (False, self.walls.T)):
            rows, columns = np.nonzero(solid[1:, :] != solid[:-1, :])
            for row in np.unique(rows):
                line = np.sort(columns[rows == row])
                ends = np.flatnonzero(np.diff(line) > 1) + 1
                for a, b in pairwise([0, *ends.tolist(), len(line)]):
                    first, last, along = int(line[a]), int(line[b - 1]) + 1, int(row) + 1
                    cells = (first, along, last, along) if flat else (along, first, along, last)
                    found.append(
                        [self.origin[k % 2] + c * self.cell_m for k, c in enumerate(cells)]
                    )
        return np.array(found, dtype=np.float64).reshape(-1, 4)

    @property
    def check(self) -> int:
        """A 24-bit hash of walls and sizes: peers with another one are not of this fleet."""
        head = f"{self.walls.shape} {self.cell_m} {self.radius_m} {self.margin_m}"
        return crc32(np.packbits(self.walls).tobytes(), crc32(head.encode())) & 0xFFFFFF
