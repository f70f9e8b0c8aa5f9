"""Priorities: reset at a goal, robots get on for ever; reset at each step, they never do."""

from random import Random

import numpy as np

from agent.mapf.pibt import grown, step, ways
from agent.mapping.building import Floor
from sim.scenarios.building_generator import CORRIDOR

GOALS_EACH = 4
STEPS_MAX = 2_000  # the slowest run with the right rule takes about a hundred


def steps_until_done(robots: int, seed: int, reset_each_step: bool) -> int | None:
    """Robots with ever new goals in two rooms and a corridor; None: not done after `STEPS_MAX`."""
    near = Floor.drawn(CORRIDOR, 1.0, 0.35).lattice.near
    rng = Random(seed)
    here = np.array(rng.sample(range(len(near)), robots), dtype=np.int32)
    goals = np.array([rng.randrange(len(near)) for _ in range(robots)], dtype=np.int32)
    priority = np.arange(robots) / (robots + 1.0)
    far, reached = ways(near, goals), 0
    rows = np.arange(robots)
    for turn in range(STEPS_MAX):
        there = np.full(robots, -1, dtype=np.int32)
        order = np.argsort(-priority, kind="stable").astype(np.int32)
        assert step(here, order, there, near, far, goals, turn, False)
        nearer = far[rows, there] < far[rows, here]
        priority = grown(priority, there, np.where(nearer & reset_each_step, there, goals))
        here = there
        for robot in np.flatnonzero(here == goals).tolist():
            reached += 1
            goals[robot] = rng.randrange(len(near))
        far = ways(near, goals)
        if reached >= robots * GOALS_EACH:
            return turn
    return None


def test_priorities_reset_at_goals_let_everybody_through() -> None:
    for seed in range(5):
        for robots in (6, 12):
            print("seed", seed, "robots", robots)
            assert steps_until_done(robots, seed, reset_each_step=False) is not None


def test_priorities_reset_at_each_step_are_a_livelock() -> None:
    """The lesson of the coverage study: should this ever finish, the test above proves nothing."""
    for seed in range(3):
        assert steps_until_done(6, seed, reset_each_step=True) is None


def test_nobody_swaps_and_nobody_shares() -> None:
    near = Floor.drawn(CORRIDOR, 1.0, 0.35).lattice.near
    for seed in range(30):
        rng = Random(seed)
        robots = rng.randrange(2, 20)
        here = np.array(rng.sample(range(len(near)), robots), dtype=np.int32)
        goals = np.array(rng.sample(range(len(near)), robots), dtype=np.int32)
        order = np.array(rng.sample(range(robots), robots), dtype=np.int32)
        there = np.full(robots, -1, dtype=np.int32)
        if not step(here, order, there, near, ways(near, goals), goals, seed, True):
            continue
        print("seed", seed)
        assert len(set(there.tolist())) == robots
        moves = set(zip(here.tolist(), there.tolist(), strict=True))
        assert not any((b, a) in moves for a, b in moves if a != b)
        for a, b in moves:
            assert a == b or b in near[a]
