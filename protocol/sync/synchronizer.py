"""Anti-entropy: how replicas that differ become equal again, one entry a frame.

Every heartbeat carries a digest; `protocol/sync/digest_comparison.py` decides which of them mean
that we lack something. Then, on a bus on which every peer receives every frame:

1. **One peer asks.** It sends STATE_SYNC_REQUEST with the stable cut T0, in the order of
   `Divergence.order`. A peer that receives it waits for the end of the conversation and needs fresh
   evidence to ask again. So there is one question at a time on the segment, whatever the number of
   peers that differ.
2. **Few peers answer.** Peers with another digest than the asker compute what it lacks. If its
   digest was one of theirs recently, they know exactly. Else they take what changed since they last
   agreed, without what the asker's side itself has sent. If they have never agreed, they take
   registers later than T0. The first three in order make a list. One sends; the others delete what
   they receive and continue where it falls silent.
3. **A stale entry is corrected** by its owner, or by the first in order. This includes a claim of a
   section that its claimant does not know to be taken, long before its next heartbeat shows that.
4. **A question without effect is repeated differently.** After a question that taught nothing, and
   where much would have to be sent for a small loss, bucket digests follow the question (11
   frames). Then only the entries of buckets that differ are answered, and after two such questions
   regardless of the cut. Pauses double.

Sync frames of the whole segment stay below `SHARE` of the bus, because a peer that sends or
receives one leaves a gap. A fresh join has T0 = 0 and the digest of an empty replica, so the answer
is a snapshot that is sent once.
"""

from collections import Counter, deque
from collections.abc import Iterable
from typing import Final, NamedTuple

from crdt import FieldAllocationCRDT, Progress
from crdt.allocation import KIND as REGISTER
from crdt.progress import KIND as BLOCK
from protocol.frames.work_frames import (
    ALL_BUCKETS,
    BUCKETS_SINCE,
    REGISTERS,
    Digests,
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)
from protocol.sync.digest_comparison import Divergence
from protocol.sync.replica import EMPTY, GROUPS, AppliedEntry, Replica, entry_of
from protocol.sync.vouchers import Revocation
from protocol.units import FRAME_US, MS, S

SHARE = 0.30
GAP_US = round(FRAME_US / SHARE)  # from one sync frame of the segment to the next
SLOT_US = 3 * MS  # step of the sending order: a frame, the frame that blocks it, and a margin
QUIET_US = 25 * MS  # a sender that is silent this long has finished or is gone
SETTLE_US = 50 * MS  # by then, frames that a heartbeat has overtaken have arrived
# Peers that keep a list: a sender and two stand-ins. If all peers kept one, each would repeat what
# it lost.
ANSWERERS = 3
PAUSE_US = 150 * MS  # between questions that teach nothing; doubles
DOUBLINGS_MAX = 8  # up to 38 s: a peer that cannot be repaired costs next to nothing
TURN_US = 150 * MS  # after our question other peers may ask; their heartbeats arrive after it
# After this many questions that taught nothing, the state counts as beyond repair for now.
GIVE_UP = 5
PATIENCE_US = 2 * S  # a reunion delays work only while something is being learned
FRESH_US = 250 * MS  # an entry that was on the bus this recently needs no correction
GRACE_US = 100 * MS  # a heartbeat period and this time are enough for every member to contradict


ENTRIES: Final = (TaskClaim, StateSyncResponse, WorkProgress)
Said = StateSyncRequest | StateSyncResponse | WorkProgress | Digests


class BucketQuestion(NamedTuple):
    """A question whose bucket digests follow in later frames."""

    salt: int
    place: int  # ours in the order of answering
    entries: frozenset[int]


class Synchronizer:
    """One peer's part in making replicas equal: when it asks, answers and corrects.

    It has no clock and no bus: the caller passes frames and digests in and sends what `on_tick`
    returns.
    """

    def __init__(self, slot: int, allocation: FieldAllocationCRDT, progress: Progress) -> None:
        self.slot = slot
        self.replica = Replica(allocation, progress)
        self.divergence = Divergence(slot, self.replica)
        self.synchronizing = False
        self.counts: Counter[str] = Counter()
        self._aired_at_us: dict[int, int] = {}  # entry -> when our present value was on the bus
        self._went_live_at_us: dict[int, int] = {}
        self._queue: dict[int, None] = {}  # entries to send, in order
        self._digests: deque[Digests] = deque()  # bucket digests to send, before any entry
        self._questions: dict[int, BucketQuestion] = {}  # asker -> what may be sent to it
        self._place = 0  # in the order of the present conversation
        self._speak_at_us = 0  # we send nothing before this time
        self._heard_at_us = -1  # last sync frame on the bus, ours included
        self._ask_at_us: int | None = None
        self._asked_at_us = -DOUBLINGS_MAX * S
        self._our_turn_was_last = False  # the last question was ours, or had our digest
        self._learned = False  # by sync frames, since the digests began to differ
        self._taught = 0  # new entries from sync frames since our last question
        self._tries = 0  # questions since one taught us something
        self._learned_at_us = 0
        self._round = 0
        self._ready_at_us: int | None = None
        self._retold: dict[int, None] = {}  # own units to tell again after a revocation, in order
        self._retell_at_us, self._retell_for_us = 0, GAP_US

    # ---------------------------------------------------------------- state

    @property
    def digest(self) -> int:
        """The 24 bits of everything that we hold now."""
        return self.replica.digest

    def outgoing_digest(self) -> int:
        """The digest for the heartbeat that is sent now."""
        return self.divergence.outgoing_digest()

    @property
    def in_step(self) -> bool:
        """Whether every live member's latest digest equals ours."""
        return self.divergence.in_step

    @property
    def cut(self) -> int:
        """T0: the Lamport time at which we last agreed with all peers that differ now."""
        return self.divergence.base.lamport

    def statistics(self) -> dict[str, int]:
        """Questions, answers begun, entries sent, corrections, given up; since the start."""
        return dict(self.counts)

    def joined(self, now_us: int, heartbeat_period_us: int) -> None:
        """We have joined the bus: ready once every member has had time to contradict."""
        self._ready_at_us = now_us + heartbeat_period_us + GRACE_US
        self._learned_at_us = now_us
        self.divergence.expect()

    def ready(self, now_us: int) -> bool:
        """Whether our knowledge is good enough to choose work."""
        return (
            self._ready_at_us is not None and now_us >= self._ready_at_us and not self.synchronizing
        )

    def live(self, slots: frozenset[int], now_us: int) -> None:
        """The members that are received now. One that returns gets questions again without a pause."""
        returned = slots - self.divergence.live
        for slot in returned:
            self._went_live_at_us[slot] = now_us
        self.divergence.see(slots)
        # Maybe no peer was there to answer before, so the pauses between questions start again.
        if returned:
            self._tries, self._ask_at_us = 0, None
        self._judge(now_us)

    def received_again(self, now_us: int) -> None:
        """Our frames were received by nobody for a while. The questions that we asked in that time
        say nothing about our state, so a reunion delays work again until they are answered."""
        if self.divergence.odd:
            self._tries, self._learned_at_us = 0, now_us
            self._judge(now_us)

    def changed_here(self, section: int, block: int | None, now_us: int, units: int = 0) -> None:
        """An own operation or own progress was written and is being sent. `units`: that are our own."""
        if block is None:
            entry = entry_of(REGISTER, section)
        else:
            entry = entry_of(BLOCK, section << 8 | block)
        self._aired_at_us[entry] = now_us
        self.replica.changed_here(section, block, units, now_us)

    def _judge(self, now_us: int) -> None:
        """Decide whether a reunion must be finished before we choose the next work."""
        divergence = self.divergence
        if not divergence.odd:
            self._tries, self._learned = 0, False
        self.synchronizing = (
            divergence.reunion
            and divergence.outvoted
            and self._tries <= GIVE_UP
            and now_us < self._learned_at_us + PATIENCE_US
        )

    # ---------------------------------------------------------------- receiving

    def heard_digest(self, slot: int, digest: int, now_us: int) -> None:
        """Handle the digest of a peer's heartbeat."""
        divergence = self.divergence
        if slot not in divergence.live:
            return
        if self._told(slot, digest, now_us) and self._ask_at_us is None:
            self._ask_at_us = (
                max(now_us + SETTLE_US, self._allowed_at_us) + divergence.place() * SLOT_US
            )

    def _told(self, slot: int, digest: int, now_us: int) -> bool:
        if not self.divergence.reunion:
            self._learned_at_us = now_us  # the patience interval starts with the reunion
        odd = self.divergence.on_digest(slot, digest, now_us)
        self._judge(now_us)
        return odd

    @property
    def _allowed_at_us(self) -> int:
        """We ask not before this: others are sending, or our last question taught nothing."""
        pause_for_us = PAUSE_US << min(max(self._tries - 1, 0), DOUBLINGS_MAX)
        turn_for_us = TURN_US if self._our_turn_was_last else 0
        return max(
            self._heard_at_us + GAP_US + QUIET_US + turn_for_us, self._asked_at_us + pause_for_us
        )

    def on_message(self, slot: int, message: object, now_us: int) -> set[int]:
        """Handle any work frame; return the sections whose register changed."""
        if isinstance(message, ENTRIES):
            return self._entry(slot, message, now_us)
        if isinstance(message, StateSyncRequest):
            self._question(slot, message, now_us)
        elif isinstance(message, Digests):
            self._buckets(slot, message, now_us)
        return set()

    def void(
        self, revoked: int, compromised_at_us: int | None, now_us: int
    ) -> tuple[list[int], list[int]]:
        """Take out what a revoked member may have said; returns sections and names of blocks.

        All members do this at once, and each tells the units again that it covered itself: in turn, and
        together within the share of the bus that sync may use. Anti-entropy does the rest, as when two
        parts of a fleet meet."""
        others = self.divergence.live - {self.slot, revoked}
        changed = self.replica.void(Revocation(revoked, compromised_at_us, others))
        vouchers = self.replica.vouchers
        if vouchers is None:
            return changed
        for waiting in (self._queue, self._digests, self._questions, self._aired_at_us):
            waiting.clear()
        self._went_live_at_us.update(dict.fromkeys(others, now_us))
        self._tries, self._taught, self._ask_at_us, self._learned_at_us = 0, 0, None, now_us
        self.divergence.start_again()
        names = (entry_of(BLOCK, name) for name in vouchers.own_blocks)
        self._retold = {entry: None for entry in names if entry in self.replica}
        self._retell_for_us = GAP_US * (len(others) + 1)
        place = sum(slot < self.slot for slot in others)
        self._retell_at_us = now_us + SETTLE_US + GAP_US * place
        return changed

    def _entry(
        self, slot: int, message: TaskClaim | StateSyncResponse | WorkProgress, now_us: int
    ) -> set[int]:
        heard = self.replica.on_message(message, slot, now_us)
        entry = heard.entry
        relayed = self._is_relayed(slot, message, entry)
        if relayed:
            self._floor_taken(now_us)
        if heard.stale:
            self._correct(slot, heard, now_us)
            return set()
        self._queue.pop(entry, None)
        self._retold.pop(entry, None)
        if entry in self.replica:
            self._aired_at_us[entry] = now_us
        if heard.changed:
            self._learned_at_us = now_us
            if relayed:
                self._taught += 1
                self._learned = True
            if not isinstance(message, WorkProgress):
                return {message.section}
        return set()

    def _is_relayed(self, slot: int, message: object, entry: int) -> bool:
        """Whether this is a sync frame, not an announcement. Progress has one frame for both; from
        the owner of the section it is an announcement."""
        if isinstance(message, WorkProgress):
            return entry in self._queue or self.replica.owner_of(entry) != slot
        return isinstance(message, StateSyncResponse)

    def _floor_taken(self, now_us: int) -> None:
        """A peer is sending: continue its list where it falls silent."""
        self._heard_at_us = now_us
        wait_for_us = GAP_US + QUIET_US + self._place * SLOT_US
        self._speak_at_us = max(self._speak_at_us, now_us + wait_for_us)

    def _correct(self, slot: int, heard: AppliedEntry, now_us: int) -> None:
        """The sender lacks an entry of ours: its owner sends it, or the first in order."""
        entry = heard.entry
        if entry in self._queue or entry in self._retold:
            return
        if now_us < self._aired_at_us.get(entry, -FRESH_US) + FRESH_US:
            return
        place = self._corrector_place(slot, entry)
        if place < ANSWERERS:
            self.counts["corrections"] += 1
            self._place = place
            self._queue[entry] = None
            self._speak_at_us = max(self._speak_at_us, now_us + GAP_US + place * SLOT_US)

    def _corrector_place(self, slot: int, entry: int) -> int:
        owner = self.replica.owner_of(entry)
        if owner == self.slot:
            return 0
        others = [s for s in self.divergence.order() if s not in (slot, owner)]
        return others.index(self.slot) + 1

    def _question(self, slot: int, m: StateSyncRequest, now_us: int) -> None:
        self._heard_at_us = now_us
        self._questions.pop(slot, None)
        self._digests.clear()  # one question at a time; ours is asked again later
        self._speak_at_us = max(self._speak_at_us, now_us + GAP_US + QUIET_US)
        self._our_turn_was_last = m.digest == self.digest
        if self._our_turn_was_last:
            return
        if slot in self.divergence.live:
            if m.cut == 0:
                self.divergence.forget(slot)
            # Evidence for our question, which comes after this one.
            if self._told(slot, m.digest, now_us + 1):
                self._ask_at_us = self._allowed_at_us + self.divergence.place() * SLOT_US
        order = [s for s in self.divergence.order(m.digest) if s != slot]
        place = (order.index(self.slot) - ANSWERERS * m.round) % len(order)
        if place >= ANSWERERS:
            return
        self.counts["answers"] += 1
        self._place = place
        entries = self._lacking(slot, m)
        if m.scope in (BUCKETS_SINCE, ALL_BUCKETS):
            self._questions[slot] = BucketQuestion(m.round & 0xFF, place, frozenset(entries))
            return
        self._speak_at_us = now_us + GAP_US + place * SLOT_US
        self._queue.update(dict.fromkeys(entries))

    def _lacking(self, slot: int, m: StateSyncRequest) -> list[int]:
        """What the asker lacks, as far as we know."""
        replica, divergence = self.replica, self.divergence
        if m.scope == ALL_BUCKETS or m.digest == EMPTY:
            return replica.since(0)
        moment = replica.when(m.digest)
        if moment is not None:
            return replica.since(moment.version)
        moment = divergence.agreed_with(slot, m.digest)
        if moment.version == 0 and m.cut > 0:
            entries = replica.after(m.cut)
        else:
            entries = replica.since(moment.version)
        if m.scope == REGISTERS and divergence.was_away(slot):
            start_at_us = self._went_live_at_us.get(slot, 0)
            entries = [entry for entry in entries if self._aired_at_us.get(entry, -1) < start_at_us]
        return entries

    def _buckets(self, slot: int, m: Digests, now_us: int) -> None:
        self._heard_at_us = now_us
        question = self._questions.get(slot)
        if question is None or question.salt != m.salt:
            self._speak_at_us = max(self._speak_at_us, now_us + GAP_US + QUIET_US)
            return
        different = self.replica.differing(m)
        chosen = [e for e in sorted(question.entries) if self.replica.bucket(e) in different]
        self._queue.update(dict.fromkeys(chosen))
        # Index of the frame; the tuple's method hides the field from type checkers.
        last = m[0] == GROUPS - 1
        wait_for_us = GAP_US + question.place * SLOT_US + (0 if last else QUIET_US)
        self._place, self._speak_at_us = question.place, now_us + wait_for_us

    # ---------------------------------------------------------------- saying

    @property
    def due_at_us(self) -> int | None:
        """When `on_tick` next has something to do, if nothing is received before; None if nothing
        waits."""
        due_at_us = self._ask_at_us
        if (self._queue or self._digests) and (due_at_us is None or self._speak_at_us < due_at_us):
            due_at_us = self._speak_at_us
        if self._retold and (due_at_us is None or self._retell_at_us < due_at_us):
            due_at_us = self._retell_at_us
        if self.synchronizing:
            wait_for_us = self._learned_at_us + PATIENCE_US
            due_at_us = wait_for_us if due_at_us is None else min(due_at_us, wait_for_us)
        return due_at_us

    def on_tick(self, now_us: int) -> Iterable[Said]:
        """The frames to send now: one at most."""
        if self.synchronizing:
            self._judge(now_us)
        if self._retold and now_us >= self._retell_at_us:
            self._retell_at_us = now_us + self._retell_for_us
            entry = next(iter(self._retold))
            del self._retold[entry]
            self._aired_at_us[entry] = self._heard_at_us = now_us
            self.counts["retold"] += 1
            return [self.replica.message_of(entry)]
        if (self._queue or self._digests) and now_us >= self._speak_at_us:
            self._speak_at_us, self._heard_at_us = now_us + GAP_US, now_us
            if self._digests:
                return [self._digests.popleft()]
            entry = next(iter(self._queue))
            del self._queue[entry]
            if not self.replica.may_tell(entry):
                return ()
            self._aired_at_us[entry] = now_us
            self.counts["entries"] += 1
            return [self.replica.message_of(entry)]
        if self._ask_at_us is not None and now_us >= self._ask_at_us:
            return self._ask(now_us)
        return ()

    def _ask(self, now_us: int) -> Iterable[Said]:
        divergence = self.divergence
        self._ask_at_us = None
        if not divergence.still_odd(self._heard_at_us):
            self._judge(now_us)
            return ()  # explained by now, or we wait for fresh evidence
        if now_us < self._allowed_at_us:
            self._ask_at_us = self._allowed_at_us + divergence.place() * SLOT_US
            return ()
        digest = self.digest
        if self._taught:
            self._taught = self._tries = 0
        if self._tries == GIVE_UP:
            self.counts["given up"] += 1
        self._asked_at_us = self._heard_at_us = now_us
        self._our_turn_was_last = True
        self._round = (self._round + 1) & 0xFF
        self.counts["questions"] += 1
        scope = self._scope(digest)
        self._tries += 1
        if scope != REGISTERS:
            self._digests = deque(self.replica.bucket_frames(self._round))
            self._speak_at_us = now_us + GAP_US
        self._judge(now_us)
        return [StateSyncRequest(divergence.base.lamport, digest, scope, self._round)]

    def _scope(self, digest: int) -> int:
        """How to ask: bucket digests cost 11 frames and pay off if little of much is missing."""
        if digest == EMPTY:
            return REGISTERS
        if self._tries >= 2:
            return ALL_BUCKETS
        news = self.replica.version - self.divergence.base.version
        small_loss = not self.divergence.reunion and news > GROUPS
        return BUCKETS_SINCE if self._tries or self._learned or small_loss else REGISTERS
