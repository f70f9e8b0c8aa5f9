"""One step of many robots on a graph: priority inheritance with backtracking (PIBT).

Okumura, Machida, Defago, Tamura, "Priority inheritance with backtracking for iterative multi-agent
path finding", Artificial Intelligence 310 (2022), with the swap of two robots at a junction from
Okumura, "Improving LaCaM for scalable eventually optimal multi-agent pathfinding" (IJCAI 2023).

In order of priority each robot takes the free neighbour node nearest to its goal. If a robot stands
there, that robot inherits the priority and has to find a place first; if it finds none, the next
neighbour is tried. Rings of robots do not rotate: no robot moves into the node of a robot whose
move depends on it. So the moves of a step can be driven one after the other, each after the one
before it.

A robot's priority grows until it reaches its goal, and only then falls back. Falling back with each
step is a livelock (see the tests).

Robots and nodes are numbers from 0. `near` (nodes, 4) holds the neighbours of each node, -1 where
there is none; `far` (robots, nodes) the steps from each node to each robot's goal. `here`, `there`
and `goals` (robots,) are nodes; `now` and `then` (nodes,) are the robots there before and after the
step, -1 for none. `salt` varies how ties are broken.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit

Ints = NDArray[np.int32]
Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Index = int | np.integer[Any]  # one type to numba
NOWHERE = np.int32(1 << 29)  # farther than any way


@njit(cache=True)
def ways(near: Ints, goals: Ints) -> Ints:
    """Steps from each node to each of the `goals`, (goals, nodes); NOWHERE where there is no way."""
    count = near.shape[0]
    found = np.full((goals.shape[0], count), NOWHERE, np.int32)
    queue = np.empty(count, np.int32)
    for g in range(goals.shape[0]):
        row = found[g]
        row[goals[g]] = 0
        queue[0] = goals[g]
        first, last = 0, 1
        while first < last:
            at = queue[first]
            first += 1
            for k in range(4):
                to = near[at, k]
                if to >= 0 and row[to] == NOWHERE:
                    row[to] = row[at] + 1
                    queue[last] = to
                    last += 1
    return found


def grown(priority: Floats, there: Ints, goals: Ints) -> Floats:
    """Priorities after a step: plus one for robots not at their goal; the whole part is 0 at a
    goal.

    `priority` and the result are (robots,), as are `there` and `goals`. The part behind the point
    stays: it breaks ties, and no two robots have the same.
    """
    after: Floats = np.where(there == goals, priority % 1.0, priority + 1.0)
    return after


@njit(cache=True)
def _chance(salt: int, i: int, node: int) -> float:
    """A number in [0, 1) for robot `i` on a node, the same on every robot."""
    z = np.uint64(salt) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(i) * np.uint64(
        0xBF58476D1CE4E5B9
    )
    z += np.uint64(node) * np.uint64(0x94D049BB133111EB)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((z ^ (z >> np.uint64(31))) >> np.uint64(11)) / 9007199254740992.0


@njit(cache=True)
def _past(
    now: Ints, near: Ints, goals: Ints, pusher_at: Index, puller_at: Index
) -> tuple[int, int]:
    """Where the robot that is pushed can go on to: how many places, and one of them (-1: none)."""
    places, last = 0, -1
    for k in range(4):
        to = near[puller_at, k]
        if to < 0 or to == pusher_at:
            continue
        who = now[to]
        if who >= 0 and goals[who] == to:  # at its goal in a dead end: no way on
            exits = 0
            for q in range(4):
                exits += near[to, q] >= 0
            if exits == 1:
                continue
        places += 1
        last = to
    return places, last


@njit(cache=True)
def _must_swap(
    now: Ints,
    near: Ints,
    far: Ints,
    goals: Ints,
    pusher: int,
    puller: int,
    pusher_at: Index,
    puller_at: Index,
) -> bool:
    """Whether pushing on would only move both along a corridor, until one is past its goal."""
    pusher_at, puller_at = np.int64(pusher_at), np.int64(puller_at)
    for _ in range(near.shape[0]):
        if far[pusher, puller_at] >= far[pusher, pusher_at]:
            break
        places, on = _past(now, near, goals, pusher_at, puller_at)
        if places >= 2:
            return False
        if places == 0:
            break
        pusher_at, puller_at = puller_at, on
    return far[puller, pusher_at] < far[puller, puller_at] and (
        far[pusher, pusher_at] == 0 or far[pusher, puller_at] < far[pusher, pusher_at]
    )


@njit(cache=True)
def _can_swap(now: Ints, near: Ints, goals: Ints, pusher_at: Index, puller_at: Index) -> bool:
    """Whether backing away leads to a place where three ways meet."""
    pusher_at, puller_at = np.int64(pusher_at), np.int64(puller_at)
    first = pusher_at
    for _ in range(near.shape[0]):
        if puller_at == first:
            return False
        places, on = _past(now, near, goals, pusher_at, puller_at)
        if places >= 2:
            return True
        if places == 0:
            return False
        pusher_at, puller_at = puller_at, on
    return False


@njit(cache=True)
def _swaps_with(
    i: int, best: int, here: Ints, there: Ints, now: Ints, near: Ints, far: Ints, goals: Ints
) -> int:
    """The robot to change places with at the next junction; -1: none."""
    at = here[i]
    if best == at:
        return -1
    ahead = now[best]
    if (
        ahead >= 0
        and there[ahead] < 0
        and _must_swap(now, near, far, goals, i, ahead, at, best)
        and _can_swap(now, near, goals, best, at)
    ):
        return ahead
    for k in range(4):  # make room for two that change places here
        to = near[at, k]
        if to < 0 or to == best or now[to] < 0:
            continue
        if _must_swap(now, near, far, goals, now[to], i, at, best) and _can_swap(
            now, near, goals, best, at
        ):
            return now[to]
    return -1


@njit(cache=True)
def _place(
    i: int,
    here: Ints,
    there: Ints,
    now: Ints,
    then: Ints,
    waiting: Flags,
    near: Ints,
    far: Ints,
    goals: Ints,
    salt: int,
    swaps: bool,
) -> bool:
    """Find the next node of robot i; False: it stays, and the asking robot must try another node."""
    at = here[i]
    options, costs = np.empty(5, np.int32), np.empty(5, np.float64)
    options[0], costs[0] = at, far[i, at] + 0.5 * _chance(salt, i, at)
    count = 1
    for k in range(4):
        to = near[at, k]
        if to < 0:
            continue
        cost = far[i, to] + 0.5 * _chance(salt, i, to) + (0.4 if now[to] >= 0 else 0.0)
        n = count
        while n > 0 and costs[n - 1] > cost:
            options[n], costs[n] = options[n - 1], costs[n - 1]
            n -= 1
        options[n], costs[n] = to, cost
        count += 1
    partner = _swaps_with(i, options[0], here, there, now, near, far, goals) if swaps else -1
    if partner >= 0:
        for k in range(count // 2):
            options[k], options[count - 1 - k] = options[count - 1 - k], options[k]
    waiting[i] = True
    for k in range(count):
        to = options[k]
        if then[to] >= 0:
            continue
        other = now[to]
        if other >= 0 and other != i and (waiting[other] or there[other] == at):
            continue
        then[to], there[i] = i, to
        asked = other >= 0 and other != i and there[other] < 0
        if asked and not _place(
            other, here, there, now, then, waiting, near, far, goals, salt, swaps
        ):
            continue
        if k == 0 and partner >= 0 and there[partner] < 0 and then[at] < 0 and to != at:
            there[partner], then[at] = at, partner
        waiting[i] = False
        return True
    then[at], there[i] = i, at
    waiting[i] = False
    return False


@njit(cache=True)
def step(
    here: Ints, order: Ints, there: Ints, near: Ints, far: Ints, goals: Ints, salt: int, swaps: bool
) -> bool:
    """Fill `there` with the next node of each robot; False if there is no such step.

    Nodes that `there` has already are kept, -1 is to be found. `order` (robots,): robots by falling
    priority. `swaps`: whether two robots may change places at a junction.
    """
    count = here.shape[0]
    now, then = np.full(near.shape[0], -1, np.int32), np.full(near.shape[0], -1, np.int32)
    waiting = np.zeros(count, np.bool_)
    for i in range(count):
        now[here[i]] = i
    for i in range(count):
        to = there[i]
        if to < 0:
            continue
        if then[to] >= 0 or (now[to] >= 0 and now[to] != i and there[now[to]] == here[i]):
            return False
        then[to] = i
    for k in range(count):
        i = order[k]
        if there[i] >= 0:
            continue
        found = _place(i, here, there, now, then, waiting, near, far, goals, salt, swaps)
        if not found and then[here[i]] != i:
            return False
    taken = np.full(near.shape[0], -1, np.int32)
    for i in range(count):
        if taken[there[i]] >= 0:
            return False
        taken[there[i]] = i
    for i in range(count):  # reject a rotating ring, because no robot in it could go first
        at, steps = i, 0
        while there[at] != here[at] and now[there[at]] >= 0:
            at = now[there[at]]
            steps += 1
            if at == i or steps > count:
                return False
    return True
