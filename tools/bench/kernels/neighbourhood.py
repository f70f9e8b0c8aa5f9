"""The nearest neighbours of every agent, from those of the step before.

Agents that were near are still near. The neighbours of the last step, sorted again, give a distance
beyond which no agent matters, and hardly any other agent is found within it. That takes half of the
time of a search from scratch. Where two agents are equally far from a third, the order in which the
tree meets them decides. Only then is the tree asked.
"""

import numpy as np
from numba import njit

from agent.avoidance.k_nearest import insert
from agent.avoidance.linear_program import ZERO
from tools.bench.kernels.agent_table import NEIGHBOURS, RANGE, X, Y
from tools.bench.kernels.kd_tree import CHILD_A, CHILD_B, FIRST, LAST, LEAF, near_agents, runs_near

f32 = np.float32


@njit(cache=True, error_model="numpy")
def _again(agents, me, known, hints, near, squares):  # type: ignore[no-untyped-def]
    """Sort the neighbours of the last step again: (how many in range, square of the reach left, tie)."""
    x, y, most = agents[me, X], agents[me, Y], int(agents[me, NEIGHBOURS])
    count, tie, reach = int(np.int64(0)), False, agents[me, RANGE] * agents[me, RANGE]
    if most == 0:
        return 0, ZERO, False
    for k in range(hints):
        other = known[k]
        dx, dy = x - agents[other, X], y - agents[other, Y]
        square = dx * dx + dy * dy
        if square >= reach:
            tie |= count == most and square == reach
            continue
        place = insert(near, squares, count, most, other, square)
        tie |= place > 0 and squares[place - 1] == square
        count = min(count + 1, most)
        if count == most:
            reach = squares[count - 1]
    return count, reach, tie


@njit(cache=True, error_model="numpy")
def _newcomers(me, mine, most, count, reach, tie, places, mark, order, runs, near, squares):  # type: ignore[no-untyped-def]
    """Add agents that were not near before: (how many, tie). `mark`: those in `near` already."""
    x, y = places[mine, 0], places[mine, 1]
    for run in range(runs.shape[0]):
        for i in range(runs[run, 0], runs[run, 1]):
            dx, dy = x - places[i, 0], y - places[i, 1]
            square = dx * dx + dy * dy
            if (square <= reach) & (mark[i] != me):  # one branch, that is hardly ever taken
                if square == reach:
                    tie |= count == most
                    continue
                place = insert(near, squares, count, most, order[i], square)
                tie |= place > 0 and squares[place - 1] == square
                count = min(count + 1, most)
                if count == most:
                    reach = squares[count - 1]
    return count, tie


@njit(cache=True, error_model="numpy")
def neighbours(agents, order, bounds, nodes, stack, known, counts):  # type: ignore[no-untyped-def]
    """Bring `known` (agents, most) and `counts` (agents,) from the last step to this one; nearest
    first.

    `agents` (n, columns), `order` (n,) and `nodes` (2 n, 4) as in `kd_tree`; `stack` (2 n + 8,) is
    working memory.
    """
    n, most = known.shape
    places, mark = np.empty((n, 2), f32), np.full(n, -1, np.int64)  # in the order of the tree
    seat = np.empty(n, np.int64)
    for i in range(n):
        assert agents[i, NEIGHBOURS] <= most
        seat[order[i]] = i
        places[i, 0], places[i, 1] = agents[order[i], X], agents[order[i], Y]
    near, squares = np.empty((LEAF, most), np.int64), np.empty((LEAF, most), f32)
    reaches, ties = np.empty(LEAF, f32), np.empty(LEAF, np.bool_)
    runs, inner = np.empty((n, 2), np.int64), np.empty(stack.size, np.int64)
    waiting = np.empty(stack.size, f32)
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        leaf = stack[top]
        begin, end = nodes[leaf, FIRST], nodes[leaf, LAST]
        if end - begin > LEAF:
            stack[top], stack[top + 1] = nodes[leaf, CHILD_B], nodes[leaf, CHILD_A]
            top += 2
            continue
        widest = ZERO
        for i in range(begin, end):
            me, k = order[i], i - begin
            counts[me], reaches[k], ties[k] = _again(
                agents, me, known[me], counts[me], near[k], squares[k]
            )
            widest = max(widest, reaches[k])
        some = runs[: runs_near(bounds, nodes, leaf, widest, inner, runs)]
        for i in range(begin, end):
            me, k = order[i], i - begin
            mark[i] = me
            for other in near[k, : counts[me]]:
                mark[seat[other]] = me
            count, tie = _newcomers(me, i, int(agents[me, NEIGHBOURS]), counts[me], reaches[k], ties[k],
                                    places, mark, order, some, near[k], squares[k])  # fmt: skip
            if tie:
                count = near_agents(agents, me, order, bounds, nodes, inner, waiting, near[k],
                                    squares[k])  # fmt: skip
            counts[me] = count
            for j in range(count):  # numba takes seconds to compile slices
                known[me, j] = near[k, j]
