"""A lowered implement goes up before it is drawn over a person or a thing that the rays see."""

from math import atan2, cos, inf, pi, sin

import numpy as np
import pytest

from agent.interface.config import S
from agent.interface.effects import Drive
from agent.interface.lifecycle import State
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Neighbour, Observation
from agent.motion.bar_guard import FORGET_US, FREE_US, PLACES_MAX, STAYS_US
from agent.motion.obstacle_detector import ObstacleDetector
from agent.motion.obstacle_stop import ObstacleStop
from agent.motion.stopping_zone import StoppingZone
from agent.motion.swept_ground import SweptGround
from protocol.frames.fleet_frames import Pose

RADIUS_M, HALF_BAR_M, RAYS = 0.6, 4.0, 72
NO_FENCES = np.empty((0, 4))
EAST = Drive(2.5, 0.0, 0.0, True)


def stop(
    fences: np.ndarray = NO_FENCES, half_bar_m: float = HALF_BAR_M, steers: bool = False
) -> ObstacleStop:
    lookout = ObstacleDetector(RADIUS_M, 1.5, fences, StoppingZone(RADIUS_M, 1.5))
    return ObstacleStop(0, BodyLimits(RADIUS_M, 2.5, 1.5), lookout, half_bar_m, steers)


def seen(x_m: float, y_m: float, vx_m_s: float = 2.5, vy_m_s: float = 0.0) -> Observation:
    """At (0, 0), heading east; one ray ends near that place."""
    ranges = [inf] * RAYS
    ranges[round(atan2(y_m, x_m) / (2 * pi / RAYS)) % RAYS] = float(np.hypot(x_m, y_m))
    return Observation(0.0, 0.0, 0.0, vx_m_s, vy_m_s, tuple(ranges))


@pytest.mark.parametrize(
    ("x_m", "y_m", "down"),
    [
        (1.5, 1.7, False),  # beside the body's strip, before the bar
        (1.5, -3.5, False),
        (0.0, 3.5, False),  # under the bar
        (1.5, 5.5, True),  # beyond its end
        (-2.0, 2.0, True),  # the bar has passed it
        (7.0, 1.7, True),  # far ahead
    ],
)
def test_the_bar_goes_up_before_what_it_would_be_drawn_over(
    x_m: float, y_m: float, down: bool
) -> None:
    question = stop()
    drive, effects = question.watch(EAST, seen(x_m, y_m), {}, True, 0)
    assert drive == EAST._replace(tool_on=down), "it drives on"
    assert not effects and not question.asking


def test_what_explains_an_echo_to_the_body_explains_it_to_the_bar() -> None:
    here = seen(1.5, 1.7)
    ray = round(atan2(1.7, 1.5) / (2 * pi / RAYS)) * 2 * pi / RAYS
    x_m, y_m = float(np.hypot(1.5, 1.7)) * cos(ray), float(np.hypot(1.5, 1.7)) * sin(ray)
    robot = Neighbour(Pose(x_m, y_m + 0.5, 0.0, 0.0, State.IDLE, False, 0), 0)
    fence = np.array([[x_m - 3.0, y_m + 0.1, x_m + 3.0, y_m + 0.1]])
    assert not stop().watch(EAST, here, {}, True, 0)[0].tool_on
    assert stop().watch(EAST, here, {1: robot}, True, 0)[0].tool_on
    assert stop(fence).watch(EAST, here, {}, True, 0)[0].tool_on
    assert stop(half_bar_m=0.0).watch(EAST, here, {}, True, 0)[0].tool_on, "it has no bar"
    assert stop().watch(EAST, here._replace(ranges_m=()), {}, True, 0)[0].tool_on, "it has no rays"


def test_the_bar_that_swings_round_a_corner_goes_up() -> None:
    """The course turns from east to north: the bar passes ahead on the right and behind on the left.

    These places are in the strip of neither course.
    """
    north = Drive(0.0, 2.5, 0.0, True)
    for x_m, y_m, down in (
        (3.5, -1.5, False),
        (-1.5, 3.5, False),
        (3.0, 3.0, True),
        (-3.0, -3.0, True),
    ):
        drive, _ = stop().watch(north, seen(x_m, y_m, 2.5, 0.0), {}, True, 0)
        assert drive.tool_on is down, (x_m, y_m)


def test_a_robot_that_stands_may_turn_its_bar_anywhere() -> None:
    for angle_rad in np.linspace(0.0, 2 * pi, 12):
        here = seen(3.0 * cos(angle_rad), 3.0 * sin(angle_rad), 0.0, 0.0)
        drive, _ = stop().watch(EAST._replace(vx_m_s=0.0), here, {}, True, 0)
        assert not drive.tool_on, angle_rad


def test_the_bar_of_a_steered_body_follows_its_bend() -> None:
    left, right = (SweptGround(2.0, [(2.5, 0.0)], 2.5, bend_1_m) for bend_1_m in (0.25, -0.25))
    # The right end of the bar is further ahead in a bend to the left than on a straight way.
    assert left.has(3.3, -1.0) and not right.has(3.3, -1.0)
    assert right.has(3.3, 1.0) and not left.has(3.3, 1.0)
    assert not SweptGround(2.0, [(2.5, 0.0)], 2.5, 0.0).has(3.3, -1.0)
    for bend_1_m in (0.25, 0.5):
        for way_m in (0.8, 1.6, 2.4):  # the whole bar, wherever the robot will be
            middle = sin(bend_1_m * way_m) / bend_1_m, (1 - cos(bend_1_m * way_m)) / bend_1_m
            course_rad = bend_1_m * way_m
            ground = SweptGround(2.0, [(2.5, 0.0)], 2.5, bend_1_m)
            for end_m in (-2.0, -1.0, 1.0, 2.0):
                x_m = middle[0] - end_m * sin(course_rad)
                assert ground.has(x_m, middle[1] + end_m * cos(course_rad)), (way_m, end_m)


def test_only_a_body_that_steers_bends_its_bar_with_its_turn() -> None:
    """The outer end comes further than on a straight way; another body turns, and its course does not."""
    bend = EAST._replace(turn_rad_s=0.625)
    here = seen(4.21, -1.96)
    assert not stop(steers=True).watch(bend, here, {}, True, 0)[0].tool_on
    assert stop().watch(bend, here, {}, True, 0)[0].tool_on


def test_places_that_keep_the_bar_up_are_limited() -> None:
    question, here = stop(), seen(1.5, 1.7)
    for metre in range(2 * PLACES_MAX):
        question.watch(EAST, here._replace(x_m=float(metre)), {}, True, metre)
    assert question.bar is not None and len(question.bar.kept_up) == PLACES_MAX


def test_what_stays_is_told_to_the_mission_and_what_has_gone_is_not() -> None:
    question, here = stop(), seen(1.5, 1.7)
    question.watch(EAST, here, {}, True, 0)
    assert not question.under_bar, "it may go"
    for now_us in range(0, STAYS_US + 2 * S, S):
        question.watch(EAST, here, {}, True, now_us)
    ((x_m, y_m),) = question.under_bar
    assert np.hypot(x_m - 1.5, y_m - 1.7) < 0.4
    clear = here._replace(ranges_m=(inf,) * RAYS)
    question.watch(EAST, clear, {}, True, 2 * STAYS_US + FORGET_US)
    assert not question.under_bar


def test_the_bar_stays_up_for_a_moment_after_the_ground_is_free() -> None:
    """It was lowered while it still swung over a box: the course that was sensed had turned before."""
    question, here = stop(), seen(1.5, 1.7)
    past = here._replace(ranges_m=seen(-2.0, 2.0).ranges_m)
    assert not question.watch(EAST, here, {}, True, 0)[0].tool_on
    question.lookout.points.clear()
    assert not question.watch(EAST, past, {}, True, FREE_US - 1)[0].tool_on
    assert question.watch(EAST, past, {}, True, FREE_US)[0].tool_on
