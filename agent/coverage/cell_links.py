"""Linking every free cell of a grid with two of its neighbours: the straight part of a coverage walk.

`links` (cells, 2) holds up to two neighbours of each cell, -1 where there is none. First links run
along one axis, so that there are long straights. Then as many as possible are made (a largest
2-matching of a bipartite graph, by augmenting paths): that leaves few paths and many rings. Rings
are merged where two parallel links face each other over a unit square: both are turned by a quarter,
at no cost, which is what spanning-tree coverage does everywhere.

Cells are numbers into a padded grid: row * width + column with a wall all round, so that neighbours
need no bounds. Kernels are integer only and go in order of cell numbers: equal maps, equal links.
"""

import numpy as np
from numba import njit

NONE = -1
FAR = 1 << 30


@njit(cache=True)
def link(links, a, b):  # type: ignore[no-untyped-def]
    links[a, 0 if links[a, 0] == NONE else 1] = b
    links[b, 0 if links[b, 0] == NONE else 1] = a


@njit(cache=True)
def unlink(links, a, b):  # type: ignore[no-untyped-def]
    links[a, 0 if links[a, 0] == b else 1] = NONE
    links[b, 0 if links[b, 0] == a else 1] = NONE


@njit(cache=True)
def is_whole(links, a):  # type: ignore[no-untyped-def]
    return links[a, 0] != NONE and links[a, 1] != NONE


@njit(cache=True)
def link_straight(free, links, along):  # type: ignore[no-untyped-def]
    """First links: all along one axis, so that the walk has long straights."""
    for cell in range(free.size - along):
        if free[cell] and free[cell + along]:
            link(links, cell, cell + along)


@njit(cache=True)
def _turn_path(links, by, end, source):  # type: ignore[no-untyped-def]
    """Along an augmenting path, backwards: what was linked is not, what was not is."""
    odd = end
    while True:
        even = by[odd]
        if even == source:
            link(links, even, odd)
            return
        before = by[even]
        unlink(links, even, before)
        link(links, even, odd)
        odd = before


@njit(cache=True)
def link_most(free, width, links):  # type: ignore[no-untyped-def]
    """Alternating breadth-first searches from each even cell that lacks a link.

    Cells reached by a failed search never lie on a later augmenting path: their stamp stays, so all
    failed searches together cost one pass over the grid.
    """
    by = np.full(free.size, NONE, np.int32)
    stamp = np.zeros(free.size, np.int32)
    queue = np.empty(free.size, np.int32)
    steps = (-width, width, -1, 1)
    turn = 0
    for source in range(free.size):
        if not free[source] or (source // width + source % width) % 2:
            continue
        while not is_whole(links, source) and stamp[source] != FAR:
            turn += 1
            queue[0], head, tail, end = source, 0, 1, NONE
            stamp[source] = turn
            while head < tail and end == NONE:
                cell = queue[head]
                head += 1
                if (cell // width + cell % width) % 2:  # odd: on along its links
                    for side in range(2):
                        even = links[cell, side]
                        if stamp[even] < turn:
                            stamp[even], by[even], queue[tail] = turn, cell, even
                            tail += 1
                    continue
                for step in steps:  # even: on to where no link is
                    odd = cell + step
                    if not free[odd] or stamp[odd] >= turn:
                        continue
                    if links[cell, 0] == odd or links[cell, 1] == odd:
                        continue
                    stamp[odd], by[odd], queue[tail] = turn, cell, odd
                    tail += 1
                    if not is_whole(links, odd):
                        end = odd
                        break
            if end == NONE:
                for i in range(tail):
                    stamp[queue[i]] = FAR
            else:
                _turn_path(links, by, end, source)


@njit(cache=True)
def find(root, piece):  # type: ignore[no-untyped-def]
    while root[piece] != piece:
        root[piece] = root[root[piece]]
        piece = root[piece]
    return piece


@njit(cache=True)
def name_pieces(free, links, piece, root, ring, size):  # type: ignore[no-untyped-def]
    """Number the paths and rings; a piece is named by its first cell found."""
    piece[:] = NONE
    for open_ends in (True, False):  # paths from their ends, then what is left: rings
        for first in range(free.size):
            if not free[first] or piece[first] != NONE or (open_ends and is_whole(links, first)):
                continue
            root[first], ring[first], size[first] = first, not open_ends, 0
            cell, before = first, NONE
            while cell != NONE and piece[cell] == NONE:
                piece[cell] = first
                size[first] += 1
                ahead = links[cell, 0] if links[cell, 0] != before else links[cell, 1]
                cell, before = ahead, cell


@njit(cache=True)
def merge_rings(free, width, links, piece, root, ring, size):  # type: ignore[no-untyped-def]
    """Turn facing parallel links of different pieces, one of them a ring, until none is left.

    First where that takes turns out of the walk, last where it adds four.
    """
    for allowed in range(-4, 6, 2):
        while _merge_pass(free, width, links, piece, root, ring, size, allowed):
            pass


@njit(cache=True)
def _merge_pass(free, width, links, piece, root, ring, size, allowed):  # type: ignore[no-untyped-def]
    changed = False
    for a in range(free.size - width - 1):
        b, c, d = a + 1, a + width, a + width + 1
        if not (free[a] and free[b] and free[c] and free[d]):
            continue
        if (links[a, 0] == b or links[a, 1] == b) and (links[c, 0] == d or links[c, 1] == d):
            pass
        elif (links[a, 0] == c or links[a, 1] == c) and (links[b, 0] == d or links[b, 1] == d):
            b, c = c, b
        else:
            continue
        one, other = find(root, piece[a]), find(root, piece[c])
        if one == other or not (ring[one] or ring[other]):
            continue
        turned = 0
        if allowed < 4:
            for e, old, new in ((a, b, c), (b, a, d), (c, d, a), (d, c, b)):
                by = links[e, 0] if links[e, 0] != old else links[e, 1]
                if by != NONE:
                    turned += (e - by != new - e) - (e - by != old - e)
            if turned > allowed:
                continue
        unlink(links, a, b)
        unlink(links, c, d)
        link(links, a, c)
        link(links, b, d)
        root[other] = one
        ring[one] = ring[one] and ring[other]
        size[one] += size[other]
        changed = True
    return changed
