"""What each received frame kind does to a peer: one short handler a kind, none of which can raise.

Handlers take (source address, slot of that address or None, message, now) and return effects.
From an address that has not announced its member slot, only a stop is accepted. From an address
whose NAME is not ours, no frame of a proprietary group is accepted (`agent/peer/frame_origin.py`).
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

from agent.interface.config import MS, S
from agent.interface.effects import HALT, Effect, Persist, Trace
from agent.interface.ports import BufferedBeacon, Neighbour
from agent.peer import fleet_summary as bulletin
from agent.peer.frame_origin import PROPRIETARY, Origin
from agent.peer.operator_directive import DIRECTED
from agent.peer.told_causes import ToldCauses
from agent.peer.unknown_stop_sources import AnyStop
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import UNAUTHENTICATED_HOLD_US
from protocol.frames.agreement_frames import AgreementMessage, SilentPosition
from protocol.frames.codec import Malformed
from protocol.frames.delivery_frames import (
    Itinerary,
    PlanOffer,
    PlanRow,
    TaskBid,
    TaskBookDigest,
    TaskOrder,
)
from protocol.frames.fleet_frames import (
    NOWHERE_M,
    Heartbeat,
    LeaderElectionVote,
    Member,
    Pose,
    Standstill,
    VectorSlice,
)  # fmt: skip
from protocol.frames.identifier import NULL_ADDRESS
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.operator_frames import OperatorGoal
from protocol.frames.safety_frames import (
    AllImplementsStop,
    Challenge,
    Command,
    EmergencyReset,
    EmergencyStop,
    Freshness,
    HeldReset,
    OperatorCommand,
    StopsHeld,
)  # fmt: skip
from protocol.frames.work_frames import (
    STOPS,
    Digests,
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)  # fmt: skip
from protocol.name import Name
from protocol.sync.synchronizer import ENTRIES

if TYPE_CHECKING:
    from agent.peer.peer import Peer

OF_MISSIONS = (
    AgreementMessage,
    SilentPosition,
    TaskOrder,
    TaskBookDigest,
    TaskBid,
    Itinerary,
    PlanOffer,
    PlanRow,
)
TOLD_OF: Final = (StateSyncRequest, Digests, StateSyncResponse)
OUTSIDER = -1  # a device that is not a member, so it has no agreed replica state
TELL_SPACING_US = 2 * S  # a snapshot of 1,000 entries takes 2.1 s at the share that sync may use
NAME_PATIENCE_US = 20 * MS  # a claim in transit may arrive after a beat of its sender
# After this a device of ours may have taken the address of another maker's device, and we may have
# missed its claim.
CLAIM_OLD_US = 10 * S
SIGNED = (EmergencyReset, HeldReset, OperatorCommand, OperatorGoal, Challenge, Freshness)
EVERYBODY = 0xFF  # target of an operator's command
Handler = Callable[[int, int | None, Any, int], Sequence[Effect]]


class InboundHandlers:
    def __init__(self, peer: "Peer") -> None:
        self.peer = peer
        bulletin.offer(peer)
        self._told_us = -TELL_SPACING_US
        self._claimed_us: dict[int, int] = {}  # address -> when its newest claim was received
        self._handlers: dict[type[Any], Handler] = {
            EmergencyReset: self._reset,
            HeldReset: self._held_reset,
            AllImplementsStop: self._implements_stop,
            OperatorCommand: self._command,
            OperatorGoal: self._goal,
            Challenge: self._challenge,
            Freshness: self._freshness,
            Pose: self._pose,
            Heartbeat: self._heartbeat,
            Member: self._member,
            Standstill: self._standstill,
            StopsHeld: self._stops_held,
            TaskClaim: self._work,
            StateSyncResponse: self._work,
            WorkProgress: self._work,
            StateSyncRequest: self._work,
            Digests: self._work,
            MapPatch: self._map,
            MapDigests: self._map,
            LeaderElectionVote: self._vote,
            VectorSlice: self._slice,
            **dict.fromkeys(OF_MISSIONS, self._mission),
            AddressClaimed: self._address,
            Malformed: self._malformed,
        }

    def dispatch(
        self, source: int, slot: int | None, message: Message | Malformed, now_us: int
    ) -> Sequence[Effect]:
        handler = self._handlers.get(type(message))
        if handler is None:
            return ()
        if slot is None:
            self.peer.conflicts.heard(source, now_us)
        if slot is None and type(message) in PROPRIETARY:  # the NAME of a member is always ours
            refused = self.refused(source, message, now_us)
            if refused is not None:
                return refused
        return handler(source, slot, message, now_us)

    def refused(
        self, source: int, message: Message | Malformed, now_us: int
    ) -> Sequence[Effect] | None:
        """None if a frame of a proprietary group is accepted, else the effects of refusing it."""
        peer = self.peer
        if source == peer.joining.address:
            doubled = peer.conflicts.speaks_from_our_address(message, now_us)
            return [*doubled, *peer.joining.violated(now_us)]
        origin = peer.origins.of(source)
        if origin is Origin.OURS or isinstance(message, Malformed):
            return None
        if origin is Origin.UNCLAIMED and isinstance(message, SIGNED) and peer.safety.keyed:
            return None  # the tag decides
        peer.origins.count(origin, message)
        if origin is not Origin.UNCLAIMED:
            return ()
        peer.origins.keep(source, message, now_us)
        peer.name_call.stranger(source, now_us, NAME_PATIENCE_US)
        if isinstance(message, Pose) and peer.safety.latched and not message.stopped:
            return peer.safety.tell_stops(now_us)  # the sender does not know the stops that hold us
        return ()

    def doubted(self, source: int, message: AnyStop, now_us: int) -> Sequence[Effect] | None:
        """None if a stop from this address counts as a stop of our fleet, else the effects.

        A frame of another maker is not a stop of ours. If no claim of the address is known, stand
        still until the sender has claimed it, and ask for the claim
        (`agent/peer/unknown_stop_sources.py`). With keys the tag decides immediately.
        """
        peer = self.peer
        origin = peer.origins.of(source)
        if origin is Origin.FOREIGN:
            peer.origins.count(origin, message)
            if now_us - self._claimed_us.get(source, 0) >= CLAIM_OLD_US:
                peer.origins.keep(source, message, now_us)
                peer.name_call.stranger(source, now_us, 0)
            return ()
        if origin is not Origin.UNCLAIMED or source in (peer.joining.address, NULL_ADDRESS):
            # A robot without an address presses from the null address; no other device may do that.
            return None
        if peer.safety.keyed or peer.doubts.believes(source):
            peer.name_call.stranger(source, now_us, 0)
            return None
        peer.name_call.urge(source, now_us)
        peer.origins.count(origin, message)
        until_us = peer.doubts.hold(source, message, now_us)
        why = f"a stop from address {source}, which nobody has claimed"
        held_us = max(UNAUTHENTICATED_HOLD_US, until_us - now_us)
        peer.safety.raise_cause(StopCause.UNAUTHENTICATED_STOP, now_us, why, held_us)
        return [HALT]

    def overdue(self, now_us: int) -> list[Effect]:
        """Accept the stops of addresses that did not claim in time, with their reception times."""
        effects = list[Effect]()
        for address, t_us, stop in self.peer.doubts.overdue(now_us):
            self.peer.name_call.calm(address)
            effects += self.peer.hear(address, stop, t_us)
        return effects

    def beats(
        self, beats: Sequence[BufferedBeacon], local: Callable[[int], int] | None = None
    ) -> list[Effect]:
        """Process buffered routine beats, each as if received at its time of arrival.

        `local`: converts bus time to our clock, if they differ. This does what `Peer.hear` does for a
        beat, without the parts that only a stop needs: beats of a stopped robot are not buffered.
        """
        peer, effects = self.peer, list[Effect]()
        membership, own = peer.membership, peer.slot
        slot_of, signs, neighbours = membership.slot_of, membership.signs_us, membership.neighbours
        for beat in beats:
            source, seen = beat[0], beat[3]
            slot = slot_of.get(source)
            if local is not None and seen is not None:
                seen = Neighbour(seen.pose, local(seen.heard_us))
            if seen is not None and slot in signs:
                neighbours[slot] = seen  # this counts as a sign of life too
                if seen[0][6] == own:  # seen.pose.heard
                    peer.check.reflected_us = seen.heard_us
            else:
                t_us = beat.t_us if local is None else local(beat.t_us)
                effects += peer.hear(source, beat.message, t_us)
        return effects

    def stop(self, source: int, message: EmergencyStop, now_us: int) -> Sequence[Effect]:
        peer = self.peer
        slot = peer.membership.slot_of.get(source)
        doubted = self.doubted(source, message, now_us) if slot is None else None
        if doubted is not None:
            return doubted
        effects = peer.safety.receive_stop(message, slot, now_us)
        if slot is not None and peer.membership.heard(slot, now_us):
            effects = [*effects, *peer.membership_changed(now_us)]
        dot = f"{message.slot}.{message.incarnation}.{message.counter}"
        return [*effects, *peer.latch(f"stop {dot} from address {source}")]

    # ---------------------------------------------------------------- safety

    def _reset(
        self, source: int, slot: int | None, m: EmergencyReset, now_us: int
    ) -> Sequence[Effect]:
        return self.peer.safety.receive_reset(m, now_us)

    def _held_reset(
        self, source: int, slot: int | None, m: HeldReset, now_us: int
    ) -> Sequence[Effect]:
        return self.peer.safety.receive_held_reset(m, now_us)

    def _implements_stop(
        self, source: int, slot: int | None, m: AllImplementsStop, now_us: int
    ) -> Sequence[Effect]:
        name = self.peer.joining.machine.names.get(source)
        robot = slot is not None and name is not None and Name.unpack(name).is_robot
        return self.peer.safety.receive_implements_stop(source, name, robot, m, now_us)

    def _command(
        self, source: int, slot: int | None, m: OperatorCommand, now_us: int
    ) -> Sequence[Effect]:
        peer = self.peer
        refusal = peer.safety.accept_order(m, now_us)
        if refusal is not None or m.target not in (peer.slot, EVERYBODY):
            return refusal or ()
        match m.command:
            case Command.MANUAL_RESET:
                return peer.manual_reset(now_us)
            case Command.START:
                return [*peer.start(now_us), *peer.directive.over("an operator's start")]
            case Command.HOLD:
                return peer.safety.hold(now_us)
            case Command.WAIVE if peer.membership.waive(m.argument, now_us):
                return peer.membership_changed(now_us)
        if m.command in DIRECTED:
            return peer.directive.order(m, now_us)
        return ()

    def _goal(
        self, source: int, slot: int | None, m: OperatorGoal, now_us: int
    ) -> Sequence[Effect]:
        """A coordinate for SET_GOAL, authenticated like an order."""
        refusal = self.peer.safety.accept_order(m, now_us)
        if refusal is None and m.target == self.peer.slot:
            self.peer.directive.name(m, now_us)
        return refusal or ()

    def _challenge(
        self, source: int, slot: int | None, m: Challenge, now_us: int
    ) -> Sequence[Effect]:
        return self.peer.safety.authority.answer(source, m, now_us)

    def _freshness(
        self, source: int, slot: int | None, m: Freshness, now_us: int
    ) -> Sequence[Effect]:
        return self.peer.safety.authority.prove(m, now_us)

    # ---------------------------------------------------------------- members

    def _stranger(self, source: int, now_us: int) -> Sequence[Effect]:
        self.peer.membership.strangers += 1
        if self.peer.joining.joined and self.peer.origins.is_robot(source):
            self.peer.roll_call.stranger(source, now_us)
        return ()

    def _pose(self, source: int, slot: int | None, m: Pose, now_us: int) -> Sequence[Effect]:
        """A pose that the fast path in `Peer.hear` did not take: of a stranger or returning member."""
        safety = self.peer.safety
        if slot is None:  # a moving stranger does not know the stops that hold us
            told = safety.tell_stops(now_us) if safety.latched and not m.stopped else ()
            return [*self._stranger(source, now_us), *told]
        if not m.placed:
            return self.unplaced(slot, m, now_us)
        self.peer.membership.neighbours[slot] = Neighbour(m, now_us)
        return safety.beat(slot, m.stopped, now_us)

    def unplaced(self, slot: int, m: Pose, now_us: int) -> Sequence[Effect]:
        """A beat of a member that does not know its position.

        The member is alive, but code that keeps a distance from positions treats it like a silent
        one from now on (`agent/motion/stopping_zone.py`)."""
        peer = self.peer
        seen = peer.membership.neighbours.get(slot)
        if seen is None or seen.pose.x_m == NOWHERE_M:
            seen = Neighbour(m._replace(speed_m_s=0.0), now_us)
        pose = seen.pose._replace(state=m.state, stopped=m.stopped, heard=m.heard)
        peer.membership.neighbours[slot] = Neighbour(pose, seen.heard_us)
        if m.heard == peer.slot:
            peer.check.reflected_us = now_us
        if m.stopped or peer.safety.latched:
            return peer.safety.beat(slot, m.stopped, now_us)
        return ()

    def _heartbeat(
        self, source: int, slot: int | None, m: Heartbeat, now_us: int
    ) -> Sequence[Effect]:
        peer = self.peer
        if slot is None:
            return () if m.leaving else self._stranger(source, now_us)
        if m.leaving:
            peer.membership.leave(slot, now_us)
            return peer.membership_changed(now_us)
        peer.clock.witness(slot, m.operations)
        peer.healths[slot] = m.health
        if not (m.held or m.stopped) and slot in peer.standstills:
            peer.standstills[slot].moves()
        peer.sync.heard_digest(slot, m.digest, now_us)
        if m.stopped or peer.safety.latched:
            return peer.safety.beat(slot, m.stopped, now_us)
        return ()

    def _member(self, source: int, slot: int | None, m: Member, now_us: int) -> Sequence[Effect]:
        peer = self.peer
        if not peer.origins.is_robot(source):
            return ()
        if m.config_hash != peer.identity.field_hash:
            peer.membership.unbind(source)
            why = "it has another field description"
            return peer.conflicts.found(StopCause.CONFIG_MISMATCH, source, why, now_us)
        peer.roll_call.known(source)
        if m.slot == peer.slot:
            return peer.conflicts.claims_our_name(source, now_us)
        peer.conflicts.settled(source, now_us)
        live = peer.membership.live
        if m.slot not in peer.membership.standing:
            return [Trace("membership", "", "REFUSED", "", f"slot {m.slot} at address {source}")]
        peer.membership.returned(m.slot, now_us)
        peer.membership.bind(source, m.slot, m.incarnation, now_us)
        return () if live == peer.membership.live else peer.membership_changed(now_us)

    def _standstill(
        self, source: int, slot: int | None, m: Standstill, now_us: int
    ) -> Sequence[Effect]:
        if slot is not None:
            self.peer.standstills.setdefault(slot, ToldCauses()).hear(m, now_us)
        return ()

    def _stops_held(
        self, source: int, slot: int | None, m: StopsHeld, now_us: int
    ) -> Sequence[Effect]:
        if slot is not None and self.peer.releasing is not None:
            self.peer.releasing.hear(slot, m)
        return ()

    def _vote(
        self, source: int, slot: int | None, m: LeaderElectionVote, now_us: int
    ) -> Sequence[Effect]:
        peer = self.peer
        if slot is None or m.election != peer.election.election:
            return ()
        peer.election.heard(slot, m, peer.membership.live)
        return ()

    def _slice(
        self, source: int, slot: int | None, m: VectorSlice, now_us: int
    ) -> Sequence[Effect]:
        for offset, low in enumerate(m.counts):
            member = m.base + offset
            if member != self.peer.slot:  # our own counter is authoritative, so do not merge it
                self.peer.clock.witness(member, low, bits=8)
        return ()

    def _address(
        self, source: int, slot: int | None, m: AddressClaimed, now_us: int
    ) -> Sequence[Effect]:
        peer = self.peer
        if slot is not None and peer.joining.changed_hands(source, m):
            peer.membership.unbind(source)
        ours = peer.joining.machine.candidate
        effects = peer.joining.receive(source, m, now_us)
        if m.name == peer.joining.machine.number:
            doubled = peer.conflicts.claims_our_name(source, now_us) if source != ours else ()
            return [*doubled, *effects]
        if source in (NULL_ADDRESS, peer.joining.address):
            return effects
        if peer.origins.changes(source, m.name):
            peer.conflicts.settled(source, now_us)
        wondered = peer.name_call.known(source)
        peer.origins.claimed(source, m.name)
        self._claimed_us[source] = now_us
        if wondered and peer.joining.joined and peer.origins.is_robot(source):
            peer.roll_call.stranger(source, now_us)  # it has sent frames: a member not known yet
        for t_us, stop in peer.doubts.end(source):
            effects = [*effects, *peer.hear(source, stop, t_us)]
        kept = peer.origins.kept(source, now_us)
        for message in kept:  # now that its NAME is known, as if the message arrived now
            effects = [*effects, *peer.hear(source, message, now_us)]
        return effects

    # ---------------------------------------------------------------- work

    def _mission(self, source: int, slot: int | None, m: Any, now_us: int) -> Sequence[Effect]:
        if slot is None and not isinstance(m, TaskOrder):  # any device may send an order
            return self._stranger(source, now_us)
        mission = self.peer.mission
        if mission is None:
            return ()
        return [Persist(*record) for record in mission.on_message(slot, m, now_us)]

    def _work(self, source: int, slot: int | None, m: Any, now_us: int) -> Sequence[Effect]:
        peer = self.peer
        if isinstance(m, StateSyncRequest) and m.scope == STOPS:  # any device may ask what holds us
            return peer.safety.answer_stops(m.cut | m.digest << 24, now_us)
        if slot is None and isinstance(
            m, StateSyncRequest
        ):  # from an inspector; answered at most once per TELL_SPACING_US
            if now_us - self._told_us >= TELL_SPACING_US:
                self._told_us = now_us
                peer.sync.receive(OUTSIDER, m, now_us)
            return ()
        if slot is None:
            return self._stranger(source, now_us)
        if isinstance(m, ENTRIES) and not peer.admission.admits(m, now_us):
            return ()
        changed = peer.sync.receive(slot, m, now_us)
        effects: list[Effect] = []
        for section in peer.claims.recheck(changed):
            effects.append(Trace("claim", f"S{section}", "LOST", "", f"told by {slot}"))
            if peer.mission is not None and peer.claims.current is None:
                peer.mission.abandon()
            effects += peer.idle_if_free(f"lost S{section}")
        if isinstance(m, TOLD_OF):
            effects.append(Trace("sync", "", type(m).__name__, "", f"from {slot}"))
        return effects

    def _map(self, source: int, slot: int | None, m: Any, now_us: int) -> Sequence[Effect]:
        if slot is None:
            return self._stranger(source, now_us)
        if self.peer.chart is not None:
            self.peer.chart.receive(slot, m, now_us)
        return ()

    def _malformed(
        self, source: int, slot: int | None, m: Malformed, now_us: int
    ) -> Sequence[Effect]:
        counted = self.peer.malformed
        counted[m.reason] = counted.get(m.reason, 0) + 1
        return ()
