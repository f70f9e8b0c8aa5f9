"""The distance to others and to fences grows with the accuracy of our own place."""

from math import dist, inf, isfinite, nan

import numpy as np
import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.lifecycle import State
from agent.interface.mission import MotionRequest
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Neighbour, Observation
from agent.motion.holonomic_motion import ACCURACIES, FENCE_SPARE_M, HolonomicMotion
from protocol.frames.fleet_frames import Pose

LIMITS = BodyLimits(0.8, 2.5, 1.5)
STANDS = Pose(10.0, 0.05, 0.0, 0.0, State.IDLE, False, True, False)


def nearest_m(accuracy_m: float) -> float:
    """How near the middle of a robot comes to one that stands in its way."""
    motion = HolonomicMotion(0, LIMITS, np.empty((0, 4)))
    x_m = y_m = vx_m_s = vy_m_s = 0.0
    nearest, step_s = 99.0, CONTROL_PERIOD_US / S
    for period in range(400):
        now_us = period * CONTROL_PERIOD_US
        here = Observation(
            x_m, y_m, 0.0, vx_m_s, vy_m_s, sensed_at_us=now_us, position_accuracy_m=accuracy_m
        )
        told = motion.drive(here, MotionRequest(1.5, 0.0), {1: Neighbour(STANDS, now_us)}, now_us)
        vx_m_s, vy_m_s = told.vx_m_s, told.vy_m_s
        x_m, y_m = x_m + vx_m_s * step_s, y_m + vy_m_s * step_s
        nearest = min(nearest, dist((x_m, y_m), (STANDS.x_m, STANDS.y_m)))
    return nearest


@pytest.mark.parametrize("accuracy_m", [0.05, 0.15])
def test_a_robot_with_an_inaccurate_place_keeps_further_away(accuracy_m: float) -> None:
    more_m = nearest_m(accuracy_m) - nearest_m(0.0)
    assert more_m == pytest.approx(ACCURACIES * accuracy_m, abs=0.03)


def nearest_to_fence_m(accuracy_m: float) -> float:
    """How near the middle of a robot comes to a fence that it is told to drive through."""
    motion = HolonomicMotion(0, LIMITS, np.array([[10.0, -50.0, 10.0, 50.0]]))
    x_m = vx_m_s = 0.0
    for period in range(400):
        now_us = period * CONTROL_PERIOD_US
        here = Observation(
            x_m, 0.0, 0.0, vx_m_s, 0.0, sensed_at_us=now_us, position_accuracy_m=accuracy_m
        )
        vx_m_s = motion.drive(here, MotionRequest(1.5, 0.0), {}, now_us).vx_m_s
        x_m += vx_m_s * CONTROL_PERIOD_US / S
    return 10.0 - x_m


@pytest.mark.parametrize("accuracy_m", [0.01, 0.15])
def test_a_robot_with_an_inaccurate_place_keeps_further_from_fences(accuracy_m: float) -> None:
    """It kept 0.2 m from them however inaccurate its place was. Planned ways stay permitted."""
    more_m = nearest_to_fence_m(accuracy_m) - nearest_to_fence_m(0.0)
    assert more_m == pytest.approx(min(ACCURACIES * accuracy_m, FENCE_SPARE_M), abs=0.01)


@pytest.mark.parametrize("accuracy_m", [inf, nan])
def test_an_accuracy_that_is_no_number_gives_a_command_that_is_one(accuracy_m: float) -> None:
    """The gate stops such a robot; what it is asked to let through must be a number all the same."""
    motion = HolonomicMotion(0, LIMITS, np.array([[10.0, -50.0, 10.0, 50.0]]))
    here = Observation(0.0, 0.0, 0.0, 0.0, 0.0, sensed_at_us=0, position_accuracy_m=accuracy_m)
    told = motion.drive(here, MotionRequest(1.5, 0.0), {1: Neighbour(STANDS, 0)}, 0)
    assert isfinite(told.vx_m_s) and isfinite(told.vy_m_s)
