"""Shortest paths over a small grid by GEOS: all pairs of corners, none of the planner's code."""

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

OFF = 2.0**-14  # of a cell; how far a bend stays off the corner of a blocked cell, as planned
NEAR = 2.0**-15  # nearer than this is through: lines may run along a cell, not between two of them


class Judge:
    """What is blocked, as geometry: judges paths, and finds shortest ones."""

    def __init__(self, blocked: NDArray[np.bool_]) -> None:
        solid = np.pad(blocked, 1, constant_values=True)
        rows, columns = np.nonzero(solid)
        half = 0.5 + NEAR
        squares = shapely.box(
            columns - 1.0 - half, rows - 1.0 - half, columns - 1.0 + half, rows - 1.0 + half
        )
        self.blocked, self._solid = blocked, solid
        self._tree = shapely.STRtree(squares)

    def through(self, ends: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the segments `ends` (n, 2, 2; row, column) come through something blocked:
        booleans (n,)."""
        lines = shapely.linestrings(ends[:, :, ::-1])
        hit: NDArray[np.bool_] = np.zeros(len(lines), dtype=np.bool_)
        hit[self._tree.query(lines, predicate="intersects")[0]] = True
        return hit

    def corners(self) -> NDArray[np.float64]:
        """Where a path may bend: (n, 2) row, column."""
        solid = self._solid.astype(np.int64)
        around = solid[:-1, :-1] + solid[:-1, 1:] + solid[1:, :-1] + solid[1:, 1:]
        i, j = np.nonzero(around == 1)
        down = solid[i + 1, j] + solid[i + 1, j + 1] - solid[i, j] - solid[i, j + 1]
        right = solid[i, j + 1] + solid[i + 1, j + 1] - solid[i, j] - solid[i + 1, j]
        return np.stack((i - 0.5 - OFF * down, j - 0.5 - OFF * right), axis=1)

    def lengths(self, queries: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lengths in cells of the shortest paths for `queries` (n, 2, 2): start and goal, row and
        column; infinite: none."""
        ends = queries.reshape(-1, 2)
        points = np.concatenate((ends, self.corners()))
        first, second = np.triu_indices(len(points), 1)
        # Ends are joined to corners and to their own other end; never passed through by others.
        used = (second >= len(ends)) | ((first % 2 == 0) & (second == first + 1))
        first, second = first[used], second[used]
        segments = np.stack((points[first], points[second]), axis=1)
        seen = ~self.through(segments)
        weight = np.hypot(*(points[first] - points[second]).T)[seen]
        size = len(points)
        graph = csr_array((weight, (first[seen], second[seen])), shape=(size, size))
        found = dijkstra(graph, directed=False, indices=np.arange(0, len(ends), 2))
        return np.array([found[k, 2 * k + 1] for k in range(len(queries))])
