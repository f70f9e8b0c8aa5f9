"""The setup of a run from its scenario: field, grid, world, safety policy, keys.

It is read once and shared by the peers of one process. The field and its grid are immutable, so
sharing gives no peer knowledge that it would not have computed equally.
"""

from collections.abc import Mapping
from functools import cached_property
from math import radians
from pathlib import Path

from shapely.geometry import Polygon

from agent.field.field_map import XY, Field, start_poses
from agent.field.field_plan import (
    CLEARANCE_M,
    FieldError,
    FieldPlan,
    FieldValues,
    divided,
    planned_radius_m,
)
from agent.interface.identity import SilencePolicy
from agent.interface.motion_controller import BodyLimits as BodyLimits
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.runtime.files.field_error import FILE_BYTES_MAX, FieldFileError
from agent.runtime.files.field_file import read_boundary
from agent.runtime.files.given_file import GivenFileError, read_bytes
from agent.runtime.files.key_file import FLEET, KeyFileError, read
from agent.runtime.mission_parts import field_parts
from agent.runtime.peer_factory import NO_MEMORY, MissionParts, keyring_of
from protocol.authentication import Keyring, Keys
from sim.scenarios.scenario import Crash, CrashWorking, FleetTable, Scenario, ScenarioError
from sim.scenarios.time_limit import time_limit_s
from sim.world.drive_trains import Chassis
from sim.world.lidar import Lidar
from sim.world.raster import Raster
from sim.world.reachable_ground import Body, Ground, reachable_ground
from sim.world.world import World

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


def vehicle_of(fleet: FleetTable) -> Vehicle:
    return Vehicle(
        fleet.radius_m, fleet.speed_m_s, fleet.acceleration_m_s2,
        DriveTrain[fleet.drive.upper()], fleet.wheelbase_m, fleet.track_m,
        radians(fleet.steer_deg),
    )  # fmt: skip


FIELDS_MAX = 8  # a campaign uses one field
_fields: dict[tuple[object, ...], Field] = {}  # by all their inputs: dividing a field takes 80 ms


class Setting:
    def __init__(self, scenario: Scenario) -> None:
        """Raises ScenarioError if the field cannot be used."""
        self.scenario = scenario
        self.field = self._field()
        self.keys = self._keys()
        self.silence = SilencePolicy[scenario.fleet.silence.upper()]
        try:
            self.plan = FieldPlan(self.field, self.vehicle)
        except FieldError as problem:
            raise ScenarioError(f"{scenario.name}: {problem}") from None
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
        values = FieldValues(
            table.implement_width_m, table.overlap_m, table.section_length_m, table.unit_m,
            table.gate,
        )  # fmt: skip
        try:
            boundary = read_boundary(path, table.feature)
            return divided(*boundary, values, self.vehicle)
        except FieldFileError as problem:
            raise ScenarioError(f"{self.scenario.name}: field.file: {problem}") from None
        except FieldError as problem:
            raise ScenarioError(f"{self.scenario.name}: {problem}") from None

    @cached_property
    def vehicle(self) -> Vehicle:
        return vehicle_of(self.scenario.fleet)

    @cached_property
    def chassis(self) -> Chassis:
        fleet = self.scenario.fleet
        plain = Chassis(
            speed_m_s=fleet.speed_m_s, acceleration_m_s2=fleet.acceleration_m_s2, slip=fleet.slip,
            kind=self.vehicle.drive,
        )  # fmt: skip
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

    def parts(
        self, slot: int, now_us: int = 0, recalled: Mapping[str, bytes] = NO_MEMORY
    ) -> MissionParts:
        """What the mission brings to the peer of one slot, which boots now with this memory."""
        return field_parts(slot, self.plan)

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
        return keyring_of(self.keys, sender, lot.encode())
