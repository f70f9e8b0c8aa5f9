"""The setup of a run from its scenario: field, grid, world, safety policy, keys.

It is read once and shared by the peers of one process. The field and its grid are immutable, so
sharing gives no peer knowledge that it would not have computed equally.
"""

from functools import cached_property
from math import radians
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Point, Polygon

from agent.field.field_division import divide
from agent.field.field_map import XY, Field, joins, rasterise, start_poses
from agent.field.field_mission import FieldMission
from agent.field.tractor_mission import TractorMission
from agent.interface.config import BRAKING_SHARE
from agent.interface.identity import SilencePolicy
from agent.interface.mission import Mission
from agent.interface.motion_controller import BodyLimits as BodyLimits
from agent.motion.holonomic_motion import FENCE_M, HolonomicMotion
from agent.motion.path_tracker import ALIGN_M
from agent.motion.tractor_motion import TractorMotion
from agent.motion.tractor_tracker import SteeringLimits
from agent.paths.route import Route
from agent.paths.tractor_route import TurnRoute
from agent.runtime.files.field_error import FILE_BYTES_MAX, FieldFileError
from agent.runtime.files.field_file import read_boundary
from agent.runtime.files.given_file import GivenFileError, read_bytes
from agent.runtime.files.key_file import FLEET, KeyFileError, read
from protocol.authentication import Keyring, Keys
from sim.scenarios.scenario import Crash, CrashWorking, Scenario, ScenarioError
from sim.scenarios.time_limit import time_limit_s
from sim.world.drive_trains import Chassis, Kind
from sim.world.lidar import Lidar
from sim.world.raster import Raster
from sim.world.reachable_ground import Body, Ground, reachable_ground
from sim.world.world import World

ROUTE_CELLS_MAX = 1_500_000  # of the path grid; larger fields get larger cells
ROUTE_CELL_M = 0.5
CLEARANCE_M = 0.3  # paths keep this distance from fences and holes, in addition to the radius
assert CLEARANCE_M > FENCE_M + ALIGN_M / 2, (
    "avoidance permits what was planned, a little off it too"
)
TURN_CELL_M = 0.25  # the same for bodies that steer, because turns need decimetres
# Planned circles are wider than the tightest one by this factor; the rest is for corrections.
TURN_SPARE = 1.2
# A body that can turn on the spot need not do so, and driving a curve is faster.
PIVOT_RADIUS_M = 0.6
PIVOT_STEER_1_M_S = 6.0  # its curvature changes as fast as its wheels turn
DEADLY = (Crash, CrashWorking)  # faults after which a robot may not work
SPACING_RADII = 3.0  # spacing of robots at the gate


def keys_of(scenario: Scenario) -> Keys | None:
    """The keys of its fleet, if it has any."""
    name = scenario.fleet.keys
    if name is None:
        return None
    try:
        return read(scenario.folder / name, FLEET).keys
    except KeyFileError as problem:
        raise ScenarioError(f"{scenario.name}: fleet.keys: {problem}") from None


FIELDS_MAX = 8  # a campaign uses one field
_fields: dict[tuple[object, ...], Field] = {}  # by all their inputs: dividing a field takes 80 ms


class Setting:
    def __init__(self, scenario: Scenario) -> None:
        """Raises ScenarioError if the field cannot be used."""
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
        return keys_of(self.scenario)

    def _field(self) -> Field:
        table = self.scenario.field
        path = self.scenario.path_of(table.file)
        try:
            content = read_bytes(path, FILE_BYTES_MAX)
        except GivenFileError:
            return self._divided(path)  # this raises the error with its reason
        key = (
            path,
            content,
            table.model_dump_json(),
            self.turn_radius_m,
            self.scenario.fleet.radius_m,
        )
        found = _fields.get(key)
        if found is None:
            if len(_fields) >= FIELDS_MAX:
                _fields.clear()
            found = _fields[key] = self._divided(path)
        return found

    def _divided(self, path: Path) -> Field:
        table = self.scenario.field
        try:
            boundary = read_boundary(path, table.feature)
            gate = table.gate or self._corner(boundary.polygon.exterior.coords)
            if not boundary.polygon.buffer(0.5).contains(Point(gate)):
                raise ScenarioError(f"{self.scenario.name}: field.gate: {gate} is not in the field")
            return divide(
                boundary.name, boundary.polygon, boundary.origin, gate, table.implement_width_m,
                table.overlap_m, table.section_length_m, table.unit_m, self.turn_radius_m,
                self.scenario.fleet.radius_m + FENCE_M,
            )  # fmt: skip
        except FieldFileError as problem:
            raise ScenarioError(f"{self.scenario.name}: field.file: {problem}") from None
        except ValueError as problem:
            raise ScenarioError(
                f"{self.scenario.name}: field.implement_width_m: {problem}"
            ) from None

    @staticmethod
    def _corner(outline: object) -> XY:
        """The start if the scenario has no gate: the south-western corner of the outline."""
        points = [(float(p[0]), float(p[1])) for p in outline]  # type: ignore[attr-defined]
        return min(points, key=lambda p: (p[0] + p[1], p))

    @cached_property
    def _grid(self) -> tuple[NDArray[np.bool_], float, float, float]:
        """A path grid, finer if cells of the usual size close a passage that robots fit through."""
        clearance_m = self.scenario.fleet.radius_m + CLEARANCE_M
        cell_m = self._cells(ROUTE_CELL_M)
        grid = rasterise(self.field, cell_m, clearance_m, whole=True)
        while grid[0].size * 4 <= ROUTE_CELLS_MAX and not joins(self.field, grid, clearance_m):
            cell_m /= 2
            grid = rasterise(self.field, cell_m, clearance_m, whole=True)
        return grid

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

    @cached_property
    def chassis(self) -> Chassis:
        fleet = self.scenario.fleet
        plain = Chassis(
            speed_m_s=fleet.speed_m_s, acceleration_m_s2=fleet.acceleration_m_s2, slip=fleet.slip,
            kind=Kind[fleet.drive.upper()],
        )  # fmt: skip
        if plain.kind is Kind.MECANUM:
            return plain
        return plain._replace(
            wheel_radius_m=0.4, half_base_m=fleet.wheelbase_m / 2, half_track_m=fleet.track_m / 2,
            steer_rad=radians(fleet.steer_deg), lead_m=fleet.wheelbase_m,
        )  # fmt: skip

    @cached_property
    def turn_radius_m(self) -> float:
        """The radius of planned paths; 0 for a body that moves in any direction without turning."""
        if self.chassis.kind is Kind.MECANUM:
            return 0.0
        return max(self.chassis.turn_radius_m * TURN_SPARE, PIVOT_RADIUS_M)

    @cached_property
    def steering(self) -> SteeringLimits:
        """The limits of a body that steers."""
        fleet, chassis = self.scenario.fleet, self.chassis
        rate = chassis.steer_rad_s / fleet.wheelbase_m
        if chassis.kind is Kind.DIFFERENTIAL:
            rate = PIVOT_STEER_1_M_S
        return SteeringLimits(fleet.speed_m_s, BRAKING_SHARE * fleet.acceleration_m_s2, rate)

    @cached_property
    def turns(self) -> TurnRoute:
        """Paths of a body that steers, on a finer grid than `route`."""
        cell_m, clearance_m = self._cells(TURN_CELL_M), self.scenario.fleet.radius_m + FENCE_M
        return TurnRoute(*rasterise(self.field, cell_m, clearance_m), self.turn_radius_m)

    def _cells(self, cell_m: float) -> float:
        west, south, east, north = self.field.polygon.bounds
        while (east - west) * (north - south) / cell_m**2 > ROUTE_CELLS_MAX:
            cell_m *= 2
        return cell_m

    def floor_space(self, radius_m: float) -> Polygon:
        """The area in which the middle of a body can be."""
        return self.field.polygon.buffer(-radius_m)

    def ground(self, raster: Raster) -> Ground:
        """Which part of the area asked for these bodies can work. `raster`: see
        `sim/world/coverage_truth.py`."""
        field, radius_m = self.field, self.scenario.fleet.radius_m
        body = Body(field.implement_width_m, field.overlap_m, radius_m, self.turn_radius_m)
        return reachable_ground(field.polygon, raster, body, self.starts)

    @property
    def time_limit_s(self) -> float:
        """The scenario's limit; by default from the field and the robots that work to the end."""
        scenario = self.scenario
        if "time_limit_s" in scenario.run.model_fields_set:
            return scenario.run.time_limit_s
        crashed = {fault.robot for fault in scenario.fault if isinstance(fault, DEADLY)}
        ends_s = [fault.at_s + getattr(fault, "for_s", 0.0) for fault in scenario.fault]
        fleet = scenario.fleet
        return time_limit_s(
            self.field, fleet.robots - len(crashed), fleet.speed_m_s, max(ends_s, default=0.0)
        )

    @property
    def config_hash(self) -> int:
        return self.field.config_hash

    @property
    def section_count(self) -> int:
        return len(self.field.sections)

    def mission(self, slot: int) -> Mission:
        fleet = self.scenario.fleet
        if self.turn_radius_m:
            return TractorMission(self.field, self.route, self.turns, fleet.radius_m, self.steering)
        braking_m_s2 = BRAKING_SHARE * fleet.acceleration_m_s2
        return FieldMission(self.field, self.route, fleet.radius_m, fleet.speed_m_s, braking_m_s2)

    def motion(self, slot: int) -> HolonomicMotion:
        fleet = self.scenario.fleet
        limits = BodyLimits(fleet.radius_m, fleet.speed_m_s, fleet.acceleration_m_s2)
        if self.turn_radius_m:
            return TractorMotion(slot, limits, self.turns, self.steering, self.fences)
        half_bar_m = self.field.implement_width_m / 2 - self.field.overlap_m
        return HolonomicMotion(slot, limits, self.fences, half_bar_m=half_bar_m)

    def world(self) -> World:
        """A new world with every robot at its place near the gate."""
        fleet = self.scenario.fleet
        rings = [self.field.exterior, *self.field.holes]
        run = self.scenario.run
        world = World(rings, run.seed, Lidar(fleet.rays), engine=run.engine)
        chassis = self.chassis
        for slot, at in enumerate(self.starts):
            world.add_robot(slot, at, fleet.radius_m, chassis)
        return world

    def keyring(self, sender: int, lot: str) -> Keyring | None:
        """`lot`: any value that no two starts of this sender share."""
        return None if self.keys is None else Keyring(self.keys, sender, lot.encode())
