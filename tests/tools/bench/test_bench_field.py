"""The plan of the whole fleet by OR-Tools, and what robots stand."""

from itertools import islice
from math import pi, sqrt
from pathlib import Path
from types import SimpleNamespace

import pytest
from shapely.geometry import LineString, Point

from agent.interface.config import S
from agent.interface.vehicle import Vehicle
from agent.motion.tractor_tracker import LATERAL_M_S2
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.bench import field
from tools.bench.drawn_fields import drawn_setup
from tools.bench.field_changes import WatchedRun
from tools.bench.field_opponent import (
    TICK_S,
    central_plan_s,
    drive_s,
    problem_at,
    problem_of,
    snake_s,
)
from tools.bench.field_tractors import dubins_s, tractor_problem
from tools.bench.standing_times import standing_times

pytest.importorskip("ortools", reason="the opponent is in the extra dev")


def test_a_central_plan_lies_between_the_work_of_a_robot_and_all_work() -> None:
    problem = problem_of(FieldSetup(load("small").changed(3, 1)))
    work_s = float(problem.work[::2].sum()) * TICK_S
    planned_s = central_plan_s(problem, 0.5)
    assert work_s / 3 < planned_s < work_s


def test_a_body_stops_at_each_corner() -> None:
    vehicle = Vehicle(speed_m_s=2.0, acceleration_m_s2=1.0)
    braking = vehicle.braking_m_s2
    full_s = 2.0 / 1.0 + 2.0 / braking
    straight_s = full_s + (100.0 - (2.0 + 2.0 / braking)) / 2.0
    assert drive_s([(0.0, 0.0), (100.0, 0.0)], vehicle) == pytest.approx(straight_s)
    corner_s = drive_s([(0.0, 0.0), (100.0, 0.0), (100.0, 100.0)], vehicle)
    assert corner_s == pytest.approx(2 * straight_s)
    assert drive_s([(0.0, 0.0), (0.0, 0.0)], vehicle) == 0.0


def test_a_robot_stands_before_it_leaves_among_its_work_and_after_it() -> None:
    """Five seconds, three, and thirty. Its track ends when it stands for the last time."""
    waits = [(k * S, 0.0, 0.0, False) for k in range(5)]
    works = [(k * S, float(k - 5), 0.0, True) for k in range(5, 40)]
    halts = [(k * S, 34.0, 0.0, True) for k in range(40, 43)]
    leaves = [(k * S, float(k - 8), 0.0, k < 60) for k in range(43, 71)]
    found = standing_times([[*waits, *works, *halts, *leaves]], 100.0)
    assert found == pytest.approx((5.0, 3.0, 30.0)) and found.total_s == pytest.approx(38.0)


def test_one_robot_that_takes_the_sections_in_their_order_is_no_faster_than_the_search() -> None:
    problem = problem_of(FieldSetup(load("small").changed(1, 1)))
    work_s = float(problem.work[::2].sum()) * TICK_S
    assert work_s < central_plan_s(problem, 0.5) <= snake_s(problem)


@pytest.mark.slow
def test_the_truth_of_a_moment_is_what_is_left_then() -> None:
    setup = FieldSetup(load("small").changed(3, 1, time_limit_s=45.0))
    run = WatchedRun(setup, 40.0)
    run.run()
    moment = run.moment
    assert moment is not None and moment.at_s == 40.0 and len(moment.places) == 3
    left_m = sum(LineString(line).length for lines in moment.left for line in lines)
    worked_m = setup.field.work_m - left_m
    # Three robots at 2 m/s for 40 s, with the way from the gate.
    assert 0.3 * 240 < worked_m < 240
    assert all(setup.field.polygon.contains(Point(place)) for place in moment.places)
    rest_s = central_plan_s(problem_at(setup, moment.places, moment.left), 0.5)
    assert left_m / 2.0 / 3 < rest_s < central_plan_s(problem_of(setup), 0.5)


@pytest.mark.slow
def test_drawn_fields_are_valid_and_the_same_for_a_seed(tmp_path: Path) -> None:
    for seed in (*range(50), *range(1000, 1020)):
        setup = drawn_setup(seed, tmp_path)
        assert 1 <= setup.scenario.fleet.robots <= 24 and setup.field.sections, seed
        assert setup.field.polygon.is_valid and setup.field.polygon.area > 300.0, seed
    assert drawn_setup(1019, tmp_path).field == setup.field


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 1002, 1011])
def test_a_drawn_field_is_worked_without_a_flaw(seed: int, tmp_path: Path) -> None:
    """`reached` is read from the tracks of the bodies: of the ground that their bars can sweep."""
    run = FieldRun(drawn_setup(seed, tmp_path))
    outcome = run.run()
    assert outcome.success and outcome.reached == 1.0 and outcome.units_twice == 0, (seed, outcome)


def test_a_tractor_turns_back_in_a_half_circle_or_a_bulb() -> None:
    half_s = dubins_s((0.0, 0.0, 0.0), (0.0, 6.0, pi), 3.0, 2.5)
    assert half_s == pytest.approx(3.0 * pi / sqrt(LATERAL_M_S2 * 3.0))
    back_s = dubins_s((0.0, 0.0, 0.0), (-5.0, 0.0, 0.0), 3.0, 2.5)
    assert back_s == pytest.approx(5.0 / 2.5)


def test_the_plan_of_tractors_takes_every_swath_once() -> None:
    setup = FieldSetup(load("small").changed(3, 1, drive="ackermann"))
    problem = tractor_problem(setup)
    work_s = float(problem.work[::2].sum()) * TICK_S
    assert work_s == pytest.approx(setup.field.work_m / setup.vehicle.speed_m_s, rel=0.001)
    assert work_s / 3 < central_plan_s(problem, 0.5) < 2 * work_s


@pytest.mark.parametrize("success", [True, False])
def test_a_fleet_that_leaves_work_undone_is_not_as_fast_as_a_plan(
    success: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mean of the makespans held with the short ones of fleets that had not finished."""
    outcome = SimpleNamespace(makespan_s=50.0, success=success)
    run = SimpleNamespace(run=lambda: outcome, tracks={})
    stands = SimpleNamespace(total_s=0.0, before_s=0.0, after_s=0.0)
    split = SimpleNamespace(split_end_s=1.0, end_s=1.0, splits=0, mean_end_s=1.0)
    for name, stand_in in (
        ("FieldRun", lambda _: run),
        ("problem_of", lambda _: None),
        ("standing_times", lambda *_: stands),
        ("central_plan_s", lambda *_: 60.0),
        ("ideal_split", lambda *_: split),
        ("QUICK", [("small", 3)]),
    ):
        monkeypatch.setattr(field, name, stand_in)
    told = islice(field.figures(quick=True), 5)
    (mean,) = (figure for figure in told if figure.figure == "makespan, mean of all")
    assert mean.holds is success
