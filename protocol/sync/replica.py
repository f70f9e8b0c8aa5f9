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
from crdt.claim_register import pack
from crdt.digest import BUCKETS, MASK, bucket_of, mix, short
from crdt.progress import KIND as BLOCKS
from crdt.progress import name_of
from protocol.frames.work_frames import Digests, StateSyncResponse, TaskClaim, WorkProgress
from protocol.sync.vouchers import Vouchers

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

    def void(self, revoked: int, compromised_at_us: int | None) -> tuple[list[int], list[int]]:
        """Take out what only a revoked member vouched for; returns sections and names of blocks.

        `compromised_at_us`: what it said before remains; None: nothing does. Without vouchers nothing is
        known of who said what, and nothing changes."""
        vouchers = self.vouchers
        if vouchers is None:
            return [], []
        registers = vouchers.registers_without(
            revoked, compromised_at_us, dict(self.allocation.entries())
        )
        blocks = [
            name for name, bits in vouchers.blocks_without(revoked, compromised_at_us).items()
            if self.progress.take_out(name >> 8, name & 0xFF, bits)
        ]  # fmt: skip
        registers |= dict.fromkeys(self._done_too_early({name >> 8 for name in blocks}))
        for section, key in registers.items():
            if key is None:
                vouchers.forget(section)
            self.allocation.take_out(section, key)
            self._taken_out(entry_of(REGISTERS, section), key is not None)
        for name in blocks:
            left = self.progress.bits(name >> 8, name & 0xFF)
            self._taken_out(entry_of(BLOCKS, name), bool(left))
        if registers or blocks:
            self._history.clear()  # nobody with an older state is one of us any more
            self.version += 1
            self._remember()
        return sorted(registers), sorted(blocks)

    def _done_too_early(self, sections: set[int]) -> list[int]:
        """Sections that an honest robot has ended, because it believed units that are void now."""
        allocation, progress = self.allocation, self.progress
        return [
            section for section in sorted(sections)
            if allocation.phase_of(section) is Phase.DONE
            and section in progress.units and not progress.complete(section)
        ]  # fmt: skip

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
                    vouchers.block(name_of(section, block), new, sender, now_us)
            else:
                changed = self.progress.apply(section, block, bits)
            stale = self.progress.bits(section, block) & ~bits != 0
            entry = entry_of(BLOCKS, section << 8 | block)
        else:
            section = message.section
            key = pack(message.epoch, message.phase, message.bid, message.lamport, message.owner)
            known = self.allocation.key(section) if vouchers is not None else None
            changed = self.allocation.apply(section, key)
            if changed and vouchers is not None and sender is not None:
                vouchers.register(section, known, key, sender, now_us)
            stale = not changed and self.allocation.key(section) != key
            entry = entry_of(REGISTERS, section)
        if changed:
            self.note(entry)
        return _tuple(AppliedEntry, (entry, changed, stale))

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
