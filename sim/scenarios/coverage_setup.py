"""A grid map with a fleet on it: the setup of a simulated fleet of whole peers that cover it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from random import Random

from agent.coverage.cell_map import CellMap
from agent.interface.vehicle import Vehicle
from agent.runtime.declared_values import FieldTable
from agent.runtime.mission_parts import coverage_parts
from agent.runtime.peer_factory import NO_MEMORY, MissionParts
from sim.files.grid_map import Instance
from sim.scenarios.fleet_setup import FleetSetup
from sim.scenarios.scenario import BusTable, Fault, FleetTable, RunTable, Scenario
from sim.world.grid_world import GridWorld

# The robots of the field scenarios: a cell is their working width.
CELL_M, SPEED_M_S, RADIUS_M = 4.0, 2.5, 0.8
STEP_S = CELL_M / SPEED_M_S
VEHICLE = Vehicle(RADIUS_M, SPEED_M_S)


class CoverageSetup(FleetSetup):
    """A fleet on the cells of a map: where robots start, how cells are numbered, and what a turn
    costs."""

    def __init__(self, scenario: Scenario, instance: Instance, turn_cost: float = 0.0) -> None:
        """ValueError if there are more free cells than numbers on the wire."""
        super().__init__(scenario)
        self.instance, self.turn_cost = instance, turn_cost
        self.ground = CellMap(instance.walls, CELL_M)
        self.cells = [self.ground.number(cell) for cell in instance.starts]
        self.starts = [self.ground.centre(number) for number in self.cells]  # metres

    @classmethod
    def made(
        cls,
        instance: Instance,
        *,
        seed: int = 1,
        faults: Sequence[Fault] = (),
        loss: float = 0.0,
        silence: str = "continue",
        time_limit_s: float = 3600.0,
        turn_cost: float = 0.0,
    ) -> "CoverageSetup":
        """Make it without a scenario file. Robots are numbered as the instance's starts."""
        scenario = Scenario.model_validate({
            "name": instance.name[:64] or "grid",
            "field": FieldTable(file="none"),
            "fleet": FleetTable.model_validate({
                "robots": len(instance.starts), "radius_m": RADIUS_M, "speed_m_s": SPEED_M_S,
                "silence": silence,
            }),
            "bus": BusTable(loss=loss),
            "run": RunTable(seed=seed, time_limit_s=time_limit_s),
            "fault": list(faults), "folder": Path(),
        })  # fmt: skip
        return cls(scenario, instance, turn_cost)

    @property
    def config_hash(self) -> int:
        return self.ground.check

    @property
    def section_count(self) -> int:
        return len(self.ground.section_units)

    def parts(
        self, slot: int, now_us: int = 0, recalled: Mapping[str, bytes] = NO_MEMORY
    ) -> MissionParts:
        """What the mission brings to the peer of one slot."""
        rng = Random(f"{self.scenario.run.seed}/grid/{slot}")
        return coverage_parts(slot, self.ground, VEHICLE, rng, self.turn_cost)

    def world(self) -> GridWorld:
        """An empty world: robots are put into it when they are switched on."""
        return GridWorld(self.ground, RADIUS_M)
