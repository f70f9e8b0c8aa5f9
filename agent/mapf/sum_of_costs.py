"""Plans of many robots with a small sum of costs: standard MAPF, one unit of time for each move.

The cost of a robot is the time from which on it stays at its goal (Stern et al., "Multi-agent
pathfinding: definitions, variants, and benchmarks", SoCS 2019). Two robots are never in one node,
and never change places. A robot may move into the node that another one leaves in the same unit of
time, which `agent/mapf/plan_schedule.py` does not allow; so these plans are shorter, and need
drivers that follow closely.

`search` of `agent/mapf/lacam.py` finds a plan. Then groups of robots are removed together and put
back on their earliest paths, in random order (MAPF-LNS, Li et al., IJCAI 2021). The result is kept
if the sum of their costs does not grow. Whole numbers and a generator of our own give all peers the
same plan.

`near` (nodes, 4) holds the neighbours of each node, -1 where there is none. `far` (robots, nodes)
holds the steps to each robot's goal. `track` (robots, times) is each robot's node at each time, at
its goal in the end. `owner` (times, nodes) is the robot in each node, -1 for none.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit
from agent.mapf.lacam import search
from agent.mapf.lns import draw
from agent.mapf.pibt import NOWHERE, ways

Ints = NDArray[np.int32]
Owners = NDArray[np.int16]
Words = NDArray[np.uint64]
GROUP_MAX = 16  # robots removed together; 8 and 32 end with longer plans after as many looks
GROUPS_EACH = 40  # groups for each robot; twice as many save less than 1 % of the sum
LOOKS_MAX = 20_000_000  # node-time states examined in total, about 1 s
CELLS_MAX = 1 << 23  # nodes times units of time, 70 MB; longer plans are not changed
SALT_OF_TRIES = 1 << 16  # between the salts of two tries
TRIES_MAX = 4  # searches with different ties; the first one that ends is taken
NOBODY = np.int16(-1)


class _Table(NamedTuple):
    """A plan that is being changed, with what its search needs."""

    near: Ints
    far: Ints
    goals: Ints  # (robots,)
    track: Ints
    owner: Owners
    ends: Ints  # (robots,), the time from which on each is at its goal
    came: Ints  # scratch: (nodes * times,) each, of `heads` (times + 1,)
    following: Ints
    heads: Ints
    seen: Ints


@njit(cache=True)
def _write(table: _Table, robot: int, who: np.int16) -> None:
    """Write `who` into the nodes of one robot at every time."""
    for t in range(table.track.shape[1]):
        table.owner[t, table.track[robot, t]] = who


@njit(cache=True)
def _put_back(table: _Table, robot: int, latest: int) -> tuple[int, int]:
    """Put a robot on its earliest path among the others, at its goal for good by `latest`.

    Returns that time, -1 if there is no such path, and the number of looks taken. The search goes by
    rising wait: a node at a time has one wait only, so each is looked at once.
    """
    near, far, owner, track = table.near, table.far[robot], table.owner, table.track
    came, following, heads, seen = table.came, table.following, table.heads, table.seen
    last, nodes = owner.shape[0] - 1, near.shape[0]
    start, goal = track[robot, 0], table.goals[robot]
    most = min(latest, last) - far[start]
    if most < 0:
        return -1, 0
    free_from = last + 1
    while free_from > 0 and owner[free_from - 1, goal] < 0:
        free_from -= 1
    if free_from > latest:
        return -1, 0
    heads[: most + 1] = -1
    heads[0] = seen[0] = start
    came[start], following[start] = start, -1
    found, looks = -1, 1
    for wait in range(most + 1):
        while heads[wait] >= 0 and found < 0:
            cell = heads[wait]
            heads[wait] = following[cell]
            t = cell // nodes
            at = cell - t * nodes
            if at == goal and t >= free_from:
                found = t
            if t == last:
                continue
            for side in range(5):
                to = near[at, side] if side < 4 else at
                if to < 0 or owner[t + 1, to] >= 0:
                    continue
                who = owner[t, to]
                if who >= 0 and owner[t + 1, at] == who:
                    continue  # they would change places
                later = t + 1 + far[to] - far[start]
                then = (t + 1) * nodes + to
                if later > most or came[then] >= 0:
                    continue
                came[then], following[then], heads[later] = at, heads[later], then
                seen[looks] = then
                looks += 1
        if found >= 0:
            break
    if found >= 0:
        at = goal
        for t in range(found, -1, -1):
            track[robot, t] = at
            at = came[t * nodes + at]
        track[robot, found:] = goal
    for k in range(looks):
        came[seen[k]] = -1
    return found, looks


@njit(cache=True)
def _group(table: _Table, group: Ints, size: int, state: Words) -> int:
    """Fill `group` with robots that probably hinder each other; returns how many.

    By turns: the robots met by one that waits on random ways that take no longer, or the ones that
    pass near a random robot's node at one time.
    """
    near, far, track, owner, ends = table.near, table.far, table.track, table.owner, table.ends
    count, last = track.shape[0], owner.shape[0] - 1
    robot = draw(state, count)
    for _ in range(4):  # the one of five that waits longest
        other = draw(state, count)
        if ends[other] - far[other, track[other, 0]] > ends[robot] - far[robot, track[robot, 0]]:
            robot = other
    group[0], found = robot, 1
    for _ in range(4 * size):
        if found == size:
            break
        t = draw(state, max(ends[robot], 1))
        at = track[robot, t]
        while t < last and found < size:
            to, choices = at, 0
            for side in range(5):
                other = near[at, side] if side < 4 else at
                if other >= 0 and t + 1 + far[robot, other] <= ends[robot]:
                    choices += 1
                    if draw(state, choices) == 0:
                        to = other
            if choices == 0:
                break
            t += 1
            for node in (to, at):
                who = np.int32(owner[t, node])
                if who >= 0 and not (group[:found] == who).any() and found < size:
                    group[found] = who
                    found += 1
            at = to
    return found


@njit(cache=True)
def _regroup(table: _Table, group: Ints) -> tuple[bool, int]:
    """Put the robots of a group back in their order. Returns whether the result is better or as
    good, and so was kept, and the number of looks taken."""
    track, ends = table.track, table.ends
    before, old = track[group], ends[group]
    left = 0
    for robot in group:
        left += ends[robot]
        _write(table, robot, NOBODY)
    for robot in group:
        left -= table.far[robot, track[robot, 0]]
    done, looks = 0, 0
    for robot in group:  # `left`: waits that may still be spent
        shortest = table.far[robot, track[robot, 0]]
        found, looked = _put_back(table, robot, shortest + left)
        looks += looked
        if found < 0:
            break
        left -= found - shortest
        ends[robot] = found
        _write(table, robot, np.int16(robot))
        done += 1
    if done == len(group):
        return True, looks
    for k in range(done):
        _write(table, group[k], NOBODY)
    for k in range(len(group)):
        track[group[k]], ends[group[k]] = before[k], old[k]
    for robot in group:
        _write(table, robot, np.int16(robot))
    return False, looks


@njit(cache=True)
def _improve(table: _Table, groups: int, state: Words) -> None:
    """Remove and put back groups until enough were tried, or nothing waits."""
    count, looks = table.track.shape[0], 0
    group = np.empty(count, np.int32)
    for _ in range(groups):
        if looks > LOOKS_MAX:
            return
        size = min(2 + draw(state, GROUP_MAX - 1), count)
        size = _group(table, group, size, state)
        for k in range(size - 1):
            other = k + draw(state, size - k)
            group[k], group[other] = group[other], group[k]
        _, looked = _regroup(table, group[:size])
        looks += looked


def costs(track: Ints, goals: Ints) -> NDArray[np.int64]:
    """The time from which on each robot stays at its goal, (robots,).

    `track`: (robots, times), `goals`: (robots,), both of nodes."""
    away = track[:, ::-1] != goals[:, None]
    times: NDArray[np.int64] = np.where(away.any(axis=1), track.shape[1] - away.argmax(axis=1), 0)
    return times


def planned(near: Ints, starts: Sequence[int], goals: Sequence[int], salt: int = 0) -> Ints | None:
    """The node of each robot at each time, (robots, times); None: there is no plan, or none was
    found.

    The nodes of `starts` are distinct, and so are those of `goals`. `salt` varies how ties are
    broken. It is a pure function of its arguments, so all peers compute the same plan.
    """
    if not starts:
        return np.empty((0, 1), dtype=np.int32)
    ends = np.array(goals, dtype=np.int32)
    far = ways(near, ends)
    shortest = far[np.arange(len(starts)), starts]
    if (shortest >= NOWHERE).any():
        return None
    steps = None
    for number in range(TRIES_MAX):
        steps = search(near, starts, goals, shortest.tolist(), salt + number * SALT_OF_TRIES)
        if steps is not None:
            break
    if steps is None:
        return None
    track = np.ascontiguousarray(np.array(steps, dtype=np.int32).T)
    nodes, times = len(near), track.shape[1]
    if nodes * times > CELLS_MAX or times == 1:
        return track
    owner = np.full((times, nodes), NOBODY, dtype=np.int16)
    for robot, row in enumerate(track):
        owner[np.arange(times), row] = robot
    came, following, seen = (np.full(times * nodes, -1, dtype=np.int32) for _ in range(3))
    table = _Table(
        near, far, ends, track, owner, costs(track, ends).astype(np.int32), came, following,
        np.empty(times + 1, dtype=np.int32), seen,
    )  # fmt: skip
    _improve(table, GROUPS_EACH * len(starts), np.array([salt], dtype=np.uint64))
    return np.ascontiguousarray(track[:, : int(costs(track, ends).max()) + 1])
