"""Robots on a public MAPF map, each with a start and a goal: the setup of a fleet of whole peers."""

from collections.abc import Mapping, Sequence
from random import Random

from agent.coverage.cell_map import CellMap
from agent.runtime.mission_parts import pathfinding_parts
from agent.runtime.peer_factory import NO_MEMORY, MissionParts
from sim.files.grid_map import Instance
from sim.files.mapf_scenario import MapfInstance
from sim.scenarios.coverage_setup import VEHICLE, CoverageSetup
from sim.scenarios.scenario import Fault, Scenario


class MapfSetup(CoverageSetup):
    """The cells of a map, and for each robot a start and a goal."""

    def __init__(self, scenario: Scenario, instance: Instance, goals: Sequence[tuple[int, int]]):
        super().__init__(scenario, instance)
        self.goals = [self.ground.number(cell) for cell in goals]

    @classmethod
    def of(
        cls, mapf: MapfInstance, *, seed: int = 1, faults: Sequence[Fault] = (), loss: float = 0.0,
        time_limit_s: float = 3600.0,
    ) -> "MapfSetup":  # fmt: skip
        """`loss`: the share of frames that a receiver misses, 0 to 1."""
        instance = Instance(mapf.name, mapf.walls, mapf.starts)
        plain = CoverageSetup.made(
            instance, seed=seed, faults=faults, loss=loss, time_limit_s=time_limit_s
        )
        return cls(plain.scenario, instance, mapf.goals)

    @property
    def section_count(self) -> int:
        return len(self.goals)

    def parts(
        self, slot: int, now_us: int = 0, recalled: Mapping[str, bytes] = NO_MEMORY
    ) -> MissionParts:
        """What the mission brings to the peer of one slot."""
        rng, ground = Random(f"{self.scenario.run.seed}/mapf/{slot}"), self.ground
        assert isinstance(ground, CellMap)
        return pathfinding_parts(slot, ground, VEHICLE, rng, self.goals[slot], len(self.goals))
