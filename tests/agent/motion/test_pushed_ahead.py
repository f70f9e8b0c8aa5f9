"""A robot before a working one that follows a fence gets out of its way."""

from math import hypot

import numpy as np
import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.lifecycle import State
from agent.interface.mission import MotionRequest
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Neighbour, Observation
from agent.motion.holonomic_motion import HolonomicMotion
from agent.motion.pushed_ahead import PUSHED_US, PushedAhead
from protocol.frames.fleet_frames import Pose

LIMITS = BodyLimits(radius_m=0.8, speed_m_s=2.5, acceleration_m_s2=2.0)
FENCE = np.array([[-50.0, 2.0, 300.0, 2.0]])
PERIOD_S = CONTROL_PERIOD_US / S


@pytest.mark.parametrize("off_m", [0.9, 0.4, 0.0, -0.4])
def test_a_robot_between_a_row_and_a_fence_is_passed_within_20_s(off_m: float) -> None:
    """It wants to go back, and the working robot comes along its row two metres from the fence. It
    was pushed to the end of the row (`curitiba`, 16 robots, seed 5: for 24 s)."""
    motion = HolonomicMotion(4, LIMITS, FENCE, half_bar_m=1.8)
    motion.set_state(State.WORKING)
    x_m, y_m, vx_m_s, vy_m_s = 0.0, off_m, 0.0, 0.0
    other_x_m, now_us = -6.0, 0
    while x_m > other_x_m and now_us < 20 * S:
        pose = Pose(other_x_m, 0.0, 0.0, 2.4, State.WORKING, False, 255, True)
        here = Observation(x_m, y_m, 0.0, vx_m_s, vy_m_s, sensed_at_us=now_us)
        wish = MotionRequest(-2.5, 0.0, 0.0, False)
        drive = motion.drive(here, wish, {3: Neighbour(pose, now_us)}, now_us)
        dx, dy = drive.vx_m_s - vx_m_s, drive.vy_m_s - vy_m_s
        share = min(1.0, LIMITS.acceleration_m_s2 * PERIOD_S / max(hypot(dx, dy), 1e-9))
        vx_m_s, vy_m_s = vx_m_s + share * dx, vy_m_s + share * dy
        x_m, y_m = x_m + vx_m_s * PERIOD_S, y_m + vy_m_s * PERIOD_S
        other_x_m += 2.4 * PERIOD_S
        now_us += CONTROL_PERIOD_US
        assert hypot(x_m - other_x_m, y_m) > 2 * LIMITS.radius_m and y_m < 2.0 - LIMITS.radius_m
    assert x_m < other_x_m, f"still before it after 20 s, at {x_m:.1f}, {y_m:.1f}"


def test_a_robot_that_makes_way_for_a_moment_is_not_pushed() -> None:
    pushed = PushedAhead(0.8, 2.5, 2.7, FENCE)
    for k in range(PUSHED_US // CONTROL_PERIOD_US - 1):
        pushed.observe((1.0, 0.0), (-1.0, 0.0), k * CONTROL_PERIOD_US)
    pushed.observe((1.0, 0.0), (1.0, 0.0), PUSHED_US)
    assert pushed.wish((0.0, 0.0), [], PUSHED_US) is None
