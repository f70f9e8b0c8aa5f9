"""The question about an obstacle, state by state; how a robot behaves is in tests/chaos/test_pause.py."""

from math import inf

import numpy as np
import pytest

from agent.interface.effects import HALT
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.motion.obstacle_detector import GRAIN_M, ObstacleDetector
from agent.motion.obstacle_stop import (
    FREE_US,
    PASSING_M_S,
    QUESTION_TABLE,
    REPORT,
    ObstacleStop,
    QuestionEvent,
    QuestionState,
)
from agent.motion.stopping_zone import StoppingZone
from tests.state_tables import check_table


def test_every_state_and_event() -> None:
    none, asking, waiting, going_round = QuestionState
    blocked, told_to_wait, told_to_pass, way_free, passed = QuestionEvent
    check_table(QUESTION_TABLE, none, {
        (none, blocked, asking), (going_round, blocked, asking),
        (asking, told_to_wait, waiting),
        (asking, told_to_pass, going_round), (waiting, told_to_pass, going_round),
        (asking, way_free, none), (waiting, way_free, none),
        (going_round, passed, none),
    })  # fmt: skip


def test_people_are_told_what_the_robot_then_does() -> None:
    """A report has the name of the state that its event leads to; GONE leads to no question."""
    for (source, event), target in QUESTION_TABLE.items():
        if event in REPORT and source is not target:
            gone = event is QuestionEvent.WAY_FREE
            assert REPORT[event].name == ("GONE" if gone else target.name)


def test_what_it_goes_round_follows_what_it_sees() -> None:
    """What has gone is gone round no longer. What is seen beside it belongs to it, nothing else does."""
    lookout = ObstacleDetector(0.8, 1.5, np.empty((0, 4)), StoppingZone(0.8, 1.5))
    stop = ObstacleStop(0, BodyLimits(0.8, 2.5, 1.5), lookout)
    near, gone, beside, other = (10, 0), (12, 0), (10, 3), (100, 0)

    def sees(*grains: tuple[int, int]) -> frozenset[tuple[int, int]]:
        lookout.points = dict.fromkeys(grains, ((0.0, 0.0), 0))
        stop.watch(HALT, Observation(0.0, 0.0, 0.0, 0.0, 0.0), {}, True, 0)
        return stop.things

    stop.machine.fire(QuestionEvent.BLOCKED)
    lookout.points = dict.fromkeys((near, gone), ((0.0, 0.0), 0))
    stop.go_round("a test", 0)
    assert sees(near, beside, other) == {near, beside}
    assert isinstance(stop.things, frozenset)
    assert not sees(other) and stop.machine.state is QuestionState.NONE


def test_a_robot_without_scans_does_not_see_that_an_obstacle_has_gone() -> None:
    lookout = ObstacleDetector(0.8, 1.5, np.empty((0, 4)), StoppingZone(0.8, 1.5))
    stop = ObstacleStop(0, BodyLimits(0.8, 2.5, 1.5), lookout)
    stop.machine.fire(QuestionEvent.BLOCKED)
    blind = Observation(0.0, 0.0, 0.0, 0.0, 0.0)
    clear = blind._replace(ranges_m=(inf,) * 36)
    for now_us in range(0, 10 * FREE_US, FREE_US // 10):
        stop.watch(HALT, blind, {}, False, now_us)
    assert stop.asking
    for now_us in range(10 * FREE_US, 12 * FREE_US, FREE_US // 10):
        stop.watch(HALT, clear, {}, False, now_us)
    assert not stop.asking


@pytest.mark.parametrize(
    ("way_m_s", "asks"), [((0.0, 2.0), True), ((2.0, 0.0), False), ((0.0, 0.0), False)]
)
def test_a_robot_asks_only_about_what_is_in_the_way_of_its_mission(
    way_m_s: tuple[float, float], asks: bool
) -> None:
    """It stops before a thing towards which it swerves for a robot, and drives on when it need not."""
    lookout = ObstacleDetector(0.6, 1.5, np.empty((0, 4)), StoppingZone(0.6, 1.5))
    stop = ObstacleStop(0, BodyLimits(0.6, 2.5, 1.5), lookout)
    ranges_m = [inf] * 72
    ranges_m[17] = ranges_m[18] = ranges_m[19] = 1.1  # to the north
    here = Observation(0.0, 0.0, 0.0, 0.0, 0.0, tuple(ranges_m))
    swerve, east = HALT._replace(vy_m_s=1.0), HALT._replace(vx_m_s=1.0)
    drive, _ = stop.watch(swerve, here, {}, True, 0, way_m_s)
    assert drive == HALT and stop.asking is asks
    if not asks:
        assert stop.watch(east, here, {}, True, 50_000, way_m_s)[0].vx_m_s == 1.0


def past_a_point(x_m: float, y_m: float) -> float:
    """How fast a robot that goes round a confirmed obstacle drives east past its nearest point, m/s."""
    lookout = ObstacleDetector(0.35, 2.0, np.empty((0, 4)), StoppingZone(0.35, 2.0))
    stop = ObstacleStop(0, BodyLimits(0.35, 1.0, 2.0), lookout)
    stop.machine.fire(QuestionEvent.BLOCKED)
    grain = (round(x_m / GRAIN_M), round(y_m / GRAIN_M))
    lookout.points = {grain: ((x_m, y_m), 0)}
    stop.go_round("a test", 0)
    here = Observation(0.0, 0.0, 0.0, 0.0, 0.0, (9.0,) * 36)
    wanted = HALT._replace(vx_m_s=0.9)
    seen = lookout.ahead(here, (0.9, 0.0), 3.0)
    if seen is None:
        return 0.9
    return stop._creep(wanted, here, seen, True, 0)[0].vx_m_s


@pytest.mark.parametrize(
    ("at_m", "at_least_m_s", "at_most_m_s"),
    [
        ((0.05, -0.49), 0.2, PASSING_M_S),  # beside the hull
        ((0.55, -0.49), 0.2, PASSING_M_S),  # soon beside it
        ((0.55, -0.40), 0.0, 0.0),  # nearer than the hull may pass
        ((0.55, 0.0), 0.0, 0.0),
        ((1.2, 0.0), 0.3, 1.0),
        ((1.2, -0.49), 0.3, 1.0),
    ],
)
def test_a_robot_gets_past_what_is_within_the_margin_of_its_side(
    at_m: tuple[float, float], at_least_m_s: float, at_most_m_s: float
) -> None:
    """It stood beside a corner of the obstacle, 15 cm from its hull, and asked again and again: in one of
    four runs of `visitor`."""
    assert at_least_m_s <= past_a_point(*at_m) <= at_most_m_s
