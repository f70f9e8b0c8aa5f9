"""Indoor places to explore: scenario files with walls, and the cells that can truly be seen."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from math import dist, hypot
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import Field

from agent.exploration.exploration_task import ORDERS_MAX
from agent.interface.geometry import Point
from agent.mapping.inflation import Inflation
from agent.mapping.occupancy_grid import INFLATION_M
from agent.runtime.declared_values import FieldTable, OrderTable, UnknownPlaceTable
from agent.runtime.peer_factory import NO_MEMORY, MissionParts
from crdt.allocation import FieldAllocationCRDT
from sim.scenarios.fleet_setup import FleetSetup
from sim.scenarios.scenario import ARENAS, FleetTable, Scenario, ScenarioError, load_kind
from sim.world.drive_trains import Chassis
from sim.world.lidar import Lidar
from sim.world.world import World

Box = tuple[float, float, float, float]


class ArenaTable(UnknownPlaceTable):
    """A walled rectangle round the origin, and solid rectangles in it: west, south, east, north."""

    solid: list[Box] = Field(default=[])
    starts: list[Point]
    rays: int = Field(default=36, ge=4, le=720)


class ArenaFleet(FleetTable):
    """The robots of an arena, smaller and slower than those of a field."""

    robots: int = Field(default=3, ge=1, le=108)
    radius_m: float = Field(default=0.15, gt=0.05, le=5.0)
    speed_m_s: float = Field(default=0.5, gt=0.05, le=12.7)
    acceleration_m_s2: float = Field(default=1.0, gt=0.05, le=10.0)
    silence: Literal["stop", "slow", "continue"] = "continue"


class ExplorationScenario(Scenario):
    """A scenario file with `mission = "exploration"`."""

    mission: Literal["exploration"] = "exploration"  # type: ignore[assignment]
    field: FieldTable = FieldTable(file="")  # there is no field
    arena: ArenaTable
    order: list[OrderTable] = Field(default=[], max_length=ORDERS_MAX)


class ExplorationFile(ExplorationScenario):
    """A scenario file with `mission = "exploration"`, with the smaller robots of an arena as defaults."""

    fleet: ArenaFleet = ArenaFleet()


def load_arena(name: str) -> ExplorationScenario:
    """Load by file, or by the name of a shipped one."""
    return load_kind(name, ExplorationFile, ARENAS)


class ExplorationSetup(FleetSetup):
    """The setup of an arena; only the world knows its walls, robots do not."""

    scenario: ExplorationScenario

    def __init__(self, scenario: ExplorationScenario) -> None:
        super().__init__(scenario)
        table = scenario.arena
        if scenario.fleet.robots > len(table.starts):
            raise ScenarioError(
                f"{scenario.name}: arena.starts: {len(table.starts)} places for "
                f"{scenario.fleet.robots} robots"
            )
        if table.too_fine:
            raise ScenarioError(f"{scenario.name}: arena.cell_m: {table.too_fine}")
        if table.too_short:
            raise ScenarioError(f"{scenario.name}: arena.range_m: {table.too_short}")
        _check_starts(scenario)
        for number, order in enumerate(scenario.order):
            if not all(table.holds(*point) for point in order.points):
                raise ScenarioError(
                    f"{scenario.name}: order.{number}.points: outside of the arena, which reaches "
                    f"{table.width_m / 2:g} m east and west, {table.height_m / 2:g} m north and south"
                )
            _check_order(scenario, number, order.points)
        self.starts = list(table.starts)
        self.order, self.geometry = table.merge_order, table.geometry
        row, column = self.geometry.cell(self.starts[0])
        if not self.open[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2].any():
            raise ScenarioError(
                f"{scenario.name}: arena.cell_m: of cells of {table.cell_m:g} m, none at the start of a "
                "robot is free for the most part"
            )

    @property
    def config_hash(self) -> int:
        text = f"{self.scenario.name} {self.geometry} {self.order.value}"
        return FieldAllocationCRDT.hash_of(text)

    @property
    def section_count(self) -> int:
        return 0  # tasks have numbers of their own

    def make_chassis(self) -> Chassis:
        radius_m = self.scenario.fleet.radius_m
        plain = super().make_chassis()
        return plain._replace(
            wheel_radius_m=radius_m / 4, half_base_m=radius_m / 2, half_track_m=radius_m / 2
        )

    def parts(
        self, slot: int, now_us: int = 0, recalled: Mapping[str, bytes] = NO_MEMORY
    ) -> MissionParts:
        """None: the run makes them, from the maps of the whole fleet."""
        return MissionParts()

    def world(self) -> World:
        table, run = self.scenario.arena, self.scenario.run
        half_w, half_h = table.width_m / 2, table.height_m / 2
        rings = [_ring((-half_w, -half_h, half_w, half_h)), *map(_ring, table.solid)]
        lidar = Lidar(table.rays, table.range_m)
        return self.populated(World(rings, run.seed, lidar, engine=run.engine))

    @cached_property
    def solid(self) -> NDArray[np.bool_]:
        """(rows, columns): cells of which the most part is in a solid object, or behind the wall."""
        g = self.geometry
        x = g.origin_m[0] + (np.arange(g.columns) + 0.5) * g.cell_m
        y = g.origin_m[1] + (np.arange(g.rows) + 0.5) * g.cell_m
        table = self.scenario.arena
        solid: NDArray[np.bool_] = np.abs(y)[:, None] > table.height_m / 2
        solid = solid | (np.abs(x) > table.width_m / 2)[None, :]
        for west, south, east, north in table.solid:
            solid |= ((y > south) & (y < north))[:, None] & ((x > west) & (x < east))[None, :]
        return solid

    @cached_property
    def open(self) -> NDArray[np.bool_]:
        """(rows, columns): cells that can be seen: free, and connected with the start of a robot."""
        regions, _ = scipy.ndimage.label(~self.solid)
        found: NDArray[np.bool_] = np.zeros(regions.shape, dtype=np.bool_)
        for start in self.starts[: self.scenario.fleet.robots]:
            found |= self._region_of_start(regions, start)
        return found

    @cached_property
    def reachable(self) -> NDArray[np.bool_]:
        """(rows, columns): the cells of `open` in sight of a position that a robot can drive to.

        Robots keep their margin from all that is solid, so a body may fit where none of them drives.
        """
        reach_m = self.scenario.fleet.radius_m + INFLATION_M
        margin = Inflation(self.solid, reach_m / self.geometry.cell_m, walled=True)
        regions, _ = scipy.ndimage.label(~margin.blocked)
        rooms, _ = scipy.ndimage.label(~self.solid)
        home = np.zeros(self.solid.shape, dtype=np.bool_)
        for start in self.starts[: self.scenario.fleet.robots]:
            room = self._region_of_start(rooms, start)
            home |= self._region_of_start(np.where(room, regions, 0), start)
        # A body in a narrow place may start in a cell of which the most part is solid.
        near = scipy.ndimage.binary_dilation(home, np.ones((3, 3))) & self.open
        into_corners = 2 * int(np.ceil(reach_m / self.geometry.cell_m))
        found: NDArray[np.bool_] = scipy.ndimage.binary_dilation(
            near, iterations=into_corners, mask=self.open
        )  # not through a wall
        return found

    def _region_of_start(self, regions: NDArray[np.int32], at: Point) -> NDArray[np.bool_]:
        """(rows, columns): the region nearest to a start; its cell alone if there is none.

        `regions`: (rows, columns), 0 where none is. A body may start nearer to a wall than the cells of a
        region are.
        """
        start, cells = self.geometry.cell(at), np.argwhere(regions)
        found: NDArray[np.bool_] = np.zeros(regions.shape, dtype=np.bool_)
        if len(cells):
            gap = np.hypot(*(cells - start).T)
            found = regions == regions[tuple(cells[np.argmin(gap)])]
        else:
            found[start] = True
        return found


def _check_starts(scenario: ExplorationScenario) -> None:
    """Raises ScenarioError where a robot would begin in a wall or in another robot."""
    table, radius_m = scenario.arena, scenario.fleet.radius_m
    half_w, half_h = table.width_m / 2 - radius_m, table.height_m / 2 - radius_m
    starts = table.starts[: scenario.fleet.robots]
    for number, (x, y) in enumerate(starts):
        where = f"{scenario.name}: arena.starts: robot {number} at {x:g},{y:g}"
        if abs(x) > half_w or abs(y) > half_h:
            raise ScenarioError(
                f"{where}: with its radius of {radius_m:g} m it is not inside of the arena, "
                f"which reaches {table.width_m / 2:g} m east and west, "
                f"{table.height_m / 2:g} m north and south"
            )
        for box in table.solid:
            west, south, east, north = box
            if hypot(max(west - x, x - east, 0), max(south - y, y - north, 0)) < radius_m:
                raise ScenarioError(f"{where}: it touches the solid rectangle {list(box)}")
        for other in range(number):
            if dist(starts[other], (x, y)) < 2 * radius_m:
                raise ScenarioError(
                    f"{where}: it touches robot {other}; both have a radius of {radius_m:g} m"
                )


def _check_order(scenario: ExplorationScenario, number: int, points: Sequence[Point]) -> None:
    """Raises ScenarioError for a point so near to the outer wall that no robot can stand there.

    Robots find out by themselves which points are in solid rectangles."""
    table, radius_m = scenario.arena, scenario.fleet.radius_m
    for x, y in points:
        if abs(x) > table.width_m / 2 - radius_m or abs(y) > table.height_m / 2 - radius_m:
            raise ScenarioError(
                f"{scenario.name}: order.{number}.points: no robot can stand at {x:g}, {y:g}, "
                f"nearer to the wall than its radius of {radius_m:g} m"
            )


def _ring(box: Box) -> list[Point]:
    west, south, east, north = box
    return [(west, south), (east, south), (east, north), (west, north)]
