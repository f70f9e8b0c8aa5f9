"""Theta*: any-angle paths on a grid (Nash, Daniel, Koenig, Felner 2007), cell centre to cell centre.

A robot may move between neighbouring free cells, diagonally only where both cells beside the
diagonal are free; a straight line is free where every cell it touches is free, both cells at a
crossing of four included. So nothing squeezes through a diagonal gap, and a path exists exactly
where 4-connected free cells join start and goal.
"""

import itertools
from math import hypot

import numpy as np
from numba import njit
from numpy.typing import NDArray

Cell = tuple[int, int]
Waypoints = list[tuple[float, float]]


@njit(cache=True)
def _sees(blocked, r0, c0, r1, c1):  # type: ignore[no-untyped-def]
    """Every cell that the segment between two centres touches is free (supercover, integers)."""
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
def _push(heap_f, heap_i, size, f, item):  # type: ignore[no-untyped-def]
    """Into a binary heap of `size` items; the caller counts."""
    k = size
    while k > 0:
        up = (k - 1) // 2
        if heap_f[up] <= f:
            break
        heap_f[k], heap_i[k] = heap_f[up], heap_i[up]
        k = up
    heap_f[k], heap_i[k] = f, item


@njit(cache=True)
def _pop(heap_f, heap_i, size):  # type: ignore[no-untyped-def]
    """The least item of a heap of `size`; the caller counts."""
    top = heap_i[0]
    f_last, i_last = heap_f[size - 1], heap_i[size - 1]
    k = 0
    while True:
        child = 2 * k + 1
        if child >= size - 1:
            break
        if child + 1 < size - 1 and heap_f[child + 1] < heap_f[child]:
            child += 1
        if heap_f[child] >= f_last:
            break
        heap_f[k], heap_i[k] = heap_f[child], heap_i[child]
        k = child
    heap_f[k], heap_i[k] = f_last, i_last
    return top


@njit(cache=True)
def _search(blocked, r0, c0, r1, c1, g, parent, stamp, turn, heap_f, heap_i):  # type: ignore[no-untyped-def]
    """Theta* with lazy deletion; the number of cells expanded, -1 without a path, -2 without room.

    `stamp` is `turn` for a reached cell and `turn + 1` for a closed one: nothing is cleared.
    """
    rows, columns = blocked.shape
    start, goal = r0 * columns + c0, r1 * columns + c1
    g[start], parent[start], stamp[start] = 0.0, start, turn
    _push(heap_f, heap_i, 0, np.hypot(r1 - r0, c1 - c0), start)
    size, expanded = 1, 0
    while size > 0:
        node = _pop(heap_f, heap_i, size)
        size -= 1
        if stamp[node] == turn + 1:
            continue
        stamp[node] = turn + 1
        expanded += 1
        if node == goal:
            return expanded
        r, c = node // columns, node % columns
        pr, pc = parent[node] // columns, parent[node] % columns
        for i in range(-1, 2):
            for j in range(-1, 2):
                nr, nc = r + i, c + j
                if (i == 0 and j == 0) or nr < 0 or nc < 0 or nr >= rows or nc >= columns:
                    continue
                if blocked[nr, nc] or (i != 0 and j != 0 and (blocked[r, nc] or blocked[nr, c])):
                    continue
                other = nr * columns + nc
                if stamp[other] == turn + 1:
                    continue
                known = g[other] if stamp[other] == turn else np.inf
                cost, by = g[parent[node]] + np.hypot(nr - pr, nc - pc), parent[node]
                if cost >= known:  # by the triangle inequality nothing better comes of this
                    continue
                if not _sees(blocked, pr, pc, nr, nc):
                    cost, by = g[node] + np.hypot(i, j), node
                    if cost >= known:
                        continue
                if size >= heap_f.size:
                    return -2
                g[other], parent[other], stamp[other] = cost, by, turn
                _push(heap_f, heap_i, size, cost + np.hypot(r1 - nr, c1 - nc), other)
                size += 1
    return -1


class Planner:
    """A grid and the memory of its searches, for many queries."""

    def __init__(self, blocked: NDArray[np.bool_]) -> None:
        self.blocked = np.ascontiguousarray(blocked, dtype=np.bool_)
        cells = self.blocked.size
        self._g = np.zeros(cells)
        self._parent = np.zeros(cells, dtype=np.int64)
        self._stamp = np.zeros(cells, dtype=np.int64)
        self._heap_f = np.zeros(4 * cells + 16)
        self._heap_i = np.zeros(4 * cells + 16, dtype=np.int64)
        self._turn = 0
        self.expanded = 0

    def update(self, blocked: NDArray[np.bool_]) -> None:
        """Another state of the same grid."""
        assert blocked.shape == self.blocked.shape
        self.blocked = np.ascontiguousarray(blocked, dtype=np.bool_)

    def sees(self, a: Cell, b: Cell) -> bool:
        return bool(_sees(self.blocked, a[0], a[1], b[0], b[1]))

    def plan(self, start: Cell, goal: Cell) -> Waypoints | None:
        """Waypoints (row, column) from start to goal, or None where there is no way."""
        rows, columns = self.blocked.shape
        for row, column in (start, goal):
            if not (0 <= row < rows and 0 <= column < columns) or self.blocked[row, column]:
                return None
        self._turn += 2
        self.expanded = _search(
            self.blocked, start[0], start[1], goal[0], goal[1], self._g, self._parent,
            self._stamp, self._turn, self._heap_f, self._heap_i,
        )  # fmt: skip
        assert self.expanded != -2, "the open list outgrew its bound"
        if self.expanded < 0:
            return None
        node, first = goal[0] * columns + goal[1], start[0] * columns + start[1]
        cells = [goal]
        while node != first:
            node = int(self._parent[node])
            cells.append((node // columns, node % columns))
        return self._pulled([*reversed(cells)])

    def _pulled(self, cells: list[Cell]) -> Waypoints:
        """Leave out waypoints between cells that see each other."""
        kept = [cells[0]]
        k = 0
        while k < len(cells) - 1:
            nxt = len(cells) - 1
            while nxt > k + 1 and not self.sees(cells[k], cells[nxt]):
                nxt -= 1
            kept.append(cells[nxt])
            k = nxt
        return [(float(r), float(c)) for r, c in kept]


def plan(blocked: NDArray[np.bool_], start: Cell, goal: Cell) -> Waypoints | None:
    """A path over a boolean array, True where blocked; cells are (row, column).

    >>> import numpy as np
    >>> wall = np.zeros((5, 5), dtype=bool); wall[2, :4] = True
    >>> plan(wall, (0, 0), (4, 0))
    [(0.0, 0.0), (1.0, 4.0), (3.0, 4.0), (4.0, 0.0)]
    """
    return Planner(np.asarray(blocked, dtype=np.bool_)).plan(
        (int(start[0]), int(start[1])), (int(goal[0]), int(goal[1]))
    )


def length(path: Waypoints) -> float:
    return sum(hypot(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(path))
