"""Stops, resets and stop causes of one peer: what is received, and what happens to it itself.

The rules are in `agent/safety/stop_controller.py`. This part passes messages and notices to it, and
is the first part of a peer: a stop is handled before anything that may fail or be slow.
"""

from collections.abc import Mapping
from typing import Any

from agent.interface.effects import HALT, Send, Trace
from agent.interface.lifecycle import State
from agent.peer import inputs, notices
from agent.peer.membership import Membership
from agent.peer.network_join import NetworkJoin
from agent.peer.part import (
    NOTHING,
    DirectHandler,
    Handler,
    Header,
    Listener,
    Outputs,
    Part,
    StepContext,
)
from agent.peer.sender_origins import SenderOrigins
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from protocol.frames.safety_frames import (
    AllImplementsStop,
    Challenge,
    EmergencyReset,
    EmergencyStop,
    Freshness,
    HeldReset,
)
from protocol.frames.trust_frames import OperatorBadge
from protocol.frames.work_frames import STOPS, StateSyncRequest


class StopReception(Part):
    """The part that passes stops, resets and proofs to the stop controller."""

    def __init__(
        self,
        safety: StopController,
        senders: SenderOrigins,
        joining: NetworkJoin,
        membership: Membership,
    ) -> None:
        self.safety, self.senders = safety, senders
        self.joining, self.membership = joining, membership

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {
            EmergencyReset: self._reset,
            HeldReset: self._held_reset,
            AllImplementsStop: self._implements_stop,
            Challenge: self._challenge,
            Freshness: self._freshness,
            OperatorBadge: self._badge,
        }

    @property
    def direct(self) -> Mapping[type[Any], DirectHandler]:
        return {EmergencyStop: self.on_stop}

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {
            inputs.Press: self.press,
            inputs.Hold: lambda ctx, call: self.safety.hold(ctx.now_us),
            inputs.Start: self.start,
            inputs.ManualReset: self.manual_reset,
            inputs.DiskFailed: self._disk_failed,
            notices.BootRemembered: lambda ctx, n: [self.safety.remember_hold()],
            notices.AddressLost: self._address_lost,
            notices.AddressGained: self._address_gained,
            notices.FleetJoined: self._fleet_joined,
            notices.BusLost: self._bus_lost,
            notices.BusBack: self._bus_back,
            notices.MembershipChanged: self._members,
            notices.HeartbeatHeard: self._heartbeat,
            notices.StopsAsked: self._asked,
            notices.BeatDue: lambda ctx, n: self.safety.say_button(ctx.live, ctx.now_us),
        }

    # ---------------------------------------------------------------- time

    @property
    def due_at_us(self) -> int:
        return self.safety.due_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        if ctx.now_us < self.safety.due_at_us:
            return NOTHING
        effects = self.safety.on_tick(ctx.now_us)
        if effects:
            return [*effects, notices.Latched("a stop with a used name")]
        return [notices.CausesExpired()]

    # ---------------------------------------------------------------- received

    def on_stop(self, source: int, slot: int | None, m: EmergencyStop, now_us: int) -> Outputs:
        """In every state and from every sender; `SenderOrigins.doubted` says which ones wait."""
        if slot is None:
            doubted = self.senders.doubted(source, m, now_us)
            if doubted is not None:
                return doubted
        effects = self.safety.receive_stop(m, slot, now_us, source)
        latched = notices.Latched(
            f"stop {m.slot}.{m.incarnation}.{m.counter} from address {source}"
        )
        if slot is None:
            return [*effects, latched, notices.StopsChanged()]
        return [*effects, notices.SignOfLife(slot), latched, notices.StopsChanged()]

    def _reset(self, ctx: StepContext, header: Header, m: EmergencyReset) -> Outputs:
        return [*self.safety.receive_reset(m, ctx.now_us), notices.StopsChanged()]

    def _held_reset(self, ctx: StepContext, header: Header, m: HeldReset) -> Outputs:
        return [*self.safety.receive_held_reset(m, ctx.now_us), notices.StopsChanged()]

    def _implements_stop(self, ctx: StepContext, header: Header, m: AllImplementsStop) -> Outputs:
        name = self.joining.machine.names.get(header.source)
        robot = (
            header.slot is not None
            and name is not None
            and self.senders.origins.is_robot(header.source)
        )
        return self.safety.receive_implements_stop(header.source, name, robot, m, ctx.now_us)

    def _challenge(self, ctx: StepContext, header: Header, m: Challenge) -> Outputs:
        return self.safety.authority.answer(header.source, m, ctx.now_us)

    def _badge(self, ctx: StepContext, header: Header, m: OperatorBadge) -> Outputs:
        self.safety.authority.hear_badge(m, ctx.now_us)
        return NOTHING

    def _freshness(self, ctx: StepContext, header: Header, m: Freshness) -> Outputs:
        return self.safety.authority.prove(m, ctx.now_us)

    def _asked(self, ctx: StepContext, notice: notices.StopsAsked) -> Outputs:
        if notice.from_gateway:  # it forwards stops of the whole fleet: `FleetStops` answers
            return NOTHING
        return self.safety.answer_stops(notice.question, ctx.now_us)

    def _heartbeat(self, ctx: StepContext, notice: notices.HeartbeatHeard) -> Outputs:
        stopped = notice.heartbeat.stopped
        if stopped or self.safety.latched:
            return self.safety.beat(notice.slot, stopped, ctx.now_us)
        return NOTHING

    # ---------------------------------------------------------------- people at this machine

    def press(self, ctx: StepContext, call: inputs.Press) -> Outputs:
        """Emergency stop at this machine."""
        self.joining.hurry(ctx.now_us)
        pressed = self.safety.press(call.reason, ctx.now_us, self.membership.free)
        return [*pressed, notices.Latched("pressed here"), notices.StopsChanged()]

    def manual_reset(self, ctx: StepContext, call: inputs.ManualReset) -> Outputs:
        """Refused while a stop is not cleared or a cause persists."""
        if ctx.state is not State.EMERGENCY_STOP or not self.safety.manual_reset(ctx.now_us):
            return [Trace("safety", "LATCHED", "MANUAL_RESET", "LATCHED", "refused")]
        outputs = [*self.safety.hold(ctx.now_us)]  # reset is not start
        permit = self.safety.button.release(ctx.now_us)
        if permit is not None:  # from the address that sent the stop, before it is claimed again
            outputs.append(Send(permit, source=self.joining.address))
        if self.safety.holds(StopCause.BUS_OFF):  # it rejoins when the bus is back
            return [*outputs, notices.WasReset()]
        return [*outputs, notices.Rejoining(), notices.WasReset()]

    def start(self, ctx: StepContext, call: inputs.Start) -> Outputs:
        """A latched robot refuses it, because it would start after the reset."""
        if self.safety.latched:
            return [Trace("safety", "LATCHED", "START", "LATCHED", "refused")]
        return [
            notices.WasStarted(call.named),
            *self.safety.start(ctx.now_us, call.named),
            Trace("safety", "HELD", "START", "STARTED", "operator"),
        ]

    # ---------------------------------------------------------------- causes

    def _disk_failed(self, ctx: StepContext, fact: inputs.DiskFailed) -> Outputs:
        """Durable memory may have lost a record: stop for good, without a retry."""
        self.safety.raise_cause(StopCause.DISK_ERROR, ctx.now_us)
        return [HALT, notices.Latched("the disk failed")]

    def _address_lost(self, ctx: StepContext, notice: notices.AddressLost) -> Outputs:
        self.safety.raise_cause(StopCause.ADDRESS_LOST, ctx.now_us)
        return NOTHING

    def _address_gained(self, ctx: StepContext, notice: notices.AddressGained) -> Outputs:
        self.safety.clear_cause(StopCause.ADDRESS_LOST, ctx.now_us)
        return NOTHING

    def _fleet_joined(self, ctx: StepContext, notice: notices.FleetJoined) -> Outputs:
        if not self.safety.unconfirmed:
            return NOTHING
        return [Send(StateSyncRequest(0, 0, STOPS, 0))]  # our memory is lost: ask the others

    def _bus_lost(self, ctx: StepContext, notice: notices.BusLost) -> Outputs:
        self.safety.raise_cause(StopCause.BUS_OFF, ctx.now_us)
        return NOTHING

    def _bus_back(self, ctx: StepContext, notice: notices.BusBack) -> Outputs:
        self.safety.clear_cause(StopCause.BUS_OFF, ctx.now_us)
        return NOTHING if self.joining.left else [notices.Rejoining()]

    def _members(self, ctx: StepContext, notice: notices.MembershipChanged) -> Outputs:
        return self.safety.members(notice.live, notice.silent, ctx.now_us)
