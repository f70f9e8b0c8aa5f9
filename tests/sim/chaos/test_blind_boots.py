"""S19: a robot that boots while it senses nothing has to stand."""

import pytest

from agent.interface.config import S
from agent.interface.effects import Drive
from sim.chaos.scenario_judge import ScenarioJudge
from sim.fleet.simulated_fleet import Cluster
from sim.scenarios import scenario as kinds
from sim.scenarios.scenario import Fault, load

DRIVES_S = 10.013  # between two commands of the robot to stand


class Misdriven(ScenarioJudge):
    """A run in which a motor controller of robot 0 drives by itself."""

    drives = True

    def _attach(self, cluster: Cluster) -> None:
        super()._attach(cluster)
        if self.drives:
            self._at(round(DRIVES_S * S), self._drive)

    def _drive(self) -> None:
        self.cluster.world.body(0).drive(Drive(1.0, 0.0), round(DRIVES_S * S))


@pytest.mark.parametrize("drives", [False, True])
def test_a_robot_that_boots_blind_is_watched(drives: bool) -> None:
    """Only a robot that was on when the fault began was."""
    faults: list[Fault] = [
        kinds.Crash(at_s=6.0, kind="crash", robot=0),
        kinds.Blind(at_s=7.0, kind="blind", robot=0, for_s=8.0),
        kinds.Restart(at_s=8.0, kind="restart", robot=0),
    ]
    scenario = load("yard").changed(2, 1)
    run = scenario.run.model_copy(update={"time_limit_s": 14.0})
    judge = Misdriven(scenario.model_copy(update={"fault": faults, "run": run}))
    judge.drives = drives
    found = [each.what for each in judge.run().broken if each.rule == "S19"]
    assert bool(found) is drives, found


@pytest.mark.parametrize("drives", [False, True])
def test_a_robot_that_was_pushed_while_it_senses_nothing_is_watched_on(drives: bool) -> None:
    """A push ended the watch for the rest of the fault."""
    faults: list[Fault] = [
        kinds.Blind(at_s=5.0, kind="blind", robot=0, for_s=8.0),
        kinds.Pushed(at_s=6.0, kind="pushed", robot=0, dx_m=0.4, dy_m=0.0),
    ]
    scenario = load("yard").changed(2, 1)
    run = scenario.run.model_copy(update={"time_limit_s": 14.0})
    judge = Misdriven(scenario.model_copy(update={"fault": faults, "run": run}))
    judge.drives = drives
    found = [each.what for each in judge.run().broken if each.rule == "S19"]
    assert bool(found) is drives, found
