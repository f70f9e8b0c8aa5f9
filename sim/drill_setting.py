"""What a run without a world is made of: a scenario with `mission = "drill"`."""

from functools import cached_property
from pathlib import Path

from agent.safety import SilencePolicy
from sim.parade import SECTIONS_A_ROBOT, Parade, Steady, Straight
from sim.scenario import FieldTable, FleetTable, RunTable, Scenario
from sim.setting import Setting

CONFIG_HASH = 1  # all peers have the same field: none


class DrillSetting(Setting):
    def __init__(self, scenario: Scenario) -> None:
        assert scenario.mission == "drill"
        self.scenario, self.keys = scenario, None
        self.silence = SilencePolicy[scenario.fleet.silence.upper()]

    @cached_property
    def parade(self) -> Parade:
        return Parade(self.scenario.fleet.robots, self.section_count)

    def world(self) -> Parade:
        return self.parade

    @property
    def config_hash(self) -> int:
        return CONFIG_HASH

    @property
    def section_count(self) -> int:
        return SECTIONS_A_ROBOT * self.scenario.fleet.robots

    def mission(self, slot: int) -> Steady:  # type: ignore[override]
        return Steady(self.parade, slot)

    def motion(self, slot: int) -> Straight:
        return Straight(slot)


def drill(robots: int, seed: int) -> Scenario:
    """A drill of so many robots, without faults."""
    return Scenario(
        name="drill", mission="drill", field=FieldTable(file="none"),
        fleet=FleetTable(robots=robots, silence="stop"), run=RunTable(seed=seed), folder=Path(),
    )  # fmt: skip
