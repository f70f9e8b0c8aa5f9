"""Tasks that arrive one by one, robots without congestion: how long a task waits to be delivered.

Policies decide when a task arrives, nobody is interrupted. Ours is the bid of
`agent/delivery/tour_auction.py` in the hands of all robots, and at the times of
`agent/delivery/waiting_policy.py` what one of them finds in a round; the mission's is the
insertion of least extra travel.
"""

from collections.abc import Callable, Sequence
from random import Random

import numpy as np

from agent.delivery.plan_negotiation import SLICE_MOVES_HASTE, SLICE_US, worth_streaming
from agent.delivery.routing_problem import Workload
from agent.delivery.tour_auction import RoutingPlanner
from agent.delivery.waiting_policy import REPLAN_US, WaitingPolicy
from agent.interface.config import MS
from tools.bench.routing_opponents import bound_ms

Plan = list[list[int]]
# Puts a task into a plan, at this time in ms.
Policy = Callable[[RoutingPlanner, Plan, int, int], None]
MOVES = REPLAN_US // SLICE_US * SLICE_MOVES_HASTE  # of a round


class LeastWaiting:
    """Ours. `rounds`: with rounds that make planned tasks wait less."""

    def __init__(self, rounds: bool = True) -> None:
        self.haste, self.rounds = WaitingPolicy(0), rounds
        self.added = 0

    def __call__(self, planner: RoutingPlanner, plan: Plan, task: int, now_ms: int) -> None:
        now_us = now_ms * MS
        self.haste.known(task, now_us)
        self.added += 1
        held = [self.haste.held(own, now_us) for own in plan]
        bids = [(planner.inserted(r, own, task, held[r]), r) for r, own in enumerate(plan)]
        (place, _), robot = min(bids, key=lambda bid: (bid[0][1], bid[1]))
        plan[robot].insert(place, task)
        waiting = sum(map(len, plan))
        if self.rounds and self.haste.due(now_us, self.added, waiting, len(plan)):
            self.haste.planned(now_us, self.added)
            plan[:] = hastened(planner, plan, held, self.added)


def hastened(planner: RoutingPlanner, plan: Plan, held: Sequence[int], seed: int) -> Plan:
    """What comes behind the first `held` tasks of each itinerary planned better."""
    work = planner.work
    tasks = sorted(task for own, first in zip(plan, held, strict=True) for task in own[first:])
    ready, lead = work.ready.copy(), work.lead[:, tasks]
    for robot, (own, first) in enumerate(zip(plan, held, strict=True)):
        if first:
            ready[robot] = planner.span_ms(robot, own[:first])
            lead[robot] = work.link[own[first - 1], tasks]
    link = np.ascontiguousarray(work.link[np.ix_(tasks, tasks)])
    rest = RoutingPlanner(Workload(ready, np.ascontiguousarray(lead), link))
    rows = [[tasks.index(t) for t in own[first:]] for own, first in zip(plan, held, strict=True)]
    found = rest.hastened(rows, seed, MOVES)
    if not worth_streaming(rest.waiting_ms(rows), rest.waiting_ms(found)):
        return plan
    return [
        own[:first] + [tasks[k] for k in row]
        for own, first, row in zip(plan, held, found, strict=True)
    ]


def least_travel(planner: RoutingPlanner, plan: Plan, task: int, now_ms: int) -> None:
    """The mission's scenario B: the place where the itinerary becomes longer by the least."""
    best = (1 << 60, 0, 0)
    for robot, own in enumerate(plan):
        before = planner.span_ms(robot, own)
        for place in range(len(own) + 1):
            after = planner.span_ms(robot, [*own[:place], task, *own[place:]])
            best = min(best, (after - before, robot, place))
    plan[best[1]].insert(best[2], task)


def arrivals(work: Workload, load: float, rng: Random) -> list[int]:
    """Milliseconds. `load`: 1 where tasks arrive as fast as the bound on plans says they can be done."""
    last_ms = bound_ms(work) / load
    return sorted(round(rng.uniform(0, last_ms)) for _ in range(work.tasks))


def latency_s(work: Workload, at_ms: Sequence[int], policy: Policy) -> float:
    """The mean of arrival to delivery."""
    plan: Plan = [[] for _ in range(work.robots)]
    last = [-1] * work.robots  # the task whose dropoff the robot is at, or on its way to
    free_ms = [0] * work.robots  # when it is there
    done_ms: dict[int, int] = {}

    def start_until(now_ms: int) -> None:
        for robot, own in enumerate(plan):
            while own and free_ms[robot] <= now_ms:
                task = own.pop(0)
                way = work.lead[robot, task] if last[robot] < 0 else work.link[last[robot], task]
                free_ms[robot] = max(free_ms[robot], 0) + int(way)
                done_ms[task] = free_ms[robot]
                last[robot] = task

    for task, now_ms in enumerate(at_ms):
        start_until(now_ms)
        for robot, own in enumerate(plan):
            if not own:  # a robot without a task has waited
                free_ms[robot] = max(free_ms[robot], now_ms)
        lead = np.stack(
            [work.lead[r] if last[r] < 0 else work.link[last[r]] for r in range(work.robots)]
        )
        ready = np.array([free - now_ms for free in free_ms], dtype=np.int64)
        policy(RoutingPlanner(Workload(ready, lead, work.link)), plan, task, now_ms)
    start_until(1 << 60)
    return sum(done_ms[task] - now_ms for task, now_ms in enumerate(at_ms)) / 1000 / work.tasks
