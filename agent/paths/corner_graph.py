"""Shortest paths over the convex corners of a grid, with the edges of each corner cached.

A shortest path bends only at convex corners, round the blocked cell there (visibility graphs:
Lozano-Perez and Wesley, CACM 1979). So each corner has two lists of edges, one for either direction
of travel that can bend round it. Each list is filled at the first visit by a field of view of one
quadrant, and kept. A* over these lists, leaving out edges that do not bend the right way, finds the
shortest path itself (taut paths: Oh and Leong, SoCS 2017).

A list remembers the rectangle of cells that it depends on. Changed cells go to a log of rectangles,
and a list is filled again only where an entry that it has not seen touches its own rectangle.

The kernels work on five arrays (see `agent.paths.corner_cache`), because each argument costs the
dispatcher of numba 0.1 to 0.2 us: `grid` (flat, int16: runs of rows, runs of columns), `index`
(lattice rows, lattice columns: lattice point to corner, -1: none), `corners` (corners,
CORNER_COLUMNS), and the scratch `ints` (flat) and `floats` (flat). `stack` (n, 3), `slopes` (n, 2)
and `found` (n,) are those of `agent.paths.line_of_sight`, as are `runs` and `columns`. Positions
such as (y, x), (r0, c0) and (r1, c1) are integers of `UNIT` to a cell: row first, with the padding.
"""

from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit
from agent.paths.binary_heap import Number, close_gap, push
from agent.paths.line_of_sight import END, HALF, MARGIN, START, UNIT, glance, look, sees

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Runs = NDArray[np.int16]
Tables = tuple[Runs, Runs, Ints, Ints]  # runs of rows, runs of columns, index, corners
Heap = tuple[Floats, Ints]  # keys, nodes
View = tuple[Ints, Floats, Ints]  # stack, slopes, found

# columns of `corners`, one row a corner: lattice point, position in units, kind, search state
ROW, COLUMN, AT_Y, AT_X, KIND, STAMP, PARENT, GOAL, LISTS = *range(8), 8
# columns of a list of edges, from `LISTS` on and from `LISTS + LIST` on
FIRST, COUNT, SEEN, TOP, BOTTOM, LEFTMOST, RIGHTMOST, LIST = range(8)
CORNER_COLUMNS = LISTS + 2 * LIST
EMPTY = -1  # SEEN of a list that is not filled
SEEN_MAX = 64  # a list that is more log entries behind than this is filled again
# head of `ints`
ROWS, COLUMNS, TURN, USED, POOL_SIZE, HEAP_SIZE, VIEW_SIZE, LOGGED, LOG_SIZE, EXPANDED = range(10)
HEAD = 16
G, H = 0, 1  # columns of the cost of a corner: from the start, at least to the goal
GOAL_NODE = -1
NO_PATH, POOL_FULL, HEAP_FULL, VIEW_FULL = -1, -2, -3, -4


@njit(cache=True, error_model="numpy")
def away(kind: int) -> tuple[int, int]:
    """Signs (row, column) of the direction from a corner of this `kind` into its blocked cell."""
    return (1 if kind > 2 else -1), (1 if kind % 2 == 0 else -1)


@njit(cache=True, error_model="numpy")
def place(corners: Ints, k: int, i: int, j: int, kind: int) -> None:
    """Make row k of `corners` the corner of this `kind` at lattice point (i, j), with empty lists."""
    down, right = away(kind)
    corners[k, ROW], corners[k, COLUMN], corners[k, KIND] = i, j, kind
    corners[k, AT_Y] = UNIT * i - UNIT // 2 + (UNIT // 2 - HALF) * down
    corners[k, AT_X] = UNIT * j - UNIT // 2 + (UNIT // 2 - HALF) * right
    corners[k, STAMP] = corners[k, GOAL] = 0
    corners[k, LISTS + SEEN] = corners[k, LISTS + LIST + SEEN] = EMPTY


@njit(cache=True, error_model="numpy")
def _verify(
    runs: Runs,
    columns: Runs,
    corners: Ints,
    y: Number,
    x: Number,
    found: Ints,
    begin: int,
    count: Number,
) -> Number:
    """Keep the corners of `found[begin:count]` that are in sight from (y, x) and at which a path
    can bend.

    Returns the new end.
    """
    kept = begin
    for n in range(begin, count):
        corner = found[n]
        sure = corner >= 0
        if not sure:
            corner = ~corner
        down, right = away(corners[corner, KIND])
        cy, cx = np.int64(corners[corner, AT_Y]), np.int64(corners[corner, AT_X])
        dy, dx = cy - y, cx - x
        if (dy * down > 0 and dx * right > 0) or (dy * down < 0 and dx * right < 0):
            continue  # straight into the blocked cell, or straight away from it: nothing to bend
        if sure or sees(runs, columns, y, x, cy, cx):
            found[kept] = corner
            kept += 1
    return kept


@njit(cache=True, error_model="numpy")
def in_sight(
    runs: Runs,
    columns: Runs,
    index: Ints,
    corners: Ints,
    y: int,
    x: int,
    stack: Ints,
    slopes: Floats,
    found: Ints,
) -> Number:
    """Fill `found` with the corners in sight from the point (y, x) inside a cell.

    Returns how many, or -1 if `stack` or `found` is too small.
    """
    uy, ux = y / UNIT + 0.5, x / UNIT + 0.5
    r, c = (y + UNIT // 2) // UNIT, (x + UNIT // 2) // UNIT
    a, b = runs[START, r, c], runs[END, r, c]
    count = np.int64(0)  # numba would compile every kernel that takes a literal twice
    for step in (-1, 1):
        line = r if step < 0 else r + 1
        top, count = glance(runs, index, uy, ux, step, line, a, b, stack, slopes, found, count)
        if count >= 0:
            count = look(runs, index, uy, ux, step, np.int64(0), runs.shape[2] - 1, stack, slopes, top,
                         found, count)  # fmt: skip
        if count < 0:
            return count
    for n in range(count):  # the views were widened: every corner must be verified
        if found[n] >= 0:
            found[n] = ~found[n]
    return _verify(runs, columns, corners, y, x, found, 0, count)


@njit(cache=True, error_model="numpy")
def _along(runs: Runs, line: int, at: int, forward: bool) -> int:
    """The first index, forward or backward from `at`, where a cell beside a lattice line changes."""
    if forward:
        return min(abs(runs[END, line - 1, at]), abs(runs[END, line, at]))
    return max(runs[START, line - 1, at - 1], runs[START, line, at - 1])


@njit(cache=True, error_model="numpy")
def _fill(
    runs: Runs,
    columns: Runs,
    index: Ints,
    corners: Ints,
    k: int,
    which: int,
    stack: Ints,
    slopes: Floats,
    found: Ints,
    pool: Ints,
    used: Number,
    logged: int,
) -> Number:
    """Fill one list of corner k from a field of view; returns how much of the pool is used then, or
    a code.

    List 0 is for travel that passes the blocked cell above or below in the direction of its column.
    """
    i, j = corners[k, ROW], corners[k, COLUMN]
    down, right = away(corners[k, KIND])
    step, side = (-down, right) if which == 0 else (down, -right)
    row, c = (i if step > 0 else i - 1), (j if side > 0 else j - 1)
    a, b = runs[START, row, c], runs[END, row, c]
    reach, none, one = stack[-1], np.int64(0), np.int64(1)
    reach[0], reach[1], reach[2] = i, j, j
    stack[0, 0] = i
    if side > 0:
        stack[0, 1], stack[0, 2], slopes[0, 0], slopes[0, 1] = j, b, 0.0, float(b - j)
        count = look(runs, index, float(i), float(j), step, np.int64(j), runs.shape[2] - 1, stack, slopes,
                     one, found, none)  # fmt: skip
    else:
        stack[0, 1], stack[0, 2], slopes[0, 0], slopes[0, 1] = a, j, float(a - j), 0.0
        count = look(
            runs, index, float(i), float(j), step, none, j - 1, stack, slopes, one, found, none
        )
    if count < 0 or count + 2 > found.size:
        return VIEW_FULL
    x, y = _along(runs, i, j, side > 0), _along(columns, j, i, step > 0)
    for corner in (index[i, x], index[y, j]):
        if corner >= 0:
            found[count] = corner
            count += 1
    y0, x0 = np.int64(corners[k, AT_Y]), np.int64(corners[k, AT_X])
    count = _verify(runs, columns, corners, y0, x0, found, 0, count)
    if used + count > pool.size:
        return POOL_FULL
    for n in range(count):  # numba takes seconds to compile slices
        pool[used + n] = found[n]
    at = LISTS + which * LIST
    corners[k, at + FIRST], corners[k, at + COUNT], corners[k, at + SEEN] = used, count, logged
    corners[k, at + TOP], corners[k, at + BOTTOM] = min(i, reach[0], y) - 1, max(i, reach[0], y)
    corners[k, at + LEFTMOST] = min(j, reach[1], x) - 1
    corners[k, at + RIGHTMOST] = max(j, reach[2], x) + 1
    return used + count


@njit(cache=True, error_model="numpy")
def _stale(corners: Ints, k: int, at: int, log: Ints, logged: int) -> bool:
    """Whether a list must be filled: it is empty, or cells that it depends on have changed."""
    seen = corners[k, at + SEEN]
    if seen == logged:
        return False
    if seen == EMPTY or logged - seen > SEEN_MAX:
        return True
    for n in range(seen, logged):
        if (
            log[n, 0] <= corners[k, at + BOTTOM] and log[n, 1] >= corners[k, at + TOP]
            and log[n, 2] <= corners[k, at + RIGHTMOST] and log[n, 3] >= corners[k, at + LEFTMOST]
        ):  # fmt: skip
            return True
    corners[k, at + SEEN] = logged
    return False


@njit(cache=True, error_model="numpy")
def _relax(
    corners: Ints,
    cost: Floats,
    keys: Floats,
    nodes: Ints,
    size: Number,
    turn: int,
    k: int,
    parent: Number,
    g: float,
    r1: int,
    c1: int,
) -> Number:
    """Reach corner k at length g; returns the size of the open list."""
    if corners[k, STAMP] != turn:
        corners[k, STAMP] = turn
        dy, dx = float(r1 - corners[k, AT_Y]), float(c1 - corners[k, AT_X])
        cost[k, H] = sqrt(dy * dy + dx * dx)
    elif g >= cost[k, G]:
        return size
    cost[k, G], corners[k, PARENT] = g, parent
    push(keys, nodes, size, g + cost[k, H], k)
    return size + 1


@njit(cache=True, error_model="numpy")
def _begin(
    tables: Tables,
    ints: Ints,
    cost: Floats,
    heap: Heap,
    view: View,
    r0: int,
    c0: int,
    r1: int,
    c1: int,
) -> Number:
    """Mark the corners that see the goal and open those that see the start; how many are open, or a
    code."""
    runs, columns, index, corners = tables
    keys, nodes = heap
    stack, slopes, found = view
    ints[TURN] += 1
    turn = ints[TURN]
    count = in_sight(runs, columns, index, corners, r1, c1, stack, slopes, found)
    for n in range(count):
        corners[found[n], GOAL] = turn
    if count <= 0:
        return NO_PATH if count == 0 else VIEW_FULL
    count = in_sight(runs, columns, index, corners, r0, c0, stack, slopes, found)
    if count < 0:
        return VIEW_FULL
    if count >= keys.size:
        return HEAP_FULL
    size, parent = np.int64(0), np.int64(GOAL_NODE)
    for n in range(count):
        k = found[n]
        dy, dx = float(corners[k, AT_Y] - r0), float(corners[k, AT_X] - c0)
        g = sqrt(dy * dy + dx * dx)
        size = _relax(corners, cost, keys, nodes, size, turn, k, parent, g, r1, c1)
    return size


@njit(cache=True, error_model="numpy")
def _search(
    tables: Tables,
    ints: Ints,
    cost: Floats,
    heap: Heap,
    pool: Ints,
    log: Ints,
    view: View,
    r0: int,
    c0: int,
    r1: int,
    c1: int,
) -> Number:
    """A*: leave the last corner before the goal in `found[0]`; returns 1, or a code."""
    runs, columns, index, corners = tables
    keys, nodes = heap
    stack, slopes, found = view
    size = _begin(tables, ints, cost, heap, view, r0, c0, r1, c1)
    if size < 0:
        return size
    turn, logged, used = ints[TURN], ints[LOGGED], np.int64(ints[USED])
    best, last = inf, GOAL_NODE
    while size > 0:
        node, key = nodes[0], keys[0]
        size -= 1
        close_gap(keys, nodes, size)
        if key >= best:
            break
        g = cost[node, G]
        if key != g + cost[node, H]:
            continue  # an outdated entry: a shorter way to it was found since
        ints[EXPANDED] += 1
        y, x, parent = corners[node, AT_Y], corners[node, AT_X], corners[node, PARENT]
        py, px = (r0, c0) if parent == GOAL_NODE else (corners[parent, AT_Y], corners[parent, AT_X])
        ty, tx = y - py, x - px  # direction of travel
        down, right = away(corners[node, KIND])
        which = 0 if ty * down <= 0 and tx * right >= 0 else 1
        turning = down * right if which == 1 else -down * right  # sign of a bend round the cell
        if corners[node, GOAL] == turn:
            dy, dx = r1 - y, c1 - x
            if (ty * dx - tx * dy) * turning >= 0 and ty * dy >= 0 and tx * dx >= 0:
                through = g + sqrt(float(dy * dy + dx * dx))
                if through < best:
                    best, last = through, node
        at = LISTS + which * LIST
        if _stale(corners, node, at, log, logged):
            used = _fill(runs, columns, index, corners, node, which, stack, slopes, found, pool,
                         used, logged)  # fmt: skip
            if used < 0:
                return used
            ints[USED] = used
        first = corners[node, at + FIRST]
        if size + corners[node, at + COUNT] >= keys.size:
            return HEAP_FULL
        for n in range(first, first + corners[node, at + COUNT]):
            k = pool[n]
            dy, dx = corners[k, AT_Y] - y, corners[k, AT_X] - x
            if (ty * dx - tx * dy) * turning >= 0:
                through = g + sqrt(float(dy * dy + dx * dx))
                size = _relax(
                    corners, cost, keys, nodes, size, turn, k, np.int64(node), through, r1, c1
                )
    found[0] = last
    return NO_PATH if last == GOAL_NODE else 1


@njit(cache=True, error_model="numpy")
def _inside(runs: Runs, y: float, x: float) -> tuple[int, int, bool]:
    """A point in cells as one in units, at least `MARGIN` inside its cell, and whether that cell is
    free."""
    if not (-0.5 <= y < runs.shape[1] - 2.5 and -0.5 <= x < runs.shape[2] - 2.5):
        return 0, 0, False
    r, c = int(np.floor(y + 0.5)), int(np.floor(x + 0.5))
    most = UNIT // 2 - MARGIN
    dy, dx = int(np.rint((y - r) * UNIT)), int(np.rint((x - c) * UNIT))
    dy, dx = min(max(dy, -most), most), min(max(dx, -most), most)
    return (r + 1) * UNIT + dy, (c + 1) * UNIT + dx, runs[END, r + 1, c + 1] > 0


@njit(cache=True, error_model="numpy")
def query(
    grid: Runs,
    index: Ints,
    corners: Ints,
    ints: Ints,
    floats: Floats,
    y0: float,
    x0: float,
    y1: float,
    x1: float,
) -> int:
    """Find the path from (y0, x0) to (y1, x1): rows and columns in cells of the grid without its
    padding.

    Returns the number of corners at which the path bends, or a code: NO_PATH, or which array is too
    small. The positions of the corners, in cells too, are then in `floats`, behind two numbers a
    row of `corners`.
    """
    rows, width = np.int64(ints[ROWS]), np.int64(ints[COLUMNS])
    area = 2 * rows * width
    runs = grid[:area].reshape((2, rows, width))
    columns = grid[area:].reshape((2, width, rows))
    r0, c0, free_0 = _inside(runs, y0, x0)
    r1, c1, free_1 = _inside(runs, y1, x1)
    if not free_0 or not free_1:
        return NO_PATH
    if sees(runs, columns, r0, c0, r1, c1):
        return 0
    size, limit = np.int64(ints[VIEW_SIZE]), np.int64(ints[LOG_SIZE])
    stack_at = HEAD + size
    nodes_at = stack_at + 3 * size
    log_at = nodes_at + ints[HEAP_SIZE]
    pool_at = log_at + 4 * limit
    found = ints[HEAD:stack_at]
    stack = ints[stack_at:nodes_at].reshape((size, 3))
    log = ints[log_at:pool_at].reshape((limit, 4))
    slopes_at = 2 * corners.shape[0]
    keys_at = slopes_at + 2 * size
    cost = floats[:slopes_at].reshape((corners.shape[0], 2))
    slopes = floats[slopes_at:keys_at].reshape((size, 2))
    code = _search(
        (runs, columns, index, corners), ints, cost, (floats[keys_at:], ints[nodes_at:log_at]),
        ints[pool_at:], log, (stack, slopes, found), r0, c0, r1, c1,
    )  # fmt: skip
    if code <= 0:
        return code
    node, count = found[0], 0
    while node != GOAL_NODE:
        node, count = corners[node, PARENT], count + 1
    if count > size:
        return VIEW_FULL
    node = found[0]
    for k in range(count - 1, -1, -1):
        at = slopes_at + 2 * k
        floats[at], floats[at + 1] = (
            corners[node, AT_Y] / UNIT - 1.0,
            corners[node, AT_X] / UNIT - 1.0,
        )
        node = corners[node, PARENT]
    return count
