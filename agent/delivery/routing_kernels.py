"""Compiled: what a sequence of tasks takes, the auction, and the search for a better plan.

A plan is `route` (robots, room) of task indices with `size` (robots,), the number of tasks in each
row. The duration of a route is found by a walk along it, which has about ten tasks. With batteries
the walk keeps labels (time, energy used), one for each bay where it could have charged last, and
drops those that are worse in both: dominance as in shortest paths with resource constraints (Irnich
and Desaulniers 2005).

Arguments of all kernels:

* `r`: number of a robot. `seq` (n or more,): task indices, of which the first `n` count.
* `work`: times and energies, as in `Workload` and `Power`.
* `of` (tasks,) and `at` (tasks,): the robot that has each task (-1: none) and its index in the route.
* `near` (tasks, n): after what each task may follow: a task, or tasks + robot for the head of a route.
* `state` (1,): the state of the random generator.
"""

from math import exp
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.delivery.routing_problem import IMPOSSIBLE_MS, Power, Whole
from agent.kernels.kernel import njit

Dice = NDArray[np.uint64]  # (1,), the state of the random generator
LABELS = 8  # kept at each task; more than four were never needed at a time
LAST = np.bool_(False)  # numba would compile twice for a literal
SEGMENT = 3  # most tasks that a move takes together


class WorkArrays(NamedTuple):
    """A `Workload` as the kernels take it, milliseconds. `charging`: whether batteries count."""

    ready: Whole  # (robots,)
    lead: Whole  # (robots, tasks)
    link: Whole  # (tasks, tasks)
    power: Power
    charging: bool


@njit(cache=True, inlined=True)
def _keep(times: Whole, used: Whole, count: int, time: int, energy: int) -> int:
    """Add the label (`time`, `energy`) to `times` and `used` (LABELS,), of which the first `count`
    count.

    It is left out if a label is as good in both; labels that it beats in both go. Returns the new
    count.
    """
    for k in range(count):
        if times[k] <= time and used[k] <= energy:
            return count
    kept = 0
    for k in range(count):
        if times[k] < time or used[k] < energy:
            times[kept], used[kept] = times[k], used[k]
            kept += 1
    if kept == LABELS:  # the slowest makes room
        worst = 0
        for k in range(1, kept):
            if times[k] > times[worst]:
                worst = k
        if times[worst] <= time:
            return kept
        times[worst], used[worst] = time, energy
        return kept
    times[kept], used[kept] = time, energy
    return kept + 1


@njit(cache=True)
def _walk_charging(
    r: int,
    seq: Whole,
    n: int,
    work: WorkArrays,
) -> tuple[int, int]:
    """`walk` with bays visited where that is faster; IMPOSSIBLE_MS twice if it runs dry."""
    ready, lead, link, power = work.ready, work.lead, work.link, work.power
    (capacity, dock, rate, left, lead_e, link_e, home, lead_bay_ms, lead_bay_e, to_bay_ms,
     to_bay_e, from_bay_ms, from_bay_e) = power  # fmt: skip
    bays = from_bay_ms.shape[0]
    times, used = np.empty(LABELS, np.int64), np.empty(LABELS, np.int64)
    new_times, new_used = np.empty(LABELS, np.int64), np.empty(LABELS, np.int64)
    times[0], used[0], count = ready[r], capacity - left[r], 1
    through, total = ready[r], 0
    for k in range(n):
        j = seq[k]
        i = seq[k - 1] if k > 0 else -1
        step_ms = link[i, j] if k > 0 else lead[r, j]
        step_e = link_e[i, j] if k > 0 else lead_e[r, j]
        fresh = 0
        for m in range(count):
            if used[m] + step_e + home[j] <= capacity:
                fresh = _keep(new_times, new_used, fresh, times[m] + step_ms, used[m] + step_e)
            for c in range(bays):
                there_ms = to_bay_ms[i, c] if k > 0 else lead_bay_ms[r, c]
                there_e = to_bay_e[i, c] if k > 0 else lead_bay_e[r, c]
                if used[m] + there_e > capacity or from_bay_e[c, j] + home[j] > capacity:
                    continue
                charge_ms = dock + int((used[m] + there_e) * rate)
                time = times[m] + there_ms + charge_ms + from_bay_ms[c, j]
                fresh = _keep(new_times, new_used, fresh, time, from_bay_e[c, j])
        if fresh == 0:
            return IMPOSSIBLE_MS, IMPOSSIBLE_MS
        count, through = fresh, new_times[0]
        for m in range(count):
            times[m], used[m] = new_times[m], new_used[m]
            through = min(through, times[m])
        total += through
    return through, total


@njit(cache=True)
def walk(
    r: int,
    seq: Whole,
    n: int,
    work: WorkArrays,
) -> tuple[int, int]:
    """When robot `r` has done the first `n` tasks of a sequence, and the sum of when it has done
    each.

    Both in milliseconds from now; IMPOSSIBLE_MS if its battery would be empty.
    """
    if n == 0:
        return work.ready[r], 0
    if work.charging:
        return _walk_charging(r, seq, n, work)
    time = work.ready[r] + work.lead[r, seq[0]]
    total = time
    for k in range(1, n):
        time += work.link[seq[k - 1], seq[k]]
        total += time
    return time, total


@njit(cache=True)
def span(
    r: int,
    seq: Whole,
    n: int,
    work: WorkArrays,
) -> int:
    """When robot `r` has done the first `n` tasks of a sequence, milliseconds from now."""
    return walk(r, seq, n, work)[0]


@njit(cache=True, inlined=True)
def copy(seq: Whole, first: int, end: int, out: Whole, to: int) -> int:
    """Copy the tasks from index `first` to `end` - 1 to `out` (n or more,), from index `to` on.

    Returns the index behind them. It is a loop, because numba takes seconds to compile slices.
    """
    for k in range(first, end):
        out[to] = seq[k]
        to += 1
    return to


@njit(cache=True, inlined=True)
def put(seq: Whole, n: int, task: int, at: int, out: Whole) -> None:
    """Copy the first `n` tasks of `seq` to `out` (n + 1 or more,) with `task` inserted at index
    `at`.
    """
    copy(seq, 0, at, out, 0)
    out[at] = task
    copy(seq, at, n, out, at + 1)


@njit(cache=True)
def best_place(
    r: int,
    seq: Whole,
    n: int,
    task: int,
    first: int,
    waiting: bool | np.bool_,
    work: WorkArrays,
    out: Whole,
) -> tuple[int, int]:
    """The cost of one more task at the best index, milliseconds, and that index.

    `waiting`: the cost is how much longer the tasks of the route wait in sum; otherwise it is when
    the robot would have done them all. `first`: the lowest index that is allowed. `out`: scratch,
    (n + 1 or more,).
    """
    before = walk(r, seq, n, work)[1] if waiting else 0
    best, place = IMPOSSIBLE_MS, n
    for at in range(first, n + 1):
        put(seq, n, task, at, out)
        time, total = walk(r, out, n + 1, work)
        cost = total - before if waiting else time
        if cost < best:
            best, place = cost, at
    return best, place


@njit(cache=True)
def auction(
    route: Whole,
    size: Whole,
    free: Whole,
    work: WorkArrays,
) -> int:
    """Sequential single-item auction (Koenig et al. 2006), in place: the lowest bid of all wins a
    task.

    A bid is the time at which the robot would have done all its tasks. Ties go to the lower task,
    then to the lower robot. `free` (n,): tasks to assign, ascending. Returns how many of them no
    robot can do.
    """
    robots, room = route.shape
    out = np.empty(room + 1, np.int64)
    bid = np.full((len(free), robots), IMPOSSIBLE_MS, np.int64)
    place = np.zeros((len(free), robots), np.int64)
    given = np.zeros(len(free), np.bool_)
    for t in range(len(free)):
        for r in range(robots):
            bid[t, r], place[t, r] = best_place(r, route[r], size[r], free[t], 0, LAST, work, out)
    for left in range(len(free), 0, -1):
        best, winner = IMPOSSIBLE_MS, -1
        taker = int(np.int64(-1))  # numba compiles twice for a literal
        for t in range(len(free)):
            if given[t]:
                continue
            for r in range(robots):
                if bid[t, r] < best:
                    best, winner, taker = bid[t, r], t, r
        if winner < 0:
            return left
        put(route[taker], size[taker], free[winner], place[winner, taker], out)
        size[taker] += 1
        copy(out, 0, size[taker], route[taker], 0)
        given[winner] = True
        for t in range(len(free)):
            if not given[t]:
                bid[t, taker], place[t, taker] = best_place(
                    taker, route[taker], size[taker], free[t], 0, LAST, work, out
                )
    return 0


@njit(cache=True)
def _weight(time: int, scale: float) -> float:
    """The eighth power of a route's time: nearly the maximum, and yet every second of every robot
    counts.
    """
    x = time / scale
    x *= x
    x *= x
    return x * x


@njit(cache=True, inlined=True)
def _moved(
    route: Whole,
    size: Whole,
    a: int,
    ia: int,
    b: int,
    ib: int,
    kind: int,
    la: int,
    lb: int,
    new_a: Whole,
    new_b: Whole,
) -> tuple[int, int]:
    """Write two routes after a move to `new_a` and `new_b`; their sizes, or -1 twice if it is no
    move.

    Task `ia` of route `a` is to come right behind index `ib` of route `b` (-1: at its head). `kind`
    0: a segment of `la` tasks goes over. 1: segments of `la` and `lb` tasks change places. 2: both
    tails do.
    """
    na, nb = size[a], size[b]
    start = ib + 1  # of the other segment
    if kind == 0:
        lb = 0
    elif kind == 2:
        if a == b:
            return -1, -1
        la, lb = na - ia, nb - start
    if ia + la > na or start + lb > nb:
        return -1, -1
    if a == b:
        return _moved_within(route[a], na, ia, start, la, lb, new_a)
    n = copy(route[a], 0, ia, new_a, 0)
    n = copy(route[b], start, start + lb, new_a, n)
    n = copy(route[a], ia + la, na, new_a, n)
    m = copy(route[b], 0, start, new_b, 0)
    m = copy(route[a], ia, ia + la, new_b, m)
    m = copy(route[b], start + lb, nb, new_b, m)
    return n, m


@njit(cache=True, inlined=True)
def _moved_within(
    seq: Whole, count: int, ia: int, start: int, la: int, lb: int, out: Whole
) -> tuple[int, int]:
    """The same move inside one route: [ia, ia + la) and [start, start + lb) change places. Returns
    (size, 0), or -1 twice if they overlap.
    """
    if start < ia:
        lo, llo, hi, lhi = start, lb, ia, la
    else:
        lo, llo, hi, lhi = ia, la, start, lb
    if lo + llo > hi or (lo + llo == hi and lhi == 0):
        return -1, -1
    n = copy(seq, 0, lo, out, 0)
    n = copy(seq, hi, hi + lhi, out, n)
    n = copy(seq, lo + llo, hi, out, n)
    n = copy(seq, lo, lo + llo, out, n)
    n = copy(seq, hi + lhi, count, out, n)
    return n, 0


@njit(cache=True)
def _next(state: Dice) -> np.uint64:
    """A random number of 31 bits by xorshift64* (Vigna 2016), equal on every machine."""
    x: np.uint64 = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return (x * np.uint64(2685821657736338717)) >> np.uint64(33)


@njit(cache=True)
def _below(state: Dice, n: int) -> int:
    """A random number from 0 to n - 1."""
    return int(_next(state) % np.uint64(n))


@njit(cache=True, inlined=True)
def propose(
    route: Whole,
    size: Whole,
    of: Whole,
    at: Whole,
    near: Whole,
    state: Dice,
    new_a: Whole,
    new_b: Whole,
) -> tuple[int, int, int, int]:
    """A random move, written to `new_a` and `new_b`: both robots and the sizes of both new routes.

    A size below 0 means that it was no move. `new_a`, `new_b`: (2 * room or more,).
    """
    tasks = len(of)
    j = _below(state, tasks)
    a, ia = of[j], at[j]
    p = near[j, _below(state, near.shape[1])]
    b, ib = (p - tasks, -1) if p >= tasks else (of[p], at[p])
    if a < 0 or b < 0:
        return a, b, -1, -1
    kind = _below(state, 3)
    la, lb = 1 + _below(state, SEGMENT), 1 + _below(state, SEGMENT)
    n, m = _moved(route, size, a, ia, b, ib, kind, la, lb, new_a, new_b)
    return a, b, n, m


@njit(cache=True, inlined=True)
def _accepted(
    before_a: int,
    before_b: int,
    ta: int,
    tb: int,
    same: bool,
    scale: float,
    temperature: float,
    state: Dice,
) -> bool | np.bool_:
    """Whether two routes may take `ta` and `tb` instead: always if that is better, otherwise by
    chance (the rule of Metropolis).
    """
    gain = _weight(ta, scale) - _weight(before_a, scale)
    if not same:
        gain += _weight(tb, scale) - _weight(before_b, scale)
    gain *= scale / 8.0
    if gain <= 0.0:
        return True
    dice = (_next(state) & np.uint64(0xFFFFFF)) / 16777216.0
    return dice < exp(-gain / temperature)


@njit(cache=True, inlined=True)
def write(
    route: Whole,
    size: Whole,
    times: Whole,
    of: Whole,
    at: Whole,
    r: int,
    tasks: Whole,
    n: int,
    time: int,
) -> None:
    """Replace the route of robot `r` by the first `n` of `tasks` (n or more,), and update `of` and
    `at`.

    `times` (robots,): duration of each route, milliseconds; `time`: of the new one.
    """
    times[r], size[r] = time, n
    for k in range(n):
        route[r, k] = tasks[k]
        of[tasks[k]], at[tasks[k]] = r, k


@njit(cache=True)
def _copy(route: Whole, size: Whole, to_route: Whole, to_size: Whole) -> None:
    """Copy a plan to `to_route` (robots, room) and `to_size` (robots,)."""
    for r in range(len(size)):
        to_size[r] = size[r]
        copy(route[r], 0, route.shape[1], to_route[r], 0)


@njit(cache=True)
def search(
    route: Whole,
    size: Whole,
    near: Whole,
    moves: int,
    hot: float,
    cold: float,
    state: Dice,
    work: WorkArrays,
) -> None:
    """Simulated annealing from a plan, in place: `moves` steps, from temperature `hot` to `cold`.

    Temperatures are shares of the mean duration of a route. At the end `route` holds the best plan
    that was met, by makespan and then by total.
    """
    robots, room = route.shape
    times = np.empty(robots, np.int64)
    of, at = np.full(len(near), -1, np.int64), np.zeros(len(near), np.int64)
    for r in range(robots):
        time = span(r, route[r], size[r], work)
        write(route, size, times, of, at, r, route[r].copy(), size[r], time)
    total = times.sum()
    best_most, best_total = times.max(), total
    if total == 0:
        return
    scale = total / robots
    best_route, best_size = route.copy(), size.copy()
    new_a, new_b = np.empty(2 * room + 2, np.int64), np.empty(2 * room + 2, np.int64)
    cooling = (cold / hot) ** (1.0 / max(moves, 1))
    temperature = hot * scale
    for _ in range(moves):
        temperature *= cooling
        a, b, n, m = propose(route, size, of, at, near, state, new_a, new_b)
        if n < 0 or n > room or m > room:
            continue
        ta = span(a, new_a, n, work)
        tb = times[b]
        if a != b:
            tb = span(b, new_b, m, work)
        if ta >= IMPOSSIBLE_MS or tb >= IMPOSSIBLE_MS:
            continue
        if not _accepted(times[a], times[b], ta, tb, a == b, scale, temperature, state):
            continue
        total += ta - times[a]
        write(route, size, times, of, at, a, new_a, n, ta)
        if a != b:
            total += tb - times[b]
            write(route, size, times, of, at, b, new_b, m, tb)
        if max(ta, tb) > best_most:
            continue
        most = times.max()
        if most < best_most or (most == best_most and total < best_total):
            best_most, best_total = most, total
            _copy(route, size, best_route, best_size)
    _copy(best_route, best_size, route, size)
