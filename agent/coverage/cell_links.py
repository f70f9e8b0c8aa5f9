"""Linking every free cell of a grid with two of its neighbours: the straight part of a coverage
walk.

First links run along one axis, so that there are long straights. Then as many as possible are made
(a largest 2-matching of a bipartite graph, by augmenting paths: Hopcroft and Karp 1973, here one
path at a time): that leaves few paths and many rings. Rings are merged where two parallel links
face each other over a unit square. Both are turned by a quarter, which costs nothing, and which is
what spanning-tree coverage does everywhere (Gabriely and Rimon 2001).

Cells are numbers into a padded grid: row * width + column with a wall all round, so that neighbours
need no bounds. Kernels are integer only and go in order of cell numbers: equal maps, equal links.

`free` (cells,) is 1 or 0. `links` (cells, 2) holds up to two neighbours of each cell, -1 where
there is none.
"""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit

Mask = NDArray[np.uint8]
Ints = NDArray[np.int32]

NONE = -1
FAR = 1 << 30


class Pieces(NamedTuple):
    """Paths and rings of linked cells. What is read at the first cell of a piece counts for it."""

    links: Ints  # (cells, 2)
    piece: Ints  # (cells,), the first cell of the piece of each cell
    root: Ints  # (cells,), at first cells: the piece that it was joined to (`find`)
    ring: Mask  # (cells,), at first cells: whether it is a ring
    size: Ints  # (cells,), at first cells: how many cells it has

    @classmethod
    def unlinked(cls, cells: int) -> Self:
        """A grid of so many cells without any link."""
        links, piece = np.full((cells, 2), NONE, np.int32), np.full(cells, NONE, np.int32)
        return cls(links, piece, piece.copy(), np.zeros(cells, np.uint8), np.zeros(cells, np.int32))


@njit(cache=True)
def link(links: Ints, a: int, b: int) -> None:
    """Link two cells; both must have fewer than two links."""
    links[a, 0 if links[a, 0] == NONE else 1] = b
    links[b, 0 if links[b, 0] == NONE else 1] = a


@njit(cache=True)
def unlink(links: Ints, a: int, b: int) -> None:
    """Remove the link between two cells; it must be there."""
    links[a, 0 if links[a, 0] == b else 1] = NONE
    links[b, 0 if links[b, 0] == a else 1] = NONE


@njit(cache=True)
def is_whole(links: Ints, a: int) -> bool:
    """Whether a cell has both of its links."""
    return links[a, 0] != NONE and links[a, 1] != NONE


@njit(cache=True)
def link_straight(free: Mask, links: Ints, along: int) -> None:
    """Make the first links, all along one axis, so that the walk has long straights.

    `along` is the step from a cell to the next: 1 for rows, the width of the grid for columns.
    """
    for cell in range(free.size - along):
        if free[cell] and free[cell + along]:
            link(links, cell, cell + along)


@njit(cache=True)
def _turn_path(links: Ints, by: Ints, end: int, source: int) -> None:
    """Exchange links along an augmenting path, backwards: what was linked is not, what was not is."""
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
def link_most(free: Mask, width: int, links: Ints) -> None:
    """Add links until no more are possible: alternating breadth-first searches from cells that lack
    one.

    Searches begin at each even cell. Cells reached by a failed search never lie on a later
    augmenting path: their stamp stays, so all failed searches together cost one pass over the grid.
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
def find(root: Ints, piece: int) -> int:
    """The number of the piece that `piece` has been joined to, or its own; shortens the way for
    later calls. `root`: (cells,)."""
    while root[piece] != piece:
        root[piece] = root[root[piece]]
        piece = root[piece]
    return piece


@njit(cache=True)
def name_pieces(free: Mask, pieces: Pieces) -> None:
    """Number the paths and rings: fill `piece`, `root`, `ring` and `size`. A piece has the number
    of its first cell found."""
    links, piece, root, ring, size = pieces
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
def merge_rings(free: Mask, width: int, pieces: Pieces) -> None:
    """Turn facing parallel links of different pieces, one of them a ring, until none is left.

    First where that takes turns out of the walk, last where it adds four. Changes `links`, `root`,
    `ring` and `size`.
    """
    for allowed in range(-4, 6, 2):
        while _merge_pass(free, width, pieces, allowed):
            pass


@njit(cache=True)
def _merge_pass(free: Mask, width: int, pieces: Pieces, allowed: int) -> bool:
    """One pass over the grid, with at most `allowed` more quarter turns a merge; whether it merged
    any."""
    links, piece, root, ring, size = pieces
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
