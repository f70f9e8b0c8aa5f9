"""Compiled: how long all tasks wait in sum, and the search for a plan in which they wait less.

The waiting time of a task counts from now to its delivery. So a short task goes before a long one
if that makes the others wait less. Routes are those of `agent/delivery/routing_kernels.py`, which
also describes `work`, `near` and `state`. A plan is `route` (robots, room) with `size` (robots,).
"""

import numpy as np

from agent.delivery.routing_kernels import Dice, WorkArrays, propose, walk, write
from agent.delivery.routing_problem import Whole
from agent.kernels.kernel import njit


@njit(cache=True)
def shorten_waiting(
    route: Whole,
    size: Whole,
    near: Whole,
    moves: int,
    state: Dice,
    work: WorkArrays,
) -> int:
    """Local search from a plan, in place; returns how many of `moves` random moves were accepted.

    A move is accepted if the tasks of its two routes wait less in sum, and if neither of the two
    lasts longer than the longest route of the plan did.
    """
    robots, room = route.shape
    through, sums = np.empty(robots, np.int64), np.empty(robots, np.int64)
    of, at = np.full(len(near), -1, np.int64), np.zeros(len(near), np.int64)
    for r in range(robots):
        time, total = walk(r, route[r], size[r], work)
        write(route, size, through, of, at, r, route[r].copy(), size[r], time)
        sums[r] = total
    latest = through.max()
    new_a, new_b = np.empty(2 * room + 2, np.int64), np.empty(2 * room + 2, np.int64)
    gained = 0
    for _ in range(moves):
        a, b, n, m = propose(route, size, of, at, near, state, new_a, new_b)
        if n < 0 or n > room or m > room:
            continue
        ta, sum_a = walk(a, new_a, n, work)
        tb, sum_b, before = through[b], 0, sums[a]
        if a != b:
            tb, sum_b = walk(b, new_b, m, work)
            before += sums[b]
        if max(ta, tb) > latest or sum_a + sum_b >= before:
            continue
        gained += 1
        write(route, size, through, of, at, a, new_a, n, ta)
        sums[a] = sum_a
        if a != b:
            write(route, size, through, of, at, b, new_b, m, tb)
            sums[b] = sum_b
    return gained
