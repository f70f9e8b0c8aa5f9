"""Shortens the longest waits in a timetable: groups of robots are removed together and put back.

Large-neighbourhood search (MAPF-LNS, Li et al., IJCAI 2021): the robot that waits longest is
removed with a few robots that are in its way. They are put back one after the other, the waiting
robot first and the others in random order. The result is kept if the sum of the sixth powers of the
group's waits does not grow, so one long wait counts as much as many short ones. Fourth powers leave
1 of 20 crowds with a robot that waits more than three times the median.

A robot at a goal in a doorway may let others pass: a goal once reached stays reached, so the robot
may step aside by at most `ASIDE_MAX` nodes and come back. Nearly all of the longest waits are of
robots with a goal that others cross late.

Whole numbers, with products and sums in a fixed order, give all robots the same timetable.

`near` (nodes, 4), `far` (robots, nodes) and `track` (robots, times + 1) are those of
`agent/mapf/plan_schedule.py`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit
from agent.mapf.plan_schedule import hold

Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Words = NDArray[np.uint64]
Flags = NDArray[np.bool_]
Owners = NDArray[np.int16]
GROUP_MAX = 8  # robots removed together; 4 and 6 get stuck more often, 10 are rarely put back
GROUPS_EACH = 3  # groups for each robot; three times as many save 2 moves of the longest wait of 24
LOOKS_MAX = 40_000_000  # node-time states examined in total, 1 s; a hundred robots take a third
CELLS_MAX = 1 << 22  # nodes times units of time, 60 MB; longer plans are not changed
ASIDE_MAX = 5  # nodes that a robot may step aside from its goal
WALKS = 10  # paths tried to find the robots in the way
PATIENCE = 16  # after this many failed attempts a robot's priority is halved
NOBODY = np.int16(-1)


class TimetableArrays(NamedTuple):
    """A timetable that is being changed, with what its search needs."""

    near: Ints  # (nodes, 4)
    far: Ints  # (robots, nodes)
    goals: Ints  # (robots,)
    track: Ints  # (robots, times + 1)
    owner: Owners  # (times, nodes), the robot that occupies a node in a unit of time, -1 for none
    waits: Longs  # (robots,)
    back: Flags  # (times + 1, nodes), whether a robot there at that time can still end at its goal
    # Nodes within ASIDE_MAX of a goal: those of robot k are round_goals[bounds[k]:bounds[k + 1]].
    round_goals: Longs
    bounds: Longs  # (robots + 1,)
    # Scratch: (nodes * (times + 1),) each, of `heads` (times + 1,).
    came: Ints
    following: Ints
    heads: Ints
    seen: Ints


@njit(cache=True)
def draw(state: Words, below: int) -> np.int64:
    """A whole number from 0 to `below` - 1 (splitmix64), the same on every robot. `state`: (1,)."""
    z = state[0] + np.uint64(0x9E3779B97F4A7C15)
    state[0] = z
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.int64(((z ^ (z >> np.uint64(31))) >> np.uint64(1)) % np.uint64(below))


@njit(cache=True)
def _price(wait: int) -> float:
    """The sixth power of a wait, as a product, which rounds alike on every machine."""
    cube = float(wait) * float(wait) * float(wait)
    return cube * cube


@njit(cache=True)
def _homeward(work: TimetableArrays, robot: int) -> int:
    """Fill `back` for one robot; returns the first time at which it can be at its goal and end
    there.

    Only nodes that are within ASIDE_MAX of its goal are filled.
    """
    near, far, owner, back, goal = (
        work.near, work.far[robot], work.owner, work.back, work.goals[robot]
    )  # fmt: skip
    round_goal = work.round_goals[work.bounds[robot] : work.bounds[robot + 1]]
    end = owner.shape[0]
    for node in round_goal:
        back[end, node] = False
    back[end, goal] = True
    first = end
    for t in range(end - 1, -1, -1):
        some = False
        for node in round_goal:
            home = False
            if owner[t, node] < 0:
                home = back[t + 1, node]
                for side in range(4):
                    to = near[node, side]
                    if to >= 0 and far[to] <= ASIDE_MAX and back[t + 1, to] and owner[t, to] < 0:
                        home = True
            back[t, node] = home
            some = some or home
        if not some:
            break
        if back[t, goal]:
            first = t
    return first


@njit(cache=True)
def _reach(work: TimetableArrays, robot: int, first: int, most: int) -> tuple[int, int]:
    """The first time at which a robot can be at its goal and end there, and the number of looks
    taken.

    It waits at most `most`; the time is -1 if it cannot. The search goes by rising wait. A node at
    a time has one wait only: the time so far plus the steps to go, less the steps from the start.
    So each is looked at once.
    """
    near, far, owner, back = work.near, work.far[robot], work.owner, work.back
    came, following, heads, seen = work.came, work.following, work.heads, work.seen
    end, nodes = owner.shape[0], near.shape[0]
    start, goal = work.track[robot, 0], work.goals[robot]
    heads[: most + 1] = -1
    heads[0] = seen[0] = came[start] = start
    following[start] = -1
    found, looks = -1, 1
    for wait in range(most + 1):
        while heads[wait] >= 0 and found < 0:
            cell = heads[wait]
            heads[wait] = following[cell]
            t = cell // nodes
            at = cell - t * nodes
            if at == goal and t >= first and back[t, goal]:
                found = t
            if t == end or owner[t, at] >= 0:
                continue
            for side in range(5):
                to = near[at, side] if side < 4 else at
                if to < 0 or owner[t, to] >= 0:
                    continue
                later = t + 1 + far[to] - far[start]
                then = (t + 1) * nodes + to
                if later > most or came[then] >= 0:
                    continue
                came[then], following[then], heads[later] = at, heads[later], then
                seen[looks] = then
                looks += 1
        if found >= 0:
            break
    return found, looks


@njit(cache=True)
def _put_back(work: TimetableArrays, robot: int, most: int) -> tuple[int, int]:
    """Put one robot back so that it waits at most `most`.

    Returns the time at which it is at its goal, -1 if there is no such path, and the number of
    looks taken.
    """
    near, far, track, owner = work.near, work.far[robot], work.track, work.owner
    back, came, seen, goal = work.back, work.came, work.seen, work.goals[robot]
    end, nodes, start = owner.shape[0], near.shape[0], track[robot, 0]
    most = min(most, end - far[start])
    if most < 0:
        return -1, 0
    first = _homeward(work, robot)
    if first > far[start] + most:
        return -1, 0
    found, looks = _reach(work, robot, first, most)
    if found >= 0:
        at = goal
        for t in range(found, -1, -1):
            track[robot, t] = at
            at = came[t * nodes + at]
        at = goal
        for t in range(found, end):  # as near to the goal as can be
            best = at if back[t + 1, at] else -1
            for side in range(4):
                to = near[at, side]
                if to < 0 or far[to] > ASIDE_MAX or not back[t + 1, to] or owner[t, to] >= 0:
                    continue
                if best < 0 or far[to] < far[best]:
                    best = to
            track[robot, t + 1] = at = best
    for k in range(looks):
        came[seen[k]] = -1
    return found, looks


@njit(cache=True)
def _in_the_way(
    work: TimetableArrays, robot: int | np.integer[Any], group: Ints, size: int, state: Words
) -> int:
    """Fill `group` with the robot and those it meets on paths with less waiting; returns how many."""
    near, far, track, owner = work.near, work.far[robot], work.track, work.owner
    end, count, goal = owner.shape[0], 1, work.goals[robot]
    group[0] = robot
    visit = far[track[robot, 0]] + work.waits[robot]
    for _ in range(WALKS):
        t = draw(state, visit)
        at = track[robot, t]
        while t < end and count < size:
            to = at
            if at != goal:  # a random neighbour from which it would still arrive earlier
                choices = 0
                for side in range(5):
                    other = near[at, side] if side < 4 else at
                    if other >= 0 and t + 1 + far[other] < visit:
                        choices += 1
                        if draw(state, choices) == 0:
                            to = other
                if choices == 0:
                    break
            for node in (to, at):
                who = np.int32(owner[t, node])
                if who >= 0 and not (group[:count] == who).any() and count < size:
                    group[count] = who
                    count += 1
            at = to
            t += 1
    return count


@njit(cache=True)
def _regroup(work: TimetableArrays, group: Ints) -> tuple[int, int]:
    """Put the robots of a group back in their order.

    Returns whether the result was kept (1: it is better, 0: as good, -1: no), and the number of
    looks taken.
    """
    track, owner, waits = work.track, work.owner, work.waits
    before = track[group]
    cost = 0.0
    for robot in group:
        cost += _price(waits[robot])
        hold(owner, track, robot, NOBODY)
    spent, done, looks = 0.0, 0, 0
    got = np.empty(len(group), np.int64)
    for robot in group:
        most = 0
        while most < owner.shape[0] and spent + _price(most + 1) <= cost:
            most += 1
        found, looked = _put_back(work, robot, most)
        looks += looked
        if found < 0:
            break
        got[done] = found - work.far[robot, track[robot, 0]]
        spent += _price(got[done])
        hold(owner, track, robot, robot)
        done += 1
    if done == len(group):
        waits[group] = got
        return (1 if spent < cost else 0), looks
    for k in range(done):
        hold(owner, track, group[k], NOBODY)
    for k in range(len(group)):
        track[group[k]] = before[k]
    for robot in group:
        hold(owner, track, robot, robot)
    return -1, looks


@njit(cache=True)
def _regrouped(work: TimetableArrays, groups: int, state: Words) -> None:
    """Remove and put back groups round the robots that wait longest, until enough were tried."""
    waits, count, looks = work.waits, work.track.shape[0], 0
    vain = np.zeros(count, np.int64)
    group = np.empty(count, np.int32)
    for _ in range(groups):
        robot = np.argmax(waits * 1024 * PATIENCE // (PATIENCE + vain))
        if waits[robot] == 0 or looks > LOOKS_MAX:
            return
        size = min(2 + draw(state, GROUP_MAX - 1), count)
        size = _in_the_way(work, robot, group, size, state)
        for k in range(1, size):
            other = k + draw(state, size - k)
            group[k], group[other] = group[other], group[k]
        kept, looked = _regroup(work, group[:size])
        looks += looked
        vain[robot] += 1
        if kept > 0:
            vain[:] = 0


def regroup(near: Ints, far: Ints, goals: Ints, track: Ints, salt: int) -> None:
    """Make waits in a timetable short, above all the long ones; `track` is changed in place.

    `near`: the lattice, (nodes, 4). `far`: (robots, nodes), steps to each robot's goal. `track`:
    (robots, times + 1), each robot's node, at its goal in the end; a move takes both its nodes.
    `goals`: (robots,). `salt` seeds the choice of groups.
    """
    count, times = track.shape
    nodes = len(near)
    if times < 2 or times * nodes > CELLS_MAX:
        return
    owner = np.full((times - 1, nodes), NOBODY, dtype=np.int16)
    for robot in range(count):
        hold(owner, track, robot, robot)
    waits = (track == goals[:, None]).argmax(axis=1) - far[np.arange(count), track[:, 0]]
    back = np.zeros((times, nodes), dtype=np.bool_)
    round_goals = [np.flatnonzero(row <= ASIDE_MAX) for row in far]
    bounds = np.cumsum([0, *map(len, round_goals)])
    came, following, seen = (np.full(times * nodes, -1, dtype=np.int32) for _ in range(3))
    work = TimetableArrays(
        near, far, goals, track, owner, waits, back, np.concatenate(round_goals), bounds,
        came, following, np.empty(times + 1, dtype=np.int32), seen,
    )  # fmt: skip
    _regrouped(work, GROUPS_EACH * count, np.array([salt], dtype=np.uint64))
