"""Plans with a small sum of costs, checked against a package and a judge that share no code with them."""

from random import Random

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.coverage.cell_map import CellMap
from agent.mapf.pibt import ways
from agent.mapf.sum_of_costs import costs, planned
from agent.pathfinding.goal_course import neighbours
from sim.files.grid_map import map_text, random_walls
from sim.files.mapf_paths import path_text
from sim.files.mapf_scenario import drawn_scenario
from sim.world.path_judge import judge_paths

Drawn = tuple[CellMap, list[int], list[int], NDArray[np.bool_]]


def drawn(side: int, robots: int, seed: int, share: float = 0.2) -> Drawn:
    walls = random_walls(side, side, share, seed)
    mapf = drawn_scenario("grid", walls, robots, seed)
    ground = CellMap(walls, 1.0)
    return ground, [*map(ground.number, mapf.starts)], [*map(ground.number, mapf.goals)], walls


@pytest.mark.parametrize("seed", range(12))
def test_plans_are_plans(seed: int) -> None:
    ground, starts, goals, walls = drawn(12, 12, seed)
    track = planned(neighbours(ground), starts, goals, seed)
    assert track is not None, f"seed {seed}: connected cells, few robots"
    steps = [[ground.cell(n) for n in at] for at in track.T.tolist()]
    text = path_text({}, steps[0], [ground.cell(n) for n in goals], steps)
    verdict = judge_paths(text, map_text(walls))
    assert not verdict.faults and steps[0] == [ground.cell(n) for n in starts], (seed, verdict)
    assert verdict.sum_of_costs == costs(track, np.array(goals, np.int32)).sum()


def test_every_peer_computes_the_same_plan() -> None:
    ground, starts, goals, _ = drawn(12, 14, 3)
    one, two = (planned(neighbours(ground), starts, goals, 7) for _ in range(2))
    assert one is not None and two is not None and np.array_equal(one, two)


@pytest.mark.parametrize("seed", range(6))
def test_small_plans_cost_no_more_than_an_optimal_solver_of_another_package(seed: int) -> None:
    pymapf = pytest.importorskip("pymapf", reason="the extra mapf is not installed")
    ground, starts, goals, walls = drawn(7, 4, seed, 0.1)
    agents = [
        pymapf.Agent(str(k), ground.cell(a), ground.cell(b))
        for k, (a, b) in enumerate(zip(starts, goals, strict=True))
    ]
    best = pymapf.solve(pymapf.MAPFProblem(pymapf.GridMap(walls.tolist()), agents), "cbs")
    track = planned(neighbours(ground), starts, goals, seed)
    assert best is not None and track is not None
    ours = costs(track, np.array(goals, np.int32)).sum()
    assert best.sum_of_costs <= ours <= 1.05 * best.sum_of_costs, f"seed {seed}"


def test_a_corridor_without_a_bay_has_no_plan_for_two_that_meet() -> None:
    ground = CellMap(np.zeros((1, 6), dtype=np.bool_), 1.0)
    ends = [ground.number((0, 0)), ground.number((0, 5))]
    assert planned(neighbours(ground), ends, ends[::-1]) is None


def test_a_hundred_robots_wait_little() -> None:
    rng = Random(5)
    ground, starts, goals, _ = drawn(40, 100, rng.randrange(99), 0.1)
    track = planned(neighbours(ground), starts, goals)
    assert track is not None
    ends = np.array(goals, np.int32)
    shortest = ways(neighbours(ground), ends)[np.arange(100), starts].sum()
    assert costs(track, ends).sum() <= 1.1 * shortest
