"""Compiled: the finish of a sequence of sections, the first plan, and the search for a better one.

A plan is `route` (robots, jobs) of job indices with `size` (robots,), the number of jobs in each row.
A job may be worked from either end. The walk along a row keeps the earliest finish for both, so a
row needs no directions: they follow from it.

Arguments of all kernels, times in milliseconds:

* `ready` (robots,): when each robot is free.
* `lead` (robots, 2 jobs): from where it is free to each end of each job; end `e` of job `j` is 2 j + e.
* `work` (jobs,): to work a job.
* `link` (2 jobs, 2 jobs): from one end to another.
* `near` (jobs, n): the jobs that are reached soonest from each, soonest first.
* `state` (1,): the state of the random generator.
"""

from math import exp

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit

Whole = NDArray[np.int64]
Dice = NDArray[np.uint64]

SEGMENT = 3  # most jobs that a move takes together
FAR = 1 << 60


@njit(cache=True, inlined=True)
def draw(state: Dice, below: int) -> int:
    """A number from 0 to `below` - 1: splitmix64 (Steele, Lea and Flood 2014)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    number: int = np.int64((z >> np.uint64(33)) % np.uint64(below))  # type: ignore[assignment]
    return number


@njit(cache=True, inlined=True)
def finish(r: int, seq: Whole, n: int, ready: Whole, lead: Whole, work: Whole, link: Whole) -> int:
    """When robot `r` has worked the first `n` jobs of `seq`, (n,) or longer; `ready` for none."""
    if n == 0:
        return int(ready[r])
    j = seq[0]
    # The earliest time at end 1 (entered at 0), and at end 0 (entered at 1).
    at_1 = ready[r] + lead[r, 2 * j] + work[j]
    at_0 = ready[r] + lead[r, 2 * j + 1] + work[j]
    for k in range(1, n):
        i, j = j, seq[k]
        a, b = 2 * i, 2 * j
        in_0 = min(at_1 + link[a + 1, b], at_0 + link[a, b])
        in_1 = min(at_1 + link[a + 1, b + 1], at_0 + link[a, b + 1])
        at_1, at_0 = in_0 + work[j], in_1 + work[j]
    return int(min(at_1, at_0))


@njit(cache=True, inlined=True)
def first_end(
    r: int, seq: Whole, n: int, ready: Whole, lead: Whole, work: Whole, link: Whole
) -> int:
    """The end, 0 or 1, at which the first of the `n` jobs of `seq`, (n,) or longer, is entered so
    that the row ends soonest.
    """
    best, end = FAR, 0
    for e in range(2):
        j = seq[0]
        at_1 = ready[r] + lead[r, 2 * j] + work[j] if e == 0 else FAR
        at_0 = ready[r] + lead[r, 2 * j + 1] + work[j] if e == 1 else FAR
        for k in range(1, n):
            i, j = j, seq[k]
            a, b = 2 * i, 2 * j
            in_0 = min(at_1 + link[a + 1, b], at_0 + link[a, b])
            in_1 = min(at_1 + link[a + 1, b + 1], at_0 + link[a, b + 1])
            at_1, at_0 = in_0 + work[j], in_1 + work[j]
        if min(at_1, at_0) < best:
            best, end = min(at_1, at_0), e
    return end


@njit(cache=True)
def exchanged(
    route: Whole, size: Whole, ready: Whole, lead: Whole, work: Whole, link: Whole
) -> tuple[Whole, Whole]:
    """If robot `r` takes row `s`: (robots, rows) its way to the first job, and when the row ends."""
    robots = len(ready)
    ways = np.zeros((robots, robots), dtype=np.int64)
    ends = np.empty((robots, robots), dtype=np.int64)
    for r in range(robots):
        for s in range(robots):
            ends[r, s] = finish(r, route[s], size[s], ready, lead, work, link)
            if size[s]:
                end = first_end(r, route[s], size[s], ready, lead, work, link)
                ways[r, s] = lead[r, 2 * route[s, 0] + end]
    return ways, ends


@njit(cache=True)
def insert_all(
    route: Whole, size: Whole, ready: Whole, lead: Whole, work: Whole, link: Whole
) -> None:
    """The first plan: each job in turn where the last finish, then the sum of finishes, grows least.

    The job that is worst to reach from every robot comes first.
    """
    robots, jobs = route.shape
    ends = np.empty(robots, dtype=np.int64)
    for r in range(robots):
        ends[r] = ready[r]
    far = np.empty(jobs, dtype=np.int64)
    for j in range(jobs):
        best = FAR
        for r in range(robots):
            best = min(best, ready[r] + min(lead[r, 2 * j], lead[r, 2 * j + 1]))
        far[j] = best + work[j]
    order = np.argsort(-far)
    seq = np.empty(jobs + 1, dtype=np.int64)
    for j in order:
        best_cost, best_r, best_at, best_end = FAR, 0, 0, 0
        for r in range(robots):
            n = size[r]
            for at in range(n + 1):
                for k in range(at):
                    seq[k] = route[r, k]
                seq[at] = j
                for k in range(at, n):
                    seq[k + 1] = route[r, k]
                end = finish(r, seq, n + 1, ready, lead, work, link)
                cost = end + 4 * (end - ends[r])
                if cost < best_cost:
                    best_cost, best_r, best_at, best_end = cost, r, at, end
        r = best_r
        for k in range(size[r], best_at, -1):
            route[r, k] = route[r, k - 1]
        route[r, best_at] = j
        size[r] += 1
        ends[r] = best_end


@njit(cache=True, inlined=True)
def _last(ends: Whole, size: Whole) -> int:
    """When the last row with jobs ends."""
    last = 0
    for r in range(len(ends)):
        if size[r]:
            last = max(last, ends[r])
    return last


@njit(cache=True, inlined=True)
def _cost(ends: Whole, size: Whole, share: float, scale: float) -> float:
    squares = 0.0
    for end in ends:
        squares += float(end) * float(end)
    return _last(ends, size) + share * squares / scale


@njit(cache=True)
def improve(
    route: Whole, size: Whole, ready: Whole, lead: Whole, work: Whole, link: Whole, near: Whole,
    moves: int, hot: float, cold: float, share: float, state: Dice,
) -> int:  # fmt: skip
    """Simulated annealing (Kirkpatrick, Gelatt and Vecchi 1983) of `route` and `size`; returns the
    last finish of the best plan, which is what they are then.

    The cost is the last finish of a row with jobs, and `share` of the sum of the squares of all
    finishes by it. So the other rows are balanced, too, if one of them ends late in any case.
    `hot`, `cold`: the first and the last temperature, milliseconds. Moves: a segment of up to
    `SEGMENT` jobs, either way round, behind or before a job near by or to the head of a row; and the
    tails of two rows, exchanged.
    """
    robots, jobs = route.shape
    of, at = np.empty(jobs, dtype=np.int64), np.empty(jobs, dtype=np.int64)
    ends = np.empty(robots, dtype=np.int64)
    for r in range(robots):
        ends[r] = finish(r, route[r], size[r], ready, lead, work, link)
        for k in range(size[r]):
            of[route[r, k]], at[route[r, k]] = r, k
    scale = float(max(_last(ends, size), 1))
    cost = _cost(ends, size, share, scale)
    best_cost, best_route, best_size = cost, route.copy(), size.copy()
    a_seq, b_seq = np.empty(jobs, dtype=np.int64), np.empty(jobs, dtype=np.int64)
    cooling = (cold / hot) ** (1.0 / max(moves, 1))
    heat = hot
    for _ in range(moves):
        heat *= cooling
        j = draw(state, jobs)
        r, p = of[j], at[j]
        kind = draw(state, 8)
        if kind == 0:  # tails: what follows j, and what follows a place in another row
            s = draw(state, robots)
            if s == r:
                continue
            q = draw(state, size[s] + 1)
            cut = p + draw(state, 2)
            n, m = cut + size[s] - q, q + size[r] - cut
            for k in range(cut):
                a_seq[k] = route[r, k]
            for k in range(q, size[s]):
                a_seq[cut + k - q] = route[s, k]
            for k in range(q):
                b_seq[k] = route[s, k]
            for k in range(cut, size[r]):
                b_seq[q + k - cut] = route[r, k]
        else:
            length = 1 + draw(state, min(SEGMENT, size[r] - p))
            if kind == 1:  # to the head of a row, also of an empty one
                s, q = draw(state, robots), 0
            else:
                i = near[j, draw(state, near.shape[1])]
                s, q = of[i], at[i] + draw(state, 2)
            backwards = draw(state, 2)
            if s == r:
                if p <= q <= p + length:
                    if backwards == 0 or length == 1:
                        continue
                    q = p
                # The row without the segment, and where the place is in it.
                n, put = 0, q if q <= p else q - length
                for k in range(size[r]):
                    if k < p or k >= p + length:
                        b_seq[n] = route[r, k]
                        n += 1
                for k in range(put):
                    a_seq[k] = b_seq[k]
                for k in range(length):
                    a_seq[put + k] = route[r, p + (length - 1 - k if backwards else k)]
                for k in range(put, n):
                    a_seq[k + length] = b_seq[k]
                n, m = size[r], -1
            else:
                n = 0
                for k in range(size[r]):
                    if k < p or k >= p + length:
                        a_seq[n] = route[r, k]
                        n += 1
                m = size[s] + length
                for k in range(q):
                    b_seq[k] = route[s, k]
                for k in range(length):
                    b_seq[q + k] = route[r, p + (length - 1 - k if backwards else k)]
                for k in range(q, size[s]):
                    b_seq[k + length] = route[s, k]
        ends_before, sizes_before = (ends[r], ends[s]), (size[r], size[s])
        ends[r] = finish(r, a_seq, n, ready, lead, work, link)
        size[r] = n
        if m >= 0:
            ends[s] = finish(s, b_seq, m, ready, lead, work, link)
            size[s] = m
        new = _cost(ends, size, share, scale)
        if new > cost and draw(state, 1 << 30) / (1 << 30) >= exp((cost - new) / heat):
            ends[r], ends[s] = ends_before
            size[r], size[s] = sizes_before
            continue
        cost = new
        for k in range(n):
            route[r, k] = a_seq[k]
            of[a_seq[k]], at[a_seq[k]] = r, k
        if m >= 0:
            for k in range(m):
                route[s, k] = b_seq[k]
                of[b_seq[k]], at[b_seq[k]] = s, k
        if cost < best_cost:
            best_cost = cost
            best_route[:], best_size[:] = route, size
    route[:], size[:] = best_route, best_size
    for r in range(robots):
        ends[r] = finish(r, route[r], size[r], ready, lead, work, link)
    return _last(ends, size)
