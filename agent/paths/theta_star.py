"""Basic Theta* over cell centres: what the default planner is measured against.

A robot may step between neighbouring free cells, diagonally only where both cells beside the
diagonal are free. A straight line is free where every cell it touches is free, both cells beside a
crossing of four included. The source is Nash, Daniel, Koenig, Felner (AAAI 2007). Two savings: no
line of sight is drawn where the triangle inequality says that nothing is gained, and generation
stamps make clearing needless.

`blocked` is (rows, columns); a cell is the number row * columns + column. Of each cell, `g`
(cells,) is the length from the start in sides of a cell, `parent` (cells,) the cell before it, and
`stamp` (cells,) whether it is open or closed. `keys` and `nodes` (8 * cells + 8,) are the open
list.

One kernel family, one file, but for the heap: the cache of numba does not notice changes elsewhere.
"""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit
from agent.paths.binary_heap import close_gap, push

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]
Longs = NDArray[np.int64]

ROOT2 = sqrt(2.0)


@njit(cache=True)
def sees(blocked: Flags, r0: int, c0: int, r1: int, c1: int) -> bool:
    """Whether the segment between the centres of cells (r0, c0) and (r1, c1) touches free cells
    only."""
    dr, dc = abs(r1 - r0), abs(c1 - c0)
    sr = 1 if r1 > r0 else -1
    sc = 1 if c1 > c0 else -1
    r, c = r0, c0
    error = dr - dc
    dr2, dc2 = 2 * dr, 2 * dc
    for _ in range(dr + dc + 1):
        if blocked[r, c]:
            return False
        if r == r1 and c == c1:
            return True
        if error > 0:
            r += sr
            error -= dc2
        elif error < 0:
            c += sc
            error += dr2
        else:  # through a corner: both cells beside it are touched
            if blocked[r + sr, c] or blocked[r, c + sc]:
                return False
            r += sr
            c += sc
            error += dr2 - dc2
    return True


@njit(cache=True)
def steps(blocked: Flags, r: int, c: int, i: int, j: int) -> bool:
    """Whether a robot may go from the cell (r, c) to its neighbour (r + i, c + j)."""
    nr, nc = r + i, c + j
    if (i == 0 and j == 0) or nr < 0 or nc < 0 or nr >= blocked.shape[0] or nc >= blocked.shape[1]:
        return False
    return not (blocked[nr, nc] or (i != 0 and j != 0 and (blocked[r, nc] or blocked[nr, c])))


@njit(cache=True)
def search(
    blocked: Flags,
    r0: int,
    c0: int,
    r1: int,
    c1: int,
    turn: int,
    g: Floats,
    parent: Longs,
    stamp: Longs,
    keys: Floats,
    nodes: Longs,
) -> int:
    """Fill `parent` from the cell (r1, c1) back to (r0, c0); returns how many cells were expanded,
    -1: no path.

    `stamp` is `turn` for an open cell, `turn + 1` for a closed one, and less for an untouched one.
    """
    columns = blocked.shape[1]
    start, goal = r0 * columns + c0, r1 * columns + c1
    g[start], parent[start], stamp[start] = 0.0, start, turn
    keys[0], nodes[0], size, expanded = 0.0, start, 1, 0
    while size > 0:
        node = nodes[0]
        size -= 1
        close_gap(keys, nodes, size)
        if stamp[node] == turn + 1:
            continue
        stamp[node] = turn + 1
        expanded += 1
        r, c = node // columns, node % columns
        if node == goal:
            return expanded
        by = parent[node]
        pr, pc, base = by // columns, by % columns, g[by]
        for i in range(-1, 2):
            for j in range(-1, 2):
                if not steps(blocked, r, c, i, j):
                    continue
                nr, nc = r + i, c + j
                other = nr * columns + nc
                if stamp[other] == turn + 1:
                    continue
                known = g[other] if stamp[other] == turn else np.inf
                cost, link = base + sqrt((nr - pr) ** 2 + (nc - pc) ** 2), by
                if cost >= known:  # by the triangle inequality, nothing shorter is possible
                    continue
                if not sees(blocked, pr, pc, nr, nc):
                    cost, link = g[node] + (ROOT2 if i != 0 and j != 0 else 1.0), node
                    if cost >= known:
                        continue
                g[other], parent[other], stamp[other] = cost, link, turn
                push(keys, nodes, size, cost + sqrt((r1 - nr) ** 2 + (c1 - nc) ** 2), other)
                size += 1
    return -1


class GridSearch:
    """A grid and the memory of searches over it."""

    def __init__(self, blocked: NDArray[np.bool_]) -> None:
        self.blocked = blocked
        cells = blocked.size
        self._g = np.empty(cells)
        self._parent = np.empty(cells, dtype=np.int64)
        self._stamp = np.zeros(cells, dtype=np.int64)
        # A cell is pushed at most once by each of its eight neighbours.
        self._keys = np.empty(8 * cells + 8)
        self._nodes = np.empty(8 * cells + 8, dtype=np.int64)
        self._turn = 0
        self.expanded = 0

    def cells(self, start: tuple[int, int], goal: tuple[int, int]) -> list[tuple[int, int]] | None:
        """Cells (row, column) where the path bends, both ends included; None: no path. Both ends
        must be free."""
        self._turn += 2
        self.expanded = search(
            self.blocked, start[0], start[1], goal[0], goal[1], self._turn,
            self._g, self._parent, self._stamp, self._keys, self._nodes,
        )  # fmt: skip
        if self.expanded < 0:
            return None
        columns = self.blocked.shape[1]
        first, node = start[0] * columns + start[1], goal[0] * columns + goal[1]
        found = [goal]
        while node != first:
            node = int(self._parent[node])
            found.append((node // columns, node % columns))
        return found[::-1]
