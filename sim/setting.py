"""Everything a run is made of, from its scenario: field, grid, world, safety policy, keys.

Read once, shared by the peers of one process: the field and its grid are immutable, so sharing them
gives nobody knowledge that it would not have computed alike.
"""

from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Point

from agent.field import XY, Field, rasterise, start_poses
from agent.motion import FENCE_M
from agent.route import Route
from agent.safety import SilencePolicy
from agent.swaths import divide
from protocol.authentication import Keyring, Keys
from sim.field_file import FieldFileError, read_boundary
from sim.key_file import FLEET, KeyFileError, read
from sim.lidar import Lidar
from sim.scenario import Scenario, ScenarioError
from sim.vehicle import Chassis
from sim.world import World

ROUTE_CELLS_MAX = 1_500_000  # of the path grid; larger fields get coarser cells
ROUTE_CELL_M = 0.5
CLEARANCE_M = 0.3  # paths keep this much more than the radius from fences and holes
SPACING_RADII = 3.0  # between robots at the gate


class Setting:
    def __init__(self, scenario: Scenario) -> None:
        """Raises ScenarioError where the field cannot be used."""
        self.scenario = scenario
        self.field = self._field()
        self.keys = self._keys()
        self.silence = SilencePolicy[scenario.fleet.silence.upper()]
        beside_m = (self.field.implement_width_m - self.field.overlap_m) / 2
        if scenario.fleet.radius_m + FENCE_M > beside_m:
            raise ScenarioError(
                f"{scenario.name}: fleet.radius_m: {scenario.fleet.radius_m} m is too wide for swaths "
                f"{beside_m:.2f} m from fences; use {beside_m - FENCE_M:.2f} m at most"
            )
        spacing_m = SPACING_RADII * scenario.fleet.radius_m
        try:
            self.starts: list[XY] = start_poses(
                self.field, scenario.fleet.robots, spacing_m, scenario.fleet.radius_m + CLEARANCE_M
            )
        except ValueError as problem:
            raise ScenarioError(f"{scenario.name}: fleet.robots: {problem}") from None

    def _keys(self) -> Keys | None:
        name = self.scenario.fleet.keys
        if name is None:
            return None
        try:
            return read(self.scenario.folder / name, FLEET).keys
        except KeyFileError as problem:
            raise ScenarioError(f"{self.scenario.name}: fleet.keys: {problem}") from None

    def _field(self) -> Field:
        table = self.scenario.field
        path = (
            Path(table.file)
            if Path(table.file).is_absolute()
            else self.scenario.folder / table.file
        )
        try:
            boundary = read_boundary(path, table.feature)
            gate = table.gate or self._corner(boundary.polygon.exterior.coords)
            if not boundary.polygon.buffer(0.5).contains(Point(gate)):
                raise ScenarioError(f"{self.scenario.name}: field.gate: {gate} is not in the field")
            return divide(
                boundary.name, boundary.polygon, boundary.origin, gate, table.implement_width_m,
                table.overlap_m, table.section_length_m, table.unit_m,
            )  # fmt: skip
        except FieldFileError as problem:
            raise ScenarioError(f"{self.scenario.name}: field.file: {problem}") from None
        except ValueError as problem:
            raise ScenarioError(
                f"{self.scenario.name}: field.implement_width_m: {problem}"
            ) from None

    @staticmethod
    def _corner(outline: object) -> XY:
        """Without a gate in the scenario: the south-western corner of the outline."""
        points = [(float(p[0]), float(p[1])) for p in outline]  # type: ignore[attr-defined]
        return min(points, key=lambda p: (p[0] + p[1], p))

    @cached_property
    def _grid(self) -> tuple[NDArray[np.bool_], float, float, float]:
        west, south, east, north = self.field.polygon.bounds
        cell_m = ROUTE_CELL_M
        while (east - west) * (north - south) / cell_m**2 > ROUTE_CELLS_MAX:
            cell_m *= 2
        return rasterise(self.field, cell_m, self.scenario.fleet.radius_m + CLEARANCE_M)

    @cached_property
    def route(self) -> Route:
        return Route(*self._grid)

    @cached_property
    def fences(self) -> NDArray[np.float64]:
        """Every outline as segments (n, 4) in metres."""
        segments = [
            (*a, *b)
            for ring in (self.field.exterior, *self.field.holes)
            for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)
            if a != b
        ]
        return np.array(segments, dtype=np.float64)

    def world(self) -> World:
        """A fresh world with every robot at its place near the gate."""
        fleet = self.scenario.fleet
        rings = [self.field.exterior, *self.field.holes]
        world = World(rings, self.scenario.run.seed, Lidar(fleet.rays))
        chassis = Chassis(
            speed_m_s=fleet.speed_m_s, acceleration_m_s2=fleet.acceleration_m_s2, slip=fleet.slip
        )
        for slot, at in enumerate(self.starts):
            world.add_robot(slot, at, fleet.radius_m, chassis)
        return world

    def keyring(self, sender: int, lot: str) -> Keyring | None:
        """`lot`: anything that no two starts of this sender share."""
        return None if self.keys is None else Keyring(self.keys, sender, lot.encode())
