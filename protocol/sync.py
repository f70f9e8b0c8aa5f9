"""Anti-entropy: how replicas that differ become equal again, one entry a frame.

Every heartbeat carries a digest. A digest that our own history does not explain is a mismatch. Then

1. one peer of those that see it (slotted back-off by rank) broadcasts STATE_SYNC_REQUEST with the
   stable cut T0: the greatest Lamport time at which it agreed with all live peers;
2. who has another digest answers with the entries newer than the cut, and with the progress blocks
   that grew since it last agreed with the asker; each entry is said once: what another says first
   is struck from the list, and while somebody speaks for us we wait;
3. what is heard and is older than ours is answered with ours;
4. if two rounds did not help (a corrupted or unexplained entry), bucket digests follow, and the
   entries of the buckets that differ.

All sync traffic of a segment together stays near `SHARE` of the bus: each speaker leaves a gap after
any sync frame, its own or another's. A fresh join has T0 = 0, which makes the answer a snapshot.
"""

from collections import OrderedDict
from collections.abc import Iterable
from typing import NamedTuple

from crdt import FieldAllocationCRDT, Progress
from crdt.allocation import KIND as REGISTERS
from crdt.digest import BUCKETS, MASK, bucket_of, entry_hash, mix, short
from crdt.progress import KIND as BLOCKS
from crdt.register import LAMPORT_MAX, Claim, pack
from protocol.work_frames import (
    Digests,
    StateSyncRequest,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)  # fmt: skip

MS = 1_000
FRAME_US = 640  # worst-case stuffing, 250 kbit/s
SHARE = 0.30
GAP_US = round(FRAME_US / SHARE)
SLOT_US = 3 * MS  # back-off step by rank: longer than a frame behind the blocking of another
RANKS = 16  # ranks beyond share the last slot; they hear the others long before
ROUND_US = 500 * MS  # a request that changed nothing is repeated after this
ROUNDS_MAX = 6  # then it is left to the next mismatch, and counted
BUCKET_ROUND = 3  # from this round on, bucket digests
HISTORY_MAX = 256  # own digests remembered; at ten changes a second, 25 s
QUIET_US = 20 * MS  # a speaker for us is silent for this long: our turn
KEY_MAX = 0xFFFF


Said = StateSyncRequest | StateSyncResponse | WorkProgress | Digests


class Agreement(NamedTuple):
    """How far we are known to agree with a peer."""

    lamport: int
    version: int  # of our progress blocks


NEVER = Agreement(0, 0)


class Sync:
    def __init__(self, slot: int, allocation: FieldAllocationCRDT, progress: Progress) -> None:
        self.slot, self.allocation, self.progress = slot, allocation, progress
        self.synchronizing = False
        self.requests = self.answered = self.repaired = self.given_up = 0
        self._live: frozenset[int] = frozenset({slot})
        self._suspects: set[int] = set()  # newly heard: believe their first mismatch
        self._pending: dict[int, int] = {}  # unexplained digest of a peer's last heartbeat
        self._differs: set[int] = set()  # peers judged to differ
        self._agreed: dict[int, Agreement] = {}
        self._history: OrderedDict[int, Agreement] = OrderedDict()
        self._version = 0
        self._grown: dict[tuple[int, int], int] = {}  # block -> version at which it grew
        self._queue: OrderedDict[tuple[int, int], None] = OrderedDict()  # (kind, name) to say
        self._frames: list[Digests] = []  # bucket digests to say
        self._speak_us = 0  # not before
        self._request_us: int | None = None
        self._round = 0
        self._rounds = 0
        self._ready_us: int | None = None
        self._note()

    # ---------------------------------------------------------------- state

    @property
    def digest(self) -> int:
        return short((self.allocation.sums.total + self.progress.sums.total) & MASK)

    def _note(self) -> int:
        """Remember the digest our replica has now."""
        digest = self.digest
        self._history[digest] = Agreement(self.allocation.lamport, self._version)
        self._history.move_to_end(digest)
        if len(self._history) > HISTORY_MAX:
            self._history.popitem(last=False)
        return digest

    def joined(self, now_us: int, heartbeat_us: int) -> None:
        """We are on the bus: ready once everybody had time to contradict."""
        self._ready_us = now_us + heartbeat_us + 100 * MS
        self._suspects |= self._live - {self.slot}

    def ready(self, now_us: int) -> bool:
        return self._ready_us is not None and now_us >= self._ready_us and not self.synchronizing

    @property
    def in_step(self) -> bool:
        return not self._differs and not self._pending

    @property
    def cut(self) -> int:
        others = self._live - {self.slot}
        return min((self._agreed.get(s, NEVER).lamport for s in others), default=0)

    def live(self, slots: frozenset[int]) -> None:
        self._suspects |= slots - self._live - {self.slot}
        self._live = slots
        self._differs &= slots
        self._pending = {s: d for s, d in self._pending.items() if s in slots}
        if not self._differs:
            self._settle()

    def changed_here(self, section: int, block: int | None = None) -> None:
        """An own operation or own progress was written and is being announced."""
        if block is not None:
            self._grew(section, block)
        self._note()

    # ---------------------------------------------------------------- hearing

    def heard_digest(self, slot: int, digest: int, now_us: int) -> None:
        """A peer's heartbeat. A mismatch is judged one heartbeat late, when frames that were on
        their way have arrived; at once for a peer that was not there a moment ago."""
        agreed = self._history.get(digest)
        if agreed is not None:
            self._agreed[slot] = max(agreed, self._agreed.get(slot, NEVER))
            self._pending.pop(slot, None)
            self._suspects.discard(slot)
            self._differs.discard(slot)
            if not self._differs:
                self._settle()
            return
        before = self._pending.get(slot)
        self._pending[slot] = digest
        if slot in self._suspects or (before is not None and before not in self._history):
            self._suspects.discard(slot)
            self._differs.add(slot)
            if not self.synchronizing:
                self.synchronizing, self._rounds = True, 0
                self._request_us = now_us + self._backoff()

    def receive(self, slot: int, message: object, now_us: int) -> set[int]:
        """Any work frame; returns the sections whose register changed."""
        if isinstance(message, TaskClaim | StateSyncResponse):
            return self._register(message, now_us)
        if isinstance(message, WorkProgress):
            self._block(message, now_us)
        elif isinstance(message, StateSyncRequest):
            self._asked(slot, message, now_us)
        elif isinstance(message, Digests):
            self._buckets(message, now_us)
        return set()

    def _register(self, m: TaskClaim | StateSyncResponse, now_us: int) -> set[int]:
        key = pack(m.epoch, m.phase, m.bid, m.lamport, m.owner)
        relayed = isinstance(m, StateSyncResponse)
        return self._told(REGISTERS, m.section, self.allocation.apply(m.section, key),
                          (self.allocation.key(m.section) or 0) > key, relayed, now_us)  # fmt: skip

    def _block(self, m: WorkProgress, now_us: int) -> None:
        grew = self.progress.apply(m.section, m.block, m.bits)
        if grew:
            self._grew(m.section, m.block)
        ours = self.progress.bits(m.section, m.block)
        name = m.section << 8 | m.block
        self._told(BLOCKS, name, grew, ours & ~m.bits != 0, (BLOCKS, name) in self._queue, now_us)

    def _told(
        self, kind: int, name: int, changed: bool, stale: bool, relayed: bool, now_us: int
    ) -> set[int]:
        """An entry was heard: strike it from what we wanted to say, or correct it."""
        entry = (kind, name)
        if relayed and self._request_us is not None:
            self._request_us = max(self._request_us, now_us + ROUND_US)  # we are being told
        if relayed or self.synchronizing:
            self._speak_us = max(self._speak_us, now_us + GAP_US + self._rank() * FRAME_US // 4)
        if stale:
            if relayed:
                self._queue[entry] = None
                self.repaired += 1
        elif entry in self._queue:
            del self._queue[entry]
            self._speak_us = max(self._speak_us, now_us + QUIET_US + self._backoff())
        if changed:
            self._note()
            return {name} if kind == REGISTERS else set()
        return set()

    def _grew(self, section: int, block: int) -> None:
        self._version += 1
        self._grown[section, block] = self._version

    def _asked(self, slot: int, m: StateSyncRequest, now_us: int) -> None:
        if self._request_us is not None and m.digest == self.digest:
            self._request_us = now_us + ROUND_US  # somebody with our state asked for us
        if m.digest in self._history and m.digest == self.digest:
            return
        self.answered += 1
        known = self._agreed.get(slot, NEVER) if m.cut else NEVER
        for section, _ in self.allocation.delta(m.cut):
            self._queue[REGISTERS, section] = None
        for (section, block), version in sorted(self._grown.items()):
            if version > known.version:
                self._queue[BLOCKS, section << 8 | block] = None
        self._speak_us = max(self._speak_us, now_us + self._backoff())

    def _buckets(self, m: Digests, now_us: int) -> None:
        ours = self._bucket_digests(m.salt)
        different = {
            3 * m.triple + k
            for k, digest in enumerate((m.first, m.second, m.third))
            if 3 * m.triple + k < BUCKETS and ours[3 * m.triple + k] != digest
        }
        if not different:
            return
        for section in self.allocation.sections():
            if bucket_of(REGISTERS, section) in different:
                self._queue[REGISTERS, section] = None
        for section, block, _ in self.progress.entries():
            if bucket_of(BLOCKS, section << 8 | block) in different:
                self._queue[BLOCKS, section << 8 | block] = None
        self._speak_us = max(self._speak_us, now_us + self._backoff())

    def _bucket_digests(self, salt: int) -> list[int]:
        totals = [0] * (BUCKETS + 1)
        for section, key in self.allocation.entries().items():
            totals[bucket_of(REGISTERS, section)] += entry_hash(REGISTERS, section, key)
        for section, block, bits in self.progress.entries():
            name = section << 8 | block
            totals[bucket_of(BLOCKS, name)] += entry_hash(BLOCKS, name, bits)
        return [mix(total & MASK ^ salt) >> 48 for total in totals]

    # ---------------------------------------------------------------- saying

    @property
    def deadline_us(self) -> int | None:
        if self._queue or self._frames:
            return min(self._speak_us, self._request_us or self._speak_us)
        return self._request_us

    def tick(self, now_us: int) -> Iterable[Said]:
        """What to send now: at most one entry, and a request when its turn has come."""
        said: list[Said] = []
        if self._request_us is not None and now_us >= self._request_us:
            said += self._request(now_us)
        if (self._queue or self._frames) and now_us >= self._speak_us:
            said.append(self._frames.pop() if self._frames else self._next_entry())
            self._speak_us = now_us + GAP_US
        return said

    def _next_entry(self) -> Said:
        (kind, name), _ = self._queue.popitem(last=False)
        if kind == REGISTERS:
            claim: Claim = self.allocation.entry(name)
            return StateSyncResponse(
                name, claim.epoch, claim.phase, claim.bid, claim.lamport, claim.owner
            )
        section, block = name >> 8, name & 0xFF
        return WorkProgress(section, block, self.progress.bits(section, block))

    def _request(self, now_us: int) -> list[Said]:
        if not self._differs:
            self._settle()
            return []
        if self._rounds >= ROUNDS_MAX:
            self.given_up += 1
            self._settle()
            return []
        self._rounds += 1
        self._round = (self._round + 1) & 0xFF
        self.requests += 1
        self._request_us = now_us + ROUND_US + self._backoff()
        if self._rounds >= BUCKET_ROUND:
            salt, digests = self._round, self._bucket_digests(self._round)
            self._frames = [
                Digests(i, salt, *digests[3 * i : 3 * i + 3])
                for i in reversed(range((BUCKETS + 2) // 3))
            ]
        cut = min((self._agreed.get(s, NEVER).lamport for s in self._differs), default=0)
        return [StateSyncRequest(min(cut, LAMPORT_MAX), self.digest, 0, self._round)]

    def _settle(self) -> None:
        self.synchronizing, self._request_us, self._rounds = False, None, 0
        self._differs.clear()

    def _rank(self) -> int:
        return sum(1 for s in self._live if s < self.slot)

    def _backoff(self) -> int:
        return min(self._rank(), RANKS) * SLOT_US
