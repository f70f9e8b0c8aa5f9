"""What each mission brings to its peer, made from declared values.

Robot processes and simulated fleets call the same functions, so a robot in a simulation has the
mission, the motion controller and the map of a real one. A mission of your own is a `MissionParts`
that your program makes; see `agent/interface/mission.py`.
"""

from collections.abc import Mapping, Sequence
from random import Random

from agent.coverage.cell_map import CellMap
from agent.coverage.coverage_mission import GridWork
from agent.coverage.proximity_guard import GridGuard
from agent.delivery.cost_matrix import Carrier
from agent.delivery.delivery_mission import DeliveryMission
from agent.delivery.warehouse import Warehouse
from agent.exploration.exploration_mission import ExplorationMission
from agent.exploration.exploration_task import ROBOTS_MAX, ExplorationOrder
from agent.field.field_mission import FieldMission
from agent.field.field_plan import TURN_SPARE, FieldPlan, FieldValues
from agent.field.tractor_mission import TractorMission
from agent.interface.config import S
from agent.interface.geometry import Point
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.mapping.building import Floor
from agent.mapping.dynamic_obstacles import geometry_of
from agent.mapping.local_and_fleet_map import LocalAndFleetMap
from agent.motion.holonomic_motion import HolonomicMotion
from agent.motion.tractor_motion import TractorMotion
from agent.motion.tractor_tracker import SteeredWheels
from agent.navigation.navigation_mission import NavigationMission
from agent.pathfinding.pathfinding_mission import GoalWork
from agent.runtime.declared_values import BatteryTable, FieldTable, FleetTable, WarehouseTable
from agent.runtime.peer_factory import NO_MEMORY, MissionParts
from crdt.hybrid_clock import HybridClock
from crdt.occupancy import SIDE_MAX
from crdt.passing_map import LAST_TIME, PassingMap
from crdt.sighting import OBSERVER_MAX
from protocol.sync.map_sync import MapSync

MAP_TICK_US = 1 * S  # of the clock in the records of a fleet's map
# Indoor robots stop from full speed in half of this; a longer horizon closes corridors.
HORIZON_S = 1.0
KEEP_RIGHT_RAD = 0.05  # breaks the symmetry of two robots that meet head on in open space
# Distance that collision avoidance keeps from walls that are not known before; planned paths keep
# 0.1 m.
EXPLORED_WALL_M = 0.04
# Share of the full speed, as an average that includes turns, braking and other robots.
PLANNING_SPEED = 0.8


def values_of(table: FieldTable, robots: int) -> FieldValues:
    """What is declared of the work in a field, without the file of its outline."""
    return FieldValues(
        table.implement_width_m, table.overlap_m, table.section_length_m, table.unit_m, table.gate,
        robots,
    )  # fmt: skip


def carrier_of(table: WarehouseTable, fleet: FleetTable, battery: BatteryTable) -> Carrier:
    """What each robot of a delivery fleet can do, for planning."""
    return Carrier(
        PLANNING_SPEED * fleet.speed_m_s, table.handle_s, battery.range_m, battery.standby_s,
        battery.dock_s, battery.charge_s, battery.reserve,
    )  # fmt: skip


def field_parts(slot: int, plan: FieldPlan) -> MissionParts:
    """Work in a field, by a vehicle that moves in any direction or by one that steers."""
    vehicle, field = plan.vehicle, plan.field
    half_bar_m = field.implement_width_m / 2 - field.overlap_m
    if plan.turn_radius_m:
        steering = plan.steering
        wheels = SteeredWheels(steering.steer_1_m_s, TURN_SPARE / plan.turn_radius_m)
        return MissionParts(
            TractorMission(
                field,
                plan.route,
                plan.turns,
                vehicle.radius_m,
                steering,
                plan.travel,
                wheels,
                plan.parts,
            ),
            TractorMotion(
                slot,
                vehicle.limits,
                plan.turns,
                steering,
                plan.fences,
                half_bar_m,
                wheels,
                turns_on_the_spot=vehicle.drive is DriveTrain.DIFFERENTIAL,
                overlap_m=field.overlap_m,
            ),
        )
    return MissionParts(
        FieldMission(
            field,
            plan.route,
            vehicle.radius_m,
            vehicle.speed_m_s,
            vehicle.braking_m_s2,
            plan.travel,
            plan.parts,
        ),
        HolonomicMotion(
            slot,
            vehicle.limits,
            plan.fences,
            half_bar_m=half_bar_m,
            overlap_m=field.overlap_m,
            stops=True,
        ),
    )


def indoor_motion(
    slot: int, floor: Floor, vehicle: Vehicle, *, agrees: bool = True, asks: bool = False
) -> HolonomicMotion:
    """Motion in a building whose walls are known. `agrees`, `asks`: see `navigation_parts`."""
    return HolonomicMotion(
        slot, vehicle.limits, floor.fences, fence_m=floor.margin_m / 2,
        horizon_s=HORIZON_S, gives_way=False, keep_right_rad=KEEP_RIGHT_RAD, looks=True,
        stops=agrees, asks=asks,
    )  # fmt: skip


def obstacle_map(slot: int, robots: int, floor: Floor, now_us: int) -> MapSync | None:
    """The map in which a fleet shares the obstacles of a building.

    None if the building or the fleet is too large for it."""
    geometry = geometry_of(floor)
    if robots > OBSERVER_MAX + 1 or max(geometry[:2]) > SIDE_MAX:
        return None
    clock = HybridClock(now_us, MAP_TICK_US, LAST_TIME)
    return MapSync(slot, PassingMap(geometry), clock, now_us)


def navigation_parts(
    slot: int,
    goals: Mapping[int, Sequence[Point]],
    floor: Floor,
    vehicle: Vehicle,
    now_us: int,
    *,
    agrees: bool = True,
    asks: bool = False,
) -> MissionParts:
    """Goals in a building, one after the other.

    `goals`: of each robot of the fleet, in their order. `agrees`: False for collision avoidance
    alone, without joint plans. `asks`: an unannounced obstacle is passed only by an operator's
    order.
    """
    chart = obstacle_map(slot, len(goals), floor, now_us)
    mission = NavigationMission(
        slot, goals, floor, vehicle.speed_m_s, vehicle.braking_m_s2, agrees, chart, now_us, asks
    )
    motion = indoor_motion(slot, floor, vehicle, agrees=agrees, asks=asks)
    return MissionParts(mission, motion, chart)


def delivery_parts(
    slot: int,
    robots: int,
    house: Warehouse,
    home: Point,
    vehicle: Vehicle,
    seed: int,
    now_us: int,
    recalled: Mapping[str, bytes] = NO_MEMORY,
    *,
    asks: bool = False,
) -> MissionParts:
    """Transports in a warehouse. `home`: where the robot waits. `seed`: of its search for plans."""
    chart = obstacle_map(slot, robots, house.floor, now_us)
    mission = DeliveryMission(
        slot, house, home, vehicle.speed_m_s, vehicle.braking_m_s2, now_us, seed, chart,
        recalled, asks,
    )  # fmt: skip
    return MissionParts(mission, indoor_motion(slot, house.floor, vehicle, asks=asks), chart)


def exploration_parts(
    slot: int,
    robots: int,
    sync: MapSync,
    vehicle: Vehicle,
    range_m: float,
    orders: Sequence[ExplorationOrder] = (),
    *,
    robots_max: int = ROBOTS_MAX,
    kind: type[ExplorationMission] = ExplorationMission,
    shares: bool = True,
) -> MissionParts:
    """Exploration of a place without a map.

    `sync`: the map and its exchange. `range_m`: of the robot's sensors. `shares`: False if the map
    is not sent on the bus. Raises FleetFullError with more than `robots_max` robots.
    """
    limits = vehicle.limits
    planned = limits._replace(acceleration_m_s2=vehicle.braking_m_s2)
    chart = LocalAndFleetMap(sync, sync.chart.geometry, vehicle.radius_m, range_m)
    mission = kind(chart, planned, robots, robots_max, orders)
    motion = HolonomicMotion(slot, limits, None, fence_m=EXPLORED_WALL_M)
    return MissionParts(mission, motion, sync if shares else None)


def coverage_parts(
    slot: int, ground: CellMap, vehicle: Vehicle, rng: Random, turn_cost: float = 0.0
) -> MissionParts:
    """Coverage of a grid of cells. `rng`: a random source of this robot alone."""
    return MissionParts(
        GridWork(slot, ground, vehicle.speed_m_s, rng, turn_cost),
        GridGuard(ground.cell_m, vehicle.radius_m, vehicle.speed_m_s),
    )


def pathfinding_parts(
    slot: int, ground: CellMap, vehicle: Vehicle, rng: Random, goal: int, robots: int
) -> MissionParts:
    """A way to one cell of a grid. `goal`: the number of the cell; `robots`: of the whole fleet.
    `rng`: a random source of this robot alone."""
    return MissionParts(
        GoalWork(slot, ground, vehicle.speed_m_s, rng, goal, robots),
        GridGuard(ground.cell_m, vehicle.radius_m, vehicle.speed_m_s),
    )
