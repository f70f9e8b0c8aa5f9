"""The timetable of a joint plan: which robot is on which node when, and its improvement by
reinsertion.

A move takes one unit of time and occupies both of its nodes for that time, so no robot follows
another closely. A timetable is therefore one way to run the plan's order, and so is every other
timetable in which no two robots occupy one node.

To improve a timetable, one robot at a time is removed and put back on its earliest path to its goal
among the others: a search in space and time, as in cooperative A* (Silver, AIIDE 2005), repeated
for a whole plan as in MAPF-LNS (Li et al., IJCAI 2021). No robot ever arrives later because of it.

`near` (nodes, 4) holds the neighbours of each node, -1 where there is none. `track` (robots, times
+ 1) holds the node of each robot at each unit of time. `taken` (times, nodes) says of a node in the
unit of time from t to t + 1 what `hold` was told.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit

Ints = NDArray[np.int32]
Flags = NDArray[np.bool_]
CELLS_MAX = 1 << 23  # nodes times units of time, 40 MB; longer plans are not shortened


@njit(cache=True)
def hold(taken: NDArray[Any], track: Ints, robot: int, held: bool | int | np.generic) -> None:
    """Write `held` to the nodes of one robot, for every unit of time in which it is on them."""
    for t in range(taken.shape[0]):
        taken[t, track[robot, t]] = held
        taken[t, track[robot, t + 1]] = held


@njit(cache=True)
def _earliest(
    start: int,
    goal: int,
    near: Ints,
    far: Ints,
    taken: Flags,
    came: Ints,
    layer: Ints,
    coming: Ints,
    latest: int,
) -> int:
    """The first time, at most `latest`, from which on the robot can be at its goal; -1: none.

    `came`: (times + 1, nodes), the node before each node that was reached, -1 for the others; the
    caller clears it. `far`: (nodes,), steps to the goal. `layer`, `coming`: (nodes,), scratch.
    """
    free_from = taken.shape[0]
    while free_from > 0 and not taken[free_from - 1, goal]:
        free_from -= 1
    if free_from > latest or far[start] > latest:
        return -1
    came[0, start], layer[0], count = start, start, 1
    for t in range(latest):
        if t >= free_from and came[t, goal] >= 0:
            return t
        found = 0
        for k in range(count):  # staying comes first, so robots wait before a gap, not inside it
            at = layer[k]
            if not taken[t, at] and t + 1 + far[at] <= latest:
                came[t + 1, at], coming[found] = at, at
                found += 1
        for k in range(count):
            at = layer[k]
            if taken[t, at]:
                continue
            for side in range(4):
                to = near[at, side]
                if to < 0 or taken[t, to] or came[t + 1, to] >= 0 or t + 1 + far[to] > latest:
                    continue
                came[t + 1, to], coming[found] = at, to
                found += 1
        count = found
        for k in range(count):
            layer[k] = coming[k]
        if count == 0:
            return -1
    return latest if came[latest, goal] >= 0 and latest >= free_from else -1


@njit(cache=True)
def _put_back(
    robot: int,
    goal: int,
    near: Ints,
    far: Ints,
    track: Ints,
    taken: Flags,
    came: Ints,
    layer: Ints,
    coming: Ints,
    latest: int,
) -> bool:
    """Find a path on which one robot is at its goal by `latest`; False: its path stays as it is."""
    hold(taken, track, robot, np.bool_(False))  # numba would compile `hold` twice for a literal
    came[: latest + 1] = -1
    end = _earliest(track[robot, 0], goal, near, far, taken, came, layer, coming, latest)
    if end >= 0:
        at = goal
        for t in range(end, -1, -1):
            track[robot, t] = at
            at = came[t, at]
        track[robot, end:] = goal
    hold(taken, track, robot, np.bool_(True))
    return end >= 0


class Timetable:
    """The tracks of all robots of a joint plan, which it can shorten in place."""

    def __init__(
        self, near: Ints, far: Ints, goals: Sequence[int], tracks: Sequence[Sequence[int]]
    ) -> None:
        """`far`: (robots, nodes), steps to each robot's goal. `tracks`: each robot's node at each
        unit of time, from 0 on, all as long."""
        self.near, self.far, self.goals = near, far, list(goals)
        self.track: Ints = np.array(tracks, dtype=np.int32)
        self._taken = np.zeros((self.track.shape[1] - 1, len(near)), dtype=np.bool_)
        for robot in range(len(self.track)):
            hold(self._taken, self.track, robot, True)

    def arrivals(self) -> NDArray[np.int64]:
        """The unit of time at which each robot first is at its goal, (robots,)."""
        there = self.track == np.array(self.goals, dtype=np.int32)[:, None]
        found: NDArray[np.int64] = there.argmax(axis=1)
        return found

    def shorten(self, most: int) -> None:
        """Put robots back, the longest-waiting first, until `most` were or no robot gains by it."""
        if self.track.size == 0 or self._taken.size > CELLS_MAX:
            return
        nodes = len(self.near)
        came = np.full((self.track.shape[1], nodes), -1, dtype=np.int32)
        layer, coming = np.empty(nodes, dtype=np.int32), np.empty(nodes, dtype=np.int32)
        tried = set[int]()  # robots tried since the last improvement
        for _ in range(most):
            arrived = self.arrivals()
            waits = arrived - self.far[np.arange(len(self.track)), self.track[:, 0]]
            waits[list(tried)] = 0
            robot = int(waits.argmax())
            if waits[robot] == 0:
                return
            gained = _put_back(
                robot, self.goals[robot], self.near, self.far[robot], self.track, self._taken,
                came, layer, coming, int(arrived[robot]) - 1,
            )  # fmt: skip
            tried = {robot} if gained else tried | {robot}

    @property
    def steps(self) -> list[Ints]:
        """The node of each robot, (robots,), at each unit of time, until the last of them has
        moved."""
        moves = (self.track[:, 1:] != self.track[:, :-1]).any(axis=0)
        last = int(np.flatnonzero(moves)[-1]) + 1 if moves.any() else 0
        return [np.ascontiguousarray(self.track[:, t]) for t in range(last + 1)]
