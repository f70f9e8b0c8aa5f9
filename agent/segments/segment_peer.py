"""A peer in a fleet of several segments: an ordinary peer that also knows other segments.

On its own segment frames and rules are the same. Added are stops and resets for all segments
(`agent/segments/fleet_stops.py`), and whether other segments are reached
(`agent/segments/remote_segments.py`). A section lent by another segment is claimed only while that
segment is reached, because only that segment decides about it.
"""

from collections.abc import Mapping, Sequence
from random import Random
from typing import Any

from agent.interface.effects import HALT, Effect, Trace
from agent.interface.identity import Identity, SilencePolicy
from agent.peer.frame_origin import PROPRIETARY
from agent.peer.peer import NOTHING, Peer
from agent.safety.stop_cause import StopCause
from agent.segments.fleet_stops import FleetStops
from agent.segments.remote_segments import RemoteSegments
from agent.segments.segment_area import Area
from agent.segments.work_relay import LAST_SLOT
from protocol.fleet_tags import FleetTags
from protocol.frames.codec import Malformed
from protocol.frames.fleet_frames import Pose
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop, HeldReset, Reason
from protocol.frames.segment_frames import (
    FleetReset,
    FleetStop,
    GatewayBeat,
    SegmentSummary,
    gateway_slot,
)
from protocol.frames.work_frames import (
    STOPS,
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)

PRESSING = (EmergencyStop, EmergencyReset, HeldReset)
CARRIED = (TaskClaim, WorkProgress, StateSyncRequest, StateSyncResponse, MapPatch, MapDigests)


class SegmentPeer(Peer):
    def __init__(
        self,
        area: Area,
        identity: Identity,
        rng: Random,
        now_us: int,
        recalled: Mapping[str, bytes],
        *parts: Any,
        policy: SilencePolicy = SilencePolicy.CONTINUE,
    ) -> None:
        """`policy`: what to do if no other segment is reached any more."""
        super().__init__(identity, rng, now_us, recalled, *parts)
        self.area, self.policy = area, policy
        guests = frozenset(area.guest(segment) for segment in area.neighbours)
        self.admission.owners = identity.members | guests | {LAST_SLOT}
        if self.admission.sections:
            self.admission.sections = self.admission.sections | area.borrowed.keys()
        keyring = self.safety.authority.keyring
        tags = None if keyring is None else FleetTags(keyring.keys)
        self.fleet_stops = FleetStops(area.segment, self.slot, self.safety, tags)
        self.beyond = RemoteSegments(area.segment, now_us)

    def hear(self, source: int, message: Message | Malformed, now_us: int) -> Sequence[Effect]:
        kind = type(message)
        if kind is Pose:  # nine frames in ten
            effects = super().hear(source, message, now_us)
            if self.fleet_stops.holds_far and not message.stopped:  # type: ignore[union-attr]
                return [*effects, *self.fleet_stops.tell(now_us)]  # it does not know our stops
            return effects
        if kind is FleetStop:
            doubted = self._hearing.doubted(source, message, now_us)  # type: ignore[arg-type]
            if doubted is not None and source not in self.membership.slot_of:
                return doubted
            effects = self.fleet_stops.receive_stop(message, now_us)  # type: ignore[arg-type]
            return [*effects, *self.latch(f"a stop from address {source}")]
        gateway = gateway_slot(source)
        if gateway is not None or kind is FleetReset:
            refused = (
                self._hearing.refused(source, message, now_us) if kind in PROPRIETARY else None
            )
            if refused is not None:
                return refused
        if gateway is not None and kind is not AddressClaimed:
            return self._gateway(gateway, source, message, now_us)
        if kind is FleetReset:
            return self.fleet_stops.receive_reset(message, now_us)  # type: ignore[arg-type]
        effects = super().hear(source, message, now_us)
        if kind in PRESSING:
            self.fleet_stops.see(self.membership.live, now_us)
            due = self.fleet_stops.tick(now_us)
            return [*effects, *due] if due else effects
        asked = isinstance(message, StateSyncRequest) and message.scope == STOPS
        if asked and self.fleet_stops.holds_far:  # by an operator's device, or a robot just joined
            return [*effects, *self.fleet_stops.tell(now_us)]
        return effects

    def _gateway(
        self, number: int, source: int, message: Message | Malformed, now_us: int
    ) -> Sequence[Effect]:
        """A gateway is not a member: its silence stops no robot, and it claims no section."""
        if isinstance(message, FleetReset):
            return self.fleet_stops.receive_reset(message, now_us)
        if isinstance(message, GatewayBeat | SegmentSummary):
            return self._alone() if self.beyond.hear(message, now_us) else NOTHING
        if isinstance(message, StateSyncRequest) and message.scope == STOPS:
            return self.fleet_stops.tell(now_us)
        if isinstance(message, CARRIED):
            return self._hearing.dispatch(source, number, message, now_us)
        return NOTHING

    def _alone(self) -> Sequence[Effect]:
        """Whether other segments are reached has changed: the policy says what that means."""
        alone = self.beyond.alone
        held: list[Effect] = []
        if self.policy is SilencePolicy.STOP:
            self._cause(StopCause.BACKBONE_LOST, alone)
            held = [HALT] if alone else []
        elif self.policy is SilencePolicy.SLOW:
            self._cause(StopCause.BACKBONE_CREEP, alone)
        return [*held, Trace("beyond", "", "ALONE" if alone else "REACHED", "", "")]

    def _cause(self, cause: StopCause, raised: bool) -> None:
        if raised:
            self.safety.raise_cause(cause, 0, "no other segment is reached")
        else:
            self.safety.clear_cause(cause, 0)

    @property
    def deadline_us(self) -> int:
        deadline_us = min(super().deadline_us, self.fleet_stops.deadline_us)
        beyond_us = self.beyond.deadline_us
        return deadline_us if beyond_us is None else min(deadline_us, beyond_us)

    def tick(self, now_us: int) -> Sequence[Effect]:
        effects = super().tick(now_us)
        if self.fleet_stops.behind:
            self.fleet_stops.see(self.membership.live, now_us)
        if now_us >= self.fleet_stops.deadline_us:
            effects = [*effects, *self.fleet_stops.tick(now_us)]
        if self.beyond.tick(now_us):
            effects = [*effects, *self._alone()]
        return effects

    def press(self, reason: Reason, now_us: int) -> Sequence[Effect]:
        effects = super().press(reason, now_us)
        self.fleet_stops.see(self.membership.live, now_us)
        return [*effects, *self.fleet_stops.tick(now_us)]

    def claim(
        self, section: int, bid: int, now_us: int, takeover: bool = False
    ) -> Sequence[Effect]:
        if self.beyond.alone and section in self.area.borrowed:
            return NOTHING  # its home segment cannot be asked
        return super().claim(section, bid, now_us, takeover)
