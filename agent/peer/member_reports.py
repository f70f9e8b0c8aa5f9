"""What members report about themselves: their health, their causes, and how much they have done."""

from collections.abc import Mapping
from typing import Any

from agent.peer import notices
from agent.peer.part import NOTHING, Handler, Header, Listener, Outputs, Part, StepContext
from agent.peer.told_causes import ToldCauses
from crdt import VectorClock
from protocol.frames.fleet_frames import Heartbeat, Standstill, VectorSlice


class MemberReports(Part):
    """The part that keeps what other members report about themselves, by slot."""

    def __init__(self, slot: int, clock: VectorClock) -> None:
        self.slot, self.clock = slot, clock
        self.healths: dict[int, float] = {}  # slot -> health from 0 to 1, from its heartbeats
        self.standstills: dict[int, ToldCauses] = {}  # slot -> why it stands or creeps

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {Standstill: self._standstill, VectorSlice: self._slice}

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {notices.HeartbeatHeard: self._heartbeat}

    def told_standing(self, slot: int, now_us: int) -> list[str]:
        """Why another member stands still and what a person can do, for each cause it reports."""
        told = self.standstills.get(slot)
        return [] if told is None else told.sentences(now_us)

    def _heartbeat(self, ctx: StepContext, notice: notices.HeartbeatHeard) -> Outputs:
        self.heard(notice.slot, notice.heartbeat)
        return NOTHING

    def heard(self, slot: int, m: Heartbeat) -> None:
        """A member's heartbeat."""
        self.clock.settle(slot, m.operations)
        self.healths[slot] = m.health
        if not (m.held or m.stopped) and slot in self.standstills:
            self.standstills[slot].moves()

    def _standstill(self, ctx: StepContext, header: Header, m: Standstill) -> Outputs:
        assert header.slot is not None
        self.standstills.setdefault(header.slot, ToldCauses()).hear(m, ctx.now_us)
        return NOTHING

    def _slice(self, ctx: StepContext, header: Header, m: VectorSlice) -> Outputs:
        for offset, low in enumerate(m.counts):
            member = m.base + offset
            if member != self.slot:  # our own counter is authoritative, so do not merge it
                self.clock.witness(member, low, bits=8)
        return NOTHING
