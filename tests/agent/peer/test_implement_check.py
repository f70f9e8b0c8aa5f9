"""An implement that does not rise stops its robot, and the robot goes on when it has risen."""

import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.effects import HALT
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView, MotionRequest
from agent.interface.observation import Observation
from agent.peer.implement_check import RISES_WITHIN_US
from agent.safety.stop_cause import StopCause
from tests.agent.lone_peer import Eager, held_by, peer_in
from tests.agent.peer.test_sense_freshness import Robot


def down(seen: Observation) -> Observation:
    return seen._replace(implement_down=True)


def up(seen: Observation) -> Observation:
    return seen._replace(implement_down=False)


class Raised(Eager):
    """Drives with its implement up."""

    def work(self, view: FleetView) -> MotionRequest:
        return super().work(view)._replace(tool_on=False)


def driving(mission: Eager | None = None) -> Robot:
    robot = Robot()
    robot.peer = peer_in(State.WORKING, None, mission=mission or Raised())
    robot.spoilt = up
    robot.periods(80)
    assert robot.v_m_s == pytest.approx(2.0) and not held_by(robot.peer)
    return robot


def test_an_implement_that_stays_down_stops_the_robot_and_lets_it_go_when_it_is_up() -> None:
    robot = driving()
    robot.spoilt, begun_at_us, before_m = down, robot.now_us, robot.x_m
    while robot.told != HALT:
        robot.period()
    assert 0 <= robot.now_us - begun_at_us - RISES_WITHIN_US <= 2 * CONTROL_PERIOD_US
    assert held_by(robot.peer) == {StopCause.IMPLEMENT_DOWN}
    robot.periods(100)
    assert robot.v_m_s == 0.0 and robot.told == HALT
    assert robot.x_m - before_m < 2.0 * RISES_WITHIN_US / S + 2.0
    robot.spoilt = up
    assert robot.periods(2).told != HALT and not held_by(robot.peer)


def test_an_implement_that_rises_in_time_stops_nobody() -> None:
    robot = driving()
    for _ in range(5):
        robot.spoilt = down
        robot.periods(RISES_WITHIN_US // CONTROL_PERIOD_US)
        robot.spoilt = up
        robot.periods(1)
        assert robot.told != HALT and not held_by(robot.peer)


def test_a_body_that_does_not_sense_its_implement_is_not_held() -> None:
    robot = driving()
    robot.spoilt = lambda seen: seen
    assert not held_by(robot.periods(100).peer)


def test_an_implement_that_was_told_to_be_down_stops_nobody() -> None:
    robot = driving(Eager())
    assert robot.told.tool_on
    robot.spoilt = down
    assert not held_by(robot.periods(100).peer)
