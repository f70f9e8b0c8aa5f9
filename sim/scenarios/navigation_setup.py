"""A fleet in a building: a map of walls, the starts of the robots, and the goals of each.

setting = NavigationSetup.made("swap", floor, starts=[(0.5, 0.5)], goals=[[(9.5, 0.5)]])
outcome = NavigationRun(setting).run()
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from random import Random

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import Point
from agent.mapping.building import Floor
from agent.runtime.declared_values import FieldTable
from agent.runtime.mission_parts import navigation_parts
from agent.runtime.peer_factory import NO_MEMORY, MissionParts
from sim.scenarios.fleet_setup import FleetSetup
from sim.scenarios.scenario import BusTable, FleetTable, RunTable, Scenario
from sim.world.lidar import Lidar
from sim.world.temporary_obstacles import TemporaryObstacle, schedule
from sim.world.walls import Grid
from sim.world.world import World


class NavigationSetup(FleetSetup):
    """A building with robots in it, the goals of each in their order, and boxes that come and go."""

    def __init__(
        self,
        scenario: Scenario,
        floor: Floor,
        starts: Sequence[Point],
        goals: Sequence[Sequence[Point]],
        agrees: bool = True,
        dropped: Sequence[TemporaryObstacle] = (),
    ) -> None:
        """`goals`: of each robot, in their order. `agrees`: False for ORCA alone. `dropped`: boxes
        that appear and vanish."""
        assert len(starts) == len(goals) == scenario.fleet.robots
        super().__init__(scenario)
        self.floor, self.agrees = floor, agrees
        self.starts, self.goals = list(starts), {k: tuple(own) for k, own in enumerate(goals)}
        self.dropped, self.appeared = dropped, list[TemporaryObstacle]()

    @classmethod
    def made(
        cls,
        name: str,
        floor: Floor,
        starts: Sequence[Point],
        goals: Sequence[Sequence[Point]],
        *,
        seed: int = 1,
        loss: float = 0.0,
        speed_m_s: float = 1.0,
        time_limit_s: float = 600.0,
        agrees: bool = True,
    ) -> "NavigationSetup":
        """A setup without a file: `starts` and `goals` are metres, `loss` is a share of all frames
        from 0 to 1."""
        scenario = Scenario(
            name=name,
            field=FieldTable(file="none"),
            fleet=FleetTable(
                robots=len(starts), radius_m=floor.radius_m, speed_m_s=speed_m_s,
                acceleration_m_s2=2.0,
            ),
            bus=BusTable(loss=loss),
            run=RunTable(seed=seed, time_limit_s=time_limit_s),
            folder=Path(),
        )  # fmt: skip
        return cls(scenario, floor, starts, goals, agrees)

    @property
    def config_hash(self) -> int:
        return self.floor.check

    @property
    def section_count(self) -> int:
        return sum(len(own) for own in self.goals.values())

    def free_space(self, radius_m: float) -> Callable[[float, float], bool]:
        return self.floor.holds

    def parts(
        self, slot: int, now_us: int = 0, recalled: Mapping[str, bytes] = NO_MEMORY
    ) -> MissionParts:
        """What the mission brings to the peer of one slot, which boots now with this memory."""
        return navigation_parts(
            slot, self.goals, self.floor, self.vehicle, now_us,
            agrees=self.agrees, asks=self.scenario.fleet.asks,
        )  # fmt: skip

    def world(self) -> World:
        """A new world with every robot at its start, and the boxes that will appear in it."""
        floor, run = self.floor, self.scenario.run
        grid = Grid(floor.walls, *floor.origin, floor.cell_m)
        world = self.populated(World([], run.seed, Lidar(), grid, run.engine))
        self.appeared = schedule(world, self.dropped, self.scenario.fleet.radius_m)
        return world


def scattered(
    floor: Floor, count: int, rng: Random, apart_m: float, among: NDArray[np.intp] | None = None
) -> list[Point]:
    """Places for robots in metres, on connected nodes of the lattice, this far from each other.
    Raises ValueError if there are too few."""
    lattice = floor.lattice
    home = int(np.argmax(np.bincount(lattice.component)))
    nodes = np.flatnonzero(lattice.component == home) if among is None else among
    order = nodes.tolist()
    rng.shuffle(order)
    found: list[Point] = []
    for node in order:
        x_m, y_m = lattice.point(node)
        if all((x_m - a) ** 2 + (y_m - b) ** 2 >= apart_m**2 for a, b in found):
            found.append((x_m, y_m))
            if len(found) == count:
                return found
    raise ValueError(f"no room for {count} robots {apart_m} m apart")
