"""What a robot remembers of unannounced obstacles."""

from math import cos, hypot, inf, pi, sin

import numpy as np
import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.lifecycle import State
from agent.interface.observation import Neighbour, Observation
from agent.motion.obstacle_detector import ObstacleDetector
from agent.motion.stopping_zone import StoppingZone
from protocol.frames.fleet_frames import Pose

RADIUS_M, RAYS, BODY = 0.8, 72, (2.2, 0.0)
AHEAD = ((2.0, 0.0),)


def observation(
    at: tuple[float, float] = (0.0, 0.0), body: tuple[float, float] = BODY
) -> Observation:
    """With a body of `RADIUS_M` at `body`."""
    ranges, x_m, y_m = [], body[0] - at[0], body[1] - at[1]
    for k in range(RAYS):
        ux, uy = cos(2 * pi * k / RAYS), sin(2 * pi * k / RAYS)
        along_m, across_m = x_m * ux + y_m * uy, abs(y_m * ux - x_m * uy)
        hit = along_m > 0.0 and across_m < RADIUS_M
        ranges.append(along_m - (RADIUS_M**2 - across_m**2) ** 0.5 if hit else inf)
    return Observation(*at, 0.0, 0.0, 0.0, ranges_m=tuple(ranges))


def test_a_body_that_joins_is_an_obstacle_no_more() -> None:
    """Found by `headland chaos`, profile all, seed 1100005: a robot stood before the body of one that
    was not switched on yet, and went on asking after that one had joined (L5)."""
    detector = ObstacleDetector(RADIUS_M, 1.5, np.empty((0, 4)), StoppingZone(RADIUS_M, 1.5))
    here = observation()
    seen = detector.observe(here, AHEAD, {}, 0)
    assert seen is not None and hypot(seen.x_m - 1.4, seen.y_m) < 0.15
    joined = Neighbour(Pose(*BODY, 0.0, 0.0, State.IDLE, False, 0), 1 * S)
    assert detector.observe(here, AHEAD, {1: joined}, 1 * S) is None
    assert not detector.points


def test_what_stands_beside_a_robot_stays_in_mind() -> None:
    detector = ObstacleDetector(RADIUS_M, 1.5, np.empty((0, 4)), StoppingZone(RADIUS_M, 1.5))
    here = observation()
    beside = Neighbour(Pose(BODY[0], 2.5, 0.0, 0.0, State.IDLE, False, 0), 0)
    assert detector.observe(here, AHEAD, {1: beside}, 0) is not None
    assert detector.observe(here, AHEAD, {1: beside}, 1 * S) is not None


@pytest.mark.parametrize(
    ("off_m", "explained"), [(0.0, True), (0.08, True), (0.2, False), (0.33, False)]
)
def test_a_silent_robot_does_not_explain_a_hull_that_avoidance_would_touch(
    off_m: float, explained: bool
) -> None:
    """Found by `headland chaos`, profile senses, seed 114001205: a robot drove 0.3 m before it found that
    its place was frozen. Its hull there was explained by the place that it had told, and another
    robot kept its distance from that place only (S19)."""
    zone = StoppingZone(RADIUS_M, 1.5)
    detector = ObstacleDetector(RADIUS_M, 1.5, np.empty((0, 4)), zone)
    here = observation()
    told = Neighbour(Pose(BODY[0] + off_m, 0.0, 0.0, 0.0, State.IDLE, False, 0), 0)
    zone.observe({1: told}, here, 2 * S)
    assert (detector.observe(here, AHEAD, {1: told}, 2 * S) is None) is explained


@pytest.mark.parametrize("before_m", [0.36, 0.38, 0.6])
def test_noise_before_a_robot_is_forgotten_when_the_scan_is_right_again(before_m: float) -> None:
    """Found by `headland chaos`, profile rays, seed 106000098: an echo that noise had put 0.37 m before a
    robot stayed, because no ray reached `BEYOND_M` further. Both robots stood for good (L5)."""
    detector = ObstacleDetector(RADIUS_M, 1.5, np.empty((0, 4)), StoppingZone(RADIUS_M, 1.5))
    here, robot = observation(), Neighbour(Pose(*BODY, 0.0, 0.0, State.IDLE, False, 0), 0)
    true = here.ranges_m
    near_m = true[0] - before_m
    noisy = here._replace(ranges_m=(near_m, *true[1:]))
    assert detector.observe(noisy, AHEAD, {1: robot}, 0) is not None
    assert detector.observe(here, AHEAD, {1: robot}, 50_000) is None and not detector.points
    # What is there stays.
    thing = here._replace(ranges_m=(near_m, near_m, *true[2:-1], near_m))
    assert detector.observe(thing, AHEAD, {1: robot}, 100_000) is not None
    assert detector.observe(thing, AHEAD, {1: robot}, 150_000) is not None


def test_what_stands_behind_a_robot_or_before_another_body_stays_in_mind() -> None:
    detector = ObstacleDetector(RADIUS_M, 1.5, np.empty((0, 4)), StoppingZone(RADIUS_M, 1.5))
    here, robot = observation(), Neighbour(Pose(*BODY, 0.0, 0.0, State.IDLE, False, 0), 0)
    behind = 4.0, 0.0
    detector.points[16, 0] = (behind, 0)
    detector.observe(here, AHEAD, {1: robot}, 50_000)
    assert (behind, 0) in detector.points.values(), "no ray gets there"
    detector.points.clear()
    detector.points[4, 0] = ((1.15, 0.0), 0)
    detector.observe(here, AHEAD, {}, 50_000)
    assert (4, 0) in detector.points, "the rays may end at the flank of the same body"


@pytest.mark.parametrize("off_m", [-0.6, -0.3, 0.3, 0.6])
def test_noise_at_a_fence_is_forgotten_when_the_scan_is_right_again(off_m: float) -> None:
    """Found by `headland chaos`, profile rays, seed 1025: echoes that noise had put before a fence or
    behind it stayed for 300 s, and the robot asked about an obstacle that was never there (L5)."""
    fence = np.array([(2.0, -20.0, 2.0, 20.0)])
    turns = [2 * pi * k / RAYS for k in range(RAYS)]
    true = [2.0 / cos(turn) if cos(turn) > 0.2 else inf for turn in turns]
    here = Observation(0.0, 0.0, 0.0, 0.0, 0.0, ranges_m=tuple(true))
    noisy = here._replace(ranges_m=(true[0] + off_m, *true[1:]))
    detector = ObstacleDetector(RADIUS_M, 1.5, fence, StoppingZone(RADIUS_M, 1.5))
    assert detector.observe(noisy, AHEAD, {}, 0) is not None
    assert detector.observe(here, AHEAD, {}, 50_000) is None and not detector.points
    thing = here._replace(ranges_m=(1.4, 1.4, *true[2:-1], 1.4))  # what is there stays
    assert detector.observe(thing, AHEAD, {}, 100_000) is not None
    assert detector.observe(thing, AHEAD, {}, 150_000) is not None


def test_a_point_behind_a_slanting_fence_is_forgotten() -> None:
    """Found by `headland chaos`, profile senses, seed 60500613: rays that repeated themselves left a
    point behind a fence. The ray beside it ended at the fence, just as far away as the point was, and
    the robot asked for good about an obstacle that was never there (L5)."""
    fence = np.array([(1.1, -20.0, 1.1, 20.0)])
    turns = [2 * pi * k / RAYS for k in range(RAYS)]
    true = [1.1 / cos(turn) if cos(turn) > 0.1 else inf for turn in turns]
    ray = 16
    here = Observation(0.0, 0.0, 0.0, 0.0, 0.0, ranges_m=tuple(true))
    detector = ObstacleDetector(RADIUS_M, 1.5, fence, StoppingZone(RADIUS_M, 1.5))
    turn = turns[ray] - 0.6 * 2 * pi / RAYS
    point = (true[ray] * cos(turn), true[ray] * sin(turn))
    assert point[0] > 1.1 + 0.25, "it is not the fence"
    detector.points[0, 0] = (point, 0)
    assert detector.observe(here, ((0.7, 2.4),), {}, 50_000) is None and not detector.points


def _before_a_fence() -> tuple[ObstacleDetector, list[float], tuple[float, float], int]:
    """A detector with a fence at x = 2.2 m and a point 0.3 m before it, between two rays: the detector,
    the rays without a body, the point, and the first of the two rays. It ends at the fence, just as far
    away as the point is."""
    fence = np.array([(2.2, -20.0, 2.2, 20.0)])
    true = [
        2.2 / cos(2 * pi * k / RAYS) if cos(2 * pi * k / RAYS) > 0.1 else inf for k in range(RAYS)
    ]
    ray = 12
    turn = 2 * pi * (ray + 0.9) / RAYS
    point = true[ray] * cos(turn), true[ray] * sin(turn)
    assert 2.2 - point[0] > 0.25 and true[ray + 1] > true[ray] + 0.18, (
        "not the fence; between two rays"
    )
    detector = ObstacleDetector(RADIUS_M, 1.5, fence, StoppingZone(RADIUS_M, 1.5))
    detector.points[0, 0] = (point, 0)
    return detector, true, point, ray


def test_a_point_before_a_slanting_fence_is_forgotten() -> None:
    """Found by `headland chaos`, profile fixes, seed 99000154: a wrong place left a point before a fence.
    The ray beside it ended at the fence, just as far away as the point was, and the robot asked for good
    about an obstacle that was never there (L5)."""
    detector, true, point, _ = _before_a_fence()
    here = Observation(0.0, 0.0, 0.0, 0.0, 0.0, ranges_m=tuple(true))
    assert detector.observe(here, (point,), {}, 50_000) is None and not detector.points


def test_a_body_beside_a_slanting_fence_stays_in_mind() -> None:
    """It stops the ray before the fence does, although the ray ends near the fence."""
    detector, true, point, ray = _before_a_fence()
    stopped_m = (2.2 - 0.15) / cos(2 * pi * ray / RAYS)
    here = Observation(0.0, 0.0, 0.0, 0.0, 0.0, ranges_m=(*true[:ray], stopped_m, *true[ray + 1 :]))
    at_m = stopped_m / hypot(*point)
    detector.points = {(0, 0): ((point[0] * at_m, point[1] * at_m), 0)}
    assert detector.observe(here, (point,), {}, 50_000) is not None


@pytest.mark.parametrize("cut", [True, False])
@pytest.mark.parametrize("speed_m_s", [0.8, 1.5, 2.5])
@pytest.mark.parametrize("course", [(-1.0, 0.0), (-0.7, 0.7), (0.0, 1.0), (0.7, 0.7)])
def test_a_robot_that_is_cut_off_and_comes_from_the_side_is_braked_for(
    course: tuple[float, float], speed_m_s: float, cut: bool
) -> None:
    """Found by `headland chaos`, profile apart, seed 115500072: two robots that were cut off from each
    other drove from their places to one row. Neither was in the strip of the other until they were 0.4 m
    apart, and they touched (S17)."""
    zone = StoppingZone(RADIUS_M, 1.5)
    detector = ObstacleDetector(RADIUS_M, 1.5, np.empty((0, 4)), zone)
    silent = Neighbour(Pose(-9.0, 5.0, 0.0, 0.0, State.IDLE, False, 0), 0)
    us, gap_m, period_s = (0.0, 0.0), 0.0, CONTROL_PERIOD_US / S
    v_m_s = u_m_s = speed_m_s  # ours, to the east, and its
    brakes = False
    body = (4.0 - 6.0 * course[0], -6.0 * course[1])
    for period in range(400):
        now_us = 2 * S + period * CONTROL_PERIOD_US
        here = observation(us, body)
        if cut:
            zone.observe({1: silent}, here, now_us)
        brakes |= detector.is_approached(here, {1: silent} if cut else {}, now_us)
        if brakes:
            v_m_s, u_m_s = (max(each - 1.5 * period_s, 0.0) for each in (v_m_s, u_m_s))
        us = us[0] + v_m_s * period_s, us[1]
        body = body[0] + course[0] * u_m_s * period_s, body[1] + course[1] * u_m_s * period_s
        gap_m = hypot(us[0] - body[0], us[1] - body[1]) - 2 * RADIUS_M
        if gap_m <= 0.0 or v_m_s == 0.0:
            break
    assert cut or not brakes, "robots that are heard avoid each other"
    assert gap_m > 0.0 or not cut, (gap_m, v_m_s)


@pytest.mark.parametrize("beside_m", [1.7, 2.2, 4.0])
def test_a_thing_that_stands_is_passed_at_full_speed_though_a_member_is_silent(
    beside_m: float,
) -> None:
    zone = StoppingZone(RADIUS_M, 1.5)
    detector = ObstacleDetector(RADIUS_M, 1.5, np.empty((0, 4)), zone)
    silent = {1: Neighbour(Pose(-9.0, 5.0, 0.0, 0.0, State.IDLE, False, 0), 0)}
    for period in range(80):
        now_us = 2 * S + period * CONTROL_PERIOD_US
        here = observation((-4.0 + 2.5 * period * CONTROL_PERIOD_US / S, 0.0), (0.0, beside_m))
        zone.observe(silent, here, now_us)
        assert not detector.is_approached(here, silent, now_us), period
