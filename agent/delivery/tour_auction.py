"""Assigns tasks to robots: an auction that all peers compute alike, insertion, and local search.

The auction uses whole numbers and fixed tie-breaking, so equal knowledge gives equal itineraries
without a frame. The search that follows has the peer's own seed. So peers find different plans, and
the cheapest is adopted (`agent/delivery/plan_negotiation.py`). The search is simulated annealing
(Kirkpatrick, Gelatt and Vecchi 1983). Its moves are segments of up to three tasks and whole tails,
towards the neighbours that cost least. docs/measured/delivery.md compares it with a reference solver.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from agent.delivery.routing_kernels import (
    WorkArrays,
    auction,
    best_place,
    search,
    span,
    walk,
)
from agent.delivery.routing_problem import (
    IMPOSSIBLE_MS,
    Itineraries,
    PlanCost,
    Power,
    Whole,
    Workload,
)
from agent.delivery.waiting_kernels import shorten_waiting

NEAR = 24  # candidate predecessors of a task: the cheapest links
HEADS = 4  # candidate robots for which it may be the first task
# Temperatures as shares of the mean route. A move that costs this much more is accepted two times
# in five.
HOT, COLD = 0.02, 0.0002
NO_BAY = np.zeros((1, 1), dtype=np.int64)
NO_POWER = Power(
    0, 0, 0.0, NO_BAY[0], NO_BAY, NO_BAY, NO_BAY[0], NO_BAY, NO_BAY, NO_BAY, NO_BAY, NO_BAY, NO_BAY,
)  # fmt: skip


class RoutingPlanner:
    """A workload in the form that the kernels take. Plans are lists of task indices, one for each
    robot.
    """

    def __init__(self, work: Workload) -> None:
        self.work = work
        power = work.power
        self._arrays = WorkArrays(
            work.ready, work.lead, work.link, power or NO_POWER, power is not None
        )

    # ---------------------------------------------------------------- reading

    def span_ms(self, robot: int, tasks: Sequence[int]) -> int:
        """When a robot finishes its tasks, charging included, milliseconds from now.

        `robot`, `tasks`: indices in the workload. The result is `IMPOSSIBLE_MS` or more if its
        battery would be empty.
        """
        seq = np.array(tasks, dtype=np.int64)
        return int(span(robot, seq, len(seq), self._arrays))

    def worth(self, plan: Itineraries) -> PlanCost:
        """The cost of a plan: the last finish, then the sum of all finishes."""
        spans = [self.span_ms(robot, tasks) for robot, tasks in enumerate(plan)]
        return PlanCost(max(spans, default=0), sum(spans))

    def waiting_ms(self, plan: Itineraries) -> int:
        """The total time from now until each task is delivered, milliseconds."""
        return sum(
            int(walk(r, np.array(own, dtype=np.int64), len(own), self._arrays)[1])
            for r, own in enumerate(plan)
        )

    # ---------------------------------------------------------------- deciding

    def auctioned(
        self, held: Itineraries | None = None, free: Sequence[int] | None = None
    ) -> Itineraries:
        """Assign every free task to the robot that would finish it first, the cheapest bid first.

        It is a sequential single-item auction (Koenig et al. 2006). `held`: itineraries to extend;
        None: empty ones. `free`: tasks to assign; None: all. A task that no robot's battery can do
        is left out.
        """
        held = [[] for _ in range(self.work.robots)] if held is None else held
        free = range(self.work.tasks) if free is None else free
        route, size = self._packed(held, sum(map(len, held)) + len(free))
        auction(route, size, np.array(sorted(free), dtype=np.int64), self._arrays)
        return _unpacked(route, size)

    def inserted(
        self, robot: int, tasks: Sequence[int], task: int, first: int = 0
    ) -> tuple[int, int]:
        """The best position of a task in a robot's itinerary and its cost: the bid of scenario B.

        The cost is how much longer all tasks of the itinerary wait in sum, the new one from now on,
        in milliseconds. `first`: the lowest position that is allowed.
        """
        seq = np.array(tasks, dtype=np.int64)
        out = np.empty(len(seq) + 1, dtype=np.int64)
        cost, place = best_place(robot, seq, len(seq), task, first, True, self._arrays, out)
        return int(place), int(cost)

    def improved(
        self, plan: Itineraries, seed: int, moves: int, heat: tuple[float, float] = (HOT, COLD)
    ) -> Itineraries:
        """The best plan that `moves` steps of simulated annealing find from `plan`; never worse
        than it.

        `heat`: first and last temperature, as shares of the mean route. The same seed gives the
        same plan. A plan that is not feasible is returned as it is.
        """
        placed = sum(map(len, plan))
        if (
            placed < 1
            or self.work.robots < 1
            or any(self.span_ms(r, tasks) >= IMPOSSIBLE_MS for r, tasks in enumerate(plan))
        ):
            return [list(tasks) for tasks in plan]
        route, size = self._packed(plan, placed)
        search(route, size, self._near, moves, heat[0], heat[1], _dice(seed), self._arrays)
        return _unpacked(route, size)

    def hastened(self, plan: Itineraries, seed: int, moves: int) -> Itineraries:
        """A plan with less total waiting time and no later last finish.

        It is found by `moves` steps, each from the plan before. The same seed gives the same plan.
        """
        placed = sum(map(len, plan))
        if placed < 2 or self.worth(plan).makespan_ms >= IMPOSSIBLE_MS:
            return [list(tasks) for tasks in plan]
        route, size = self._packed(plan, placed)
        shorten_waiting(route, size, self._near, moves, _dice(seed), self._arrays)
        return _unpacked(route, size)

    @cached_property
    def _near(self) -> Whole:
        """(tasks, n): the tasks (or tasks + robot for the head of its route) that a task follows
        most cheaply.
        """
        link = self.work.link.astype(np.float64)
        np.fill_diagonal(link, np.inf)
        tasks, count = len(link), min(NEAR, len(link) - 1)
        before = np.argsort(link, axis=0, kind="stable")[:count].T
        heads = min(HEADS, self.work.robots)
        first = np.argsort(self.work.lead, axis=0, kind="stable")[:heads].T + tasks
        return np.ascontiguousarray(np.concatenate((before, first), axis=1), dtype=np.int64)

    def _packed(self, plan: Itineraries, room: int) -> tuple[Whole, Whole]:
        route = np.zeros((self.work.robots, max(room, 1) + 1), dtype=np.int64)
        size = np.zeros(self.work.robots, dtype=np.int64)
        for robot, tasks in enumerate(plan):
            route[robot, : len(tasks)] = tasks
            size[robot] = len(tasks)
        return route, size


def _dice(seed: int) -> NDArray[np.uint64]:
    return np.array([(seed * 2 + 1) * 0x9E3779B97F4A7C15 & (1 << 64) - 1], dtype=np.uint64)


def _unpacked(route: Whole, size: Whole) -> Itineraries:
    return [route[robot, :count].tolist() for robot, count in enumerate(size.tolist())]
