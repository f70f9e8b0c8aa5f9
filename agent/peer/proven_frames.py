"""Believes what robots say only when it is proven, in a fleet with keys.

Frames that could lose, invent or hide work, life or membership are *held* when they arrive. They are
processed when the PROOF of their sender covers them, and dropped and counted if none does
(`protocol/frame_proofs.py`). Stops, resets and orders carry their own tags and are never held. Beacons
(POSE) are not held either, because robots avoid each other by them: they keep a member alive only
for `life_for_us` after its last proof (`agent/peer/membership.py`).

Our own frames get a proof: with each heartbeat, else within `SOON_US`. Progress is announced with
heartbeats, so that it needs no proof of its own. In a fleet without keys nothing is held and nothing
is proven.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from agent.interface.config import BEATS, MS
from agent.interface.effects import Effect, Send, Trace
from agent.interface.instants import FOREVER_US
from agent.peer import notices
from agent.peer.membership import Membership
from agent.peer.network_join import NetworkJoin
from agent.peer.part import (
    NOTHING,
    Handler,
    Header,
    Listener,
    Outputs,
    Part,
    StepContext,
)
from protocol.authentication import OPERATOR_FIRST
from protocol.frame_proofs import (
    HELD_FOR_US,
    FleetTime,
    ProofBatch,
    ProofChecker,
    ProofKeys,
    Proven,
)
from protocol.frames.agreement_frames import AgreementMessage, SilentPosition
from protocol.frames.delivery_frames import (
    Itinerary,
    PlanOffer,
    PlanRow,
    TaskBid,
    TaskBookDigest,
    TaskOrder,
)
from protocol.frames.fleet_frames import (
    Heartbeat,
    LeaderElectionVote,
    Member,
    Standstill,
    VectorSlice,
)
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.frames.segment_frames import GatewayBeat, SegmentSummary
from protocol.frames.trust_frames import Proof
from protocol.frames.work_frames import (
    STOPS,
    Digests,
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)
from protocol.operator_badges import Role

# Every frame of a robot that changes what others know or do, except beacons and frames with tags.
PROVEN_KINDS: Final[frozenset[type[Any]]] = frozenset({
    Heartbeat, Member, Standstill, VectorSlice, LeaderElectionVote,
    TaskClaim, WorkProgress, StateSyncRequest, StateSyncResponse, Digests,
    MapPatch, MapDigests, AgreementMessage, SilentPosition,
    TaskOrder, TaskBookDigest, TaskBid, Itinerary, PlanOffer, PlanRow,
})  # fmt: skip
# What a gateway brings from other segments, and says of them (`agent/segments/gateway_proofs.py`).
GATEWAY_KINDS: Final[frozenset[type[Any]]] = frozenset({
    TaskClaim, WorkProgress, StateSyncRequest, StateSyncResponse, MapPatch, MapDigests,
    GatewayBeat, SegmentSummary,
})  # fmt: skip
NOTHING_HELD: Final[frozenset[type[Any]]] = frozenset()
SOON_US: Final = 20 * MS  # less than the pause after which another robot continues a sync
# Frames that nobody waits for: no safety or work depends on them. They are proven with the next
# heartbeat, so that a full fleet sends a tenth less proofs.
PATIENT_KINDS: Final[frozenset[type[Any]]] = frozenset({LeaderElectionVote, VectorSlice})
PATIENT_US: Final = BEATS[-1].heartbeat_period_us
assert PATIENT_US + 2 * SOON_US <= HELD_FOR_US, "receivers still hold what is proven so late"


class ProvenFrames(Part):
    """The part that proves what we send, and holds what others send until it is proven."""

    def __init__(
        self,
        slot: int,
        keys: ProofKeys | None,
        time: FleetTime,
        membership: Membership,
        joining: NetworkJoin,
    ) -> None:
        """`keys`: None in a fleet without keys."""
        self.slot, self.membership, self.joining = slot, membership, joining
        self.kinds = NOTHING_HELD if keys is None else PROVEN_KINDS
        self.checker = None if keys is None else ProofChecker(keys, time)
        self._batch = None if keys is None else ProofBatch(slot, keys, time)
        self._address: int | None = None  # from which the batch was sent

    # ---------------------------------------------------------------- sent

    def cover(self, effects: Sequence[Effect], now_us: int) -> Sequence[Effect]:
        """The effects of a step, with the proof of what it sends if that is due now."""
        batch, kinds = self._batch, self.kinds
        if batch is None:
            return effects
        covered: list[Effect] | None = None
        for at, effect in enumerate(effects):
            if type(effect) is Send and type(effect.message) in kinds:
                self._address = self.joining.address if effect.source is None else effect.source
                batch.add(effect.message, now_us + self._wait_for_us(effect.message))
                if batch.full and covered is None:
                    covered = list(effects[: at + 1])
                    covered += self._proof(now_us)
                    covered += self.cover(effects[at + 1 :], now_us)
                    return covered
        if batch.due_at_us is not None and batch.due_at_us <= now_us:
            return [*effects, *self._proof(now_us)]
        return effects

    @staticmethod
    def _wait_for_us(message: Any) -> int:
        if type(message) is Heartbeat or type(message) is Member:
            return 0
        return PATIENT_US if type(message) in PATIENT_KINDS else SOON_US

    def _proof(self, now_us: int) -> list[Effect]:
        assert self._batch is not None
        address = self._address
        if address is None:
            self._batch.clear()
            return []
        proof = self._batch.seal(address, now_us)
        return [] if proof is None else [Send(proof, source=address)]

    @property
    def due_at_us(self) -> int:
        batch = self._batch
        return FOREVER_US if batch is None or batch.due_at_us is None else batch.due_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        return self._proof(ctx.now_us) if ctx.now_us >= self.due_at_us else NOTHING

    # ---------------------------------------------------------------- received

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {Proof: self._verify}

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {
            notices.FleetTimeKnown: self._introduce,
            notices.AddressTaken: self._taken,
            notices.AddressLost: self._lost,
            notices.KeysChanged: self._keys_changed,
        }

    def hold(self, source: int, slot: int | None, message: Any, now_us: int) -> Outputs | None:
        """Keep a received frame until it is proven; None if it needs no proof."""
        assert self.checker is not None
        if type(message) is StateSyncRequest and (message.scope == STOPS or slot is None):
            return None  # any device may ask
        if type(message) is TaskBookDigest and slot is None:
            return None  # a question, too: robots repeat orders that they know, and learn nothing
        outputs: list[Any] = []
        if slot is None and type(message) is not Member and type(message) is not TaskOrder:
            outputs.append(notices.StrangerHeard(source))
        for proven in self.checker.hold(source, message, now_us):
            outputs += self._believe(source, slot, proven, now_us)
        return outputs

    def hold_carried(self, source: int, message: Any, now_us: int) -> Outputs | None:
        """Keep a frame of a gateway until the gateway has proven it; None if it needs no proof."""
        if self.checker is None or type(message) not in GATEWAY_KINDS:
            return None
        if type(message) is StateSyncRequest and message.scope == STOPS:
            return None
        outputs: list[Any] = []
        for proven in self.checker.hold(source, message, now_us):
            outputs += _carried(source, proven, now_us)
        return outputs

    def _verify(self, ctx: StepContext, header: Header, m: Proof) -> Outputs:
        checker, source, now_us = self.checker, header.source, ctx.now_us
        if checker is None or source == self.joining.address:
            return NOTHING
        if header.from_gateway:
            if m.sender != header.slot:
                checker.bad += 1
                return NOTHING
            carried = checker.verify(source, m, now_us)
            return NOTHING if carried is None else _carried(source, carried, now_us)
        if not self._may_speak(source, header.slot, m.sender):
            checker.bad += 1
            return [] if header.slot is not None else [notices.StrangerHeard(source)]
        proven = checker.verify(source, m, now_us)
        if proven is not None:
            return self._believe(source, header.slot, proven, now_us)
        if len(checker.held(source)) < m.covered or self.membership.vouched(m.sender, now_us):
            return NOTHING  # its frames are still in a queue, or one is lost
        return [notices.TimeDoubted()]

    def _may_speak(self, source: int, slot: int | None, sender: int) -> bool:
        """A robot speaks from the address that it has proven, or proves it now; tools from any."""
        if sender == slot or sender >= OPERATOR_FIRST:
            return True
        assert self.checker is not None
        return any(
            type(message) is Member and message.slot == sender
            for message in self.checker.held(source)
        )

    def _may_order(self, device: int, now_us: int) -> bool:
        """A proof was right, so the badge of this operator's device is its own."""
        badges = None if self.checker is None else self.checker.keys.badges
        assert badges is not None, "a robot with keys hears badges"
        badges.prove(device, now_us)
        return badges.allows(device, Role.TASK, now_us)

    def _believe(self, source: int, slot: int | None, proven: Proven, now_us: int) -> list[Any]:
        sender, messages = proven
        if sender >= OPERATOR_FIRST:
            if not self._may_order(sender, now_us):
                return [
                    Trace("keys", "", "FORBIDDEN", "", f"device {sender} may order no transport")
                ]
            return [notices.HeardAgain(source, m, now_us) for m in messages if type(m) is TaskOrder]
        if sender == self.slot:  # another machine has our identity and our key
            return [notices.HeardAgain(source, m, now_us) for m in messages if type(m) is Member]
        if sender != slot and not any(type(m) is Member and m.slot == sender for m in messages):
            return [notices.StrangerHeard(source)]  # its address is not bound to its slot yet
        self.membership.prove(sender, now_us)
        first = [m for m in messages if type(m) is Member]  # it binds the address for the others
        rest = [m for m in messages if type(m) is not Member]
        outputs: list[Any] = [notices.HeardAgain(source, m, now_us) for m in (*first, *rest)]
        if not any(type(m) is Heartbeat and m.leaving for m in messages):
            outputs.insert(len(first), notices.SignOfLife(sender))
        return outputs

    # ---------------------------------------------------------------- told by other parts

    def _introduce(self, ctx: StepContext, notice: notices.FleetTimeKnown) -> Outputs:
        """Nothing that we sent before could be proven: say our slot again."""
        return [Send(self.joining.announcement)] if ctx.joined else NOTHING

    def _taken(self, ctx: StepContext, notice: notices.AddressTaken) -> Outputs:
        if self.checker is not None:
            self.checker.forget(notice.address)
        return NOTHING

    def _keys_changed(self, ctx: StepContext, notice: notices.KeysChanged) -> Outputs:
        """What waits for a proof was said with the old keys, perhaps after a revoked member: drop it."""
        if self.checker is not None and self._batch is not None:
            self._batch.rekey()
            self.checker.rekey(notice.keys)
            self.checker.time.begin(self.checker.keys, ctx.now_us)
        return NOTHING

    def _lost(self, ctx: StepContext, notice: notices.AddressLost) -> Outputs:
        if self._batch is not None:
            self._batch.clear()
        return NOTHING


def _carried(source: int, proven: Proven, now_us: int) -> list[Any]:
    """What a gateway has proven. It is no member, so this is no sign of life."""
    return [notices.HeardAgain(source, message, now_us) for message in proven.messages]
