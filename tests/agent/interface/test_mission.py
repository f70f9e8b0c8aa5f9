"""A mission needs two methods; everything else that its peer calls has a default."""

from random import Random
from typing import Any

import numpy as np
import pytest

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.effects import Drive
from agent.interface.mission import ClaimRequest, FleetView, Mission, MotionRequest
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.motion.holonomic_motion import HolonomicMotion
from agent.peer.inputs import Sensed, Timer
from agent.runtime.peer_factory import MissionParts, identity_of, make_peer
from sim.record.robot_intent import intent_of


class Smallest(Mission):
    def choose(self, view: FleetView) -> ClaimRequest | None:
        return None

    def work(self, view: FleetView) -> MotionRequest:
        return MotionRequest(1.0, 0.0)


def test_a_mission_without_hooks_runs_and_stands_still_without_a_section() -> None:
    identity = identity_of("total", 0, 2, 1, first_boot=True)
    motion = HolonomicMotion(0, BodyLimits(0.8, 2.5, 1.5), np.empty((0, 4)))
    peer = make_peer(identity, Random(1), 0, {}, MissionParts(Smallest(), motion))
    drives = list[Drive]()
    for now_us in range(0, 3 * S, CONTROL_PERIOD_US):
        peer.step(Sensed(Observation(0.0, 0.0, 0.0, 0.0, 0.0, sensed_at_us=now_us)), now_us)
        drives += [effect for effect in peer.step(Timer(), now_us) if isinstance(effect, Drive)]
    assert drives
    assert all(drive.vx_m_s == 0.0 == drive.vy_m_s for drive in drives)
    assert len(peer.progress) == 0
    intent = intent_of(peer)
    assert intent is not None and intent.path == ()


def test_a_mission_without_hooks_accepts_no_goal_and_sends_nothing() -> None:
    mission = Smallest()
    assert not mission.accepts_goal((0.0, 0.0))
    assert not mission.replans
    assert list(mission.outgoing(0)) == []
    assert mission.covered_units().units == ()


def test_a_mission_that_cannot_choose_or_work_cannot_be_made() -> None:
    class Idle(Mission):
        def choose(self, view: FleetView) -> ClaimRequest | None:
            return None

    incomplete: type[Any] = Idle
    with pytest.raises(TypeError, match="work"):
        incomplete()
