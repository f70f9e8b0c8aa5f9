"""Robots put back together: plans stay plans, and a robot at its goal lets others pass."""

from random import Random
from statistics import median

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from agent.mapf.lacam import JointPlan, planned, search
from agent.mapf.lns import regroup
from agent.mapf.pibt import ways
from agent.mapf.plan_schedule import Timetable
from agent.mapping.building import Floor
from sim.scenarios.building_generator import CORRIDOR, DEAD_END, rooms
from tests.agent.mapf.test_lacam import drive
from tests.examples import examples

LATTICES = [Floor.drawn(text, 1.0, 0.35).lattice for text in (CORRIDOR, DEAD_END, rooms(3, 16))]


def price(waits: np.ndarray) -> float:
    return float((waits.astype(float) ** 6).sum())


@settings(max_examples=examples(40), deadline=None)
@given(robots=st.integers(2, 12), seed=st.integers(0, 10**6))
def test_a_regrouped_plan_is_a_plan_and_no_worse(robots: int, seed: int) -> None:
    lattice, rng = LATTICES[seed % len(LATTICES)], Random(seed)
    home = np.flatnonzero(lattice.component == np.bincount(lattice.component).argmax()).tolist()
    starts, goals = rng.sample(home, robots), rng.sample(home, robots)
    steps = search(lattice.near, starts, goals, [0.0] * robots, seed)
    assume(steps is not None)  # the search is bounded, and a dead end with ten robots may exceed it
    assert steps is not None
    ends = np.array(goals, dtype=np.int32)
    far = ways(lattice.near, ends)
    table = Timetable(lattice.near, far, goals, JointPlan.of(steps).tracks())
    free, before = far[np.arange(robots), starts], table.arrivals()
    again = table.track.copy()
    regroup(lattice.near, far, ends, table.track, seed)
    regroup(lattice.near, far, ends, again, seed)
    assert np.array_equal(table.track, again), "a pure function"
    assert price(table.arrivals() - free) <= price(before - free)
    plan = JointPlan.of(table.steps)
    assert [(route[0], route[-1]) for route in plan.routes] == list(zip(starts, goals, strict=True))
    drive(plan, rng)
    assert (plan.arrivals(goals) <= table.arrivals()).all(), "driven in its order it is no later"
    for at, to in zip(table.steps, table.steps[1:], strict=False):
        held = [{a, b} for a, b in zip(at.tolist(), to.tolist(), strict=True)]
        assert all(b in lattice.near[a] or a == b for a, b in zip(at, to, strict=True))
        assert sum(map(len, held)) == len(set().union(*held)), "a move takes both its nodes"


def test_who_is_at_home_in_a_doorway_lets_others_pass() -> None:
    """Its goal is the passage of all; it is there first, steps aside, and comes back in the end."""
    lattice = Floor.drawn("....\n....\n#.##\n....\n....", 1.0, 0.35).lattice
    door = lattice.nearest((1.5, 2.5))
    above, below = ([lattice.nearest((x + 0.5, y + 0.5)) for x in range(4)] for y in (4, 0))
    starts, goals = [lattice.nearest((1.5, 3.5)), *above], [door, *below]
    # The others first, one after the other, and only then the one whose goal is the door.
    far = ways(lattice.near, np.array(goals, dtype=np.int32))
    found = search(lattice.near, starts, goals, [0.0, 9.0, 8.0, 7.0, 6.0], 1)
    assert found is not None
    table = Timetable(lattice.near, far, goals, JointPlan.of(found).tracks())
    late = int(table.arrivals()[0])
    regroup(lattice.near, far, np.array(goals, dtype=np.int32), table.track, 1)
    assert int(table.arrivals()[0]) <= min(late, 3)
    assert int(table.track[0, -1]) == door
    drive(JointPlan.of(table.steps), Random(1))


def test_a_crowd_in_rooms_waits_fairly() -> None:
    """A hundred in other rooms than those that are measured, with fewer jams and so a low median."""
    longest, before, ratios = 0, 0, []
    for seed in (1, 2, 3, 4):
        lattice, rng = Floor.drawn(rooms(seed), 1.0, 0.35).lattice, Random(seed)
        starts, goals = (rng.sample(range(len(lattice)), 100) for _ in range(2))
        plan = planned(lattice.near, starts, goals, seed)
        steps = search(lattice.near, starts, goals, [0.0] * 100, seed)
        assert plan is not None and steps is not None
        free = ways(lattice.near, np.array(goals, dtype=np.int32))[np.arange(100), starts]
        waits = (plan.arrivals(goals) - free).tolist()
        longest += max(waits)
        before += int((JointPlan.of(steps).arrivals(goals) - free).max())
        ratios.append(max(waits) / max(median(waits), 1.0))
    print(f"longest waits {longest} in all, {before} as found; of the median {ratios}")
    assert longest <= 0.5 * before
    assert median(ratios) <= 3.5
