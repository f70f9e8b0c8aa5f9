"""A peer's shared state as one set of entries, with what the sync must remember of it.

An entry is a register or a progress block; its code is kind and name in one integer. The replica
counts its changes (`version`). For each entry it keeps the version of its last change, and for each
digest it recently had, the version it belongs to. So for a peer whose digest is one of our recent
ones, we know exactly what it lacks: the entries that changed since. This needs no Lamport time. It
therefore works for progress, which has none, and for entries of a third replica that was behind the
cut of all others.
"""

from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

from crdt import FieldAllocationCRDT, Phase, Progress
from crdt.allocation import KIND as REGISTERS
from crdt.claim_register import owner_of, pack
from crdt.digest import BUCKETS, MASK, bucket_of, mix, short
from crdt.progress import KIND as BLOCKS
from crdt.progress import name_of
from protocol.frames.work_frames import Digests, StateSyncResponse, TaskClaim, WorkProgress
from protocol.sync.vouchers import Revocation, Vouched, Vouchers

FORKS_MAX = 256  # versions tried as a fork, newest first; takes a fifth of a millisecond
HISTORY_MAX = 512  # own digests remembered: 10 s of the busiest fleet, minutes of a small one
NAME_BITS = 24
EMPTY = 0  # the digest of an empty replica; every other replica is ahead of it
GROUPS = (BUCKETS + 2) // 3  # frames of three bucket digests


class ReplicaVersion(NamedTuple):
    """A state we had: its number of changes, its greatest Lamport time, its sum of entries."""

    version: int
    lamport: int
    total: int


NEVER = ReplicaVersion(0, 0, 0)


class AppliedEntry(NamedTuple):
    """What a frame with one entry changed here."""

    entry: int
    changed: bool  # it was new to us
    stale: bool  # ours is newer: the sender lacks something


_tuple = tuple.__new__


def entry_of(kind: int, name: int) -> int:
    """The code of an entry: its kind in the bits above its 24-bit name."""
    return kind << NAME_BITS | name


class Replica:
    """The allocation and the progress of one peer, with the versions of their recent states."""

    def __init__(self, allocation: FieldAllocationCRDT, progress: Progress) -> None:
        self.allocation, self.progress = allocation, progress
        self.vouchers: Vouchers | None = None  # of a fleet with keys
        self.version = 1
        self._changed: dict[int, int] = {}  # entry -> version of its last change; newest last
        self._history: dict[int, ReplicaVersion] = {}  # own digest -> version; newest last
        # Ends of sections that come back when their units are told again: what was said of them.
        self._waiting: dict[int, tuple[int, dict[int, list[Vouched]]]] = {}
        self._returned: set[int] = set()  # sections whose end has come back
        for entry in self.entries():
            self._changed[entry] = self.version
        self._remember()

    @property
    def total(self) -> int:
        """Sum of the hashes of all entries, modulo 2**64."""
        return self.allocation.sums.total + self.progress.sums.total & MASK

    @property
    def digest(self) -> int:
        """The 24 bits that heartbeats carry; equal replicas have equal ones."""
        return short(self.total)

    def entries(self) -> Iterator[int]:
        """The codes of all entries: registers by section, then progress blocks."""
        for section in self.allocation.sections():
            yield entry_of(REGISTERS, section)
        for section, block, _ in self.progress.entries():
            yield entry_of(BLOCKS, section << 8 | block)

    def __contains__(self, entry: int) -> bool:
        return entry in self._changed

    def owner_of(self, entry: int) -> int | None:
        """The slot that holds the section an entry belongs to."""
        kind, name = entry >> NAME_BITS, entry & (1 << NAME_BITS) - 1
        return self.allocation.owner_of(name if kind == REGISTERS else name >> 8)

    # ---------------------------------------------------------------- changes

    def note(self, entry: int) -> None:
        """Count a change of an entry: the replica has a new version and digest."""
        self.version += 1
        self._changed.pop(entry, None)
        self._changed[entry] = self.version
        self._remember()

    def changed_here(self, section: int, block: int | None, units: int, now_us: int) -> None:
        """Count an own operation (no block), or `units` of a block that we covered ourselves."""
        vouchers = self.vouchers
        if block is None:
            self.note(entry_of(REGISTERS, section))
            if vouchers is not None:
                key = self.allocation.key(section)
                assert key is not None, "an own operation was written"
                vouchers.register(section, key, vouchers.slot, now_us)
            return
        self.note(entry_of(BLOCKS, name_of(section, block)))
        if vouchers is not None:
            vouchers.cover(name_of(section, block), units)
            self._return_end(section)

    def void(self, void: Revocation) -> tuple[list[int], list[int]]:
        """Take out what a revoked member may have said; returns sections and names of blocks.

        Without vouchers nothing is known of the senders, and nothing changes. The end of a section
        whose units are not all here waits for them: its sender may have believed false units."""
        vouchers, allocation = self.vouchers, self.allocation
        if vouchers is None:
            return [], []
        self._waiting.clear()
        registers = vouchers.registers_without(void, dict(allocation.entries()))
        for section, key in registers.items():
            allocation.take_out(section, key)
            self._taken_out(entry_of(REGISTERS, section), key is not None)
        blocks = [
            name for name, bits in vouchers.blocks_without(void).items()
            if self.progress.take_out(name >> 8, name & 0xFF, bits)
        ]  # fmt: skip
        for name in blocks:
            left = self.progress.bits(name >> 8, name & 0xFF)
            self._taken_out(entry_of(BLOCKS, name), bool(left))
        early = [section for section in allocation.sections() if self._done_too_early(section)]
        for section in early:
            key = allocation.key(section)
            assert key is not None
            self.await_units(section, key, vouchers.forget(section))
            allocation.take_out(section, None)
            self._taken_out(entry_of(REGISTERS, section), False)
        changed = sorted({*registers, *early})
        if changed or blocks:
            self._history.clear()  # nobody with an older state is one of us any more
            self.version += 1
            self._remember()
        return changed, sorted(blocks)

    def await_units(self, section: int, key: int, said: dict[int, list[Vouched]]) -> None:
        """Join the end of a section when all its units are here, and not before."""
        self._waiting[section] = key, said
        self._return_end(section)

    def take_returned(self) -> set[int]:
        """Sections whose end has come back since the last call."""
        returned, self._returned = self._returned, set()
        return returned

    def _return_end(self, section: int) -> None:
        if section not in self._waiting or not self.progress.complete(section):
            return
        key, said = self._waiting.pop(section)
        assert self.vouchers is not None
        self.vouchers.restore(section, said)
        if self.allocation.apply(section, key):
            self._returned.add(section)
            self.note(entry_of(REGISTERS, section))

    def _done_too_early(self, section: int) -> bool:
        """Whether a section is said to be done, and units of it are not known to be covered."""
        if self.allocation.phase_of(section) is not Phase.DONE:
            return False
        return section in self.progress.units and not self.progress.complete(section)

    def _taken_out(self, entry: int, remains: bool) -> None:
        self._changed.pop(entry, None)
        if remains:
            self.version += 1
            self._changed[entry] = self.version

    def _remember(self) -> None:
        history = self._history
        total = self.total
        history[short(total)] = _tuple(
            ReplicaVersion, (self.version, self.allocation.lamport, total)
        )
        if len(history) > HISTORY_MAX:
            del history[next(iter(history))]

    def when(self, digest: int) -> ReplicaVersion | None:
        """The version at which we had this digest, if recently; a peer with it lacks later
        changes."""
        if digest == EMPTY:
            return NEVER
        return self._history.get(digest)

    def fork(self, digest: int, met_total: int, after: int) -> ReplicaVersion | None:
        """The version, later than `after`, at which another replica diverged from ours; None if no
        version fits.

        The other replica has sent us all that it changed since, and we have sent it nothing. So its
        `digest` is that of our present entries without those that were new on our side since we
        met, when our sum was `met_total`. The sums of the remembered versions show which one that
        is.
        """
        learned = self.total - met_total
        for moment in islice(reversed(self._history.values()), FORKS_MAX):
            if moment.version < after:
                return None
            if short(moment.total + learned & MASK) == digest:
                return moment
        return None

    def since(self, version: int) -> list[int]:
        """Entries that changed after a version, in order of their codes."""
        found = []
        for entry, changed in reversed(self._changed.items()):
            if changed <= version:
                break
            found.append(entry)
        return sorted(found)

    def after(self, lamport: int) -> list[int]:
        """Registers written after a Lamport time: for peers that remember more than we do."""
        return [entry_of(REGISTERS, section) for section, _ in self.allocation.delta(lamport)]

    # ---------------------------------------------------------------- frames

    def on_message(
        self,
        message: TaskClaim | StateSyncResponse | WorkProgress,
        sender: int | None = None,
        now_us: int = 0,
    ) -> AppliedEntry:
        """Join the entry that a frame carries, and say what that changed.

        `sender`: the member whose proof covers the frame; None in a fleet without keys."""
        vouchers = None if sender is None else self.vouchers
        if isinstance(message, WorkProgress):
            section, block, bits = message
            if vouchers is not None and sender is not None:
                before = self.progress.bits(section, block)
                changed = self.progress.apply(section, block, bits)
                if changed:
                    new = self.progress.bits(section, block) & ~before
                    vouchers.units(name_of(section, block), new, sender, now_us)
            else:
                changed = self.progress.apply(section, block, bits)
            stale = self.progress.bits(section, block) & ~bits != 0
            entry = entry_of(BLOCKS, section << 8 | block)
        else:
            section = message.section
            key = pack(message.epoch, message.phase, message.bid, message.lamport, message.owner)
            changed = self.allocation.apply(section, key)
            told = changed or sender == message.owner
            if told and vouchers is not None and sender is not None:
                vouchers.register(section, key, sender, now_us)
                if vouchers.adopts(key, sender):
                    vouchers.register(section, key, vouchers.slot, now_us)
            stale = not changed and self.allocation.key(section) != key
            entry = entry_of(REGISTERS, section)
        if changed:
            self.note(entry)
            if self._waiting:
                self._return_end(section)
        return _tuple(AppliedEntry, (entry, changed, stale))

    def may_tell(self, entry: int) -> bool:
        """Whether we may send an entry: in a fleet with keys, what we are said to own only if we said it.

        Else a lie in our name would become our own word."""
        kind, name = entry >> NAME_BITS, entry & (1 << NAME_BITS) - 1
        if self.vouchers is None or kind != REGISTERS:
            return True
        key, slot = self.allocation.key(name), self.vouchers.slot
        return key is None or owner_of(key) != slot or key == self.vouchers.said_by(name, slot)

    def message_of(self, entry: int) -> StateSyncResponse | WorkProgress:
        """The frame that carries the present value of an entry."""
        kind, name = entry >> NAME_BITS, entry & (1 << NAME_BITS) - 1
        if kind == REGISTERS:
            return StateSyncResponse(name, *self.allocation.entry(name))
        section, block = name >> 8, name & 0xFF
        return WorkProgress(section, block, self.progress.bits(section, block))

    # ---------------------------------------------------------------- buckets

    def bucket_frames(self, salt: int) -> list[Digests]:
        """Bucket digests, three a frame. The salt keeps a collision from repeating."""
        digests = self._bucket_digests(salt) + [0] * (3 * GROUPS - BUCKETS)
        return [Digests(k, salt, *digests[3 * k : 3 * k + 3]) for k in range(GROUPS)]

    def differing(self, told: Digests) -> set[int]:
        """The buckets of a frame in which the sender's entries differ from ours."""
        index, salt, *theirs = told
        ours = self._bucket_digests(salt)
        return {
            bucket
            for bucket, digest in enumerate(theirs, 3 * index)
            if bucket < BUCKETS and ours[bucket] != digest
        }

    def _bucket_digests(self, salt: int) -> list[int]:
        both = zip(self.allocation.sums.buckets(), self.progress.sums.buckets(), strict=True)
        return [mix((a + b & MASK) ^ salt) >> 48 for a, b in both]

    @staticmethod
    def bucket(entry: int) -> int:
        """The bucket of an entry, 0 to `BUCKETS` - 1."""
        return bucket_of(entry >> NAME_BITS, entry & (1 << NAME_BITS) - 1)
