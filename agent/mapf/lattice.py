"""Places where robots can stand beside each other, and the straight ways between neighbouring ones.

Rows and columns are laid over the free space. Where they cross and a body fits, there is a node;
where a body can drive straight to the next node, there is an edge. Rows and columns are further
apart than two bodies with their margins. So robots on different nodes, or moving along edges that
share no node, cannot touch, and what is decided on the lattice (`agent/mapf/lacam.py`) is free of
contact when it is driven.

The lattice knows a passage only where a row or column goes through it. The narrowest passages are
served first. Of two passages that lead the same way and are less than a pitch out of line, only one
can have a row or column. In a map of cells as wide as the pitch nothing is lost.
"""

from math import hypot

import numpy as np
import scipy
from numpy.typing import NDArray

from agent.interface.geometry import Point

Near = NDArray[np.int32]  # (nodes, 4): east, north, west, south; -1 where there is none
NODES_MAX = 1 << 16  # an ACCORD frame names a node in 16 bits
TRIES = 12  # layouts tried; a few are enough if lines can go through all passages at all
DEARER = 4.0  # a missed passage is worth this much more the next time
FINE = 16  # positions are sent in this many parts of the pitch


class Lattice:
    """The nodes of one map, numbered from 0, with their places and their neighbours."""

    def __init__(
        self, blocked: NDArray[np.bool_], origin: Point, cell_m: float, pitch_cells: int
    ) -> None:
        """`blocked`: (rows, columns) where no centre of a body may be; row 0 in the south, cell
        (0, 0) with its corner at `origin`; a node every `pitch_cells`."""
        assert pitch_cells >= 1
        self.pitch_m = pitch_cells * cell_m
        rows, columns, self.near = _laid(blocked, pitch_cells)
        assert len(rows) <= NODES_MAX, "too many nodes: use a wider pitch"
        self.points = np.stack(
            (origin[0] + (columns + 0.5) * cell_m, origin[1] + (rows + 0.5) * cell_m), axis=1
        )
        self.component = components(self.near)
        east, north, west, south = (self.near >= 0).T
        self.narrow: NDArray[np.bool_] = (east & west & ~north & ~south) | (
            north & south & ~east & ~west
        )  # robots cannot pass each other here

    def __len__(self) -> int:
        return len(self.points)

    def point(self, node: int) -> Point:
        """The place of a node in the world."""
        x_m, y_m = self.points[node].tolist()
        return x_m, y_m

    def nearest(self, at: Point) -> int:
        """The node with the least straight distance to a place, walls or not."""
        return int(np.argmin((self.points[:, 0] - at[0]) ** 2 + (self.points[:, 1] - at[1]) ** 2))

    def encode(self, at: Point) -> tuple[int, int]:
        """A place as an agreement frame carries it: the nearest node, and a byte for where in its
        square.

        Each half of the byte counts sixteenths of the pitch from the south-western corner of the
        square: x in the low half, y in the high one. Places outside of the square are moved to its
        edge.
        """
        node = self.nearest(at)
        x_m, y_m = self.point(node)
        parts = [
            min(max(round((a - b) / self.pitch_m * FINE) + FINE // 2, 0), FINE - 1)
            for a, b in ((at[0], x_m), (at[1], y_m))
        ]
        return node, parts[0] | parts[1] << 4

    def decode(self, node: int, detail: int) -> Point:
        """The place that `encode` wrote as a node and the byte `detail`."""
        x_m, y_m = self.point(node)
        part_m = self.pitch_m / FINE
        return (
            x_m + ((detail & 15) - FINE // 2) * part_m,
            y_m + ((detail >> 4) - FINE // 2) * part_m,
        )

    def within(self, at: Point, reach_m: float) -> NDArray[np.intp]:
        """The nodes nearer to a place than `reach_m`, (n,), in ascending order."""
        gap = np.hypot(self.points[:, 0] - at[0], self.points[:, 1] - at[1])
        return np.flatnonzero(gap < reach_m)

    def distance_m(self, node: int, at: Point) -> float:
        """The straight distance from a node to a place, walls or not."""
        x_m, y_m = self.point(node)
        return hypot(x_m - at[0], y_m - at[1])


def _laid(
    blocked: NDArray[np.bool_], pitch: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], Near]:
    """Rows and columns of nodes, and their neighbours: the best of a few layouts.

    Where a passage has been missed, what lies on the way through it is worth more the next time.
    """
    room = scipy.ndimage.label(~blocked)[0]
    tall, wide = np.ones(blocked.shape), np.ones(blocked.shape)
    best: tuple[int, tuple[NDArray[np.intp], NDArray[np.intp], Near]] | None = None
    for _ in range(TRIES):
        laid = _lay(blocked, lines(blocked, pitch, tall), lines(blocked.T, pitch, wide.T))
        size = int(np.bincount(components(laid[2])).max()) if len(laid[2]) else 0
        if best is None or size > best[0]:
            best = (size, laid)
        missed = _missed(room, *laid)
        if missed is None:
            break
        tall[missed] *= DEARER
        wide[missed] *= DEARER
    assert best is not None
    return best[1]


def _missed(
    room: NDArray[np.int32], rows: NDArray[np.intp], columns: NDArray[np.intp], near: Near
) -> tuple[NDArray[np.intp], NDArray[np.intp]] | None:
    """Cells of a shortest way from the largest component of nodes to another one in the same room;
    None if there is no other."""
    parts = components(near)
    if not len(parts):
        return None
    home = int(np.argmax(np.bincount(parts)))
    here = room[rows[parts == home][0], columns[parts == home][0]]
    away = (parts != home) & (room[rows, columns] == here)
    if not away.any():
        return None
    cells = np.full(room.shape, -1, dtype=np.int64)
    cells[room == here] = np.arange(np.count_nonzero(room == here))
    a = np.concatenate((cells[:, :-1].ravel(), cells[:-1].ravel()))
    b = np.concatenate((cells[:, 1:].ravel(), cells[1:].ravel()))
    free = (a >= 0) & (b >= 0)
    count = int(cells.max()) + 1
    graph = scipy.sparse.coo_array((np.ones(free.sum()), (a[free], b[free])), shape=(count, count))
    starts = cells[rows[parts == home], columns[parts == home]]
    far, before, _ = scipy.sparse.csgraph.dijkstra(
        graph, directed=False, indices=starts, unweighted=True, min_only=True,
        return_predecessors=True,
    )  # fmt: skip
    goals = cells[rows[away], columns[away]]
    at, way = int(goals[np.argmin(far[goals])]), []
    while at >= 0:
        way.append(at)
        at = int(before[at])
    found = np.argwhere(room == here)[way]
    return found[:, 0], found[:, 1]


def _lay(
    blocked: NDArray[np.bool_], tall: NDArray[np.intp], wide: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp], Near]:
    """Rows and columns of the nodes, and their neighbours."""
    free = ~blocked[np.ix_(tall, wide)]
    number = np.full(free.shape, -1, dtype=np.int32)
    number[free] = np.arange(np.count_nonzero(free), dtype=np.int32)
    near = np.full((int(free.sum()), 4), -1, dtype=np.int32)
    for axis, (ahead, behind) in ((1, (0, 2)), (0, (1, 3))):
        # blocked cells up to here along the axis: none between two nodes is a clear edge
        sums = np.cumsum(blocked, axis=axis)[np.ix_(tall, wide)]
        a = (slice(None), slice(None, -1)) if axis else (slice(None, -1), slice(None))
        b = (slice(None), slice(1, None)) if axis else (slice(1, None), slice(None))
        joined = free[a] & free[b] & (sums[a] == sums[b])
        near[number[a][joined], ahead] = number[b][joined]
        near[number[b][joined], behind] = number[a][joined]
    rows, columns = np.nonzero(free)
    return tall[rows], wide[columns], near


def lines(blocked: NDArray[np.bool_], pitch: int, weight: NDArray[np.float64]) -> NDArray[np.intp]:
    """Rows at least `pitch` cells apart that together go through the most passages, in ascending
    order.

    `blocked` and `weight`: (rows, columns). The worth of a row is a sum over its free cells: the
    `weight` of the cell divided by the square of the length of the free run across it. That length
    is how many rows would do as well there. Dynamic programming finds the rows with the most worth,
    the first of equals.
    """
    count = len(blocked)
    runs = np.zeros(blocked.shape)
    length = np.zeros(blocked.shape[1])
    for row in range(count):
        length = np.where(blocked[row], 0.0, length + 1.0)
        runs[row] = length
    for row in range(count - 2, -1, -1):
        runs[row] = np.where(~blocked[row] & ~blocked[row + 1], runs[row + 1], runs[row])
    worth = np.where(blocked, 0.0, weight / np.maximum(runs, 1.0) ** 2).sum(axis=1)
    best = np.zeros(count + 1)  # of the rows before
    for row in range(count):
        best[row + 1] = max(best[row], worth[row] + best[max(row + 1 - pitch, 0)])
    chosen, row = [], count
    while row > 0:
        if best[row] == best[row - 1]:
            row -= 1
            continue
        chosen.append(row - 1)
        row = max(row - pitch, 0)
    return np.array(chosen[::-1], dtype=np.intp)


def components(near: Near) -> NDArray[np.int32]:
    """The component of each node, (nodes,): nodes with an edge path between them have the same
    number."""
    count = len(near)
    a, k = np.nonzero(near >= 0)
    graph = scipy.sparse.coo_array(
        (np.ones(len(a), dtype=np.int8), (a, near[a, k])), shape=(count, count)
    )
    labels: NDArray[np.int32] = scipy.sparse.csgraph.connected_components(graph, directed=False)[1]
    return labels
