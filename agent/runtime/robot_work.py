"""The work that a robot file declares, as the mission, motion controller and map of one robot."""

from collections.abc import Mapping
from random import Random
from typing import NamedTuple

from agent.coverage.cell_map import CellMap
from agent.coverage.proximity_guard import GridGuard
from agent.delivery.task_registry import TransportTask
from agent.delivery.warehouse import Warehouse
from agent.exploration.exploration_task import FleetFullError
from agent.field.field_plan import FieldError, FieldPlan, divided
from agent.interface.vehicle import DriveTrain
from agent.mapping.building import Floor, FloorError
from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import read_boundary
from agent.runtime.files.given_file import DRAWING_BYTES_MAX, GivenFileError, read_text
from agent.runtime.mission_parts import (
    MAP_TICK_US,
    carrier_of,
    coverage_parts,
    delivery_parts,
    exploration_parts,
    field_parts,
    navigation_parts,
    values_of,
)
from agent.runtime.peer_factory import NO_MISSION, MissionParts
from agent.runtime.robot_body import FactoryError, called
from agent.runtime.robot_file import (
    CarrierTable,
    ExplorationTable,
    NavigationTable,
    RobotError,
    RobotFile,
)
from crdt import FieldAllocationCRDT
from crdt.hybrid_clock import HybridClock
from crdt.occupancy import OccupancyMap
from crdt.sighting import TIME_MAX
from protocol.sync.map_sync import MapSync


class Work(NamedTuple):
    """What a robot works on."""

    field_hash: int  # u24; equal for all robots of a fleet; other work has another
    sections: int  # in all; 0: not known before
    parts: MissionParts


def work_of(robot: RobotFile, now_us: int, recalled: Mapping[str, bytes]) -> Work:
    """The work that a robot file declares. Raises RobotError.

    `now_us`: the time of the boot. `recalled`: the contents of the robot's durable memory.
    """
    slot = robot.robot.slot
    try:
        if robot.field is not None:
            boundary = read_boundary(robot.folder / robot.field.file, robot.field.feature)
            field = divided(
                *boundary, values_of(robot.field, robot.fleet.robots), robot.fleet.vehicle
            )
            parts = field_parts(slot, FieldPlan(field, robot.fleet.vehicle))
            return Work(field.config_hash, len(field.sections), parts)
        if robot.warehouse is not None:
            return _transports(robot, robot.warehouse, now_us, recalled)
        if robot.navigation is not None:
            return _errands(robot, robot.navigation, now_us)
        if robot.exploration is not None:
            return _unknown_place(robot, robot.exploration, now_us)
        if robot.coverage is not None:
            return _grid(robot, now_us)
        if robot.mission is not None:
            return _mission(robot, now_us)
    except FieldFileError as problem:
        raise RobotError(f"robot {slot}: field.file: {problem}") from None
    except (FieldError, FloorError) as problem:
        raise RobotError(f"robot {slot}: {problem}") from None
    except FactoryError as problem:
        raise RobotError(f"robot {slot}: mission.factory: {problem}") from None
    return Work(FieldAllocationCRDT.hash_of(robot.name), 0, NO_MISSION)


def _drawing(robot: RobotFile, work: str, value: str) -> str:
    """The map of a building: the value itself if it is a drawing, else the file. Raises RobotError."""
    if "\n" in value:
        return value
    try:
        return read_text(robot.folder / value, DRAWING_BYTES_MAX)
    except GivenFileError as problem:
        raise RobotError(f"robot {robot.robot.slot}: {work}.map: {problem}") from None


def _any_direction(robot: RobotFile, work: str) -> None:
    """Raises RobotError if the body does not suit this work."""
    if robot.fleet.vehicle.drive is not DriveTrain.MECANUM:
        raise RobotError(
            f"robot {robot.robot.slot}: fleet.drive: {work} needs a body that drives in any direction"
        )


def _transports(
    robot: RobotFile, table: CarrierTable, now_us: int, recalled: Mapping[str, bytes]
) -> Work:
    house, fleet = _house(robot, table), robot.fleet
    parts = delivery_parts(
        robot.robot.slot, fleet.robots, house, table.home, fleet.vehicle, table.seed, now_us,
        recalled, asks=fleet.asks,
    )  # fmt: skip
    return Work(house.check, 0, parts)


def _house(robot: RobotFile, table: CarrierTable) -> Warehouse:
    """The warehouse with the tasks that are known before the start. Raises RobotError, FloorError."""
    slot = robot.robot.slot
    text = _drawing(robot, "warehouse", table.map)
    floor = Floor.drawn(text, table.cell_m, robot.fleet.radius_m)
    carrier = carrier_of(table, robot.fleet, table.battery)
    plain, known = Warehouse(floor, carrier), dict[int, TransportTask]()
    for bay in table.bays:
        if plain.cell(bay) is None:
            raise RobotError(f"robot {slot}: warehouse.bays: {bay} is not on free floor")
    for task in table.task:
        pickup, dropoff = plain.cell(task.pickup), plain.cell(task.dropoff)
        if pickup is None or dropoff is None:
            raise RobotError(f"robot {slot}: warehouse.task {task.number}: not on free floor")
        known[task.number] = TransportTask(pickup, dropoff)
    return Warehouse(floor, carrier, table.bays, known, table.t_max)


def _errands(robot: RobotFile, table: NavigationTable, now_us: int) -> Work:
    slot, fleet, goals = robot.robot.slot, robot.fleet, table.goals
    _any_direction(robot, "navigation")
    if len(goals) != fleet.robots:
        raise RobotError(
            f"robot {slot}: navigation.goals: goals of {len(goals)} robots for {fleet.robots}"
        )
    text = _drawing(robot, "navigation", table.map)
    floor = Floor.drawn(text, table.cell_m, fleet.radius_m, table.margin_m)
    if len(floor.lattice) == 0:
        raise RobotError(
            f"robot {slot}: navigation.map: no place for a body of {fleet.radius_m} m radius"
        )
    for x_m, y_m in (goal for own in goals for goal in own):
        if not floor.route.admits((x_m, y_m)):
            raise RobotError(
                f"robot {slot}: navigation.goals: no robot can stand at {x_m:g}, {y_m:g}"
            )
    parts = navigation_parts(
        slot, dict(enumerate(goals)), floor, fleet.vehicle, now_us, asks=fleet.asks
    )
    return Work(floor.check, sum(map(len, goals)), parts)


def _unknown_place(robot: RobotFile, table: ExplorationTable, now_us: int) -> Work:
    slot, fleet, geometry = robot.robot.slot, robot.fleet, table.geometry
    _any_direction(robot, "exploration")
    if table.too_fine:
        raise RobotError(f"robot {slot}: exploration.cell_m: {table.too_fine}")
    if table.too_short:
        raise RobotError(f"robot {slot}: exploration.range_m: {table.too_short}")
    for number, order in enumerate(table.order):
        if not all(table.holds(*point) for point in order.points):
            raise RobotError(
                f"robot {slot}: exploration.order.{number}.points: outside of the place"
            )
    clock = HybridClock(now_us, MAP_TICK_US, TIME_MAX)
    sync = MapSync(slot, OccupancyMap(geometry, table.merge_order), clock, now_us)
    orders = [order.order for order in table.order]
    try:
        parts = exploration_parts(
            slot, fleet.robots, sync, fleet.vehicle, table.range_m, orders,
            robots_max=table.robots_max,
        )  # fmt: skip
    except FleetFullError as problem:
        raise RobotError(f"robot {slot}: exploration.robots_max: {problem}") from None
    text = f"{robot.name} {geometry} {table.merge_order.value}"
    return Work(FieldAllocationCRDT.hash_of(text), 0, parts)


def _grid(robot: RobotFile, now_us: int) -> Work:
    slot, fleet, table = robot.robot.slot, robot.fleet, robot.coverage
    assert table is not None
    _any_direction(robot, "coverage")
    text = _drawing(robot, "coverage", table.map)
    floor = Floor.drawn(text, table.cell_m, fleet.radius_m)
    if not GridGuard.fits(table.cell_m, fleet.radius_m, fleet.speed_m_s):
        raise RobotError(
            f"robot {slot}: coverage.cell_m: {table.cell_m:g} m is too small for bodies of "
            f"{fleet.radius_m:g} m radius at {fleet.speed_m_s:g} m/s"
        )
    try:
        ground = CellMap(floor.walls, table.cell_m)
    except ValueError as problem:
        raise RobotError(f"robot {slot}: coverage.map: {problem}") from None
    rng = Random(f"{robot.name}/{now_us}/{slot}")
    parts = coverage_parts(slot, ground, fleet.vehicle, rng, table.turn_cost)
    return Work(ground.check, len(ground.section_units), parts)


def _mission(robot: RobotFile, now_us: int) -> Work:
    """A mission of the user's own. Raises FactoryError."""
    table = robot.mission
    assert table is not None
    try:
        made = called(table.factory, robot.robot.slot, robot.fleet.robots, now_us, **table.options)
    except FactoryError:
        raise
    except (OSError, ValueError) as problem:  # as its own code raises them, for its options
        raise FactoryError(f"{table.factory!r}: {problem}") from None
    if not isinstance(made, MissionParts):
        raise FactoryError(f"{table.factory!r} makes no MissionParts")
    text = f"{robot.name} {table.model_dump_json()}"
    return Work(FieldAllocationCRDT.hash_of(text), 0, made)
