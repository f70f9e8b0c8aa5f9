"""Cutting a coverage walk into one run for each robot, so that all end at about the same time.

A run costs the way to its nearer end and the walk from there. With the robots in a given order
along the walk, the least common bound is found by bisection: each takes as much as it can do within
the bound. The order comes from the cheapest assignment of robots to runs, then better by exchanges.
Nothing here is random: equal walk and equal places, equal cut at every peer.

`order` (n,) are the cells of the walk, `along` (n,) the cost before each of them. `ways` (robots,
cells) is the cost from each robot's place to each cell. Run k is order[cuts[k]:cuts[k + 1]]; `cuts`
is (robots + 1,), and `robots` (robots,) says whose run it is.
"""

import numpy as np
from numpy.typing import NDArray

from agent.coverage.team_state import Number
from agent.kernels.kernel import njit
from agent.mapf.linear_assignment import assigned_rows

Integers = NDArray[np.int32]
Longs = NDArray[np.int64]
UNREACHED = 1 << 28  # distance to unreachable cells; sums of it do not overflow


@njit(cache=True)
def _run_end(order: Integers, along: Integers, way: Integers, first: int, bound: Number) -> int:
    """The end of the run that a robot can do from index `first` on within the bound.

    The robot enters at either end. Both costs never fall as the run grows, so the end is found by
    halving.
    """
    # Low is feasible (an empty run), one after `high` - 1 is not known.
    low, high = (first, order.size)
    enter = way[order[first]]
    while low < high:
        middle = (low + high) // 2
        if min(enter, way[order[middle]]) + along[middle] - along[first] <= bound:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True)
def _fits(
    order: Integers, along: Integers, ways: Integers, robots: Longs, bound: Number, cuts: Longs
) -> bool:
    """Whether robots in this order can do the whole walk within the bound; fills `cuts`."""
    cuts[0] = 0
    for i in range(robots.size):
        first = cuts[i]
        cuts[i + 1] = first
        if first < order.size:
            cuts[i + 1] = _run_end(order, along, ways[robots[i]], first, bound)
    return cuts[robots.size] == order.size


@njit(cache=True)
def _least_bound(
    order: Integers, along: Integers, ways: Integers, robots: Longs, cuts: Longs, below: Number
) -> Number:
    """The least bound under `below`, and its cuts; `below` where there is none."""
    if not _fits(order, along, ways, robots, below - 1, cuts):
        return below
    low, high = np.int64(0), below - 1
    while low < high:
        middle = (low + high) // 2
        if _fits(order, along, ways, robots, middle, cuts):
            high = middle
        else:
            low = middle + 1
    _fits(order, along, ways, robots, low, cuts)
    return low


@njit(cache=True)
def _assigned(order: Integers, ways: Integers, cuts: Longs) -> Longs:
    """Robots for the runs between cuts, with the least way in all to their nearer ends."""
    count = cuts.size - 1
    cost = np.zeros((count, count))  # sums of these whole numbers are exact
    for i in range(count):
        if cuts[i] < cuts[i + 1]:
            a, b = order[cuts[i]], order[cuts[i + 1] - 1]
            for robot in range(count):
                cost[i, robot] = min(ways[robot, a], ways[robot, b])
    return assigned_rows(cost)


@njit(cache=True)
def _exchanged(
    order: Integers,
    along: Integers,
    ways: Integers,
    robots: Longs,
    bound: Number,
    cuts: Longs,
    tries: int,
) -> Number:
    """Exchange two robots wherever that lowers the bound, at most `tries` tests."""
    count = robots.size
    trial = cuts.copy()
    done, improved = 0, True
    while improved and done < tries:
        improved = False
        for i in range(count - 1):
            for j in range(i + 1, count):
                robots[i], robots[j] = robots[j], robots[i]
                better = _least_bound(order, along, ways, robots, trial, bound)
                done += 1
                if better < bound:
                    bound, improved = better, True
                    for k in range(cuts.size):  # numba takes seconds to compile slices
                        cuts[k] = trial[k]
                else:
                    robots[i], robots[j] = robots[j], robots[i]
            if done >= tries:
                break
    return bound


@njit(cache=True)
def cut(
    order: Integers, along: Integers, ways: Integers, rounds: int, tries: int
) -> tuple[int, Longs, Longs]:
    """(bound, robot of each run, cuts): runs whose greatest cost, the bound, is as small as was
    found.

    Assignment and cut are repeated for at most `rounds`; then pairs of robots are exchanged, with
    at most about `tries` tests.
    """
    count = ways.shape[0]
    cuts = np.empty(count + 1, np.int64)
    length = along[-1] + 1 - along[0]
    for i in range(count + 1):
        cuts[i] = np.searchsorted(along, along[0] + (length * i + count - 1) // count)
    cuts[count] = order.size
    best = np.int64(UNREACHED)
    best_robots, best_cuts = np.arange(count), cuts.copy()
    for _ in range(rounds):
        robots = _assigned(order, ways, cuts)
        bound = _least_bound(order, along, ways, robots, cuts, np.int64(UNREACHED))
        if bound >= best:
            break
        best = bound
        best_robots, best_cuts = robots.copy(), cuts.copy()
    best = _exchanged(order, along, ways, best_robots, best, best_cuts, tries)
    return best, best_robots, best_cuts
