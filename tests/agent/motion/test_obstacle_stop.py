"""The question about an obstacle, state by state; how a robot behaves is in tests/chaos/test_pause.py."""

from math import inf

import numpy as np

from agent.interface.effects import HALT
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.motion.obstacle_detector import ObstacleDetector
from agent.motion.obstacle_stop import (
    FREE_US,
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
