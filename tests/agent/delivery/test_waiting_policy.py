"""That tasks wait less: rounds over what is planned, and what nothing may overtake."""

from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.delivery.routing_problem import Workload
from agent.delivery.tour_auction import RoutingPlanner
from agent.delivery.waiting_policy import EVERY_US, PATIENCE_US, WaitingPolicy
from agent.interface.config import MS, S
from protocol.frames.delivery_frames import HASTENS, PlanOffer
from tests.agent.planning import frozen, play, random_work
from tests.examples import examples
from tools.bench.task_stream import LeastWaiting, Plan


@settings(max_examples=examples(40), deadline=None)
@given(st.integers(1, 6), st.integers(0, 20), st.integers(0, 10_000))
def test_hastened_tasks_wait_less_in_sum_and_the_last_finish_is_no_later(
    robots: int, tasks: int, seed: int
) -> None:
    planner = RoutingPlanner(random_work(robots, tasks, seed))
    rng = Random(seed)
    plan: Plan = [[] for _ in range(robots)]
    for task in range(tasks):
        plan[rng.randrange(robots)].append(task)
    better = planner.hastened(plan, seed, 2_000)
    assert sorted(t for row in better for t in row) == list(range(tasks))
    assert planner.waiting_ms(better) <= planner.waiting_ms(plan)
    assert planner.worth(better).makespan_ms <= planner.worth(plan).makespan_ms
    assert better == planner.hastened(plan, seed, 2_000)


def test_ways_that_cross_are_uncrossed() -> None:
    """Two robots, each with the tasks beside the other: no insertion of one more task mends that."""
    near, far = 10_000, 100_000
    lead = np.array([[near, near, far, far], [far, far, near, near]])
    link = np.array([[near if a // 2 == b // 2 else far for b in range(4)] for a in range(4)])
    planner = RoutingPlanner(Workload(np.zeros(2, dtype=np.int64), lead, link))
    found = planner.hastened([[2, 3], [0, 1]], 1, 2_000)
    assert [set(row) for row in found] == [{0, 1}, {2, 3}]
    assert planner.waiting_ms(found) == 6 * near


def test_no_sum_is_worth_a_later_last_finish() -> None:
    """After 50 and 60 ms; the other way round after 10 and 70, which is less in sum."""
    lead, link = np.array([[50, 10]]), np.array([[0, 10], [60, 0]])
    planner = RoutingPlanner(Workload(np.zeros(1, dtype=np.int64), lead, link))
    assert planner.waiting_ms([[1, 0]]) < planner.waiting_ms([[0, 1]])
    assert planner.hastened([[0, 1]], 1, 2_000) == [[0, 1]]


@pytest.mark.parametrize("loss", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_a_round_over_what_is_planned_is_adopted_by_all_or_ends(seed: int, loss: float) -> None:
    problem = frozen(4, 12, seed)
    plan = [[k, k + 4, k + 8] for k in range(4)]
    planner = RoutingPlanner(problem.work)
    peers = play(4, loss, seed, problem=problem._replace(plan=plan))
    assert not any(peer.active for peer in peers)
    adopted = [peer.adopted for peer in peers if peer.adopted is not None]
    assert loss or len(adopted) == 4
    for rows in adopted:
        assert loss or rows == adopted[0]
        found = [[task - 100 for task in rows[slot]] for slot in range(4)]
        assert sorted(t for row in found for t in row) == list(range(12))
        assert planner.waiting_ms(found) < planner.waiting_ms(plan)
        assert planner.worth(found).makespan_ms <= planner.worth(plan).makespan_ms


def test_a_round_that_finds_nothing_streams_nothing() -> None:
    problem = frozen(4, 12, 1)
    planner = RoutingPlanner(problem.work)
    best = planner.hastened([[k, k + 4, k + 8] for k in range(4)], 1, 200_000)
    peers = play(4, 0.0, 1, problem=problem._replace(plan=best))
    assert not any(peer.active or peer.adopted or peer.streamed for peer in peers)


def test_a_call_says_what_for() -> None:
    assert PlanOffer(3, 4, HASTENS, 0).hastens
    assert not PlanOffer(3, 4, 0, 0).hastens
    assert not PlanOffer(3, 0, HASTENS, 0).hastens  # an offer that costs a millisecond


def test_a_round_is_due_when_tasks_have_come_and_one_waits_behind_another() -> None:
    haste = WaitingPolicy(0)
    assert haste.due(EVERY_US, 1, 4, 3)
    assert not haste.due(EVERY_US - 1, 1, 4, 3)
    assert not haste.due(EVERY_US, 0, 4, 3)  # nothing has come
    assert not haste.due(EVERY_US, 1, 3, 3)  # nobody has two
    assert not haste.due(EVERY_US, 1, 4, 1)  # alone: insertion has done it
    haste.planned(EVERY_US, 1)
    assert not haste.due(3 * EVERY_US, 1, 4, 3)
    assert haste.due(3 * EVERY_US, 2, 4, 3)


def test_what_has_waited_for_long_is_held_with_all_before_it() -> None:
    haste = WaitingPolicy(0)
    haste.known(5, 100 * S)
    haste.known(6, 200 * S)
    haste.known(5, 900 * S)  # told again: it is as old as before
    assert haste.held([6, 5, 7], 100 * S) == 0
    assert haste.held([6, 5], PATIENCE_US + 100 * S) == 2
    assert haste.held([5, 6], PATIENCE_US + 100 * S) == 1
    assert haste.held([6, 7], PATIENCE_US) == 2  # 7 is from before the start


@pytest.mark.parametrize("seed", range(3))
def test_nothing_waits_for_ever_however_many_come(seed: int) -> None:
    """A far task in a stream of near ones, twice as many as can be done: without end it came last."""
    print(f"seed {seed}")
    near, far, tasks = 20_000, 200_000, 600
    rng = Random(seed)
    link = np.full((tasks, tasks), near)
    link[:, 0] = far
    plan: Plan = [[]]
    policy, ready, begun_ms = LeastWaiting(), 0, {}
    for task in range(tasks):
        now_ms = task * near // 2
        while plan[0] and ready <= now_ms:
            first = plan[0].pop(0)
            begun_ms[first] = max(ready, 0)
            ready = max(ready, 0) + int(link[0, first])
        work = Workload(np.array([ready - now_ms]), link[:1], link)
        before = plan[0][: policy.haste.held(plan[0], now_ms * MS)]
        policy(RoutingPlanner(work), plan, task, now_ms)
        assert plan[0][: len(before)] == before
    assert begun_ms[0] <= PATIENCE_US // MS + near * rng.randint(1, 2)
