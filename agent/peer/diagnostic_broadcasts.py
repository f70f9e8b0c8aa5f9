"""What a robot tells diagnostic tools unasked, or in a rhythm that they asked for.

DM1 of SAE J1939-73: each second while a cause is active, at once when causes change, and once when
the last one has gone. A cause that the leader of the fleet repeats is left to it (`repeated_causes`).
The standard heartbeat of ISO 11783-7: after a request for its rate.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from agent.interface.config import FAULTS_PERIOD_US, MS, STANDARD_HEARTBEAT_US
from agent.interface.effects import Effect, Send
from agent.interface.instants import FOREVER_US
from agent.peer.diagnostics import fault_of, repeated_causes, root_causes
from agent.peer.leader_votes import LeaderVotes
from agent.peer.member_reports import MemberReports
from agent.peer.part import NOTHING, Handler, Header, Outputs, Part, StepContext
from agent.peer.pgn_responder import PgnResponder, acknowledged
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from protocol.frames.diagnostic_frames import (
    DM1,
    DM13,
    STANDARD_HEARTBEAT,
    BroadcastControl,
    ClearControl,
    ClearFault,
    ClearRefusal,
    StandardHeartbeat,
)
from protocol.frames.fleet_frames import Standstill
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.frames.network_frames import AcknowledgmentControl, RepetitionRateRequest

FAULTS_GAP_US: Final = 200 * MS  # a cause that comes and goes must not fill the bus
FIRST_SEQUENCE: Final = 251
LAST_SEQUENCE: Final = 250
END_SEQUENCE: Final = 255
OWN_RATE: Final = 0xFFFF


class DiagnosticBroadcasts(Part):
    """The part that sends DM1 and the standard heartbeat, and refuses to clear what holds a robot."""

    def __init__(
        self,
        safety: StopController,
        letters: PgnResponder,
        votes: LeaderVotes,
        reports: MemberReports,
        cyclic: bool,
    ) -> None:
        """`cyclic`: whether DM1 is sent unasked."""
        self.safety, self.letters, self.cyclic = safety, letters, cyclic
        self.votes, self.reports = votes, reports
        self._told: tuple[StopCause, ...] = ()  # active at our newest DM1
        self._told_at_us = -FAULTS_PERIOD_US
        self._beat_at_us = FOREVER_US
        self._sequence = FIRST_SEQUENCE

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {
            RepetitionRateRequest: self._rate,
            BroadcastControl: self._stop_talking,
            ClearFault: self._clear,
        }

    @property
    def due_at_us(self) -> int:
        if not self.cyclic or (self.safety.free and not self._told):
            return self._beat_at_us
        period_us = FAULTS_PERIOD_US if self._same() else FAULTS_GAP_US
        return min(self._beat_at_us, self._told_at_us + period_us)

    def on_timer(self, ctx: StepContext) -> Outputs:
        if ctx.now_us < self.due_at_us:
            return NOTHING
        outputs: list[Effect] = []
        if self._beat_at_us <= ctx.now_us:
            outputs += self._beat(ctx)
        if self.cyclic and not (self.safety.free and not self._told):
            outputs += self._faults(ctx)
        return outputs

    def _same(self) -> bool:
        return self._told == root_causes(self.safety.causes)

    def _faults(self, ctx: StepContext) -> Sequence[Effect]:
        period_us = FAULTS_PERIOD_US if self._same() else FAULTS_GAP_US
        if ctx.now_us < self._told_at_us + period_us:
            return ()
        self._told_at_us = ctx.now_us
        if not ctx.joined:  # looked at again after that time
            return ()
        causes = self.safety.causes
        self._told, faults = root_causes(causes), self.letters.faults
        faults.see(self._told)
        content = faults.active_faults(repeated_causes(causes, self._leader_tells(ctx)))
        return self.letters.sends(DM1.pgn, content, GLOBAL_ADDRESS, ctx.now_us)

    def _leader_tells(self, ctx: StepContext) -> Sequence[Standstill]:
        """The causes that hold the leader; none if we lead, or if no leader is heard."""
        leader = self.votes.leader
        if leader is None or leader == ctx.slot or leader not in ctx.live:
            return ()
        told = self.reports.standstills.get(leader)
        return () if told is None else told.fresh(ctx.now_us)

    def _beat(self, ctx: StepContext) -> Sequence[Effect]:
        self._beat_at_us = ctx.now_us + STANDARD_HEARTBEAT_US
        if not ctx.joined:
            return ()
        sequence = self._sequence
        self._sequence = 0 if sequence >= LAST_SEQUENCE else sequence + 1
        return [Send(StandardHeartbeat(sequence))]

    def _rate(self, ctx: StepContext, header: Header, m: RepetitionRateRequest) -> Outputs:
        if not ctx.joined:
            return NOTHING
        allowed = (0, STANDARD_HEARTBEAT_US // MS, OWN_RATE)
        if m.pgn != STANDARD_HEARTBEAT.pgn or m.rate_ms not in allowed:
            return acknowledged(
                AcknowledgmentControl.NACK, header.source, header.destination, m.pgn
            )
        sends = self._beat_at_us != FOREVER_US
        if m.rate_ms == 0:
            self._beat_at_us = FOREVER_US
            return [Send(StandardHeartbeat(END_SEQUENCE))] if sends else NOTHING
        if not sends:
            self._beat_at_us, self._sequence = ctx.now_us, FIRST_SEQUENCE
        return NOTHING

    def _stop_talking(self, ctx: StepContext, header: Header, m: BroadcastControl) -> Outputs:
        if not ctx.joined:
            return NOTHING
        return acknowledged(AcknowledgmentControl.NACK, header.source, header.destination, DM13.pgn)

    def _clear(self, ctx: StepContext, header: Header, m: ClearFault) -> Outputs:
        asks = m.control in (ClearControl.CLEAR_PREVIOUS, ClearControl.CLEAR_ACTIVE)
        if not ctx.joined or not asks or header.destination == GLOBAL_ADDRESS:
            return NOTHING
        fault = (m.spn_high << 16 | m.spn_low, m.fmi)
        if m.control == ClearControl.CLEAR_PREVIOUS:
            control, refusal = ClearControl.PREVIOUS_KEPT, ClearRefusal.NOT_PREVIOUS
            self.letters.faults.see(root_causes(self.safety.causes))
            for cause in self.letters.faults.earlier:
                if fault == fault_of(cause):
                    self.letters.faults.forget(cause)
                    cleared = m._replace(
                        control=ClearControl.PREVIOUS_CLEARED, refusal=ClearRefusal.NOT_AVAILABLE
                    )
                    return [Send(cleared, header.source)]
        else:
            control, refusal = ClearControl.ACTIVE_KEPT, ClearRefusal.NOT_ACTIVE
            if fault in (fault_of(cause) for cause in root_causes(self.safety.causes)):
                refusal = ClearRefusal.ACCESS_DENIED  # only its own condition ends it
        if fault not in (fault_of(cause) for cause in StopCause):
            refusal = ClearRefusal.UNKNOWN_FAULT
        return [Send(m._replace(control=control, refusal=refusal), header.source)]
