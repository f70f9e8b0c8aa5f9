"""Polygons that do not move, as the table in which ORCA looks walls up.

Rings are solid inside when their vertices run counter-clockwise; a ring that runs clockwise is a
boundary seen from its inside; two vertices are a fence with two sides. A binary space partition
over the edges (van den Berg et al. 2011, section 5.4; the choices of the RVO2 library, Apache-2.0)
makes a look-up touch only what is near. Edges that cross a partition are split.

Units: metres; x east, y north. `table` (edges, COLUMNS) is described in
`agent.avoidance.half_planes`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.avoidance.half_planes import (
    ALONG_X,
    ALONG_Y,
    AT_X,
    AT_Y,
    COLUMNS,
    CONVEX,
    LEFT,
    NEXT,
    PREVIOUS,
    RIGHT,
    Table,
)
from agent.avoidance.k_nearest import Real, insert
from agent.avoidance.linear_program import ONE, ZERO
from agent.kernels.kernel import njit

Longs = NDArray[np.int64]
Singles = NDArray[np.float32]
Vertex = tuple[float, float]  # metres (x, y)
EPSILON = np.float32(1e-5)
NONE = -1  # no child


class ObstacleTree(NamedTuple):
    """`table`: one row an edge, see `agent.avoidance.half_planes`; the tree's root is row `root`."""

    table: Table
    root: int


NO_WALLS = ObstacleTree(np.zeros((0, COLUMNS), dtype=np.float32), NONE)


def left_of(ax: np.float32, ay: np.float32, bx: np.float32, by: np.float32,
            cx: NDArray[np.float32], cy: NDArray[np.float32]) -> NDArray[np.float32]:  # fmt: skip
    """Twice the area of the triangles a, b, c in m²: positive where c is left of the line from a to
    b.

    `cx`, `cy` and the result: (n,).
    """
    return (ax - cx) * (by - ay) - (ay - cy) * (bx - ax)


def vertices(rings: Sequence[Sequence[Vertex]]) -> Table:
    """One row a vertex, (vertices, COLUMNS), ring by ring; not yet in a tree."""
    rows: list[Table] = []
    first = 0
    for ring in rings:
        assert len(ring) >= 2, "a wall has at least two vertices"
        points = np.asarray(ring, dtype=np.float32)
        count = len(points)
        table = np.zeros((count, COLUMNS), dtype=np.float32)
        after, before = np.roll(points, -1, axis=0), np.roll(points, 1, axis=0)
        along = after - points
        scale = np.float32(1) / np.sqrt(along[:, 0] * along[:, 0] + along[:, 1] * along[:, 1])
        table[:, AT_X : AT_Y + 1] = points
        table[:, ALONG_X], table[:, ALONG_Y] = along[:, 0] * scale, along[:, 1] * scale
        turn = (before[:, 0] - after[:, 0]) * (points[:, 1] - before[:, 1]) - (
            before[:, 1] - after[:, 1]
        ) * (points[:, 0] - before[:, 0])
        table[:, CONVEX] = turn >= 0 if count > 2 else 1
        table[:, NEXT] = first + (np.arange(count) + 1) % count
        table[:, PREVIOUS] = first + (np.arange(count) - 1) % count
        table[:, LEFT] = table[:, RIGHT] = NONE
        rows.append(table)
        first += count
    return np.concatenate(rows) if rows else np.zeros((0, COLUMNS), dtype=np.float32)


def _sides(table: Table, edge: int, others: NDArray[np.int64]) -> tuple[NDArray[np.bool_], ...]:
    """Which of the other edges lie left of this one's line, which right; the rest cross it."""
    a, b = table[edge], table[int(table[edge, NEXT])]
    begin, end = table[others], table[table[others, NEXT].astype(np.int64)]
    first = left_of(a[AT_X], a[AT_Y], b[AT_X], b[AT_Y], begin[:, AT_X], begin[:, AT_Y])
    second = left_of(a[AT_X], a[AT_Y], b[AT_X], b[AT_Y], end[:, AT_X], end[:, AT_Y])
    left = (first >= -EPSILON) & (second >= -EPSILON)
    right = ~left & (first <= EPSILON) & (second <= EPSILON)
    return left, right, first > 0


def _best(table: Table, edges: NDArray[np.int64]) -> int:
    """Place in `edges` of the most balanced partition; the first of equals."""
    best, place = (len(edges), len(edges)), 0
    for k, edge in enumerate(edges):
        left, right, _ = _sides(table, int(edge), np.delete(edges, k))
        crossing = ~left & ~right
        sizes = int(np.sum(left | crossing)), int(np.sum(right | crossing))
        if (max(sizes), min(sizes)) < best:
            best, place = (max(sizes), min(sizes)), k
    return place


def _split(table: Table, edge: int, other: int) -> Table:
    """Append the vertex where the line of `edge` cuts edge `other`; the table with it."""
    a, b = table[edge], table[int(table[edge, NEXT])]
    p, q = table[other].copy(), int(table[other, NEXT])
    ex, ey = b[AT_X] - a[AT_X], b[AT_Y] - a[AT_Y]
    end = table[q]
    t = (ex * (p[AT_Y] - a[AT_Y]) - ey * (p[AT_X] - a[AT_X])) / (
        ex * (p[AT_Y] - end[AT_Y]) - ey * (p[AT_X] - end[AT_X])
    )
    row = p
    row[AT_X], row[AT_Y] = p[AT_X] + t * (end[AT_X] - p[AT_X]), p[AT_Y] + t * (end[AT_Y] - p[AT_Y])
    row[CONVEX], row[NEXT], row[PREVIOUS] = 1, q, other
    row[LEFT] = row[RIGHT] = NONE
    table[other, NEXT] = table[q, PREVIOUS] = len(table)
    return np.concatenate([table, row[np.newaxis]])


def obstacle_tree(rings: Sequence[Sequence[Vertex]]) -> ObstacleTree:
    """Build the table once; see the top of this file for the direction of rings.

    The most balanced of all partitions is tried at each level, which takes time quadratic in the
    number of edges: about 0.1 s for 200 edges, so this is for walls that are known beforehand.
    """
    table = vertices(rings)
    root = NONE
    todo: list[tuple[NDArray[np.int64], int, int]] = [(np.arange(len(table)), NONE, LEFT)]
    while todo:
        edges, parent, side = todo.pop()
        if len(edges) == 0:
            continue
        place = _best(table, edges)
        edge = int(edges[place])
        if parent == NONE:
            root = edge
        else:
            table[parent, side] = edge
        others = np.delete(edges, place)
        left, right, first_left = _sides(table, edge, others)
        lefts: list[int] = []
        rights: list[int] = []
        for k, other in enumerate(others.tolist()):
            if left[k]:
                lefts.append(other)
            elif right[k]:
                rights.append(other)
            else:
                table = _split(table, edge, other)
                new = len(table) - 1
                lefts.append(other if first_left[k] else new)
                rights.append(new if first_left[k] else other)
        todo.append((np.asarray(rights, dtype=np.int64), edge, RIGHT))
        todo.append((np.asarray(lefts, dtype=np.int64), edge, LEFT))
    return ObstacleTree(table, root)


WALLS_MAX = 256  # walls in reach of one robot; the nearest are kept


@njit(cache=True, error_model="numpy")
def _to_edge(table: Table, a: int, b: int, x: Real, y: Real) -> Real:
    """Square of the distance from a point to an edge."""
    ax, ay = x - table[a, AT_X], y - table[a, AT_Y]
    ex, ey = table[b, AT_X] - table[a, AT_X], table[b, AT_Y] - table[a, AT_Y]
    r = (ax * ex + ay * ey) / (ex * ex + ey * ey)
    if r > ONE:
        ax, ay = x - table[b, AT_X], y - table[b, AT_Y]
    elif r >= ZERO:
        ax, ay = x - (table[a, AT_X] + r * ex), y - (table[a, AT_Y] + r * ey)
    return ax * ax + ay * ay


@njit(cache=True, error_model="numpy")
def near_walls(
    table: Table,
    root: int,
    x: Real,
    y: Real,
    reach: Real,
    stack: Longs,
    near: Longs,
    squares: Singles,
) -> int:
    """Fill `near` with the edges that face (x, y) within reach, nearest first; returns how many.

    `near` and `squares` are (WALLS_MAX,): rows of `table`, and squares of their distances. `root`
    is the row of the tree's root. `reach` is the square of a distance. `stack` is scratch for two
    entries an edge.

    The tree is walked in its own order: the side of the partition on which we are, the edge of the
    partition itself, the other side. A node that waits for its turn is on the stack as -2 - node.
    """
    count, top, most = int(np.int64(0)), 0, int(np.int64(WALLS_MAX))  # not literals
    if root >= 0:
        stack[0], top = root, 1
    while top > 0:
        top -= 1
        node = stack[top]
        entered = node >= 0
        edge = node if entered else -2 - node
        b = int(table[edge, NEXT])
        ex, ey = table[b, AT_X] - table[edge, AT_X], table[b, AT_Y] - table[edge, AT_Y]
        side = (table[edge, AT_X] - x) * ey - (table[edge, AT_Y] - y) * ex
        ours = int(table[edge, LEFT if side >= ZERO else RIGHT])
        if entered:
            stack[top] = -2 - edge
            top += 1
            if ours >= 0:
                stack[top] = ours
                top += 1
            continue
        if not side * side / (ex * ex + ey * ey) < reach:
            continue
        if side < ZERO:
            square = _to_edge(table, edge, b, x, y)
            if square < reach and (count < WALLS_MAX or square < squares[count - 1]):
                insert(near, squares, count, most, edge, square)
                count = min(count + 1, WALLS_MAX)
        beyond = int(table[edge, RIGHT if side >= ZERO else LEFT])
        if beyond >= 0:
            stack[top] = beyond
            top += 1
    return count
