"""Plans of deliveries: what an auction gives away, what a search keeps, and what it is worth."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.delivery.cost_matrix import FULL, Carrier, workload
from agent.delivery.tour_auction import RoutingPlanner
from tests.agent.planning import COSTS, random_work, trips
from tests.examples import examples


@settings(max_examples=examples(40), deadline=None)
@given(st.integers(1, 6), st.integers(0, 20), st.integers(0, 10_000))
def test_every_task_is_given_to_one_robot_and_a_search_never_makes_it_worse(
    robots: int, tasks: int, seed: int
) -> None:
    planner = RoutingPlanner(random_work(robots, tasks, seed))
    first = planner.auctioned()
    assert sorted(t for row in first for t in row) == list(range(tasks))
    better = planner.improved(first, seed, 2_000)
    assert sorted(t for row in better for t in row) == list(range(tasks))
    assert planner.worth(better) <= planner.worth(first)


def test_the_same_seed_finds_the_same_plan() -> None:
    planner = RoutingPlanner(random_work(5, 30, 1))
    first = planner.auctioned()
    assert first == RoutingPlanner(random_work(5, 30, 1)).auctioned()
    assert planner.improved(first, 7, 20_000) == planner.improved(first, 7, 20_000)
    assert planner.improved(first, 7, 20_000) != planner.improved(first, 8, 20_000)


def test_a_small_problem_is_solved_to_its_optimum() -> None:
    work = random_work(2, 5, 3)
    planner = RoutingPlanner(work)
    found = planner.worth(planner.improved(planner.auctioned(), 1, 20_000)).makespan_ms
    assert found == _best(planner)


def _best(planner: RoutingPlanner) -> int:
    from itertools import permutations

    tasks = range(planner.work.tasks)
    return min(
        planner.worth([list(order[:cut]), list(order[cut:])]).makespan_ms
        for order in permutations(tasks)
        for cut in range(len(order) + 1)
    )


def test_insertion_costs_what_all_tasks_wait_longer() -> None:
    planner = RoutingPlanner(random_work(1, 4, 5))
    place, cost = planner.inserted(0, [0, 1, 2], 3)
    waits = [
        sum(planner.span_ms(0, order[: k + 1]) for k in range(len(order)))
        for order in ([0, 1, 2], [3, 0, 1, 2], [0, 3, 1, 2], [0, 1, 3, 2], [0, 1, 2, 3])
    ]
    assert cost == min(waits[1:]) - waits[0]
    assert place == int(np.argmin(waits[1:]))
    assert planner.inserted(0, [0, 1, 2], 3, first=3)[0] == 3


def test_a_battery_that_is_too_small_for_a_task_takes_none_of_it() -> None:
    rng = np.random.default_rng(4)
    given = trips(3, rng)
    bays = [(0.5, 0.5), (1.5, 0.5)]
    for battery_m, feasible in ((3.0, False), (80.0, True)):
        carrier = Carrier(1.0, 2.0, battery_m=battery_m)
        work = workload(COSTS, carrier, given, [(0.5, 0.5)], [0], bays, [FULL])
        plan = RoutingPlanner(work).auctioned()
        assert (len(plan[0]) == 3) is feasible


def test_charging_makes_a_route_longer_and_keeps_it_possible() -> None:
    rng = np.random.default_rng(6)
    given = trips(8, rng)
    bays = [(0.5, 0.5), (13.5, 8.5)]
    spans = []
    for battery_m in (1e6, 90.0):
        carrier = Carrier(1.0, 2.0, battery_m=battery_m, dock_s=10.0, charge_s=20.0)
        work = workload(COSTS, carrier, given, [(0.5, 0.5)], [0], bays, [FULL])
        planner = RoutingPlanner(work)
        spans.append(planner.worth(planner.auctioned()))
    assert all(worth.feasible for worth in spans)
    assert spans[1].makespan_ms > spans[0].makespan_ms + 10_000
