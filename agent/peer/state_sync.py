"""Keeps the registers and the progress of this peer equal to those of the other members.

`protocol/sync/synchronizer.py` compares and repairs. This part feeds it, checks what is plausible
(`agent/peer/work_admission.py`), and tells the lifecycle whether the states differ.
"""

from collections.abc import Mapping
from typing import Any, Final

from agent.interface.config import S
from agent.interface.effects import Persist, Send, Trace
from agent.interface.instants import FOREVER_US
from agent.interface.lifecycle import IDLE, SYNCHRONIZING, WORKING
from agent.peer import notices
from agent.peer.durable_records import DurableRecords
from agent.peer.network_join import NetworkJoin
from agent.peer.part import NOTHING, Handler, Header, Listener, Outputs, Part, StepContext
from agent.peer.sender_limits import SenderLimits
from agent.peer.work_admission import Admission
from crdt.claim_register import epoch_of, pack
from protocol.frames.work_frames import (
    STOPS,
    Digests,
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)
from protocol.rekeying import NOBODY
from protocol.sync.synchronizer import ENTRIES, Synchronizer
from protocol.sync.vouchers import Vouchers

TOLD_OF: Final = (StateSyncRequest, Digests, StateSyncResponse)
OUTSIDER: Final = -1  # a device that is not a member, so it has no agreed replica state
TELL_SPACING_US: Final = 2 * S  # 1,000 entries take 2.1 s at the share that sync may use


class StateSync(Part):
    """The part that merges work frames of others and takes part in anti-entropy."""

    def __init__(
        self,
        sync: Synchronizer,
        admission: Admission,
        joining: NetworkJoin,
        heartbeat_period_us: int,
        limits: SenderLimits,
    ) -> None:
        self.sync, self.admission, self.joining = sync, admission, joining
        self.heartbeat_period_us, self.limits = heartbeat_period_us, limits
        self._told_at_us = -TELL_SPACING_US  # when a device that is no member was last answered

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {
            TaskClaim: self._work,
            StateSyncResponse: self._work,
            WorkProgress: self._work,
            Digests: self._work,
            StateSyncRequest: self._request,
        }

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {
            notices.MembershipChanged: self._members,
            notices.AddressGained: self._joined,
            notices.HeartbeatHeard: self._heartbeat,
            notices.ReceivedAgain: self._received_again,
            notices.KeysChanged: self._keys_changed,
        }

    @property
    def due_at_us(self) -> int:
        due_at_us = self.sync.due_at_us if self.joining.joined else None
        return FOREVER_US if due_at_us is None else due_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        if not ctx.joined:
            return NOTHING
        outputs: list[Any] = [Send(message) for message in self.sync.on_tick(ctx.now_us)]
        if self.sync.synchronizing:
            if ctx.state in (IDLE, WORKING):
                outputs.append(notices.SyncDiffers())
        elif ctx.state is SYNCHRONIZING:
            outputs.append(notices.SyncAgrees())  # a robot that may move resumes work
        return outputs

    def _request(self, ctx: StepContext, header: Header, m: StateSyncRequest) -> Outputs:
        if m.scope == STOPS:  # any device may ask what holds us
            return [notices.StopsAsked(m.cut | m.digest << 24, header.from_gateway)]
        if header.slot is not None:
            return self._work(ctx, header, m)
        if ctx.now_us - self._told_at_us >= TELL_SPACING_US:  # from an inspector
            self._told_at_us = ctx.now_us
            self.sync.on_message(OUTSIDER, m, ctx.now_us)
        return NOTHING

    def _work(self, ctx: StepContext, header: Header, m: Any) -> Outputs:
        slot = header.slot
        assert slot is not None
        allocation = self.sync.replica.allocation
        if isinstance(m, ENTRIES) and not self.admission.admits(m, allocation, ctx.now_us):
            return NOTHING
        outputs: list[Any] = []
        vouchers = self.sync.replica.vouchers
        if vouchers is not None and not header.from_gateway and isinstance(m, ENTRIES):
            excess = self.admission.excess(m, slot, allocation, vouchers)
            if excess is not None:
                return [Trace("trust", "", "REFUSED", str(slot), excess)]
            too_much = self._too_much(slot, m, vouchers, ctx.now_us)
            if too_much is not None:
                outputs.append(Trace("trust", "", "SUSPECTED", str(slot), too_much))
        changed = self.sync.on_message(slot, m, ctx.now_us)
        if vouchers is not None:
            outputs += self._adopted(slot, changed, vouchers)
            changed |= self.sync.replica.take_returned()
        if changed:
            outputs.append(notices.SectionsMerged(frozenset(changed), slot))
        if isinstance(m, TOLD_OF):
            outputs.append(Trace("sync", "", type(m).__name__, "", f"from {slot}"))
        return outputs

    def _adopted(self, slot: int, changed: set[int], vouchers: Vouchers) -> Outputs:
        """Write down what is our own word from now on, because our memory is lost and we were told."""
        keys = [(section, self.sync.replica.allocation.key(section)) for section in changed]
        return [
            Persist(*DurableRecords.register(section, key, vouchers))
            for section, key in keys
            if key is not None and vouchers.adopts(key, slot)
        ]

    def _too_much(
        self,
        slot: int,
        m: TaskClaim | StateSyncResponse | WorkProgress,
        vouchers: Vouchers,
        now_us: int,
    ) -> str | None:
        """What is more than this member can honestly say, before it is merged."""
        replica = self.sync.replica
        if isinstance(m, WorkProgress):
            new = m.bits & ~replica.progress.bits(m.section, m.block)
            return self.limits.progress(slot, new.bit_count(), now_us)
        known = replica.allocation.key(m.section) or 0
        told = pack(m.epoch, m.phase, m.bid, m.lamport, m.owner)
        if told <= known:
            return None  # it says nothing new
        jump = self.limits.claim(slot, m.epoch, epoch_of(known), now_us)
        if m.owner == slot or m.owner not in self.sync.divergence.live:
            return jump
        if told <= vouchers.said_by(m.section, m.owner):
            return jump
        return self.limits.foreign(slot, m.owner == self.sync.slot, now_us) or jump

    def _members(self, ctx: StepContext, notice: notices.MembershipChanged) -> Outputs:
        for slot in notice.live - self.sync.divergence.live:
            self.limits.appeared(slot, ctx.now_us)
        self.sync.live(notice.live, ctx.now_us)
        return NOTHING

    def _joined(self, ctx: StepContext, notice: notices.AddressGained) -> Outputs:
        self.sync.joined(ctx.now_us, self.heartbeat_period_us)
        return NOTHING

    def _heartbeat(self, ctx: StepContext, notice: notices.HeartbeatHeard) -> Outputs:
        self.sync.heard_digest(notice.slot, notice.heartbeat.digest, ctx.now_us)
        return NOTHING

    def _keys_changed(self, ctx: StepContext, notice: notices.KeysChanged) -> Outputs:
        """What the revoked member may have said is void; that work is free again.

        Nothing is written down: records of the keys of before count no more than what is left now."""
        revoked, compromised_at_us = notice.revoked, notice.compromised_at_us
        vouchers = self.sync.replica.vouchers
        if vouchers is not None:
            vouchers.generation = notice.keys.generation
        if revoked == NOBODY:
            return NOTHING
        sections, blocks = self.sync.void(revoked, compromised_at_us, ctx.now_us)
        if ctx.joined:
            self.sync.joined(ctx.now_us, self.heartbeat_period_us)
        self.limits.learn(ctx.now_us)
        said = f"sections {sections}, {len(blocks)} blocks of units"
        outputs: list[Any] = [Trace("sync", "", "VOID", "", f"by robot {revoked}: {said}")]
        if sections:
            outputs.append(notices.SectionsMerged(frozenset(sections), revoked))
        return outputs

    def _received_again(self, ctx: StepContext, notice: notices.ReceivedAgain) -> Outputs:
        self.sync.received_again(ctx.now_us)
        return NOTHING
