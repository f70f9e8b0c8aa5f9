"""A joint plan for all robots of a jam, from their positions to their goals.

LaCAM (Okumura, "LaCaM: search-based algorithm for quick multi-agent pathfinding", AAAI 2023): a
depth-first search over whole configurations. PIBT generates the next one. If PIBT leads in a
circle, constraints are added robot by robot until every successor has been tried. So the search is
complete: it finds a plan wherever one exists on the lattice, and otherwise says that there is none,
both within `STEPS_MAX` configurations. It is a pure function of its arguments, so all robots
compute the same plan.

The first plan found is seldom a good one. `planned` makes several, shortens each
(`agent/mapf/plan_schedule.py`), and takes the fairest. With many robots that one is made fairer
still (`agent/mapf/lns.py`).

A plan is driven without a common clock. Only each robot's route is kept, and the order in which
robots visit each node: a later robot waits until the one before it has gone on.
"""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.mapf.lns import regroup
from agent.mapf.pibt import NOWHERE, grown, step, ways
from agent.mapf.plan_schedule import Timetable

Ints = NDArray[np.int32]
STEPS_MAX = 20_000  # searched configurations, a few seconds; hard jams of ten take some hundreds
TRIES_MAX = 16  # plans of which one is taken, and
# Robots in all of them: a robot that computes longer than 0.1 s is missed by the others.
TRIED_MAX = 160
PUT_BACK_MAX = 200  # robots in each of them: 0.3 ms each among a hundred, most are never needed
FEW = 10  # robots: the fairest of their tries is good, and waits of more are worth more time than that
TRIED_SALT = 1 << 16  # between the salts of two tries: rounds are counted in 16 bits


class _Configuration:
    """A search state: all robots' nodes, how it was reached, and what is still to be tried."""

    def __init__(
        self, at: Ints, before: "_Configuration | None", priority: NDArray[np.float64]
    ) -> None:
        self.at, self.before, self.priority = at, before, priority
        self.order: Ints = np.argsort(-priority, kind="stable").astype(np.int32)
        self.tree: deque[tuple[tuple[int, int], ...]] = deque([()])  # (robot, node) each


def search(
    near: Ints,
    starts: Sequence[int],
    goals: Sequence[int],
    urgency: Sequence[float],
    salt: int = 0,
    most: int = STEPS_MAX,
    wanted: Sequence[int] | None = None,
) -> list[Ints] | None:
    """Configurations from starts to goals, one step after the other, each (robots,) nodes; None:
    there is no plan, or none was found.

    `near`: the lattice, (nodes, 4). The nodes of `starts` are distinct, and so are those of
    `goals`. `urgency`: a weight for each robot, the greatest goes first, equal ones in their order.
    `salt` varies how ties are broken. `most`: the number of configurations that are searched.
    `wanted`: indices of the robots that must come to their goals, others may end anywhere; None: all.
    """
    first, last = np.array(starts, dtype=np.int32), np.array(goals, dtype=np.int32)
    assert len(set(starts)) == len(starts) and len(set(goals)) == len(goals)
    far = ways(near, last)
    count = len(starts)
    must = np.arange(count) if wanted is None else np.array(wanted, dtype=np.int64)
    if any(far[i, first[i]] == NOWHERE for i in range(count)):
        return None
    # Ties are broken by the longer remaining distance, then by order.
    priority = np.array(urgency, dtype=np.float64)
    priority += far[np.arange(count), first] / (2.0 * len(near) + 1.0)
    root = _Configuration(first, None, priority)
    known = {first.tobytes(): root}
    stack = [root]
    for number in range(most):
        if not stack:
            return None
        here = stack[-1]
        if np.array_equal(here.at[must], last[must]):
            return _steps(here)
        if not here.tree:
            stack.pop()
            continue
        fixed = here.tree.popleft()
        if len(fixed) < count:
            robot = int(here.order[len(fixed)])
            at = int(here.at[robot])
            for node in (at, *(int(n) for n in near[at] if n >= 0)):
                here.tree.append((*fixed, (robot, node)))
        there = _successor(here, fixed, near, far, last, salt + number)
        if there is None:
            continue
        seen = known.get(there.tobytes())
        if seen is not None:
            stack.append(seen)
            continue
        priority = grown(here.priority, there, last)
        new = known[there.tobytes()] = _Configuration(there, here, priority)
        stack.append(new)
    return None


def _successor(
    here: _Configuration,
    fixed: tuple[tuple[int, int], ...],
    near: Ints,
    far: Ints,
    goals: Ints,
    salt: int,
) -> Ints | None:
    for swaps in (True, False):  # changing places may close a ring; without it, it cannot
        there: Ints = np.full(len(here.at), -1, dtype=np.int32)
        for robot, node in fixed:
            there[robot] = node
        if step(here.at, here.order, there, near, far, goals, salt, swaps):
            return there
    return None


def _steps(last: _Configuration) -> list[Ints]:
    steps = []
    at: _Configuration | None = last
    while at is not None:
        steps.append(at.at)
        at = at.before
    return steps[::-1]


def planned(
    near: Ints, starts: Sequence[int], goals: Sequence[int], salt: int = 0
) -> "JointPlan | None":
    """The fairest of up to `TRIES_MAX` plans; None if there is no plan.

    Fairest is the least sum of squared waits, so that no long wait of one robot is paid for with
    short waits of others. The robots that wait long in the best plan so far go first in the next
    try. `near`: the lattice, (nodes, 4). `starts`, `goals`: a node for each robot. `salt` varies
    how ties are broken.
    """
    far = ways(near, np.array(goals, dtype=np.int32))
    free = far[np.arange(len(starts)), starts]
    urgency = np.zeros(len(starts))
    best: tuple[float, JointPlan] | None = None
    most = STEPS_MAX
    for number in range(max(1, min(TRIES_MAX, TRIED_MAX // max(len(starts), 1)))):
        steps = search(near, starts, goals, urgency.tolist(), salt + number * TRIED_SALT, most)
        if steps is None:
            if best is None:
                return None
            continue
        table = Timetable(near, far, goals, JointPlan.of(steps).tracks())
        table.shorten(PUT_BACK_MAX)
        waits = table.arrivals() - free
        cost = float((waits * waits).sum())
        if best is None:
            most = 2 * len(steps) + len(starts)  # a try that leads astray is not worth its time
        if best is None or cost < best[0]:
            best = cost, JointPlan.of(table.steps)
            urgency = waits.astype(np.float64)
    assert best is not None
    if len(starts) <= FEW:
        return best[1]
    table = Timetable(near, far, goals, best[1].tracks())
    regroup(near, far, np.array(goals, dtype=np.int32), table.track, salt)
    return JointPlan.of(table.steps)


class Precedence(NamedTuple):
    """Before a move: this robot must have reached the node with index `node` of its route."""

    robot: int
    node: int


class JointPlan(NamedTuple):
    """Each robot's nodes, and for each node the robots it waits for before it moves there."""

    routes: tuple[tuple[int, ...], ...]
    turns: tuple[tuple[Precedence | None, ...], ...]

    @classmethod
    def of(cls, steps: Sequence[Ints]) -> "JointPlan":
        """The plan of configurations as `search` returns them: (robots,) nodes at each step."""
        count = len(steps[0])
        routes: list[list[int]] = [[] for _ in range(count)]
        turns: list[list[Precedence | None]] = [[] for _ in range(count)]
        # Node -> its last visitor, and the index in that robot's route.
        visitor: dict[int, Precedence] = {}
        for at in steps:
            moved = [i for i in range(count) if not routes[i] or routes[i][-1] != at[i]]
            waits = [visitor.get(int(at[i])) for i in moved]
            for i, wait in zip(moved, waits, strict=True):
                node = int(at[i])
                routes[i].append(node)
                gone = (
                    None
                    if wait is None or wait.robot == i
                    else Precedence(wait.robot, wait.node + 1)
                )
                turns[i].append(gone)
                visitor[node] = Precedence(i, len(routes[i]) - 1)
        return cls(tuple(map(tuple, routes)), tuple(map(tuple, turns)))

    def times(self) -> list[list[int]]:
        """The unit of time at which each robot reaches each node of its route, if every move takes
        one unit."""
        times = [[0] for _ in self.routes]
        pending = [(i, 1) for i, route in enumerate(self.routes) if len(route) > 1]
        while pending:
            late = []
            for i, k in pending:
                own, turns = times[i], self.turns[i]
                while k < len(turns):
                    turn = turns[k]
                    if turn is None:
                        own.append(own[-1] + 1)
                    elif turn.node < len(times[turn.robot]):
                        own.append(max(own[-1], times[turn.robot][turn.node]) + 1)
                    else:
                        late.append((i, k))
                        break
                    k += 1
            assert late != pending, "robots wait for each other in a circle"
            pending = late
        return times

    def tracks(self) -> list[list[int]]:
        """Each robot's node at each unit of time, until the last robot has come to its end."""
        times = self.times()
        units = np.arange(max(own[-1] for own in times) + 1)
        return [
            np.array(route)[np.searchsorted(own, units, side="right") - 1].tolist()
            for route, own in zip(self.routes, times, strict=True)
        ]

    def arrivals(self, goals: Sequence[int]) -> NDArray[np.int64]:
        """The unit of time at which each robot first is at its goal, (robots,)."""
        first = [
            own[route.index(goal)]
            for own, route, goal in zip(self.times(), self.routes, goals, strict=True)
        ]
        return np.array(first, dtype=np.int64)

    def permitted(self, robot: int, reached: Sequence[int]) -> int:
        """The index of the furthest node of its route that a robot may drive to.

        `reached`: the index that each robot has reached in its route.
        """
        index, turns = max(reached[robot], 0), self.turns[robot]
        while index + 1 < len(turns):
            turn = turns[index + 1]
            if turn is not None and reached[turn.robot] < turn.node:
                break
            index += 1
        return index
