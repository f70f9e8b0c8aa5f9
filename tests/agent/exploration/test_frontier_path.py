"""An explorer's way over what it knows: noticed when blocked, given up when it leads nowhere."""

from math import dist

import pytest

from agent.exploration.exploration_task import AT_M
from agent.exploration.frontier_path import STUCK_US, TURN_ROUND, FrontierPath
from agent.interface.mission import FleetView
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.mapping.local_and_fleet_map import LocalAndFleetMap
from crdt import FieldAllocationCRDT, Progress
from crdt.occupancy import Geometry

SIDE, CELL_M, BODY_M = 60, 0.2, 0.3
START, STATION = (1.1, 6.1), (10.1, 6.1)
LIMITS = BodyLimits(BODY_M, 1.0, 2.0)


def view(x_m: float, y_m: float, now_us: int = 0) -> FleetView:
    here = Observation(x_m, y_m, 0.0, 0.0, 0.0)
    return FleetView(0, now_us, here, FieldAllocationCRDT(), Progress({}), frozenset({0}), {}, {})


@pytest.fixture
def way() -> FrontierPath:
    chart = LocalAndFleetMap(None, Geometry(SIDE, SIDE, (0.0, 0.0), CELL_M), BODY_M, 5.0)
    found = FrontierPath(chart, LIMITS)
    found.head_for(STATION, view(*START))
    return found


def wall(way: FrontierPath, column: int, rows: slice) -> None:
    cells = way.chart.own() < 0
    cells[rows, column] = True
    way.chart.grid.wall(cells)


def nearest_m(way: FrontierPath, column: int, rows: range) -> float:
    """From the solid cells to the waypoints."""
    centre = way.chart.geometry.centre
    return min(dist(at, centre(row, column)) for at in way.rest for row in rows)


def test_a_wall_across_a_straight_stretch_blocks_it_and_the_next_way_goes_round(
    way: FrontierPath,
) -> None:
    assert way.rest == [STATION] and not way.blocked
    wall(way, 30, slice(10, 50))
    assert way.blocked
    way.plan(view(*START).here)
    assert len(way.rest) > 1 and way.rest[-1] == STATION and not way.blocked
    assert nearest_m(way, 30, range(10, 50)) > BODY_M


def test_a_wall_on_a_waypoint_blocks(way: FrontierPath) -> None:
    wall(way, 30, slice(0, 40))
    way.plan(view(*START).here)
    assert len(way.rest) > 1 and not way.blocked
    row, _ = way.cell(way.rest[0])
    wall(way, 30, slice(row, row + 1))
    assert way.blocked


def test_walls_beside_the_way_and_behind_the_station_do_not_block(way: FrontierPath) -> None:
    wall(way, 30, slice(0, 25))
    wall(way, 55, slice(0, SIDE))
    assert not way.blocked


def test_a_start_in_the_inflation_of_a_wall_is_not_a_block(way: FrontierPath) -> None:
    wall(way, 4, slice(30, 31))  # 0.2 m west of the robot's edge
    way.plan(view(*START).here)
    assert way.chart.grid.tight.blocked[way.cell(START)], "else this shows nothing"
    assert way.rest and not way.blocked


def test_no_way_is_no_block_and_the_robot_turns_round(way: FrontierPath) -> None:
    wall(way, 30, slice(0, SIDE))
    way.plan(view(*START).here)
    assert way.rest == [] and not way.blocked
    assert way.drive(view(*START)) == TURN_ROUND


def test_driving_ends_at_the_station_and_says_when(way: FrontierPath) -> None:
    (x_m, y_m), now_us = START, 0
    while not way.arrived_at_us:
        wish = way.drive(view(x_m, y_m, now_us))
        x_m, y_m, now_us = x_m + 0.05 * wish.vx_m_s, y_m + 0.05 * wish.vy_m_s, now_us + 50_000
        assert not way.stuck(now_us)
        assert now_us < 30_000_000, f"after 30 s at {x_m:.2f}, {y_m:.2f}"
    assert dist((x_m, y_m), STATION) < AT_M and way.arrived_at_us == now_us - 50_000
    assert way.drive(view(x_m, y_m, now_us)) == TURN_ROUND


def test_who_gets_no_nearer_is_stuck_until_it_has_time_again(way: FrontierPath) -> None:
    way.drive(view(*START))
    assert not way.stuck(STUCK_US) and way.stuck(STUCK_US + 1)
    way.has_time(STUCK_US + 1)
    assert not way.stuck(STUCK_US + 1)
