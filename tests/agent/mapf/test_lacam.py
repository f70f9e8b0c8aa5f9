"""Joint plans: found wherever there is one, and driven to the end in whatever order robots move."""

from random import Random

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.mapf.lacam import JointPlan, planned, search
from agent.mapf.pibt import ways
from agent.mapf.plan_schedule import Timetable
from agent.mapping.building import Floor
from sim.scenarios.building_generator import CORRIDOR, DEAD_END, JUNCTION, rooms
from tests.examples import examples

DRAWINGS = {"corridor": CORRIDOR, "junction": JUNCTION, "dead end": DEAD_END}
LATTICES = {name: Floor.drawn(text, 1.0, 0.35).lattice for name, text in DRAWINGS.items()}


def drive(plan: JointPlan, rng: Random) -> None:
    """Robots move one at a time, in any order; nobody enters a node that another one has."""
    count = len(plan.routes)
    reached = [0] * count
    while True:
        able = [i for i in range(count) if plan.permitted(i, reached) > reached[i]]
        if not able:
            break
        mover = rng.choice(able)
        node = plan.routes[mover][reached[mover] + 1]
        for other in range(count):
            assert other == mover or plan.routes[other][reached[other]] != node
        reached[mover] += 1
    assert all(reached[i] == len(plan.routes[i]) - 1 for i in range(count)), "a deadlock"


# Robots with which no search of 1,500 was ended by its limit. Of eight on the 23 nodes of the dead end,
# one of 250 is, and finds no plan (seed 471 in no salt that was tried).
ROBOTS = {"corridor": 8, "dead end": 6}


@settings(max_examples=examples(60), deadline=None)
@given(
    case=st.sampled_from([(name, n) for name, most in ROBOTS.items() for n in range(1, most + 1)]),
    seed=st.integers(0, 10**6),
)
def test_plans_in_corridors(case: tuple[str, int], seed: int) -> None:
    (name, robots), rng = case, Random(seed)
    lattice = LATTICES[name]
    starts = rng.sample(range(len(lattice)), robots)
    goals = rng.sample(range(len(lattice)), robots)
    steps = search(lattice.near, starts, goals, [0.0] * robots, seed)
    assert steps is not None, f"seed {seed}"
    assert steps[0].tolist() == starts and steps[-1].tolist() == goals
    drive(JointPlan.of(steps), rng)


def test_two_change_ends_of_a_t() -> None:
    lattice = LATTICES["junction"]
    a, b = lattice.nearest((0.5, 2.5)), lattice.nearest((10.5, 2.5))
    steps = search(lattice.near, [a, b], [b, a], [0.0, 0.0])
    assert steps is not None
    drive(JointPlan.of(steps), Random(1))


def test_what_cannot_be_is_said() -> None:
    """Two in a corridor without a place to pass."""
    lattice = Floor.drawn(".........", 1.0, 0.35).lattice
    assert search(lattice.near, [0, 8], [8, 0], [0.0, 0.0]) is None


def test_a_hundred_robots_in_rooms() -> None:
    lattice = Floor.drawn(rooms(1), 1.0, 0.35).lattice
    rng = Random(1)
    starts, goals = (rng.sample(range(len(lattice)), 100) for _ in range(2))
    steps = search(lattice.near, starts, goals, [0.0] * 100)
    assert steps is not None
    drive(JointPlan.of(steps), rng)


def test_equal_arguments_equal_plans() -> None:
    lattice, rng = LATTICES["corridor"], Random(5)
    starts, goals = (rng.sample(range(len(lattice)), 9) for _ in range(2))
    one, two = (search(lattice.near, starts, goals, [0.0] * 9, 3) for _ in range(2))
    assert one is not None and two is not None
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))


def unit_moves(plan: JointPlan, goals: list[int]) -> list[int]:
    """When each robot first is at its goal, where all that may move at once, a unit of time each."""
    count = len(plan.routes)
    reached, now = [0] * count, 0
    found = [0 if plan.routes[i][0] == goals[i] else -1 for i in range(count)]
    while any(reached[i] < len(plan.routes[i]) - 1 for i in range(count)):
        before, now = list(reached), now + 1
        for i in range(count):
            if plan.permitted(i, before) > before[i]:
                reached[i] += 1
                if found[i] < 0 and plan.routes[i][reached[i]] == goals[i]:
                    found[i] = now
        assert reached != before, "a deadlock"
    return found


@settings(max_examples=30, deadline=None)
@given(robots=st.integers(1, 8), seed=st.integers(0, 10**6))
def test_the_fairest_of_some_plans(robots: int, seed: int) -> None:
    lattice, rng = LATTICES["corridor"], Random(seed)
    starts = rng.sample(range(len(lattice)), robots)
    goals = rng.sample(range(len(lattice)), robots)
    first = search(lattice.near, starts, goals, [0.0] * robots, seed)
    plan = planned(lattice.near, starts, goals, seed)
    assert first is not None and plan is not None, f"seed {seed}"
    assert [(route[0], route[-1]) for route in plan.routes] == list(zip(starts, goals, strict=True))
    drive(plan, rng)
    assert plan.arrivals(goals).tolist() == unit_moves(plan, goals)
    free = ways(lattice.near, np.array(goals, dtype=np.int32))[np.arange(robots), starts]
    waits = [each.arrivals(goals) - free for each in (plan, JointPlan.of(first))]
    assert (waits[0] >= 0).all() and (waits[0] ** 2).sum() <= (waits[1] ** 2).sum()
    assert plan == planned(lattice.near, starts, goals, seed), "a pure function"


@settings(max_examples=examples(40), deadline=None)
@given(robots=st.integers(1, 9), seed=st.integers(0, 10**6))
def test_nobody_comes_later_when_robots_are_put_back(robots: int, seed: int) -> None:
    name = ["corridor", "dead end"][seed % 2]
    lattice, rng = LATTICES[name], Random(seed)
    starts = rng.sample(range(len(lattice)), robots)
    goals = rng.sample(range(len(lattice)), robots)
    steps = search(lattice.near, starts, goals, [0.0] * robots, seed)
    assert steps is not None, f"seed {seed}"
    first = JointPlan.of(steps)
    far = ways(lattice.near, np.array(goals, dtype=np.int32))
    table = Timetable(lattice.near, far, goals, first.tracks())
    assert table.arrivals().tolist() == first.arrivals(goals).tolist()
    table.shorten(100)
    after = JointPlan.of(table.steps)
    drive(after, rng)
    assert [route[-1] for route in after.routes] == goals
    assert (after.arrivals(goals) <= table.arrivals()).all()
    assert (table.arrivals() <= first.arrivals(goals)).all()
    for at, to in zip(table.steps, table.steps[1:], strict=False):
        for node, following in zip(at.tolist(), to.tolist(), strict=True):
            assert node == following or following in lattice.near[node]
