"""A kd-tree over the positions of agents, the one of the RVO2 library (Apache-2.0), as kernels.

The permutation `order` is kept from step to step: with equal distances the order in which neighbours
are met decides, so the tree is part of the result.
"""

import numpy as np
from numba import njit

from agent.avoidance.k_nearest import take
from agent.avoidance.linear_program import HALF, ZERO
from tools.bench.kernels.agent_table import NEIGHBOURS, RANGE, X, Y

f32 = np.float32
LEAF = 10  # agents in a leaf of the tree
LOW_X, HIGH_X, LOW_Y, HIGH_Y = range(4)  # columns of a node's bounds
FIRST, LAST, CHILD_A, CHILD_B = range(4)  # columns of a node's indices


@njit(cache=True, error_model="numpy")
def _split(agents, order, begin, end, column, value):  # type: ignore[no-untyped-def]
    """Agents below the value first; returns where the others begin."""
    left, right = begin, end
    while left < right:
        while left < right and agents[order[left], column] < value:
            left += 1
        while right > left and agents[order[right - 1], column] >= value:
            right -= 1
        if left < right:
            order[left], order[right - 1] = order[right - 1], order[left]
            left += 1
            right -= 1
    return left if left > begin else left + 1


@njit(cache=True, error_model="numpy")
def build(agents, order, bounds, nodes, stack):  # type: ignore[no-untyped-def]
    """The kd-tree over positions, into `nodes` and `bounds`.

    `agents` (n, columns) has a row for each agent, `order` (n,) is the permutation that is kept
    between steps, `nodes` (2 n, 4) and `bounds` (2 n, 4) have a row for each node, `stack` (2 n +
    8,) is working memory.
    """
    nodes[0, FIRST], nodes[0, LAST] = 0, order.size
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        begin, end = nodes[node, FIRST], nodes[node, LAST]
        low_x = high_x = agents[order[begin], X]
        low_y = high_y = agents[order[begin], Y]
        for i in range(begin + 1, end):
            x, y = agents[order[i], X], agents[order[i], Y]
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
        bounds[node, LOW_X], bounds[node, HIGH_X] = low_x, high_x
        bounds[node, LOW_Y], bounds[node, HIGH_Y] = low_y, high_y
        if end - begin <= LEAF:
            continue
        if high_x - low_x > high_y - low_y:
            middle = _split(agents, order, begin, end, np.int64(X), HALF * (high_x + low_x))
        else:
            middle = _split(agents, order, begin, end, np.int64(Y), HALF * (high_y + low_y))
        a, b = node + 1, node + 2 * (middle - begin)
        nodes[node, CHILD_A], nodes[node, CHILD_B] = a, b
        nodes[a, FIRST], nodes[a, LAST] = begin, middle
        nodes[b, FIRST], nodes[b, LAST] = middle, end
        stack[top], stack[top + 1] = b, a
        top += 2


@njit(cache=True, error_model="numpy")
def _to_box(bounds, node, x, y):  # type: ignore[no-untyped-def]
    a, b = max(ZERO, bounds[node, LOW_X] - x), max(ZERO, x - bounds[node, HIGH_X])
    c, d = max(ZERO, bounds[node, LOW_Y] - y), max(ZERO, y - bounds[node, HIGH_Y])
    return a * a + b * b + c * c + d * d


@njit(cache=True, error_model="numpy")
def near_agents(agents, me, order, bounds, nodes, stack, waiting, near, squares):  # type: ignore[no-untyped-def]
    """Fill `near` with the nearest agents in range of agent `me`, nearest first; returns how many.

    `agents` (n, columns), `order` (n,), `bounds` and `nodes` (2 n, 4) as `build` left them; `stack`
    and `waiting` (2 n + 8,) are working memory; `near` and `squares` (most,) are written. Of agents
    equally far away the one that is met first comes first, as in the RVO2 library.
    """
    x, y, most = agents[me, X], agents[me, Y], int(agents[me, NEIGHBOURS])
    reach = agents[me, RANGE] * agents[me, RANGE]
    count = np.int64(0)  # a literal is a type of its own: compiled twice
    if most == 0:
        return 0
    waiting[0], stack[0], top = ZERO, 0, 1  # how far away each node on the stack is, squared
    while top > 0:
        top -= 1
        node = stack[top]
        if waiting[top] >= reach:
            continue
        begin, end = nodes[node, FIRST], nodes[node, LAST]
        if end - begin > LEAF:
            a, b = nodes[node, CHILD_A], nodes[node, CHILD_B]
            to_a, to_b = _to_box(bounds, a, x, y), _to_box(bounds, b, x, y)
            if (
                to_a < to_b
            ):  # visit the nearer child first, and the other within the reach that is left
                a, b, to_a, to_b = b, a, to_b, to_a
            if to_a < reach:
                stack[top], waiting[top] = a, to_a
                top += 1
            if to_b < reach:
                stack[top], waiting[top] = b, to_b
                top += 1
            continue
        for i in range(begin, end):
            other = order[i]
            dx, dy = x - agents[other, X], y - agents[other, Y]
            square = dx * dx + dy * dy
            if other != me and square < reach:
                count, reach = take(near, squares, count, most, reach, other, square)
    return count


@njit(cache=True, error_model="numpy")
def runs_near(bounds, nodes, leaf, reach, stack, runs):  # type: ignore[no-untyped-def]
    """Fill `runs` (n, 2: first, last) with the parts of `order` whose boxes are within the square
    root of `reach` of a leaf's box; returns how many.

    `bounds` and `nodes` (2 n, 4) as `build` left them; `stack` (2 n + 8,) is working memory.
    """
    count, stack[0], top = 0, 0, 1
    low_x, high_x = bounds[leaf, LOW_X], bounds[leaf, HIGH_X]
    low_y, high_y = bounds[leaf, LOW_Y], bounds[leaf, HIGH_Y]
    while top > 0:
        top -= 1
        node = stack[top]
        dx = max(ZERO, max(bounds[node, LOW_X] - high_x, low_x - bounds[node, HIGH_X]))
        dy = max(ZERO, max(bounds[node, LOW_Y] - high_y, low_y - bounds[node, HIGH_Y]))
        if dx * dx + dy * dy > reach:
            continue
        begin, end = nodes[node, FIRST], nodes[node, LAST]
        if end - begin > LEAF:
            stack[top], stack[top + 1] = nodes[node, CHILD_B], nodes[node, CHILD_A]
            top += 2
        elif count > 0 and runs[count - 1, 1] == begin:
            runs[count - 1, 1] = end
        else:
            runs[count, 0], runs[count, 1] = begin, end
            count += 1
    return count
