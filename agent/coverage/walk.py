"""One walk over all free cells of a room, nearly without stepping twice, the same at every peer.

The pieces that `agent/coverage/cell_links.py` leaves, paths and rings, are spliced together, the
smallest first: into a link of a neighbour or on to its end, wherever the detour is least. On maps
made of 2 x 2 blocks, as coverage benchmarks are, nothing is stepped on twice; single dead ends cost
their way back.

Cells are numbers into the padded grid. `free` and `todo` (cells,) are 1 or 0. `ends` (cells, 2) holds the
two ends of each piece. A walk is its cells in `order` (n,).
"""

import numpy as np
from numpy.typing import NDArray

from agent.coverage.cell_links import (
    FAR,
    NONE,
    Pieces,
    find,
    is_whole,
    link,
    link_most,
    link_straight,
    merge_rings,
    name_pieces,
    unlink,
)
from agent.kernels.kernel import njit

Mask = NDArray[np.uint8]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Memory = tuple[Ints, Ints, Ints]  # stamps, distances, queue: (cells,) each


@njit(cache=True)
def reach(free: Mask, width: int, source: int, radius: int, near: Memory) -> int:
    """Fill the distances of `near` with steps from `source` up to `radius`; returns how many cells
    were reached.

    They are in its queue, nearest first, and their stamp is the number of this search.
    """
    stamp, distance, queue = near
    stamp[0] += 1
    turn = stamp[0]
    queue[0], head, tail = source, 0, 1
    stamp[source], distance[source] = turn, 0
    while head < tail:
        cell = queue[head]
        head += 1
        if distance[cell] >= radius:
            break
        for step in (-width, width, -1, 1):
            near = cell + step
            if free[near] and stamp[near] != turn:
                stamp[near], distance[near] = turn, distance[cell] + 1
                queue[tail] = near
                tail += 1
    return tail


@njit(cache=True)
def memory(cells: int) -> Memory:
    """Stamps, distances and queue of searches, (cells,) each. Cell 0 is a wall: its stamp counts
    the searches."""
    return np.zeros(cells, np.int32), np.zeros(cells, np.int32), np.empty(cells, np.int32)


@njit(cache=True)
def _path_ends(pieces: Pieces, ends: Ints) -> None:
    """Fill `ends` with the ends of each path."""
    links, piece, root = pieces.links, pieces.piece, pieces.root
    for cell in range(piece.size):
        if piece[cell] != NONE and not is_whole(links, cell):
            one = find(root, piece[cell])
            if ends[one, 0] == NONE:
                ends[one, 0] = cell
            ends[one, 1] = cell  # a piece of one cell has it twice


@njit(cache=True)
def _open_ring(width: int, pieces: Pieces, one: int, ends: Ints) -> None:
    """Cut a ring where it can be put into its neighbour with the least detour."""
    links, piece, root = pieces.links, pieces.piece, pieces.root
    steps = (-width, width, -1, 1)
    best, best_a, best_b = FAR, ends[one, 0], links[ends[one, 0], 0]
    start = ends[one, 0]
    before, cell = NONE, start
    while True:
        for step in steps:
            near = cell + step
            if piece[near] == NONE or find(root, piece[near]) == one:
                continue
            for side in range(2):
                beside = links[cell, side]
                for there in range(2):
                    far = links[near, there]
                    if far == NONE:
                        cost = 0
                    else:
                        cost = abs(far // width - beside // width) + abs(
                            far % width - beside % width
                        )
                    if cost < best:
                        best, best_a, best_b = cost, cell, beside
        ahead = links[cell, 0] if links[cell, 0] != before else links[cell, 1]
        before, cell = cell, ahead
        if cell == start:
            break
    unlink(links, best_a, best_b)
    ends[one, 0], ends[one, 1] = best_a, best_b


@njit(cache=True)
def _splice(
    free: Mask, width: int, pieces: Pieces, ends: Ints, one: int, near_a: Memory, near_b: Memory
) -> bool:
    """Put the path `one` into another piece, or on to its end, where that costs least; False: no
    way."""
    links, piece, root = pieces.links, pieces.piece, pieces.root
    a, b = ends[one, 0], ends[one, 1]
    _, distance_a, queue_a = near_a
    stamp_b, distance_b, queue_b = near_b
    none = int(np.int64(NONE))  # numba would compile twice for a literal
    best, at, after, mine, radius = FAR, none, none, a, int(np.int64(4))
    while True:
        found = reach(free, width, a, radius, near_a)
        found_b = reach(free, width, b, radius, near_b)
        for i in range(found + found_b):
            from_a = i < found
            u = queue_a[i] if from_a else queue_b[i - found]
            if piece[u] == NONE or find(root, piece[u]) == one:
                continue
            way = distance_a[u] if from_a else distance_b[u]
            if not is_whole(links, u) and way < best:
                best, at, after, mine = way, u, NONE, a if from_a else b
            if not from_a:
                continue
            for side in range(2):
                v = links[u, side]
                if v == NONE or stamp_b[v] != stamp_b[0]:
                    continue
                if abs(u - v) != 1 and abs(u - v) != width:
                    continue
                if way + distance_b[v] - 1 < best:
                    best, at, after, mine = way + distance_b[v] - 1, u, v, a
        if best <= radius or radius > free.size:
            break
        radius *= 2
    if at == NONE:
        return False
    other = find(root, piece[at])
    if after == NONE:  # on to an end
        link(links, mine, at)
        rest = b if mine == a else a
        ends[other, 0] = ends[other, 1] if at == ends[other, 0] else ends[other, 0]
        ends[other, 1] = rest
    else:
        unlink(links, at, after)
        link(links, at, a)
        link(links, after, b)
    root[one] = other
    pieces.size[other] += pieces.size[one]
    return True


@njit(cache=True)
def _join_pieces(free: Mask, width: int, pieces: Pieces) -> Ints:
    """Join all pieces that a way connects to one path; returns `ends`."""
    links, piece, root, ring, size = pieces
    ends = np.full((free.size, 2), NONE, np.int32)
    _path_ends(pieces, ends)
    near_a, near_b = memory(free.size), memory(free.size)
    while True:
        names = np.array([c for c in range(free.size) if piece[c] == c and root[c] == c])
        if names.size < 2:
            break
        order = names[np.argsort(size[names], kind="mergesort")]
        before = size.copy()
        joined = False
        for one in order[: (names.size + 1) // 2]:
            if root[one] != one or size[one] != before[one]:
                continue
            if ring[one]:
                ends[one, 0] = one
                _open_ring(width, pieces, one, ends)
                ring[one] = 0
            if _splice(free, width, pieces, ends, one, near_a, near_b):
                joined = True
        if not joined:  # rooms with no way between them
            break
    for one in range(free.size):  # a map that is one ring
        if piece[one] == one and root[one] == one and ring[one]:
            ring[one] = 0
            ends[one, 0], ends[one, 1] = one, links[one, 0]
            unlink(links, one, links[one, 0])
    return ends


@njit(cache=True)
def steps_between(free: Mask, width: int, a: int, b: int, near: Memory) -> int:
    """Steps from cell a to cell b; FAR where there is no way. `near` is scratch from `memory`."""
    if abs(a - b) == 1 or abs(a - b) == width:
        return 1
    stamp, distance, queue = near
    stamp[0] += 1
    turn = stamp[0]
    queue[0], head, tail = a, 0, 1
    stamp[a], distance[a] = turn, 0
    while head < tail:
        cell = queue[head]
        head += 1
        for step in (-width, width, -1, 1):
            beside = cell + step
            if free[beside] and stamp[beside] != turn:
                if beside == b:
                    return distance[cell] + 1
                stamp[beside], distance[beside] = turn, distance[cell] + 1
                queue[tail] = beside
                tail += 1
    return 0 if a == b else FAR


@njit(cache=True)
def measure_runs(free: Mask, width: int, order: Ints, cuts: Longs, unit: int, turn: int) -> Ints:
    """The cost before each cell of `order` from the beginning of its run, (n,).

    Run k is order[cuts[k]:cuts[k + 1]]; `cuts` is (runs + 1,). A step costs `unit`, a quarter turn
    `turn`. Of the way to a cell that is not next door only the length counts, and one quarter turn.
    """
    near = memory(free.size)
    along = np.zeros(order.size, np.int32)
    for k in range(cuts.size - 1):
        first = cuts[k]
        for i in range(first + 1, cuts[k + 1]):
            steps = steps_between(free, width, order[i - 1], order[i], near)
            cost = steps * unit
            if i > first + 1 and turn:
                before, ahead = order[i - 1] - order[i - 2], order[i] - order[i - 1]
                if steps > 1 or before != ahead:
                    cost += 2 * turn if before == -ahead else turn
            along[i] = along[i - 1] + cost
    return along


@njit(cache=True)
def measure(free: Mask, width: int, order: Ints, unit: int, turn: int) -> Ints:
    """As `measure_runs`, (n,), for one walk: a step costs `unit`, a quarter turn `turn`."""
    return measure_runs(free, width, order, np.array([0, order.size]), unit, turn)


@njit(cache=True)
def _read(pieces: Pieces, ends: Ints) -> Ints:
    """The cells of all pieces, from one end to the other, (n,)."""
    links, piece, root = pieces.links, pieces.piece, pieces.root
    order = np.empty(piece.size, np.int32)
    count = 0
    for one in range(piece.size):
        if piece[one] != one or root[one] != one:
            continue
        before, cell = NONE, ends[one, 0]
        while cell != NONE:
            order[count] = cell
            count += 1
            ahead = links[cell, 0] if links[cell, 0] != before else links[cell, 1]
            before, cell = cell, ahead
    return order[:count].copy()


def walk(free: Mask, todo: Mask, width: int, axis: int, straight: bool) -> NDArray[np.int32]:
    """Every cell of `todo` once, (n,), in an order with short ways; straights along `axis` (1 or
    width).

    `free`: where a robot may go on the way, (cells,), 1 or 0, one connected room; `todo`, (cells,),
    is part of it. `straight`: make straights as long as possible, with a few more steps between
    them.
    """
    pieces = Pieces.unlinked(free.size)
    link_straight(todo, pieces.links, axis)
    if not straight:
        link_most(todo, width, pieces.links)
    name_pieces(todo, pieces)
    merge_rings(todo, width, pieces)
    order: NDArray[np.int32] = _read(pieces, _join_pieces(free, width, pieces))
    return order
