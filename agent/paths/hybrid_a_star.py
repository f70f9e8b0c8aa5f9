"""Ways between poses for a body with a turning circle: hybrid A* that ends with a Dubins word.

The first thing tried from any pose is a Dubins word to the goal, forwards or backing up, that stays
on free cells. At a wide headland nothing else is needed. Where it is narrow, short pieces ahead and
back are searched (Dolgov, Thrun, Montemerlo, Diebel 2010), which finds the bulbs and three-point
turns that a driver would make. The heuristic is the free way of a point, from a coarse flood with
Dijkstra's algorithm.

`blocked` (rows, columns) says where the middle of the body may not be. `place` (3,) is x and y of
the corner of cell (0, 0), and the side of a cell. `start`, `goal` and `pose` (3,) are x, y,
heading. `nodes` (n, N_COLUMNS) are poses that were reached; `keys` (n,) and `ids` (n,) the open
ones as a heap.

Units: metres, radians, curvatures in 1/m; x east, y north, headings counter-clockwise from x.

One kernel family, one file, but for the words of `dubins.py` and the heap.
"""

from math import floor, hypot, pi

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit
from agent.paths.binary_heap import Number, close_gap, push
from agent.paths.dubins import WORDS, step, words

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]
Longs = NDArray[np.int64]

PIECE_M = 0.9  # length of a piece of the search; longer than the diagonal of a cell
NUDGES_M = (0.3, 0.6)  # lengths of the first pieces where no longer one is free
CELL_M = 0.5  # side of a search cell: one pose is kept for each cell and heading
HEADINGS = 36
CHECK_M = 0.15  # between points looked up on the grid
BACK_COST = 2.0  # cost of a metre backing up, in metres ahead: backing up is slower
SHIFT_M = 3.0  # cost of a change between forwards and backwards, in metres ahead
BEND_COST = 0.1  # a metre of full lock costs this much more than one straight ahead
NODES_MAX = 40_000  # poses expanded before the search gives up: about 0.2 s
BETTER_NODES = 3_000  # poses expanded after a way was found, to find a better one
FLOOD = 4  # cells of the grid in one cell of the flood, each way
LEAP_M = 12.0  # nearer than this a word is tried from every 4th pose, further away from every 20th
LEAP_NEAR, LEAP_EVERY = 4, 20
# a node: pose, cost, parent, curvature and signed length of the piece that led to it
N_X, N_Y, N_HEADING, N_COST, N_PARENT, N_CURVATURE, N_LENGTH, N_COLUMNS = *range(7), 8


@njit(cache=True, error_model="numpy")
def is_free(blocked: Flags, place: Floats, x: float, y: float) -> bool:
    """Whether the middle of the body may be at (x, y); False outside of the grid."""
    row, column = floor((y - place[1]) / place[2]), floor((x - place[0]) / place[2])
    rows, columns = blocked.shape
    return 0 <= row < rows and 0 <= column < columns and not blocked[row, column]


@njit(cache=True, error_model="numpy")
def piece_is_free(
    blocked: Flags,
    place: Floats,
    x: float,
    y: float,
    heading: float,
    curvature: float,
    length: float,
) -> bool:
    """Whether a piece from a pose stays on free cells, looked up every `CHECK_M`; the pose itself
    is not."""
    steps = int(abs(length) / CHECK_M) + 1
    for k in range(1, steps + 1):
        px, py, _ = step(x, y, heading, curvature, length * k / steps)
        if not is_free(blocked, place, px, py):
            return False
    return True


@njit(cache=True, error_model="numpy")
def _leap(
    blocked: Flags,
    place: Floats,
    x: float,
    y: float,
    heading: float,
    goal: Floats,
    radius: float,
    before: float,
    lengths: Floats,
    curvatures: Floats,
    out: Floats,
) -> float:
    """Write the cheapest free word to the goal into `out`, (3, 2); returns its cost, infinite if
    there is none."""
    best = np.inf
    for back in range(2):
        sign, turned = (-1.0, pi) if back else (1.0, 0.0)
        words(
            x, y, heading + turned, goal[0], goal[1], goal[2] + turned, radius, lengths, curvatures
        )
        for _ in range(WORDS):
            word, least = -1, np.inf
            for k in range(WORDS):
                total = lengths[k, 0] + lengths[k, 1] + lengths[k, 2]
                if total < least:
                    word, least = k, total
            if word < 0:
                break
            cost = least * (BACK_COST if back else 1.0)
            if before * sign < 0.0:
                cost += SHIFT_M
            if cost >= best:
                break
            px, py, at, free = x, y, heading, True
            for k in range(3):
                curvature, length = sign * curvatures[word, k], sign * lengths[word, k]
                if not piece_is_free(blocked, place, px, py, at, curvature, length):
                    free = False
                    break
                px, py, at = step(px, py, at, curvature, length)
            if free:
                best = cost
                for k in range(3):
                    out[k, 0], out[k, 1] = sign * curvatures[word, k], sign * lengths[word, k]
                break
            lengths[word, 0] = np.inf
    return best


@njit(cache=True, error_model="numpy")
def flood(blocked: Flags, row: int, column: int) -> Floats:
    """Length of the way of a point from every coarse cell to one cell, in sides of a fine cell.

    The result is (coarse rows, coarse columns), a coarse cell being `FLOOD` cells wide and free
    where any of its cells is; infinite where there is no way. Steps go to eight neighbours, a
    diagonal one counts as the square root of 2.
    """
    rows, columns = blocked.shape[0] // FLOOD + 1, blocked.shape[1] // FLOOD + 1
    free = np.zeros((rows, columns), dtype=np.bool_)
    for r in range(blocked.shape[0]):
        for c in range(blocked.shape[1]):
            if not blocked[r, c]:
                free[r // FLOOD, c // FLOOD] = True
    far = np.full((rows, columns), np.inf)
    buckets = np.empty((rows * columns * 9, 2), dtype=np.int32)
    far[row // FLOOD, column // FLOOD] = 0.0
    buckets[0, 0], buckets[0, 1] = row // FLOOD, column // FLOOD
    head, tail = 0, 1
    while head < tail and tail < buckets.shape[0] - 9:  # label correcting, nearly in order
        r, c = buckets[head, 0], buckets[head, 1]
        head += 1
        for i in range(-1, 2):
            for j in range(-1, 2):
                nr, nc = r + i, c + j
                if nr < 0 or nc < 0 or nr >= rows or nc >= columns or not free[nr, nc]:
                    continue
                cost = far[r, c] + (1.4142135623730951 if i != 0 and j != 0 else 1.0) * FLOOD
                if cost < far[nr, nc] - 1e-9:
                    far[nr, nc] = cost
                    buckets[tail, 0], buckets[tail, 1] = nr, nc
                    tail += 1
    return far


@njit(cache=True, error_model="numpy")
def _state(place: Floats, shape: tuple[int, ...], pose: Floats) -> int:
    """The number of the cell and heading that a pose falls into."""
    columns = int(shape[1] * place[2] / CELL_M) + 2
    row, column = int((pose[1] - place[1]) / CELL_M), int((pose[0] - place[0]) / CELL_M)
    heading = floor(pose[2] / (2 * pi) * HEADINGS + 0.5) % HEADINGS
    return (row * columns + column) * HEADINGS + heading


@njit(cache=True, error_model="numpy")
def _to_go(far: Floats, blocked: Flags, place: Floats, pose: Floats, goal: Floats) -> float:
    """Metres that a point has to go at least from a pose to the goal."""
    r = floor((pose[1] - place[1]) / place[2]) // FLOOD
    c = floor((pose[0] - place[0]) / place[2]) // FLOOD
    straight = hypot(goal[0] - pose[0], goal[1] - pose[1])
    if not (0 <= r < far.shape[0] and 0 <= c < far.shape[1]):
        return straight
    flooded = (far[r, c] - 2 * FLOOD) * place[2] / 1.08  # octile ways are up to 8 % longer
    return max(straight, flooded) if far[r, c] < np.inf else straight + 50.0


@njit(cache=True, error_model="numpy")
def _joined(far: Floats, place: Floats, pose: Floats) -> bool:
    """Whether a point could go from here to where the flood began."""
    r = floor((pose[1] - place[1]) / place[2]) // FLOOD
    c = floor((pose[0] - place[0]) / place[2]) // FLOOD
    return 0 <= r < far.shape[0] and 0 <= c < far.shape[1] and far[r, c] < np.inf


@njit(cache=True, error_model="numpy")
def _grow(
    blocked: Flags,
    place: Floats,
    goal: Floats,
    radius: float,
    far: Floats,
    node: int,
    nodes: Floats,
    made: Number,
    closed: Flags,
    best: float,
    keys: Floats,
    ids: Longs,
    size: Number,
) -> tuple[Number, Number]:
    """Add the pieces that can follow one node: ahead and back, each left, straight and right.

    Returns the new numbers of nodes and of keys.
    """
    pose, before = nodes[node, :3], nodes[node, N_LENGTH]
    for gear in range(2):
        length = -PIECE_M if gear else PIECE_M
        for bend in range(-1, 2):
            curvature = bend / radius
            if not piece_is_free(blocked, place, pose[0], pose[1], pose[2], curvature, length):
                continue
            new = nodes[made]
            new[N_X], new[N_Y], new[N_HEADING] = step(pose[0], pose[1], pose[2], curvature, length)
            if closed[_state(place, blocked.shape, new)]:
                continue
            cost = nodes[node, N_COST]
            cost += PIECE_M * ((BACK_COST if gear else 1.0) + BEND_COST * abs(bend))
            if before * length < 0.0:
                cost += SHIFT_M
            new[N_COST], new[N_PARENT] = cost, node
            new[N_CURVATURE], new[N_LENGTH] = curvature, length
            key = cost + _to_go(far, blocked, place, new, goal)
            if key < best:
                push(keys, ids, size, key, made)
                size, made = size + 1, made + 1
    return made, size


@njit(cache=True, error_model="numpy")
def _nudge(
    blocked: Flags,
    place: Floats,
    radius: float,
    nodes: Floats,
    made: Number,
    keys: Floats,
    ids: Longs,
    size: Number,
) -> tuple[Number, Number]:
    """Add short pieces from the start, for a body with its nose to a fence.

    They end in cells in which a pose may be known already. Returns the new numbers of nodes and of
    keys.
    """
    for nudge_m in NUDGES_M:
        for turn in range(6):
            length, curvature = (-nudge_m if turn < 3 else nudge_m), (turn % 3 - 1) / radius
            x, y, heading = nodes[0, N_X], nodes[0, N_Y], nodes[0, N_HEADING]
            if not piece_is_free(blocked, place, x, y, heading, curvature, length):
                continue
            new = nodes[made]
            new[N_X], new[N_Y], new[N_HEADING] = step(x, y, heading, curvature, length)
            new[N_COST], new[N_PARENT] = abs(length) * BACK_COST, 0.0
            new[N_CURVATURE], new[N_LENGTH] = curvature, length
            push(keys, ids, size, new[N_COST], made)
            size, made = size + 1, made + 1
    return made, size


@njit(cache=True, error_model="numpy")
def search(
    blocked: Flags, place: Floats, start: Floats, goal: Floats, radius: float, nudged: bool
) -> Floats:
    """Pieces (n, 2) of curvature and signed length from start to goal; n is 0 where none was found.

    `radius`: of the smallest turning circle. `nudged`: whether to begin with shorter pieces, too.
    """
    lengths, curvatures, leap = np.empty((6, 3)), np.empty((6, 3)), np.empty((3, 2))
    cost = _leap(
        blocked, place, start[0], start[1], start[2], goal, radius, 0.0, lengths, curvatures, leap
    )
    straight = hypot(goal[0] - start[0], goal[1] - start[1])
    if cost < 1.3 * straight + 4 * pi * radius:
        return leap.copy()
    row, column = int((goal[1] - place[1]) / place[2]), int((goal[0] - place[0]) / place[2])
    far = flood(blocked, row, column)
    if not _joined(far, place, start):
        return np.empty((0, 2))
    nodes = np.empty((NODES_MAX * 6 + 1, N_COLUMNS))
    keys, ids = np.empty(NODES_MAX * 6 + 1), np.empty(NODES_MAX * 6 + 1, dtype=np.int64)
    side = place[2] / CELL_M
    states = (int(blocked.shape[0] * side) + 2) * (int(blocked.shape[1] * side) + 2) * HEADINGS
    closed = np.zeros(states, dtype=np.bool_)
    nodes[0, N_X], nodes[0, N_Y], nodes[0, N_HEADING] = start[0], start[1], start[2]
    nodes[0, N_COST], nodes[0, N_PARENT], nodes[0, N_LENGTH] = 0.0, -1.0, 0.0
    keys[0], ids[0], found = 0.0, 0, -1
    size, made = np.int64(1), np.int64(1)  # numba compiles kernels twice for a literal
    best, best_leap = cost, leap.copy()
    left = NODES_MAX
    if nudged:
        made, size = _nudge(blocked, place, radius, nodes, made, keys, ids, size)
    if cost < np.inf:
        found, left = 0, BETTER_NODES
    for looked in range(NODES_MAX):
        if size == 0 or keys[0] >= best or left == 0:
            break
        left -= 1
        node = ids[0]
        size -= 1
        close_gap(keys, ids, size)
        pose, spent, before = nodes[node, :3], nodes[node, N_COST], nodes[node, N_LENGTH]
        state = _state(place, blocked.shape, pose)
        if closed[state] and nodes[node, N_PARENT] != 0.0:
            continue
        closed[state] = True
        near = hypot(goal[0] - pose[0], goal[1] - pose[1]) < LEAP_M
        if looked % (LEAP_NEAR if near else LEAP_EVERY) == 0:
            more = _leap(
                blocked, place, pose[0], pose[1], pose[2], goal, radius, before, lengths,
                curvatures, leap,
            )  # fmt: skip
            if spent + more < best:
                best, found, best_leap = spent + more, node, leap.copy()
                left = min(left, BETTER_NODES)
        made, size = _grow(
            blocked, place, goal, radius, far, node, nodes, made, closed, best, keys, ids, size
        )
    return _pieces(nodes, found, best_leap)


@njit(cache=True, error_model="numpy")
def _pieces(nodes: Floats, found: int, leap: Floats) -> Floats:
    """The pieces that led to node `found`, then those of the last word; none if `found` is
    negative."""
    if found < 0:
        return np.empty((0, 2))
    count, node = 0, found
    while nodes[node, N_PARENT] >= 0.0:
        count, node = count + 1, int(nodes[node, N_PARENT])
    pieces = np.empty((count + 3, 2))
    for k in range(leap.shape[0]):  # numba takes seconds to compile slices
        pieces[count + k, 0], pieces[count + k, 1] = leap[k, 0], leap[k, 1]
    node = found
    for k in range(count - 1, -1, -1):
        pieces[k, 0], pieces[k, 1] = nodes[node, N_CURVATURE], nodes[node, N_LENGTH]
        node = int(nodes[node, N_PARENT])
    return pieces
