"""The plan of the whole fleet by OR-Tools, and what robots stand."""

import pytest

from agent.interface.vehicle import Vehicle
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tools.bench.field import TICK_S, central_plan_s, drive_s, problem_of, standing_share

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


def test_a_robot_that_stands_for_a_quarter_of_the_time() -> None:
    drives = [(k * 1_000_000, float(k), 0.0, False) for k in range(76)]
    stands = [(k * 1_000_000, 75.0, 0.0, False) for k in range(76, 90)]
    assert standing_share([[*drives, *stands]], 100.0) == pytest.approx(0.25)
