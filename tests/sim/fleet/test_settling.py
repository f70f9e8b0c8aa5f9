"""Replicas have the time that the protocol needs to be equal after the last work."""

import pytest

from sim.fleet.settling import LOSSY_QUIET_US, QUIET_US, quiet_for_us
from sim.runs.navigation_run import NavigationRun
from sim.scenarios.navigation_scenario import NavigationScenario, load_mission, setting_of
from sim.scenarios.scenario import BusTable


@pytest.mark.slow
def test_m27_the_documented_corridor_ends_with_equal_replicas() -> None:
    scenario = load_mission("corridor").changed(seed=3)
    assert isinstance(scenario, NavigationScenario)
    outcome = NavigationRun(setting_of(scenario)).run()
    assert outcome.success and outcome.replicas_equal


def test_m27_only_a_bus_that_loses_frames_is_waited_for() -> None:
    assert quiet_for_us(BusTable()) == QUIET_US
    assert (
        quiet_for_us(BusTable(loss=0.3)) == quiet_for_us(BusTable(omission=0.1)) == LOSSY_QUIET_US
    )
