"""The setup of a fleet that works a field: the field, its plan, its world."""

from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path

import shapely

from agent.field.field_map import Field, start_poses
from agent.field.field_plan import (
    CLEARANCE_M,
    FieldError,
    FieldPlan,
    divided,
    planned_radius_m,
)
from agent.interface.geometry import Point
from agent.interface.vehicle import DriveTrain
from agent.runtime.files.field_error import FILE_BYTES_MAX, FieldFileError
from agent.runtime.files.field_file import read_boundary
from agent.runtime.files.given_file import GivenFileError, read_bytes
from agent.runtime.mission_parts import field_parts, values_of
from agent.runtime.peer_factory import NO_MEMORY, MissionParts
from sim.scenarios.drawn_field import drawn_boundary
from sim.scenarios.fleet_setup import FleetSetup
from sim.scenarios.scenario import (
    Box,
    Crash,
    CrashWorking,
    Fault,
    Order,
    PassingVehicle,
    Person,
    Scenario,
    ScenarioError,
    is_drawn,
)
from sim.scenarios.time_limit import time_limit_s
from sim.world.drive_trains import Chassis
from sim.world.lidar import Lidar
from sim.world.raster import Raster
from sim.world.reachable_ground import Ground, WorkingBody, reachable_ground
from sim.world.world import World

DEADLY = (Crash, CrashWorking)  # faults after which a robot may not work
SPACING_RADII = 3.0  # spacing of robots at the gate
# Smaller bodies begin where bodies of this radius would, if there is room. At 0.4 m from each other,
# avoidance left them 0.05 m to begin their turns with, and some could not turn between two fences.
STARTS_AS_M = 0.8


FIELDS_MAX = 8  # a campaign uses one field
_fields: dict[tuple[object, ...], Field] = {}  # by all their inputs: dividing a field takes 80 ms


class FieldSetup(FleetSetup):
    """A field with its sections and swaths, and the bodies that work it."""

    def __init__(self, scenario: Scenario) -> None:
        """Raises ScenarioError if the field cannot be used."""
        super().__init__(scenario)
        self.field = self._field()
        try:
            self.plan = FieldPlan(self.field, self.vehicle)
        except FieldError as problem:
            raise ScenarioError(f"{scenario.name}: {problem}") from None
        self.starts = self._starts()
        self._check_places()

    def _starts(self) -> list[Point]:
        """Places of the robots, (x, y) metres. ScenarioError if there is no room for all."""
        own_m, count = self.scenario.fleet.radius_m, self.scenario.fleet.robots
        for radius_m in (max(own_m, STARTS_AS_M), own_m):
            clearance_m = radius_m + CLEARANCE_M
            room = self.field.polygon.buffer(-clearance_m)
            if room.is_empty and radius_m > own_m:
                continue
            try:
                return start_poses(self.field, count, SPACING_RADII * radius_m, clearance_m)
            except ValueError as problem:
                why = problem
        raise ScenarioError(f"{self.scenario.name}: fleet.robots: {why}") from None

    def _check_places(self) -> None:
        """ScenarioError for an obstacle or a goal where no robot of this field could ever meet it."""
        bounds = west, south, east, north = self.field.polygon.bounds
        for number, fault in enumerate(self.scenario.fault):
            if is_met_within(fault, bounds):
                continue
            x_m, y_m = _met_at(fault)[1][0]
            raise ScenarioError(
                f"{self.scenario.name}: fault.{number}: {x_m:g}, {y_m:g} is outside of the field, "
                f"which reaches from {west:.0f} to {east:.0f} m east and from {south:.0f} to "
                f"{north:.0f} m north of its middle"
            )

    def _field(self) -> Field:
        table = self.scenario.field
        path = self.scenario.path_of(table.file)
        try:
            content = b"" if is_drawn(table.file) else read_bytes(path, FILE_BYTES_MAX)
        except GivenFileError:
            return self._divided(path)  # this raises the error with its reason
        key = (
            path,
            content,
            table.model_dump_json(),
            self.turn_radius_m,
            self.scenario.fleet.radius_m,
            self.scenario.fleet.robots,
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
            boundary = (
                drawn_boundary(table.file)
                if is_drawn(table.file)
                else read_boundary(path, table.feature)
            )
            return divided(*boundary, values_of(table, self.scenario.fleet.robots), self.vehicle)
        except FieldFileError as problem:
            raise ScenarioError(f"{self.scenario.name}: field.file: {problem}") from None
        except FieldError as problem:
            raise ScenarioError(f"{self.scenario.name}: {problem}") from None

    def make_chassis(self) -> Chassis:
        fleet = self.scenario.fleet
        plain = super().make_chassis()._replace(kind=self.vehicle.drive)
        if plain.kind is DriveTrain.MECANUM:
            return plain
        return plain._replace(
            wheel_radius_m=0.4, half_base_m=fleet.wheelbase_m / 2, half_track_m=fleet.track_m / 2,
            steer_rad=self.vehicle.steer_rad, steer_rad_s=self.vehicle.steer_rad_s,
            lead_m=fleet.wheelbase_m,
        )  # fmt: skip

    @property
    def turn_radius_m(self) -> float:
        """The radius of planned paths; 0 for a body that moves in any direction without turning."""
        return planned_radius_m(self.vehicle)

    def free_space(self, radius_m: float) -> Callable[[float, float], bool]:
        inside = self.field.polygon.buffer(-radius_m)
        return lambda x_m, y_m: bool(inside.contains(shapely.Point(x_m, y_m)))

    def ground(self, raster: Raster) -> Ground:
        """Which part of the area asked for these bodies can work. `raster`: see
        `sim/world/coverage_truth.py`."""
        field, radius_m = self.field, self.scenario.fleet.radius_m
        body = WorkingBody(field.implement_width_m, field.overlap_m, radius_m, self.turn_radius_m)
        return reachable_ground(field.polygon, raster, body, self.starts)

    @property
    def time_limit_s(self) -> float:
        """The scenario's limit; by default from the field and the robots that work to the end."""
        scenario = self.scenario
        if "time_limit_s" in scenario.run.model_fields_set:
            return scenario.run.time_limit_s
        crashed = {fault.robot for fault in scenario.fault if isinstance(fault, DEADLY)}
        ends_at_s = [fault.at_s + getattr(fault, "for_s", 0.0) for fault in scenario.fault]
        fleet = scenario.fleet
        return time_limit_s(
            self.field, fleet.robots - len(crashed), fleet.speed_m_s, max(ends_at_s, default=0.0)
        )

    @property
    def config_hash(self) -> int:
        return self.field.config_hash

    @property
    def section_count(self) -> int:
        return len(self.field.sections)

    @cached_property
    def unreachable(self) -> frozenset[int]:
        """The sections that no robot can reach from its start."""
        apart = [self.plan.parts.apart_from(start) for start in self.starts]
        return frozenset.intersection(*apart)

    @property
    def reachable_count(self) -> int:
        return self.section_count - len(self.unreachable)

    def parts(
        self, slot: int, now_us: int = 0, recalled: Mapping[str, bytes] = NO_MEMORY
    ) -> MissionParts:
        """What the mission brings to the peer of one slot, which boots now with this memory."""
        return field_parts(slot, self.plan)

    def world(self) -> World:
        """A new world with every robot at its place near the gate."""
        rings, run = [self.field.exterior, *self.field.holes], self.scenario.run
        lidar = Lidar(self.scenario.fleet.rays)
        return self.populated(World(rings, run.seed, lidar, engine=run.engine))


def is_met_within(fault: Fault, bounds: tuple[float, float, float, float]) -> bool:
    """Whether robots of a field with these bounds (west, south, east, north, metres) could ever meet it,
    or it has no place."""
    west, south, east, north = bounds
    reach_m, places = _met_at(fault)
    xs, ys = [x_m for x_m, _ in places], [y_m for _, y_m in places]
    return not places or (
        max(xs) >= west - reach_m and min(xs) <= east + reach_m
        and max(ys) >= south - reach_m and min(ys) <= north + reach_m
    )  # fmt: skip


def _met_at(fault: Fault) -> tuple[float, list[tuple[float, float]]]:
    """How far from its places a fault reaches, metres, and the places; none where it has none."""
    match fault:
        case Box(x_m=x_m, y_m=y_m, size_m=size_m):
            return size_m / 2, [(x_m, y_m)]
        case Person(route=route) | PassingVehicle(route=route):
            return 0.0, route
        case Order(order="set_goal", x_m=x_m, y_m=y_m):
            return 0.0, [(x_m, y_m)]
        case _:
            return 0.0, []
