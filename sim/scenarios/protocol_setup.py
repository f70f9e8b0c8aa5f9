"""The setup of a run without a world: a scenario with `mission = "drill"`, or "sprint"."""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path

from agent.runtime.declared_values import FieldTable
from agent.runtime.peer_factory import NO_MEMORY, MissionParts
from sim.scenarios.fleet_setup import FleetSetup
from sim.scenarios.scenario import DRILLS, FleetTable, RunTable, Scenario
from sim.world.protocol_world import (
    SECTIONS_A_ROBOT,
    SPRINT_SECTIONS,
    PassThroughMotion,
    ProtocolWorld,
    TimedMission,
)

CONFIG_HASH = 1  # equal for all peers, because there is no field


class ProtocolSetup(FleetSetup):
    """A fleet that works sections by the clock, in a world without physics."""

    def __init__(self, scenario: Scenario) -> None:
        assert scenario.mission in DRILLS
        super().__init__(scenario)

    @cached_property
    def parade(self) -> ProtocolWorld:
        """The world, made once: bodies that stand, and the truth about units."""
        return ProtocolWorld(self.scenario.fleet.robots, self.section_count)

    def world(self) -> ProtocolWorld:
        return self.parade

    @property
    def config_hash(self) -> int:
        return CONFIG_HASH

    @property
    def section_count(self) -> int:
        each = SPRINT_SECTIONS if self._crowded else SECTIONS_A_ROBOT
        return each * self.scenario.fleet.robots

    @property
    def _crowded(self) -> bool:
        return self.scenario.mission == "sprint"

    def parts(
        self, slot: int, now_us: int = 0, recalled: Mapping[str, bytes] = NO_MEMORY
    ) -> MissionParts:
        return MissionParts(TimedMission(self.parade, slot, self._crowded), PassThroughMotion())


def drill(
    robots: int, seed: int, mission: str = "drill", silence: str = "stop", keys: str | None = None
) -> Scenario:
    """A protocol scenario with this many robots, without faults. `keys`: a file, or `DRAWN`."""
    fleet = FleetTable.model_validate({"robots": robots, "silence": silence, "keys": keys})
    parts = {"mission": mission, "field": FieldTable(file="none"), "fleet": fleet,
             "run": RunTable(seed=seed)}  # fmt: skip
    return Scenario.model_validate({"name": mission, "folder": Path(), **parts})
