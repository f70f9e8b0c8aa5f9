"""Our plans inside pymapf, and PettingZoo's own test of the environment of one peer."""

import numpy as np
import pytest

from sim.files.grid_map import random_walls
from sim.files.mapf_scenario import drawn_scenario

pymapf = pytest.importorskip("pymapf", reason="the extra mapf is not installed")
pettingzoo_test = pytest.importorskip("pettingzoo.test", reason="the extra mapf is not installed")


@pytest.mark.parametrize("seed", range(5))
def test_pymapf_knows_a_solver_headland_and_finds_its_plans_valid(seed: int) -> None:
    import headland.pymapf_solver  # noqa: F401

    mapf = drawn_scenario("grid", random_walls(16, 16, 0.2, seed), 20, seed)
    agents = [
        pymapf.Agent(str(k), start, goal)
        for k, (start, goal) in enumerate(zip(mapf.starts, mapf.goals, strict=True))
    ]
    problem = pymapf.MAPFProblem(pymapf.GridMap(mapf.walls.tolist()), agents)
    found = pymapf.solve(problem, "headland", seed=seed)
    assert found is not None and found.is_valid(), seed
    assert all(
        found.paths[a.name][0] == a.start and found.paths[a.name][-1] == a.goal for a in agents
    )
    theirs = pymapf.solve(problem, "lacam", seed=seed)
    assert theirs is None or found.sum_of_costs <= theirs.sum_of_costs, seed


def test_pettingzoo_accepts_the_environment() -> None:
    from headland.mapf_environment import MapfEnvironment

    mapf = drawn_scenario("grid", random_walls(9, 9, 0.2, 1), 6, 1)
    pettingzoo_test.parallel_api_test(MapfEnvironment(mapf, loss=0.2, steps_max=60), num_cycles=100)


def test_a_robot_hears_less_if_frames_are_lost_and_never_moves_into_another() -> None:
    from headland.mapf_environment import MapfEnvironment
    from tools.run.mapf_environment import UNHEARD

    mapf = drawn_scenario("grid", random_walls(9, 9, 0.1, 2), 20, 2)
    env = MapfEnvironment(mapf, loss=0.5, seed=4)
    seen, _ = env.reset()
    unheard = sum(int((one["heard"][:, 2] == UNHEARD).sum()) for one in seen.values())
    assert 100 < unheard < 280, "about half of 380"
    rng = np.random.default_rng(3)
    for _ in range(200):
        before = list(env.places)
        env.step({agent: int(rng.integers(5)) for agent in env.possible_agents})
        assert len(set(env.places)) == 20
        swaps = {(a, b) for a, b in zip(before, env.places, strict=True) if a != b}
        assert not any((b, a) in swaps for a, b in swaps)
