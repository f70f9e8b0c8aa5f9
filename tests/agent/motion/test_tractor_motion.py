"""Two that steer meet: they stop before they touch, and one of them gets out of the way."""

from math import atan2, cos, hypot, pi, sin

import numpy as np
import pytest

from agent.interface.lifecycle import State
from agent.interface.mission import MotionRequest
from agent.interface.motion_controller import BodyLimits as Body
from agent.interface.observation import Neighbour, Observation
from agent.motion.tractor_motion import TractorMotion
from agent.motion.tractor_tracker import HOLD_M_S, SteeringLimits
from agent.paths.tractor_route import TurnRoute
from protocol.frames.fleet_frames import Pose as Beat
from sim.world.drive_trains import TRACTOR
from sim.world.world import World

RADIUS_M, SPEED_M_S = 0.8, 2.0
CELLS = np.zeros((240, 240), dtype=bool)  # 60 x 60 m
TURNS = TurnRoute(CELLS, -30.0, -30.0, 0.25, 1.72)
BODY, STEERING = Body(RADIUS_M, 2.5, 1.5), SteeringLimits(2.5, 0.7, 0.67)


def meet(angle_rad: float, offset_m: float, seed: int) -> tuple[World, float, list[TractorMotion]]:
    """Two come from 12 m towards the middle, at an angle, for 20 s, each straight on: (world, smallest
    distance of their middles, their motions)."""
    world = World([], seed)
    bodies = [
        world.add_robot(0, (-12.0, offset_m), RADIUS_M, TRACTOR, 0.0),
        world.add_robot(
            1, (-12.0 * cos(angle_rad), -12.0 * sin(angle_rad)), RADIUS_M, TRACTOR, angle_rad
        ),
    ]
    motions = [TractorMotion(slot, BODY, TURNS, STEERING, np.empty((0, 4))) for slot in (0, 1)]
    heard: dict[int, Neighbour] = {}
    closest_m = 24.0
    for now_us in range(0, 20_000_000, 50_000):
        seen = [body.sense(now_us) for body in bodies]
        closest_m = min(closest_m, hypot(seen[0].x_m - seen[1].x_m, seen[0].y_m - seen[1].y_m))
        for slot, here in enumerate(seen):
            speed_m_s = hypot(here.vx_m_s, here.vy_m_s)
            course = atan2(here.vy_m_s, here.vx_m_s) if speed_m_s > 0.05 else here.heading_rad
            beat = Beat(here.x_m, here.y_m, course % (2 * pi), speed_m_s, State.WORKING, False, 0)
            heard[slot] = Neighbour(beat, now_us)
        for slot, (here, motion) in enumerate(zip(seen, motions, strict=True)):
            heading = here.heading_rad
            wish = MotionRequest(SPEED_M_S * cos(heading), SPEED_M_S * sin(heading), 0.0, True)
            others = {s: n for s, n in heard.items() if s != slot}
            bodies[slot].drive(motion.drive(here, wish, others, now_us), now_us)
    return world, closest_m, motions


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("offset_m", [0.0, 0.7, -1.4])
@pytest.mark.parametrize("angle_deg", [180, 135, 90, 45])
def test_they_never_touch(angle_deg: int, offset_m: float, seed: int) -> None:
    world, closest_m, _ = meet(angle_deg * pi / 180, offset_m, seed)
    assert world.contacts == [], f"seed {seed}"
    assert closest_m > 2 * RADIUS_M, f"seed {seed}"


def test_m26_one_that_may_halt_where_it_crosses_is_braked_for() -> None:
    """Found by `steered` 116000006: a tractor drove on at 2.5 m/s because the one that crossed its way
    would have been gone in time. That one braked for it, and stood in its way."""
    motion = TractorMotion(0, BODY, TURNS, STEERING, np.empty((0, 4)))
    here = Observation(0.0, 0.0, pi / 2, 0.0, 2.5)
    for dx_m, dy_m in ((1.08, 2.22), (1.2, 2.6), (1.4, 2.0)):
        beat = Beat(dx_m, dy_m, atan2(0.54, 1.25), hypot(1.25, 0.54), State.WORKING, False, 0)
        drive = motion.drive(here, MotionRequest(0.0, 2.5, 0.0, True), {1: Neighbour(beat, 0)}, 0)
        assert drive.vy_m_s < 1.5, (dx_m, dy_m)
    # One that is far enough away is not.
    beat = Beat(3.5, 6.0, 0.0, 1.25, State.WORKING, False, 0)
    drive = motion.drive(here, MotionRequest(0.0, 2.5, 0.0, True), {1: Neighbour(beat, 0)}, 0)
    assert drive.vy_m_s == 2.5


def test_nose_to_nose_the_higher_slot_gives_way() -> None:
    _, _, motions = meet(pi, 0.0, 1)
    assert motions[1].given >= 1 and motions[0].given == 0


def test_passing_in_the_next_row_slows_nobody() -> None:
    world, _, motions = meet(pi, 3.8, 1)
    assert all(motion.given == 0 for motion in motions)
    east_m = world.body(0).sense(20_000_000).x_m
    assert east_m > -12.0 + 0.9 * SPEED_M_S * 18.0


def test_a_tractor_that_waits_for_its_wheels_gives_way_to_nobody() -> None:
    """Wheels take up to 1.8 s from lock to lock. It backed away from a robot that stood before it."""
    motion = TractorMotion(1, BODY, TURNS, STEERING, np.empty((0, 4)))
    stands = Beat(2.0, 0.0, 0.0, 0.0, State.WORKING, False, 0)
    here = Observation(0.0, 0.0, 0.0, 0.0, 0.0)
    for now_us in range(0, 3_000_000, 50_000):
        wish = MotionRequest(HOLD_M_S, 0.0, HOLD_M_S * 0.5, False)
        motion.drive(here, wish, {0: Neighbour(stands, now_us)}, now_us)
    assert motion.given == 0
    for now_us in range(3_000_000, 5_000_000, 50_000):
        motion.drive(here, MotionRequest(1.0, 0.0, 0.0), {0: Neighbour(stands, now_us)}, now_us)
    assert motion.given == 1


WALL = np.array([[-30.0, 3.0, 30.0, 3.0]])


@pytest.mark.parametrize("turn_1_m", [0.0, 0.4, -0.4])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_i26_a_tractor_stops_before_a_fence_and_drives_away_from_it(
    turn_1_m: float, seed: int
) -> None:
    """A tractor that had left its path by 0.4 m touched a fence: only paths knew of fences."""
    world = World([(each[:2], each[2:]) for each in WALL.tolist()], seed)
    body = world.add_robot(0, (0.0, -4.0), RADIUS_M, TRACTOR, pi / 2 - 2.5 * turn_1_m)
    motion = TractorMotion(0, BODY, TURNS, STEERING, WALL)
    for now_us in range(0, 20_000_000, 50_000):
        here = body.sense(now_us)
        ahead = 1.0 if now_us < 10_000_000 else -1.0
        speed_m_s = ahead * SPEED_M_S
        vx_m_s, vy_m_s = speed_m_s * cos(here.heading_rad), speed_m_s * sin(here.heading_rad)
        wish = MotionRequest(vx_m_s, vy_m_s, abs(speed_m_s) * turn_1_m, False)
        body.drive(motion.drive(here, wish, {}, now_us), now_us)
        if now_us == 9_000_000 and not turn_1_m:
            assert 0.0 < 3.0 - RADIUS_M - here.y_m < 0.4, "it has come near"
    assert world.contacts == [], f"seed {seed}"
    assert body.sense(20_000_000).y_m < 0.5


@pytest.mark.parametrize("ahead_m", [0.6, 1.0])
def test_the_implement_is_up_before_it_meets_a_body(ahead_m: float) -> None:
    """A working robot passes a body that stands beside its row, within reach of the bar."""
    motion = TractorMotion(0, BODY, TURNS, STEERING, np.empty((0, 4)), half_bar_m=1.8)
    world = World([], 1)
    body = world.add_robot(0, (0.0, 0.0), RADIUS_M, TRACTOR, 0.0)
    standing = Beat(ahead_m, 2.5, 0.0, 0.0, State.IDLE, False, 0)
    wish = MotionRequest(SPEED_M_S, 0.0, 0.0, True)
    here = body.sense(0)
    assert not motion.drive(here, wish, {1: Neighbour(standing, 0)}, 0).tool_on
    far = standing._replace(y_m=3.8)  # the next row
    assert motion.drive(here, wish, {1: Neighbour(far, 0)}, 0).tool_on
