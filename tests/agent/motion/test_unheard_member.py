"""A member that has not been heard for long stays an obstacle for robots without range sensors."""

from math import hypot

import numpy as np
import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.lifecycle import State
from agent.interface.mission import MotionRequest
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Neighbour, Observation
from agent.motion.holonomic_motion import UNHEARD_US, HolonomicMotion
from protocol.frames.fleet_frames import Pose

LIMITS = BodyLimits(0.35, 0.8, 1.0)
STANDS = Pose(4.0, 0.05, 0.0, 0.0, State.WORKING, False, True, False)


def nearest_m(ranges_m: tuple[float, ...], unheard_for_us: int) -> float:
    """How near a robot comes to a member that was last heard this long before it set out."""
    motion = HolonomicMotion(0, LIMITS, np.empty((0, 4)), looks=True)
    x_m = y_m = vx_m_s = vy_m_s = 0.0
    nearest, step_s = 99.0, CONTROL_PERIOD_US / S
    for period in range(300):
        now_us = unheard_for_us + period * CONTROL_PERIOD_US
        here = Observation(
            x_m, y_m, 0.0, vx_m_s, vy_m_s, ranges_m=ranges_m, sensed_at_us=now_us
        )  # fmt: skip
        told = motion.drive(here, MotionRequest(0.8, 0.0), {1: Neighbour(STANDS, 0)}, now_us)
        vx_m_s, vy_m_s = told.vx_m_s, told.vy_m_s
        x_m, y_m = x_m + vx_m_s * step_s, y_m + vy_m_s * step_s
        nearest = min(nearest, hypot(x_m - STANDS.x_m, y_m - STANDS.y_m))
    return nearest


@pytest.mark.parametrize("unheard_for_us", [UNHEARD_US // 2, UNHEARD_US, 24 * UNHEARD_US])
def test_a_robot_without_range_sensors_keeps_away_from_where_it_stood(unheard_for_us: int) -> None:
    """A vehicle drove through one that stood: its place was unknown for more than five seconds."""
    assert nearest_m((), unheard_for_us) > 2 * LIMITS.radius_m


def test_a_robot_whose_range_sensors_see_that_it_is_gone_drives_on() -> None:
    assert nearest_m((9.0,) * 36, 2 * UNHEARD_US) < LIMITS.radius_m
