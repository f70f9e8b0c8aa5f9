"""The planning map: free space as a few hundred convex polygons, and A* over them.

A navigation mesh (Snook, Game Programming Gems, 2000). The polygons are rectangles of cells, made
once from the permanent walls: greedy, the largest first along the scan. Two that touch share a
portal. Waypoints stand on the portals, at their ends and at most `SPACING_M` apart; inside a
polygon every straight line is free. So the lengths in the graph of waypoints are never too short,
and too long only by what the spacing costs. `Mesh.way` pulls its path taut.
"""

from collections.abc import Sequence
from functools import cached_property
from heapq import heappop, heappush
from itertools import pairwise
from math import ceil, dist, hypot, inf
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from agent.interface.geometry import Point
from agent.kernels.kernel import njit
from agent.paths.binary_heap import close_gap, push
from agent.paths.theta_star import sees

Floats = NDArray[np.float64]
Longs = NDArray[np.int64]
Box = tuple[int, int, int, int]  # rows [r0, r1) and columns [c0, c1)
DETOUR = 1.0003  # an edge is left out if two others together are at most this factor longer
# Between waypoints of a portal: makes ways at most 0.3 % longer where halls are 10 m wide.
SPACING_M = 2.0


@njit(cache=True)
def spread(
    indptr: NDArray[Any], indices: NDArray[Any], data: Floats, nodes: Longs, cost: Floats
) -> None:
    """Dijkstra's algorithm from `nodes`, (n,), over a graph as scipy's csr_array stores it.

    `indptr` (graph nodes + 1,), `indices` (edges,) and `data` (edges,), metres, are its rows.
    `cost` (graph nodes,) in metres is set at `nodes` and infinite elsewhere; the least is filled in
    everywhere.
    """
    room = len(indices) + len(nodes) + 1
    keys, heap, size = np.empty(room), np.empty(room, np.int64), 0
    for node in nodes:
        push(keys, heap, size, cost[node], node)
        size += 1
    while size > 0:
        key, node = keys[0], heap[0]
        size -= 1
        close_gap(keys, heap, size)
        if key > cost[node]:
            continue
        for k in range(indptr[node], indptr[node + 1]):
            other = indices[k]
            if key + data[k] < cost[other]:
                cost[other] = key + data[k]
                push(keys, heap, size, cost[other], other)
                size += 1


@njit(cache=True)
def needed(places: Floats) -> tuple[Longs, Longs, Floats]:
    """Pairs of a polygon's waypoints and the metres between them, three arrays (pairs,).

    `places`: (waypoints, 2) in metres. A pair is left out if another waypoint all but lies on its
    line.
    """
    n = len(places)
    gap = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            gap[i, j] = np.hypot(places[i, 0] - places[j, 0], places[i, 1] - places[j, 1])
    rows, columns, metres, count = (
        np.empty(n * n, np.int64), np.empty(n * n, np.int64), np.empty(n * n), 0
    )  # fmt: skip
    for i in range(n):
        for j in range(i + 1, n):
            far = gap[i, j] * DETOUR
            for k in range(n):
                if k != i and k != j and gap[i, k] + gap[k, j] <= far:
                    break
            else:
                rows[count], columns[count], metres[count] = i, j, gap[i, j]
                count += 1
    return rows[:count], columns[:count], metres[:count]


class Mesh:
    """The rectangles of one map, the waypoints between them, and shortest ways over those."""

    def __init__(self, blocked: NDArray[np.bool_], origin: Point, cell_m: float) -> None:
        """`blocked`: (rows, columns) where no centre of a body may be; row 0 in the south."""
        self.blocked, self.origin, self.cell_m = blocked, origin, cell_m
        self.boxes, self.box_of = rectangles(blocked)
        self._lay()

    def __len__(self) -> int:
        return len(self.boxes)

    # ---------------------------------------------------------------- building

    def _lay(self) -> None:
        """Place waypoints on portals, and list those of each polygon."""
        number: dict[tuple[float, float], int] = {}
        inside: list[list[int]] = [[] for _ in self.boxes]
        for a, b, ends in portals(self.boxes, self.box_of):
            for at in _along(ends, SPACING_M / self.cell_m):
                waypoint = number.setdefault(at, len(number))
                inside[a].append(waypoint)
                inside[b].append(waypoint)
        self.inside = [np.array(sorted(set(own)), dtype=np.int64) for own in inside]
        places = np.array(list(number), dtype=np.float64).reshape(-1, 2)  # row, column
        self.waypoints = np.stack(
            (
                self.origin[0] + places[:, 1] * self.cell_m,
                self.origin[1] + places[:, 0] * self.cell_m,
            ),
            axis=1,
        )

    @cached_property
    def graph(self) -> "scipy.sparse.csr_array":
        """Metres between the waypoints of one polygon, (waypoints, waypoints), where no third lies
        between."""
        rows, columns, lengths = [], [], []
        for own in self.inside:
            i, j, metres = needed(self.waypoints[own])
            rows.append(own[i])
            columns.append(own[j])
            lengths.append(metres)
        a, b = np.concatenate(rows), np.concatenate(columns)
        count = len(self.waypoints)
        keep = np.unique(np.minimum(a, b) * count + np.maximum(a, b), return_index=True)[1]
        a, b, length = a[keep], b[keep], np.concatenate(lengths)[keep]
        both = (np.concatenate((a, b)), np.concatenate((b, a)))
        return scipy.sparse.csr_array(
            (np.concatenate((length, length)), both), shape=(count, count)
        )

    # ---------------------------------------------------------------- reading

    def box(self, at: Point) -> int:
        """The index of the polygon that a point is in, or of the nearest one."""
        row, column = self._cell(at)
        rows, columns = self.box_of.shape
        row, column = min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)
        found = int(self.box_of[row, column])
        if found >= 0:
            return found
        r0, r1, c0, c1 = np.array(self.boxes).T
        away = np.maximum(np.maximum(r0 - row, row - r1 + 1), 0) ** 2
        away += np.maximum(np.maximum(c0 - column, column - c1 + 1), 0) ** 2
        return int(np.argmin(away))

    def _cell(self, at: Point) -> tuple[int, int]:
        return (
            int((at[1] - self.origin[1]) // self.cell_m),
            int((at[0] - self.origin[0]) // self.cell_m),
        )

    def onto(self, at: Point) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The waypoints of the polygon that a point is in, and the metres to each: two arrays (n,)."""
        own = self.inside[self.box(at)]
        gap = self.waypoints[own] - at
        return own, np.hypot(gap[:, 0], gap[:, 1])

    def field_m(self, at: Point) -> NDArray[np.float64]:
        """Metres from a point to every waypoint, (waypoints,); inf where there is no way."""
        own, metres = self.onto(at)
        found = np.full(len(self.waypoints), np.inf)
        found[own] = metres
        graph = self.graph
        spread(graph.indptr, graph.indices, graph.data, own, found)
        return found

    def metres(self, a: Point, b: Point) -> float:
        """The length of the way between two points, by A*; inf where there is none."""
        found = self._astar(a, b)
        return inf if found is None else sum(dist(*leg) for leg in pairwise(found))

    def way(self, a: Point, b: Point) -> list[Point] | None:
        """The way that `metres` measures, pulled taut: places of a polyline, both ends included;
        None: no way.

        Waypoints that a straight line can pass by are left out.
        """
        found = self._astar(a, b)
        if found is None:
            return None
        taut, k = [found[0]], 0
        while k < len(found) - 1:
            further = k + 1
            while further + 1 < len(found) and self._clear(found[k], found[further + 1]):
                further += 1
            taut.append(found[further])
            k = further
        return taut

    def _clear(self, a: Point, b: Point) -> bool:
        rows, columns = self.blocked.shape
        cells = []
        for at in (a, b):
            row, column = self._cell(at)
            cells += [min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)]
        return bool(sees(self.blocked, *cells))

    def _astar(self, a: Point, b: Point) -> list[Point] | None:
        """Waypoints from one point to another. A* with the straight line as its estimate."""
        if self.box(a) == self.box(b):
            return [a, b]
        graph, places = self.graph, self.waypoints
        indptr, indices, data = graph.indptr, graph.indices, graph.data
        last = dict(zip(*(x.tolist() for x in self.onto(b)), strict=True))
        goal = len(places)
        far = np.hypot(*(places - b).T)
        best: dict[int, float] = {}
        before: dict[int, int] = {}
        heap: list[tuple[float, int]] = []
        for node, metres in zip(*(x.tolist() for x in self.onto(a)), strict=True):
            best[node], before[node] = metres, -1
            heappush(heap, (metres + float(far[node]), node))
        closed: set[int] = set()
        while heap:
            _, node = heappop(heap)
            if node == goal:
                return self._traced(a, b, before)
            if node in closed:
                continue
            closed.add(node)
            steps = zip(
                indices[indptr[node] : indptr[node + 1]].tolist(),
                data[indptr[node] : indptr[node + 1]].tolist(),
                strict=True,
            )
            for other, metres in [*steps, *([(goal, last[node])] if node in last else [])]:
                cost = best[node] + metres
                if cost < best.get(other, inf):
                    best[other], before[other] = cost, node
                    heappush(heap, (cost + (0.0 if other == goal else float(far[other])), other))
        return None

    def _traced(self, a: Point, b: Point, before: dict[int, int]) -> list[Point]:
        found, node = [b], before[len(self.waypoints)]
        while node >= 0:
            x_m, y_m = self.waypoints[node].tolist()
            found.append((x_m, y_m))
            node = before[node]
        return [*found, a][::-1]


def rectangles(blocked: NDArray[np.bool_]) -> tuple[list[Box], NDArray[np.int32]]:
    """Free cells as rectangles that do not overlap, and the index of each cell's rectangle (-1:
    none).

    `blocked` and the indices are (rows, columns). From the first free cell along the scan, the
    larger of two is taken: as wide as possible and then tall, or as tall as possible and then wide.
    """
    rows = len(blocked)
    box_of = np.where(blocked, -2, -1).astype(np.int32)
    boxes: list[Box] = []
    for r in range(rows):
        for c in np.flatnonzero(box_of[r] == -1).tolist():
            if box_of[r, c] != -1:
                continue
            found = max(_wide(box_of, r, c), _wide(box_of.T, c, r)[::-1], key=lambda s: s[0] * s[1])
            box_of[r : r + found[0], c : c + found[1]] = len(boxes)
            boxes.append((r, r + found[0], c, c + found[1]))
    box_of[box_of == -2] = -1
    return boxes, box_of


def _wide(box_of: NDArray[np.int32], r: int, c: int) -> tuple[int, int]:
    """Rows and columns of the rectangle that is first as wide as it goes."""
    taken = np.flatnonzero(box_of[r, c:] != -1)
    wide = int(taken[0]) if len(taken) else box_of.shape[1] - c
    full = (box_of[r:, c : c + wide] != -1).any(axis=1)
    tall = int(np.argmax(full)) if full.any() else len(full)
    return tall, wide


def portals(
    boxes: Sequence[Box], box_of: NDArray[np.int32]
) -> list[tuple[int, int, tuple[float, float, float, float]]]:
    """(polygon, polygon, ends of the border that they share as row, column, row, column).

    `boxes` and `box_of`, (rows, columns), are what `rectangles` returned. Ends are lattice points.
    """
    found: dict[tuple[int, int], list[int]] = {}
    for flat, table in ((True, box_of), (False, box_of.T)):
        below, above = table[:-1], table[1:]
        r, c = np.nonzero((below != above) & (below >= 0) & (above >= 0))
        for row, column in zip(r.tolist(), c.tolist(), strict=True):
            key = (int(below[row, column]), int(above[row, column]))
            ends = found.setdefault(key, [flat, row + 1, column, column + 1])
            ends[2], ends[3] = min(ends[2], column), max(ends[3], column + 1)
    return [
        (a, b, (row, first, row, last) if flat else (first, row, last, row))
        for (a, b), (flat, row, first, last) in sorted(found.items())
    ]


def _along(ends: tuple[float, float, float, float], spacing: float) -> list[tuple[float, float]]:
    """Places on a portal: both ends, half a cell inside, and between them at even steps."""
    r0, c0, r1, c1 = ends
    length = hypot(r1 - r0, c1 - c0)
    inset = min(0.5, length / 2) / length  # the centre of a body stays on the middles of cells
    r0, r1 = r0 + (r1 - r0) * inset, r1 - (r1 - r0) * inset
    c0, c1 = c0 + (c1 - c0) * inset, c1 - (c1 - c0) * inset
    steps = ceil((length - 1.0) / spacing) if length > 1 else 0
    if not steps:
        return [(r0, c0)]
    return [(r0 + (r1 - r0) * k / steps, c0 + (c1 - c0) * k / steps) for k in range(steps + 1)]
