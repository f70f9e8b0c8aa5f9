"""A robot whose range sensors fall silent or hang stands, and goes on by itself when they work again."""

from math import cos, inf, pi, sin
from random import Random

import pytest

from agent.interface.config import CONTROL_PERIOD_US, SCAN_AGE_MAX_US
from agent.interface.effects import HALT
from agent.interface.observation import Observation
from agent.peer.range_freshness import MOVED_M, STEADY_US
from agent.safety.stop_cause import StopCause
from tests.agent.lone_peer import held_by
from tests.agent.peer.test_sense_freshness import Robot

RAYS, FAR_M = 36, 60.0


def facing(seen: Observation) -> Observation:
    """A wall across its way, 60 m from its start."""
    turns = [2 * pi * k / RAYS for k in range(RAYS)]
    ahead_m = FAR_M - seen.x_m
    return seen._replace(
        ranges_m=tuple(ahead_m / cos(turn) if cos(turn) > 0.5 else inf for turn in turns)
    )


def beside(seen: Observation) -> Observation:
    """A straight wall beside its way: every scan is the same."""
    turns = [2 * pi * k / RAYS for k in range(RAYS)]
    return seen._replace(
        ranges_m=tuple(3.0 / sin(turn) if sin(turn) > 0.3 else inf for turn in turns)
    )


def without(seen: Observation) -> Observation:
    return seen._replace(ranges_m=())


def driving() -> Robot:
    robot = Robot()
    robot.spoilt = facing
    robot.periods(80)
    assert robot.v_m_s == pytest.approx(2.0) and not held_by(robot.peer)
    return robot


def test_a_robot_without_scans_stands_in_the_next_period_and_comes_back() -> None:
    robot = driving()
    robot.spoilt = without
    assert robot.periods(1).told == HALT and held_by(robot.peer) == {StopCause.SCAN_LOST}
    robot.periods(60)
    robot.spoilt, back_at_us = facing, robot.now_us
    while robot.told == HALT:
        robot.period()
    assert STEADY_US <= robot.now_us - back_at_us <= STEADY_US + 2 * CONTROL_PERIOD_US
    assert not held_by(robot.peer)


def test_a_robot_that_never_had_a_scan_has_no_range_sensors() -> None:
    robot = Robot()
    robot.spoilt = without
    assert robot.periods(80).v_m_s == pytest.approx(2.0) and not held_by(robot.peer)


def test_a_scan_that_hangs_stops_a_robot_that_moves() -> None:
    robot = driving()
    assert robot.sensed is not None
    old = facing(robot.sensed).ranges_m
    robot.spoilt = lambda seen: seen._replace(ranges_m=old)
    hung_at_us, hung_at_m = robot.now_us, robot.x_m
    while robot.told != HALT:
        robot.period()
    late_m = 2.0 * CONTROL_PERIOD_US / 1e6
    assert robot.x_m - hung_at_m <= max(MOVED_M, 2.0 * SCAN_AGE_MAX_US / 1e6) + 2 * late_m
    assert robot.now_us - hung_at_us <= SCAN_AGE_MAX_US + 2 * CONTROL_PERIOD_US
    robot.periods(100)
    assert held_by(robot.peer) == {StopCause.SCAN_LOST}, "standing does not prove a scan"
    robot.spoilt = facing
    robot.periods(2 + STEADY_US // CONTROL_PERIOD_US)
    assert not held_by(robot.peer) and robot.told != HALT


def test_a_standing_robot_sees_the_same_for_ever_and_is_free() -> None:
    robot = driving()
    robot.peer.safety.raise_cause(StopCause.CREEP, robot.now_us)
    robot.blind = True  # so that it stands
    robot.periods(60)
    robot.blind = False
    robot.periods(100)
    assert StopCause.SCAN_LOST not in held_by(robot.peer)


def test_a_wall_along_the_way_looks_the_same_everywhere() -> None:
    robot = Robot()
    robot.spoilt = beside
    assert robot.periods(200).v_m_s == pytest.approx(2.0) and not held_by(robot.peer)


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_not_taken_for_a_fault(seed: int) -> None:
    rng, robot = Random(seed), driving()
    robot.spoilt = lambda seen: seen._replace(
        ranges_m=tuple(
            inf if rng.random() < 0.3 else max(0.0, each + rng.gauss(0.0, 0.2))
            for each in facing(seen).ranges_m
        )
    )
    robot.periods(200)
    assert StopCause.SCAN_LOST not in held_by(robot.peer)
