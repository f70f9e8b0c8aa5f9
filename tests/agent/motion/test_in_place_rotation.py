"""A body that turns on the spot gets out of a corner into which it was pushed aslant."""

from math import cos, hypot, pi, sin

import numpy as np
import pytest

from agent.avoidance.fence_distance import gap_m
from agent.interface.lifecycle import State
from agent.interface.mission import MotionRequest
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Neighbour
from agent.interface.vehicle import DriveTrain
from agent.motion.tractor_motion import TractorMotion
from agent.motion.tractor_tracker import SteeringLimits
from agent.paths.tractor_route import TurnRoute
from protocol.frames.fleet_frames import NOBODY, Pose
from sim.world.drive_trains import Chassis
from sim.world.world import World

RADIUS_M = 0.8
TURNS = TurnRoute(np.zeros((240, 240), dtype=bool), -30.0, -30.0, 0.25, 0.6)
CHASSIS = Chassis(speed_m_s=2.5, kind=DriveTrain.DIFFERENTIAL)
BODY, STEERING = BodyLimits(RADIUS_M, 2.5, 1.5), SteeringLimits(2.5, 0.7, 6.0)


def corner(angle_rad: float) -> np.ndarray:
    """Two fences that meet at (0, 0), one along x and one at this angle to it."""
    return np.array(
        [(0.0, 0.0, 30.0, 0.0), (0.0, 0.0, 30.0 * cos(angle_rad), 30.0 * sin(angle_rad))]
    )


def out_m(angle_deg: int, heading_deg: int, ahead: float, *, turns: bool) -> float:
    """How far from the tip a body is after 25 s that wants to drive `ahead` (1 or -1) the whole time.

    It begins 4 cm from both fences."""
    angle_rad = angle_deg * pi / 180
    fences = corner(angle_rad)
    tip_m = (RADIUS_M + 0.04) / sin(angle_rad / 2)
    world = World([(tuple(each[:2]), tuple(each[2:])) for each in fences.tolist()], 1)
    start = tip_m * cos(angle_rad / 2), tip_m * sin(angle_rad / 2)
    body = world.add_robot(0, start, RADIUS_M, CHASSIS, heading_deg * pi / 180)
    motion = TractorMotion(0, BODY, TURNS, STEERING, fences, turns_on_the_spot=turns)
    for now_us in range(0, 25_000_000, 50_000):
        here = body.sense(now_us)
        vx_m_s, vy_m_s = ahead * cos(here.heading_rad), ahead * sin(here.heading_rad)
        body.drive(motion.drive(here, MotionRequest(vx_m_s, vy_m_s, 0.0), {}, now_us), now_us)
    assert world.contacts == []
    return hypot(*body.position) - tip_m


@pytest.mark.parametrize("ahead", [1.0, -1.0])
@pytest.mark.parametrize(("angle_deg", "heading_deg"), [(90, 135), (90, -45), (54, 117), (35, -70)])
def test_a_body_that_fences_hold_turns_and_drives_away(
    angle_deg: int, heading_deg: int, ahead: float
) -> None:
    """Found by chaos with bodies of differential drive in a triangle: one was pushed aslant into a corner
    and stood there for good, because no curve led out."""
    assert out_m(angle_deg, heading_deg, ahead, turns=False) < 0.1
    assert out_m(angle_deg, heading_deg, ahead, turns=True) > 1.0


def gone_m(heading_deg: float, *, turns: bool) -> float:
    """How far a small body drives in 12 s that wants to drive ahead, in a corner of 64 degrees.

    One fence is behind it, and a standing body as near beside it as avoidance allows."""
    fences = corner(64 * pi / 180)
    world = World([(tuple(each[:2]), tuple(each[2:])) for each in fences.tolist()], 1)
    start, other = (1.53, 1.62), (1.1, 0.54)
    body = world.add_robot(0, start, 0.4, CHASSIS, heading_deg * pi / 180)
    world.add_robot(1, other, 0.4, CHASSIS)
    middles_m = -30.0 + (np.arange(240) + 0.5) * 0.25
    blocked = np.array([[gap_m(x_m, y_m, fences) < 0.6 for x_m in middles_m] for y_m in middles_m])
    ways = TurnRoute(blocked, -30.0, -30.0, 0.25, 0.6)
    motion = TractorMotion(
        0, BodyLimits(0.4, 2.5, 1.5), ways, STEERING, fences, turns_on_the_spot=turns
    )
    for now_us in range(0, 12_000_000, 50_000):
        here = body.sense(now_us)
        wish = MotionRequest(cos(here.heading_rad), sin(here.heading_rad), 0.0)
        pose = Pose(*other, 0.0, 0.0, State.IDLE, False, NOBODY)
        drive = motion.drive(here, wish, {1: Neighbour(pose, now_us)}, now_us)
        body.drive(drive, now_us)
    assert world.contacts == []
    return hypot(body.position[0] - start[0], body.position[1] - start[1])


@pytest.mark.parametrize("heading_deg", [-30.0, -75.0])
def test_a_body_between_a_fence_and_another_body_turns_and_drives_away(heading_deg: float) -> None:
    """Found in a drawn triangle: two small bodies stood beside each other at the gate for good."""
    assert gone_m(heading_deg, turns=False) < 0.3
    assert gone_m(heading_deg, turns=True) > 1.0
