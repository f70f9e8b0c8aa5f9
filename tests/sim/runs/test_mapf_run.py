"""Whole peers drive MAPF instances over the wire; their bodies judge, and validators of others."""

import re

import numpy as np
import pytest

from sim.files.grid_map import map_text, parse_map, random_walls
from sim.files.mapf_scenario import MapfInstance, drawn_scenario
from sim.runs.mapf_run import MapfOutcome, MapfRun
from sim.scenarios.mapf_setup import MapfSetup
from sim.scenarios.scenario import Blind, Crash, Estop, Fault, Reset
from sim.world.path_judge import judge_paths
from tools.run.mapf import judged, path_file


def play(
    mapf: MapfInstance, *faults: Fault, seed: int = 1, loss: float = 0.0
) -> tuple[MapfRun, MapfOutcome]:
    run = MapfRun(MapfSetup.of(mapf, seed=seed, loss=loss, faults=faults, time_limit_s=240.0))
    return run, run.run()


def scene(side: int, robots: int, seed: int, share: float = 0.15) -> MapfInstance:
    return drawn_scenario("grid", random_walls(side, side, share, seed), robots, seed)


@pytest.mark.parametrize(("seed", "loss"), [(1, 0.0), (2, 0.02), (3, 0.2)])
def test_all_arrive_and_two_validators_find_no_conflict(seed: int, loss: float) -> None:
    mapf = scene(12, 8, seed)
    run, outcome = play(mapf, seed=seed, loss=loss)
    assert outcome.success and outcome.arrived == 8, (seed, outcome)
    assert outcome.ratio < 1.35 + loss, (seed, outcome)
    verdict = judged(run, outcome, mapf.walls)
    assert not verdict.faults and verdict.arrived == 8, (seed, verdict)
    assert abs(verdict.sum_of_costs - outcome.sum_of_costs) <= 8, "a path file rounds to units"
    pymapf = pytest.importorskip("pymapf", reason="the extra mapf is not installed")
    rows = path_file(run, outcome).partition("solution=\n")[2].splitlines()
    steps = [re.findall(r"\((\d+),(\d+)\)", row) for row in rows]
    paths = {str(k): [tuple(map(int, step[k])) for step in steps] for k in range(8)}
    assert pymapf.find_first_conflict(paths) is None, seed


def test_robots_that_stand_on_their_goals_cost_nothing() -> None:
    """Found: where nobody had to move, each of them cost 0.03125."""
    cells = [(0, 0), (1, 1)]
    mapf = MapfInstance("pair", np.zeros((2, 2), dtype=np.bool_), cells, cells)
    _, outcome = play(mapf)
    assert outcome.success and outcome.arrived == 2
    assert outcome.sum_of_costs == outcome.makespan == outcome.shortest == 0


@pytest.mark.parametrize("robot", [0, 1])
def test_a_robot_that_never_sees_its_place_does_not_keep_the_others_standing(robot: int) -> None:
    """Each round waited for its cell, so none set out, for good."""
    starts, goals = [(0, 0), (1, 1), (2, 0)], [(0, 7), (1, 7), (2, 7)]
    mapf = MapfInstance("hall", np.zeros((4, 8), dtype=np.bool_), starts, goals)
    blind = Blind(at_s=0.0, kind="blind", robot=robot, for_s=20.0)
    run = MapfRun(MapfSetup.of(mapf, faults=[blind], time_limit_s=15.0))
    assert run.run().arrived == 2
    _, outcome = play(mapf, blind)
    assert outcome.success and outcome.arrived == 3, "it takes part when it sees"


@pytest.mark.parametrize("seed", [1, 2])
def test_a_robot_that_fails_on_the_way_is_driven_round(seed: int) -> None:
    mapf = scene(14, 8, seed)
    run, outcome = play(mapf, Crash(at_s=6.0, kind="crash", robot=3), seed=seed, loss=0.02)
    assert outcome.success and outcome.crashed == 1 and outcome.rounds >= 2, (seed, outcome)
    assert not judged(run, outcome, mapf.walls).faults, seed


def test_a_robot_behind_a_wreck_is_in_the_cell_that_holds_its_centre() -> None:
    """It stood past the border, another robot went through the cell that it had left, and it came back.
    Visits of middles alone said that both were in that cell. The wreck is across the next border."""
    mapf = drawn_scenario("grid", random_walls(12, 12, 0.1, 1), 8, 1)
    faults = [Crash(at_s=17.13, kind="crash", robot=4), Crash(at_s=24.53, kind="crash", robot=2)]
    run, outcome = play(mapf, *faults)
    assert outcome.success and outcome.arrived == 6 and not outcome.conflict, outcome
    assert not judged(run, outcome, mapf.walls).faults


@pytest.mark.slow
def test_a_robot_that_stands_past_a_border_for_long_has_left_its_cell() -> None:
    """By middles, agents 13 and 14 changed places, 3 m from each other at the nearest."""
    mapf = drawn_scenario("grid", random_walls(16, 16, 0.15, 39), 20, 39)
    crashes = ((15, 4.72), (5, 6.71), (8, 12.39))
    faults = [Crash(at_s=at_s, kind="crash", robot=robot) for robot, at_s in crashes]
    run, outcome = play(mapf, *faults, seed=39)
    assert outcome.success and outcome.arrived == 17, outcome
    assert not judged(run, outcome, mapf.walls).faults


def test_a_wreck_in_the_only_door_closes_off_goals_and_the_others_arrive() -> None:
    walls = parse_map("type octile\nheight 3\nwidth 9\nmap\n....@....\n.........\n....@....\n")
    mapf = MapfInstance(
        "door", walls, [(1, 3), (0, 0), (2, 0), (0, 8)], [(1, 8), (0, 7), (0, 2), (2, 5)]
    )
    run, outcome = play(mapf, Crash(at_s=2.3, kind="crash", robot=0))
    assert outcome.success and outcome.crashed == 1, outcome
    assert outcome.unsolvable == 1 and outcome.arrived == 2, "robot 1 cannot come through"
    assert run.excused == {0, 1} and not judged(run, outcome, walls).faults
    steps = run.steps
    run.steps = [*steps, [*steps[-1][:2], steps[0][2], *steps[-1][3:]]]
    faults = judged(run, outcome, walls).faults
    assert "agent 2 does not end at its goal" in faults, "one wreck excused every robot"


def test_robots_in_the_wrong_order_behind_a_wreck_need_not_all_arrive() -> None:
    """One of both can be at its goal, and the run was told as a failure."""
    rows = "............\n@@@@@@.@@@@@\n"
    walls = parse_map(f"type octile\nheight 2\nwidth 12\nmap\n{rows}")
    starts = [(0, 4), (0, 1), (0, 0)]
    crash = Crash(at_s=2.0, kind="crash", robot=0)
    run, outcome = play(MapfInstance("row", walls, starts, [(0, 11), (0, 2), (0, 3)]), crash)
    assert outcome.success and outcome.arrived == outcome.unsolvable == 1, outcome
    assert not judged(run, outcome, walls).faults
    run, outcome = play(MapfInstance("row", walls, starts, [(0, 11), (0, 3), (0, 2)]), crash)
    assert outcome.success and outcome.arrived == 2, outcome


FILE_OF_FOUR = (
    "............", [(0, 3), (0, 2), (0, 1), (0, 0)], [(0, 11), (0, 10), (0, 9), (0, 8)]
)  # fmt: skip
LOOP_OF_THREE = (
    ".....\n.@@@.\n.@@@.\n.....", [(0, 3), (0, 2), (0, 1)], [(3, 3), (3, 4), (2, 4)]
)  # fmt: skip


@pytest.mark.parametrize("at_s", [2.0, 2.2, 2.6, 3.56])
@pytest.mark.parametrize("scene_of", [FILE_OF_FOUR, LOOP_OF_THREE], ids=["file", "loop"])
def test_a_robot_stranded_between_two_cells_behind_a_wreck_goes_back(
    scene_of: tuple[str, list[tuple[int, int]], list[tuple[int, int]]], at_s: float
) -> None:
    """The next robot has entered the cell that it left: no round of agreement ended, for good."""
    rows, starts, goals = scene_of
    height, width = rows.count("\n") + 1, rows.index("\n") if "\n" in rows else len(rows)
    walls = parse_map(f"type octile\nheight {height}\nwidth {width}\nmap\n{rows}\n")
    mapf = MapfInstance("narrow", walls, starts, goals)
    run, outcome = play(mapf, Crash(at_s=at_s, kind="crash", robot=0))
    assert outcome.success and outcome.simulated_s < 60.0, outcome
    assert not judged(run, outcome, walls).faults


def test_a_stop_on_the_way_halts_all_and_they_arrive_after_its_release() -> None:
    mapf = scene(10, 5, 4)
    stop, release = Estop(at_s=5.0, kind="estop", robot=2), Reset(at_s=15.0, kind="reset")
    _, outcome = play(mapf, stop, release, seed=4)
    assert outcome.success and outcome.sum_of_costs > outcome.shortest + 5 * 5, outcome


def test_one_seed_is_one_run() -> None:
    hashes = [play(scene(8, 4, 2), seed=seed)[1].trace_hash for seed in (1, 1, 2)]
    assert hashes[0] == hashes[1] != hashes[2]


def test_the_judge_of_paths_can_fail() -> None:
    mapf = scene(8, 3, 5)
    run, outcome = play(mapf)
    text = path_file(run, outcome)
    assert judge_paths(text, map_text(mapf.walls)).faults == []
    two = re.sub(r"^(\d+):(\(\d+,\d+\),)\(\d+,\d+\),", r"\1:\2\2", text, flags=re.M)
    assert judge_paths(two, map_text(mapf.walls)).faults
