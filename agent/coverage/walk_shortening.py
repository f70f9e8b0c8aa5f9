"""Shortening a coverage walk at its hops: the places where the next cell is not next door.

Two kinds of change, tried at every hop until none helps: turning round a stretch between the hop
and a neighbour of one of its ends (2-opt, Croes 1958), and moving a short stretch that begins after
the hop to a place beside it (Or-opt, Or 1976). Each is measured by true steps around walls, and
only shorter walks are taken.

Cells are numbers into the padded grid; `free` (cells,) is 1 or 0. `order` (n,) are the cells of the
walk, `at` (cells,) the index of each cell in it (-1: none), `gaps` (n,) the steps from each to the
next.
"""

import numpy as np
from numpy.typing import NDArray

from agent.coverage.team_state import NONE, Number
from agent.coverage.walk import Memory, memory, reach, steps_between
from agent.kernels.kernel import njit

Mask = NDArray[np.uint8]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]

PASSES = 3  # passes over all hops; further ones save almost nothing
HOP_MAX = 24  # steps; longer hops are rare, and searching round one costs its square
STRETCH_MAX = 64  # cells moved at once


@njit(cache=True)
def _apart(width: int, a: int, b: int) -> int:
    """Steps without walls: what a way is never shorter than."""
    return abs(a // width - b // width) + abs(a % width - b % width)


@njit(cache=True)
def _turn(order: Ints, at: Longs, first: Number, last: Number) -> None:
    """Reverse order[first..last]."""
    while first < last:
        a, b = order[first], order[last]
        order[first], order[last] = b, a
        at[b], at[a] = first, last
        first += 1
        last -= 1


@njit(cache=True)
def _reverse(gaps: Longs, first: Number, last: Number) -> None:
    """Reverse gaps[first..last]. Loops, here and below: numba takes seconds to compile slices."""
    while first < last:
        gaps[first], gaps[last] = gaps[last], gaps[first]
        first += 1
        last -= 1


@njit(cache=True)
def _gap(order: Ints, gaps: Longs, i: int) -> Number:
    """Steps between order[i] and order[i + 1]; 0 beyond the ends."""
    return gaps[i] if 0 <= i < order.size - 1 else 0


@njit(cache=True)
def _regap(
    free: Mask, width: int, order: Ints, gaps: Longs, first: Number, last: Number, near: Memory
) -> None:
    """Measure the gaps after the cells with indices `first` to `last` again."""
    for i in range(max(first, 0), min(last, order.size - 2) + 1):
        gaps[i] = steps_between(free, width, order[i], order[i + 1], near)


@njit(cache=True)
def _known(near: Memory, cell: int) -> Number:
    """Steps to a cell from where the last search began; -1 beyond its radius."""
    return near[1][cell] if near[0][cell] == near[0][0] else NONE


@njit(cache=True)
def _untangle(free, width, order, at, gaps, i, near_a, near_b):  # type: ignore[no-untyped-def]
    """The best 2-opt change that removes the hop after place i; returns what it saves."""
    a, b, hop = order[i], order[i + 1], gaps[i]
    last = order.size - 1
    best, first, final = 0, np.int64(0), np.int64(0)  # numba would compile twice for literals
    for step in (-width, width, -1, 1):
        c = a + step
        j = at[c]
        if j != NONE and j != i + 1:  # link a to c, and b to what came after c
            saved = hop + _gap(order, gaps, j) - 1
            rest = 0 if j == last else _known(near_b, order[j + 1])
            if rest != NONE and j != i and saved - rest > best:
                best, first, final = saved - rest, min(i, j) + 1, max(i, j)
        c = b + step
        j = at[c]
        if j != NONE and j != i:  # link b to c, and a to what came before c
            saved = hop + _gap(order, gaps, j - 1) - 1
            rest = 0 if j == 0 else _known(near_a, order[j - 1])
            if rest != NONE and j != i + 1 and saved - rest > best:
                best, first, final = saved - rest, min(i + 1, j), max(i + 1, j) - 1
    if best > 0:
        _turn(order, at, first, final)
        _reverse(gaps, first, final - 1)
        _regap(free, width, order, gaps, first - 1, first - 1, near_a)
        _regap(free, width, order, gaps, final, final, near_a)
    return best


@njit(cache=True)
def _move(
    free: Mask,
    width: int,
    order: Ints,
    at: Longs,
    gaps: Longs,
    first: int,
    last: int,
    to: int,
    turned: bool,
    near: Memory,
) -> None:
    """Put order[first..last] behind place `to` (outside of it), turned round or not."""
    count = last + 1 - first
    stretch, inner = np.empty(count, order.dtype), np.empty(count, gaps.dtype)
    for k in range(count):
        stretch[k] = order[last - k if turned else first + k]
    for k in range(count - 1):
        inner[k] = gaps[last - 1 - k if turned else first + k]
    low, high = (to + 1, last) if to < first else (first, to)
    if to < first:  # cells in between move up, and the stretch goes before them
        for k in range(first - 1, to, -1):
            order[k + count] = order[k]
        for k in range(first - 2, to, -1):
            gaps[k + count] = gaps[k]
        start = to + 1
    else:
        for k in range(last + 1, to + 1):
            order[k - count] = order[k]
        for k in range(last + 1, to):
            gaps[k - count] = gaps[k]
        start = to + 1 - count
    for k in range(count):
        order[start + k] = stretch[k]
    for k in range(count - 1):
        gaps[start + k] = inner[k]
    for k in range(low, high + 1):
        at[order[k]] = k
    joint = start + count - 1 if to < first else start - 1
    for k in (low - 1, joint, high):
        _regap(free, width, order, gaps, k, k, near)


@njit(cache=True)
def _shift(
    free: Mask,
    width: int,
    order: Ints,
    at: Longs,
    gaps: Longs,
    i: int,
    near_a: Memory,
    near_b: Memory,
) -> int:
    """The best move of a stretch that begins after the hop at i; returns what it saves."""
    last, hop, a, b = order.size - 1, gaps[i], order[i], order[i + 1]
    none = int(np.int64(0))  # numba would compile twice for a literal
    best, best_end, best_to, best_turned = 0, none, none, none > 0
    for end in range(i + 1, min(last, i + STRETCH_MAX) + 1):
        out = _gap(order, gaps, end)
        if end > i + 3 and out == 1:
            continue  # a long stretch only between two hops
        tail = order[end]
        closed = 0
        if end < last:
            if hop + out - _apart(width, a, order[end + 1]) <= best:
                continue
            closed = steps_between(free, width, a, order[end + 1], near_a)
        won = hop + out - closed
        if won <= best:
            continue
        for side in range(2):  # which end of the stretch goes beside its new neighbour
            head, other = (b, tail) if side == 0 else (tail, b)
            for step in (-width, width, -1, 1):
                j = at[head + step]
                if j == NONE or i + 1 <= j <= end:
                    continue
                for ahead in range(2):  # the stretch comes after c, or before it
                    k = j + 1 if ahead else j - 1
                    if i + 1 <= k <= end or (j == i and ahead) or (j == end + 1 and not ahead):
                        continue
                    cost = 1
                    if 0 <= k <= last:
                        cut = _gap(order, gaps, min(j, k))
                        if won - 1 - _apart(width, other, order[k]) + cut <= best:
                            continue
                        cost += steps_between(free, width, other, order[k], near_b) - cut
                    if won - cost > best:
                        best, best_end = won - cost, end
                        best_to = j if ahead else k
                        best_turned = (side == 0) != (ahead == 1)
    if best > 0:
        _move(free, width, order, at, gaps, i + 1, best_end, best_to, best_turned, near_a)
    return best


@njit(cache=True)
def polish(free: Mask, width: int, order: Ints) -> int:
    """Shorten the walk `order` in place; returns the number of steps saved."""
    near_a, near_b = memory(free.size), memory(free.size)
    at = np.full(free.size, NONE, np.int64)
    for i in range(order.size):
        at[order[i]] = i
    gaps = np.zeros(order.size, np.int64)
    _regap(free, width, order, gaps, np.int64(0), order.size - 2, near_a)
    total = 0
    for _ in range(PASSES):
        before = total
        for i in range(order.size - 1):
            if gaps[i] < 2 or gaps[i] > HOP_MAX:
                continue
            reach(free, width, order[i], gaps[i], near_a)
            reach(free, width, order[i + 1], gaps[i], near_b)
            won = _untangle(free, width, order, at, gaps, i, near_a, near_b)
            if won == 0:
                won = _shift(free, width, order, at, gaps, i, near_a, near_b)
            total += won
        if total == before:
            break
    return total
