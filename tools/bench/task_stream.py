"""Tasks that arrive one by one, robots without congestion: how long a task waits to be delivered.

Policies decide when a task arrives, nobody is interrupted. Ours is the bid of `agent/auction.py` in the
hands of all robots; the mission's is the insertion of least extra travel.
"""

from collections.abc import Callable, Sequence
from random import Random

import numpy as np

from agent.auction import Planner
from agent.workload import Workload
from tools.bench.routing_opponents import bound_ms

Policy = Callable[[Planner, list[list[int]], int], tuple[int, int]]  # robot, place


def least_waiting(planner: Planner, plan: list[list[int]], task: int) -> tuple[int, int]:
    bids = [(planner.inserted(r, own, task), r) for r, own in enumerate(plan)]
    (place, _), robot = min(bids, key=lambda bid: (bid[0][1], bid[1]))
    return robot, place


def least_travel(planner: Planner, plan: list[list[int]], task: int) -> tuple[int, int]:
    """The mission's scenario B: the place where the itinerary becomes longer by the least."""
    best = (1 << 60, 0, 0)
    for robot, own in enumerate(plan):
        before = planner.span_ms(robot, own)
        for place in range(len(own) + 1):
            after = planner.span_ms(robot, [*own[:place], task, *own[place:]])
            best = min(best, (after - before, robot, place))
    return best[1], best[2]


def earliest_finish(planner: Planner, plan: list[list[int]], task: int) -> tuple[int, int]:
    """The itinerary that would be through first with the task in it."""
    best = (1 << 60, 0, 0)
    for robot, own in enumerate(plan):
        for place in range(len(own) + 1):
            span = planner.span_ms(robot, [*own[:place], task, *own[place:]])
            best = min(best, (span, robot, place))
    return best[1], best[2]


def arrivals(work: Workload, load: float, rng: Random) -> list[int]:
    """Milliseconds. `load`: 1 where tasks arrive as fast as the bound on plans says they can be done."""
    last_ms = bound_ms(work) / load
    return sorted(round(rng.uniform(0, last_ms)) for _ in range(work.tasks))


def latency_s(work: Workload, at_ms: Sequence[int], policy: Policy) -> float:
    """The mean of arrival to delivery."""
    plan: list[list[int]] = [[] for _ in range(work.robots)]
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
            if not own:  # who has nothing to do has waited
                free_ms[robot] = max(free_ms[robot], now_ms)
        lead = np.stack(
            [work.lead[r] if last[r] < 0 else work.link[last[r]] for r in range(work.robots)]
        )
        ready = np.array([free - now_ms for free in free_ms], dtype=np.int64)
        robot, place = policy(Planner(Workload(ready, lead, work.link)), plan, task)
        plan[robot].insert(place, task)
    start_until(1 << 60)
    return sum(done_ms[task] - now_ms for task, now_ms in enumerate(at_ms)) / 1000 / work.tasks
