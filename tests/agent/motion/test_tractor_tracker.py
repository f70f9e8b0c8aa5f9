"""A tractor stays on its way: measured with the simulated chassis, slip included."""

from math import cos, hypot, pi, sin

import numpy as np
import pytest
from numpy.typing import NDArray
from shapely.geometry import box

from agent.interface.effects import Drive
from agent.interface.vehicle import DriveTrain
from agent.motion.tractor_tracker import (
    AT_WORK,
    HOLD_M_S,
    ON_THE_WAY,
    SETTLED_M,
    SLOWEST_M_S,
    SteeredWheels,
    SteeringLimits,
    SteeringManner,
    TractorTracker,
    bend_speed_m_s,
    smooth_way,
)
from agent.paths.tractor_route import Piece, VehiclePose, sampled
from sim.world.drive_trains import TRACTOR, Chassis
from sim.world.world import World

BEND = 1.0 / (1.2 * TRACTOR.turn_radius_m)
LIMITS = SteeringLimits(2.5, 0.7, TRACTOR.steer_rad_s / (2 * TRACTOR.half_base_m))
PIVOT_LIMITS = SteeringLimits(2.5, 0.7, 6.0)
PIVOT = Chassis(kind=DriveTrain.DIFFERENTIAL)


def follow(
    way: NDArray[np.float64], start: VehiclePose, chassis: Chassis = TRACTOR, seed: int = 1,
    manner: SteeringManner = AT_WORK,
) -> NDArray[np.float64]:  # fmt: skip
    """(n, 2) along, off the way at each control period until it arrives."""
    limits = LIMITS if chassis.kind is DriveTrain.ACKERMANN else PIVOT_LIMITS
    world = World([], seed)
    body = world.add_robot(0, (start.x_m, start.y_m), 0.8, chassis, start.heading_rad)
    tracker = TractorTracker(way, limits, 0.0, manner)
    rows = []
    for now_us in range(0, 120_000_000, 50_000):
        here = body.sense(now_us)
        tracker.locate(here.x_m, here.y_m, here.heading_rad)
        rows.append((tracker.along_m, tracker.off_m))
        assert not tracker.lost
        if tracker.arrived:
            return np.array(rows)
        speed, turn = tracker.command()
        course = here.heading_rad + turn * 0.025
        body.drive(Drive(speed * cos(course), speed * sin(course), turn), now_us)
    raise AssertionError(f"not arrived, seed {seed}")


@pytest.mark.parametrize("chassis", [TRACTOR, PIVOT], ids=["ackermann", "differential"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_half_a_metre_off_is_closed_without_swinging(chassis: Chassis, seed: int) -> None:
    way = sampled(VehiclePose(0.0, 0.0, 0.0), [Piece(0.0, 40.0)])
    rows = follow(way, VehiclePose(0.0, 0.5, 0.0), chassis, seed)
    assert np.abs(rows[rows[:, 0] > 10.0, 1]).max() < 0.04
    assert rows[:, 1].min() > -0.1, "it hardly overshoots"


@pytest.mark.parametrize("chassis", [TRACTOR, PIVOT], ids=["ackermann", "differential"])
def test_a_row_end_turn_leads_onto_the_line(chassis: Chassis) -> None:
    quarter = Piece(BEND, pi / 2 / BEND)
    way = sampled(
        VehiclePose(0, 0, 0), [Piece(0, 10), quarter, Piece(0, 0.4), quarter, Piece(0, 12)]
    )
    rows = follow(way, VehiclePose(0.0, 0.0, 0.0), chassis)
    end_m = rows[-1, 0]
    assert np.abs(rows[:, 1]).max() < 0.15
    assert np.abs(rows[rows[:, 0] > end_m - 11.0, 1]).max() < 0.08, "a metre after the turn"


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_turn_with_a_run_out_takes_as_long_as_planned(seed: int) -> None:
    """A half circle 3.8 m wide took 7.0 s, of which the tractor lost 1.3 s because it was off its path:
    that began in an arc, and the wheels were straight."""
    run_out_m = ON_THE_WAY.preview_for_s * bend_speed_m_s(2.5, 1.0 / BEND)
    pieces = [Piece(0, run_out_m), Piece(BEND, pi / BEND), Piece(0, 1.0)]
    way = sampled(VehiclePose(0, 0, 0), pieces)
    rows = follow(way, VehiclePose(0.0, 0.0, 0.0), TRACTOR, seed, ON_THE_WAY)
    tracker = TractorTracker(way, LIMITS, 0.0, ON_THE_WAY)
    passing_m_s = np.maximum((tracker.speeds[1:] + tracker.speeds[:-1]) / 2, 0.15)
    planned_s = float((np.diff(tracker.along) / passing_m_s).sum())
    # It begins at a stand, which takes a second longer.
    assert len(rows) * 0.05 < planned_s + 1.5, seed
    assert np.abs(rows[:, 1]).max() < 0.1, seed


def test_i26_a_body_beside_its_path_slows_down_before_work_begins() -> None:
    way = sampled(VehiclePose(0.0, 0.0, 0.0), [Piece(0.0, 20.0)])
    speeds_m_s = []
    for x_m in (10.0, 20.0 - SETTLED_M + 0.2):
        tracker = TractorTracker(way, LIMITS, 2.5, ON_THE_WAY)
        tracker.locate(x_m, 0.0, 0.15)
        speeds_m_s.append(tracker.command()[0])
    assert speeds_m_s[0] == pytest.approx(2.5) and speeds_m_s[1] < 2.2


def test_a_three_point_turn() -> None:
    pieces = [Piece(0, 5), Piece(BEND, 2), Piece(-BEND, -2), Piece(BEND, 1), Piece(0, 3)]
    rows = follow(sampled(VehiclePose(0, 0, 0), pieces), VehiclePose(0.0, 0.0, 0.0))
    assert np.abs(rows[:, 1]).max() < 0.2 and abs(rows[-1, 1]) < 0.05


LOCK_TO_LOCK = [Piece(0, 4), Piece(BEND, 2.5), Piece(-BEND, 2.5), Piece(BEND, 2.5), Piece(0, 2)]
TO_AND_FRO = [Piece(0, 3), Piece(BEND, -2.5), Piece(-BEND, 2), Piece(BEND, -2), Piece(-BEND, 2.5)]


@pytest.mark.parametrize("manner", [AT_WORK, ON_THE_WAY], ids=["at work", "on the way"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_i26_wheels_are_turned_before_a_way_to_and_fro_goes_on(
    manner: SteeringManner, seed: int
) -> None:
    """It left such a path by 0.4 m, and one touched a fence."""
    way = sampled(VehiclePose(0, 0, 0), [*TO_AND_FRO, Piece(0, 1.5)])
    rows = follow(way, VehiclePose(0.0, 0.0, 0.0), manner=manner, seed=seed)
    assert np.abs(rows[:, 1]).max() < 0.06
    assert len(rows) * 0.05 < 24.5, "no slower than before: 25 s"


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_i26_from_lock_to_lock_it_steers_earlier(seed: int) -> None:
    """It left such a path by 0.46 m, and took 18.8 s."""
    way = sampled(VehiclePose(0, 0, 0), LOCK_TO_LOCK)
    rows = follow(way, VehiclePose(0.0, 0.0, 0.0), manner=ON_THE_WAY, seed=seed)
    assert np.abs(rows[:, 1]).max() < 0.12
    assert len(rows) * 0.05 < 16.0


def test_wheels_that_are_turned_by_another_part_are_waited_for() -> None:
    way = sampled(VehiclePose(0, 0, 0), [Piece(BEND, 3.0)])
    wheels = SteeredWheels(LIMITS.steer_1_m_s, 2 * BEND)
    tracker = TractorTracker(way, LIMITS, 0.0, AT_WORK, wheels)
    tracker.locate(0.0, 0.0, 0.0)
    speeds_m_s = []
    for _ in range(40):
        speed_m_s, turn_rad_s = tracker.command()
        speeds_m_s.append(speed_m_s)
        wheels.command(speed_m_s, turn_rad_s)
    held = sum(speed_m_s == HOLD_M_S for speed_m_s in speeds_m_s)
    assert held == pytest.approx(BEND / LIMITS.steer_1_m_s / 0.05, abs=3)
    assert speeds_m_s[-1] > SLOWEST_M_S
    for _ in range(200):
        wheels.command(0.1, -5.0)
    assert wheels.curvature_1_m == -2 * BEND, "they do not turn further than to their lock"
    wheels.command(0.0, 1.0)
    assert wheels.curvature_1_m == -2 * BEND, "and stay so where nothing is commanded"
    tracker = TractorTracker(way, LIMITS, 0.0, AT_WORK, wheels)
    tracker.locate(0.0, 0.0, 0.0)
    assert all(tracker.command()[0] == HOLD_M_S for _ in range(400)), "nobody turns them"


@pytest.mark.parametrize("clockwise", [False, True])
def test_a_ring_round_a_hole_within_the_tolerance(clockwise: bool) -> None:
    """Two metres round its corners, nearly the tightest it can do, at the tolerance of the work."""
    ring = list(box(-3, -4, 6, 4).buffer(2.0).exterior.coords)
    way = smooth_way(ring if clockwise else ring[::-1], 0.6)
    rows = follow(way, VehiclePose(*way[0, :3]))
    assert np.abs(rows[:, 1]).max() < 0.1
    line = box(-3, -4, 6, 4).buffer(2.0).exterior
    off = [line.distance(point) for point in _points(way)]
    assert max(off) < 0.05, "rounding itself takes less than half of it"


def test_pushed_aside_it_knows() -> None:
    way = sampled(VehiclePose(0, 0, 0), [Piece(0, 20)])
    tracker = TractorTracker(way, LIMITS)
    tracker.locate(3.0, 0.1, 0.0)
    assert not tracker.lost
    tracker.locate(3.0, 1.2, 0.0)
    assert tracker.lost
    tracker.locate(3.0, 0.0, 1.5)
    assert tracker.lost


def test_it_slows_for_bends_and_stops_at_a_change_of_direction() -> None:
    way = sampled(VehiclePose(0, 0, 0), [Piece(0, 10), Piece(BEND, 3), Piece(0, -3)])
    tracker = TractorTracker(way, LIMITS)
    shift = int(np.flatnonzero(np.diff(way[:, 4]))[0])
    assert tracker.speeds[shift] == 0.0 and tracker.speeds[-1] == 0.0
    assert tracker.speeds[105:125].max() < 1.5 < tracker.speeds[20]
    speeds, along = tracker.speeds, tracker.along
    braking = (speeds[:-1] ** 2 - speeds[1:] ** 2) / (2 * np.maximum(np.diff(along), 1e-9))
    assert braking[np.diff(along) > 0.01].max() < LIMITS.deceleration_m_s2 + 1e-6


def _points(way: NDArray[np.float64]) -> list[object]:
    from shapely.geometry import Point

    return [Point(x, y) for x, y in way[:, :2]]


def test_smoothing_keeps_the_ends() -> None:
    way = smooth_way([(0.0, 0.0), (10.0, 0.0), (20.0, 2.0)], 0.6)
    assert hypot(*way[0, :2]) < 1e-9 and hypot(way[-1, 0] - 20.0, way[-1, 1] - 2.0) < 1e-9
