"""Where a silent member may stand: its body is there, however it died, and nobody drives into it."""

from math import cos, hypot, inf, pi, sin

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.interface.config import CONTROL_PERIOD_US, GONE_QUIET_US, S
from agent.interface.effects import Drive
from agent.interface.lifecycle import State
from agent.interface.mission import MotionRequest
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Neighbour, Observation
from agent.motion.holonomic_motion import MARGIN_M, HolonomicMotion
from agent.motion.stopping_zone import DRIVES_ON_US, SPACING_M, StoppingZone
from protocol.frames.fleet_frames import Pose
from sim.world.drive_trains import Chassis
from sim.world.world import World

RADIUS_M, LIMITS = 0.8, BodyLimits(0.8, 2.5, 1.5)
NOBODY = Observation(0.0, 0.0, 0.0, 0.0, 0.0)
SLIP_M = 0.2  # of wheels, and POSE rounds


def beat_of(here: Observation, heard_at_us: int) -> Neighbour:
    speed_m_s = hypot(here.vx_m_s, here.vy_m_s)
    course_rad = float(np.arctan2(here.vy_m_s, here.vx_m_s)) % (2 * pi)
    pose = Pose(here.x_m, here.y_m, course_rad, speed_m_s, State.WORKING, False, 0)
    return Neighbour(pose, heard_at_us)


@given(
    speed_m_s=st.floats(0.0, 2.5),
    course_rad=st.floats(0.0, 6.28),
    on_us=st.integers(0, DRIVES_ON_US - 150_000),
    braking_m_s2=st.floats(1.5, 4.0),
)
@settings(max_examples=30, deadline=None)
def test_a_body_comes_to_rest_in_one_of_the_places(
    speed_m_s: float, course_rad: float, on_us: int, braking_m_s2: float
) -> None:
    """`on_us`: how long it drives on without a word, before its commands end."""
    world = World([], 1)
    chassis = Chassis(acceleration_m_s2=1.5, braking_m_s2=braking_m_s2)
    body = world.add_robot(0, (3.0, -2.0), RADIUS_M, chassis, 0.0)
    command = Drive(speed_m_s * cos(course_rad), speed_m_s * sin(course_rad))
    heard_at_us, now_us, told = 2 * S, 0, beat_of(NOBODY, 0)
    while now_us <= heard_at_us + on_us:
        body.drive(command, now_us)
        if now_us == heard_at_us:
            told = beat_of(body.sense(now_us), now_us)
        now_us += CONTROL_PERIOD_US
        world.advance(now_us)
    world.advance(now_us := now_us + 4 * S)
    rest = body.sense(now_us)
    coasting = StoppingZone(RADIUS_M, LIMITS.acceleration_m_s2)
    coasting.observe({0: told}, NOBODY, now_us)
    places = coasting.places(0)
    assert places
    off_m = min(hypot(rest.x_m - x_m, rest.y_m - y_m) for x_m, y_m in places)
    assert off_m <= SPACING_M / 2 + SLIP_M


def test_it_is_known_until_it_is_heard_again_or_seen_through() -> None:
    silent = {4: beat_of(Observation(3.0, 0.0, 0.0, 2.0, 0.0), 0)}
    coasting = StoppingZone(RADIUS_M, 1.5)
    coasting.observe(silent, NOBODY, GONE_QUIET_US - 1)
    assert coasting.places(4) is None  # it may only be between two beats: moved on by its age
    coasting.observe(silent, NOBODY, GONE_QUIET_US)
    places = coasting.places(4)
    assert places is not None and places[0] == (3.0, 0.0)
    assert places[-1][0] > 3.0 + 2.0 * 2.0 / (2 * 1.5)  # as far as it brakes, at least
    blind = NOBODY._replace(ranges_m=(inf,) * 8)  # rays further apart than a body is wide
    coasting.observe(silent, blind, GONE_QUIET_US)
    assert coasting.places(4) == places
    coasting.observe(silent, NOBODY._replace(ranges_m=(inf,) * 36), GONE_QUIET_US)
    left = coasting.places(4)
    assert left is not None and len(left) < len(places)  # what lies further off cannot be told
    assert all(x_m > 3.9 for x_m, _ in left)
    coasting.observe(silent, NOBODY, 2 * GONE_QUIET_US)
    assert coasting.places(4) == left  # what was seen stays seen
    coasting.observe({4: silent[4]._replace(heard_at_us=9 * S)}, NOBODY, 9 * S)
    assert coasting.places(4) is None


@given(aim_m=st.floats(-1.0, 4.0), from_rad=st.floats(0.0, 6.28), at_s=st.sampled_from((1.2, 3.0)))
@settings(max_examples=30, deadline=None)
def test_nobody_drives_into_a_body_that_braked_behind_its_last_beat(
    aim_m: float, from_rad: float, at_s: float
) -> None:
    """One dies at full speed; another is sent across the place where it came to rest."""
    world = World([], 3)
    chassis = Chassis(acceleration_m_s2=1.5)
    dead = world.add_robot(0, (-6.0, 0.0), RADIUS_M, chassis, 0.0)
    alive = world.add_robot(1, (9.0 * cos(from_rad), 9.0 * sin(from_rad)), RADIUS_M, chassis, 0.0)
    motion = HolonomicMotion(1, LIMITS, np.empty((0, 4)))
    died_us, told = 2_400_000, beat_of(NOBODY, 0)
    closest_m = inf
    for now_us in range(0, 20 * S, CONTROL_PERIOD_US):
        world.advance(now_us)
        if now_us <= died_us:
            dead.drive(Drive(2.5, 0.0), now_us)
            told = beat_of(dead.sense(now_us), now_us)
            continue
        if now_us < died_us + round(at_s * S):
            continue
        here = alive.sense(now_us)
        goal = told.pose.x_m + aim_m, told.pose.y_m
        dx_m, dy_m = goal[0] - here.x_m, goal[1] - here.y_m
        away_m = max(hypot(dx_m, dy_m), 1e-9)
        speed_m_s = min(2.5, away_m)
        wish = MotionRequest(dx_m / away_m * speed_m_s, dy_m / away_m * speed_m_s)
        alive.drive(motion.drive(here, wish, {0: told}, now_us), now_us)
        rest = dead.sense(now_us)
        closest_m = min(closest_m, hypot(rest.x_m - here.x_m, rest.y_m - here.y_m))
    assert world.contacts == []
    assert closest_m > 2 * RADIUS_M + MARGIN_M / 2
