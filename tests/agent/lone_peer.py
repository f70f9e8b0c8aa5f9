"""One peer without a bus, in any state and held by any cause."""

from collections.abc import Mapping
from random import Random

import numpy as np

from agent.interface.config import S
from agent.interface.effects import HALT, Drive, Effect, Send
from agent.interface.identity import Identity, SilencePolicy
from agent.interface.lifecycle import State
from agent.interface.mission import Mission
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.motion.holonomic_motion import HolonomicMotion
from agent.peer.inputs import BusState, Heard, Sensed, Timer
from agent.peer.peer import Peer
from agent.runtime.peer_factory import MissionParts, make_peer
from agent.safety.stop_cause import ClearCondition, StopCause
from protocol.controller_health import Health
from protocol.frames.fleet_frames import Member
from protocol.frames.network_frames import AddressClaimed
from protocol.name import fleet_name, tool_name
from sim.rigs.keyed_rig import AlwaysForward

BY_TIME_US = 1 * S  # what is raised with a time holds so long here


class Eager(AlwaysForward):
    """A mission of one section that always wants full speed."""

    section_units: Mapping[int, int] = {0: 4}


def peer_in(
    state: State, cause: StopCause | None, policy: SilencePolicy = SilencePolicy.STOP,
    mission: Mission | None = None, acceleration_m_s2: float = 1.5,
) -> Peer:  # fmt: skip
    identity = Identity(
        0, frozenset(range(3)), fleet_name("total", 0), 1, policy, started=True, first_boot=True
    )
    motion = HolonomicMotion(0, BodyLimits(0.8, 2.5, acceleration_m_s2), np.empty((0, 4)))
    peer = make_peer(identity, Random(1), 0, {}, MissionParts(mission or Eager(), motion))
    peer.step(Sensed(Observation(0.0, 0.0, 0.0, 0.0, 0.0, sensed_at_us=0)), 0)
    if cause is StopCause.BUS_OFF:
        peer.step(BusState(Health.OFF, True), 0)  # a bus can come back only after it was gone
    peer.claims.current = 0 if state is State.WORKING else None
    peer.lifecycle.machine.state = state
    if cause is not None:
        timed = cause.clears in (ClearCondition.BY_TIMEOUT, ClearCondition.WHEN_APART)
        peer.safety.raise_cause(cause, 0, "", BY_TIME_US if timed else 0)
    return peer


def introduce(peer: Peer, address: int, slot: int, now_us: int = 0) -> list[Effect]:
    """Another robot of its fleet claims an address and says which member it is."""
    claim = AddressClaimed(fleet_name("total", slot).pack())
    heard = peer.step(Heard(address, claim), now_us)
    return [*heard, *peer.step(Heard(address, Member(slot, 0, 1)), now_us)]


def introduce_tools(peer: Peer, *addresses: int) -> Peer:
    """Panels and operators' devices claim these addresses."""
    for address in addresses:
        peer.step(Heard(address, AddressClaimed(tool_name(address).pack())), 0)
    return peer


def held_by(peer: Peer) -> set[StopCause]:
    return {cause for cause, _ in peer.safety.causes}


def turn(peer: Peer, now_us: int) -> list[Effect]:
    """It senses that it has moved a little, its bus has sent what it said, and it has a turn."""
    assert peer.here is not None
    peer.step(BusState(Health.ACTIVE, True, now_us), now_us)
    x_m = peer.here.x_m + 0.05
    peer.step(Sensed(peer.here._replace(x_m=x_m, sensed_at_us=now_us)), now_us)
    return [*peer.step(Timer(), now_us)]


def pass_time(peer: Peer, until_us: int = 10 * S) -> None:
    """Its body does what it is told, at once, and its bus confirms each frame."""
    now_us, x_m, drive, sent = 0, 0.0, HALT, 0
    while now_us < until_us:
        then_us = max(now_us + 1, peer.due_at_us)
        x_m += drive.vx_m_s * (then_us - now_us) / S
        now_us = then_us
        peer.step(BusState(Health.ACTIVE, True, sent), now_us)
        if peer.wants_observation(now_us):
            here = Observation(x_m, 0.0, 0.0, drive.vx_m_s, 0.0, sensed_at_us=now_us)
            peer.step(Sensed(here), now_us)
        effects = peer.step(Timer(), now_us)
        sent += sum(isinstance(effect, Send) for effect in effects)
        drive = next((e for e in effects if isinstance(e, Drive)), drive)
