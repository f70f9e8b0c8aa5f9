"""The planner of the project brief, for comparison: what it promises and where it fails."""

from itertools import pairwise

import numpy as np
import pytest

from sim.files.grid_map import Instance, largest_room, random_starts, random_walls
from sim.world.plan_judge import judge
from tools.bench.voronoi_coverage import baseline, dfs_with_hops, reservations, voronoi


def scene(seed: int) -> Instance:
    walls = random_walls(20, 20, 0.15, seed)
    return Instance(str(seed), walls, random_starts(walls, 8, seed))


def test_everyone_owns_what_is_nearest() -> None:
    owner = voronoi(np.zeros((1, 5), dtype=bool), [(0, 0), (0, 4)])
    assert [owner[0, column] for column in range(5)] == [0, 0, 0, 1, 1], (
        "a tie to the smaller index"
    )


@pytest.mark.parametrize("seed", range(5))
def test_one_robot_walks_its_whole_region(seed: int) -> None:
    instance = scene(seed)
    room = set(largest_room(instance.walls))
    path = dfs_with_hops(instance.walls, instance.starts[0], room)
    assert set(path) == room
    assert all(abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1 for a, b in pairwise(path))


def test_the_sketch_lets_a_robot_into_an_occupied_cell() -> None:
    paths = [[(0, 0), (0, 1), (0, 2)], [(0, 2)]]
    schedule, ended = reservations(paths, strict=False)
    assert ended and schedule[-1] == [(0, 2), (0, 2)], "both in one cell"
    schedule, ended = reservations(paths, strict=True)
    assert not ended and schedule[-1] == [(0, 1), (0, 2)], "safe, and stuck for ever"


@pytest.mark.parametrize("seed", range(12))
def test_made_strict_it_is_safe(seed: int) -> None:
    plan, ended = baseline(scene(seed), strict=True)
    verdict = judge(plan)
    assert verdict.collisions == verdict.swaps == verdict.wall_entries == 0
    assert not ended or verdict.uncovered == 0
