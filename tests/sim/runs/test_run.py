"""Whole runs: the small scenario without a flaw, twice the same, and with trouble on the way."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from sim.fleet.outcome import FieldOutcome
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Crash, Estop, Loss, Reset, Restart, Scenario, load
from tests.chaos.broad import broad

ROOT = Path(__file__).parents[3]


def play(scenario: Scenario) -> FieldOutcome:
    return FieldRun(FieldSetup(scenario)).run()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_fleet_finishes_a_field(seed: int) -> None:
    outcome = play(load("small").changed(None, seed))
    assert outcome.success, outcome
    assert outcome.units_twice == 0 and outcome.malformed == 0


def test_a_run_whose_robots_are_all_dead_ends() -> None:
    """It went on to its limit, an hour by default."""
    crashes = [Crash(at_s=4.0 + robot, kind="crash", robot=robot) for robot in range(3)]
    outcome = play(load("small").model_copy(update={"fault": crashes}))
    assert not outcome.finished and 6.0 < outcome.simulated_s < 15.0, outcome.simulated_s
    returns = Restart(at_s=30.0, kind="restart", robot=0)
    scenario = load("small").model_copy(update={"fault": [*crashes, returns]})
    limit = scenario.run.model_copy(update={"time_limit_s": 60})
    outcome = play(scenario.model_copy(update={"run": limit}))
    assert outcome.simulated_s == 60.0, "robot 0 came back"


@pytest.mark.slow
def test_one_robot_is_a_fleet() -> None:
    assert play(broad().changed(1, 1)).success


@pytest.mark.slow
def test_the_same_seed_is_the_same_run_in_another_process_with_other_hashes() -> None:
    code = (
        "from sim.runs.field_run import FieldRun; from sim.scenarios.scenario import load; "
        "from sim.scenarios.field_setup import FieldSetup; "
        "plain = load('small').changed(3, 5); "
        "limit = plain.run.model_copy(update={'time_limit_s': 60}); "
        "scenario = plain.model_copy(update={'run': limit}); "
        "print(FieldRun(FieldSetup(scenario)).run().trace_hash)"
    )
    hashes = {
        subprocess.run(
            [sys.executable, "-c", code],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)},
            timeout=120,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(hashes) == 1


@pytest.mark.slow
def test_a_crashed_robot_stops_nobody_for_long() -> None:
    faults = [Crash(at_s=40.0, kind="crash", robot=1)]
    scenario = load("small").model_copy(update={"fault": faults})
    outcome = play(scenario)
    assert outcome.finished and outcome.replicas_equal and outcome.contacts == 0, outcome


@pytest.mark.slow
def test_a_stop_stops_and_the_work_goes_on_after_reset_and_start() -> None:
    faults = [Estop(at_s=30.0, kind="estop", robot=2), Reset(at_s=45.0, kind="reset")]
    scenario = broad().model_copy(update={"fault": faults})
    outcome = play(scenario)
    assert outcome.success, outcome
    assert outcome.frames["EmergencyStop"] >= 3 and outcome.frames["EmergencyReset"] >= 1


@pytest.mark.slow
def test_a_lossy_bus_costs_time_not_work() -> None:
    faults = [Loss(at_s=10.0, kind="loss", rate=0.05), Loss(at_s=120.0, kind="loss", rate=0.0)]
    scenario = load("small").model_copy(update={"fault": faults})
    outcome = play(scenario)
    assert outcome.finished and outcome.replicas_equal and outcome.contacts == 0, outcome
