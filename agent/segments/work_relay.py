"""A gateway's part in the work: keeps the sections shared with neighbour segments equal.

The home of a section decides. Its value is sent to the neighbours that share it and becomes their
copy. Claims and progress of a neighbour's robot are sent to the home as a request, merge there by
the same order, and come back as the home's value. If two claims differ only in their owners, the
home decides by raising the epoch. Losses and network cuts are repaired by comparing one digest for
each neighbour. On a difference the entries changed since the last agreement are sent, and if that
did not help, all entries.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from agent.interface.config import MS
from agent.segments.segment_area import GUEST_FIRST, Area, SegmentPlace
from crdt import FieldAllocationCRDT, Phase, Progress
from crdt.claim_register import DONE_BIT, EPOCH_MAX, LAMPORT_MAX, Claim
from crdt.digest import mix
from protocol.backbone_messages import ENTRIES_MAX, Entry
from protocol.frames.work_frames import (
    TASK_CLAIM,
    WORK_PROGRESS,
    StateSyncResponse,
    TaskClaim,
    WorkProgress,
)

REGISTER, BLOCK = 1, 2  # kinds of entries; for the map see `map_relay.py`
LAST_SLOT = GUEST_FIRST - 1  # owner of a finished section if only its segment is known
UNKNOWN_OWNER = 0xFF  # an unknown robot of that segment
FLUSH_US = 20 * MS  # changes wait this long to be sent together; a claim is contested for 250 ms
OWNER_BITS = 8
# Comparisons between two repairs at most: at two summaries a second, two minutes. A difference that
# cannot be repaired must not hide later ones, of which entries were lost.
REPAIRS_APART_MAX = 256

Work = TaskClaim | StateSyncResponse | WorkProgress


class Change(NamedTuple):
    """An entry to be sent: its kind, its section number here, and its block of progress."""

    kind: int
    section: int
    block: int = 0


class WorkRelay:
    """The shared sections as one gateway knows them, and what it has to send where."""

    def __init__(self, area: Area) -> None:
        self.area = area
        self.allocation, self.progress = FieldAllocationCRDT(), Progress()
        self.counts: Counter[str] = Counter()
        self._outbox: dict[int, dict[Change, None]] = {n: {} for n in area.neighbours}
        self._fresh: list[Change] = []  # changes by the message that is being read
        self._inject: dict[Change, None] = {}  # to be sent on our bus with the newest value
        self._changed: dict[Change, int] = {}  # -> version of its last change
        self._version = 0
        self._blocks: dict[int, int] = {}  # section -> blocks that were ever written
        self._agreed: dict[int, int] = {}  # neighbour -> version at which our digests were equal
        self._differs: dict[int, int] = {}  # neighbour -> comparisons in a row that failed

    # ---------------------------------------------------------------- our segment

    def on_message(self, message: Work, from_gateway: bool) -> None:
        """A work frame on our bus, which the reader has merged into the replica.

        A frame of another gateway is not sent back to where it came from."""
        section = message.section
        change = Change(REGISTER, section)
        if isinstance(message, WorkProgress):
            change = Change(BLOCK, section, message.block)
        self._inject.pop(change, None)  # it was sent already
        if from_gateway:
            self._touch(change)
        else:
            self._news(change)

    def _news(self, change: Change) -> None:
        neighbours = self.area.concerned(change.section)
        if neighbours:
            self._touch(change)
        for neighbour in neighbours:
            self._outbox[neighbour][change] = None

    def _touch(self, change: Change) -> None:
        self._version += 1
        self._changed[change] = self._version
        if change.kind == BLOCK:
            blocks = self._blocks.get(change.section, 0)
            self._blocks[change.section] = max(blocks, change.block + 1)

    # ---------------------------------------------------------------- to a neighbour

    @property
    def has_entries(self) -> bool:
        """Whether there are entries for the backbone."""
        return any(self._outbox.values())

    def outgoing(self) -> Iterable[tuple[int, tuple[Entry, ...]]]:
        """For each neighbour the entries to publish now, at most `ENTRIES_MAX` each."""
        for neighbour, changes in self._outbox.items():
            if changes:
                chosen = list(changes)[:ENTRIES_MAX]
                for change in chosen:
                    del changes[change]
                self.counts["told"] += len(chosen)
                yield neighbour, tuple(self._entry(change) for change in chosen)

    def _entry(self, change: Change) -> Entry:
        """The current value, in the numbers of the section's home."""
        home, section = self.area.place_of(change.section)
        if change.kind == BLOCK:
            bits = self.progress.bits(change.section, change.block)
            return Entry(
                BLOCK,
                home,
                section,
                0,
                0,
                WORK_PROGRESS.pack(WorkProgress(section, change.block, bits)),
            )
        claim = self.allocation.entry(change.section)
        segment = self.area.segment_of(claim.owner)
        owner = claim.owner if segment == self.area.segment else UNKNOWN_OWNER
        return Entry(
            REGISTER, home, section, segment, owner, TASK_CLAIM.pack(TaskClaim(section, *claim))
        )

    # ---------------------------------------------------------------- from a neighbour

    @property
    def version(self) -> int:
        """A counter of changes to shared sections."""
        return self._version

    def on_entries(self, source: int, entries: Iterable[Entry]) -> Iterable[tuple[int, int | None]]:
        """Merge entries of the neighbour `source`. Returns (section, block) of each change; block
        None stands for the register.

        Entries of sections that are not shared with it, or that cannot be read, are counted as
        refused.
        """
        self._fresh = []
        for entry in entries:
            number = self.area.number_of.get(SegmentPlace(entry.segment, entry.section))
            concerned = () if number is None else self.area.concerned(number)
            if number is None or source not in concerned:
                self.counts["refused"] += 1  # not shared with the sender
            elif entry.kind == BLOCK:
                self._join_block(number, WORK_PROGRESS.unpack(entry.data))
            elif entry.kind == REGISTER:
                self._join_register(number, entry)
            else:
                self.counts["refused"] += 1
        return [(c.section, c.block if c.kind == BLOCK else None) for c in self._fresh]

    def _join_block(self, number: int, told: WorkProgress) -> None:
        change = Change(BLOCK, number, told.block)
        if self.progress.apply(number, told.block, told.bits):
            self._joined(change)

    def _join_register(self, number: int, entry: Entry) -> None:
        try:
            told = TASK_CLAIM.unpack(entry.data)
        except ValueError:
            self.counts["refused"] += 1
            return
        owner = self._owner_here(number, entry, told)
        if owner is None:
            return
        claim = Claim(told.epoch, Phase(told.phase), told.bid, told.lamport, owner)
        key, known = claim.pack(), self.allocation.key(number)
        change = Change(REGISTER, number)
        if known is not None and key >> OWNER_BITS == known >> OWNER_BITS:
            if key != known and self.area.segment_of(owner) != self._segment_here(known):
                self._settle(change, known)
        elif self.allocation.apply(number, key):
            self._joined(change)

    def _segment_here(self, key: int) -> int:
        return self.area.segment_of(Claim.unpack(key).owner)

    def _owner_here(self, number: int, entry: Entry, told: TaskClaim) -> int | None:
        """The owner number in a register here; None if the entry is not needed."""
        area = self.area
        if entry.owner_segment == area.segment:
            if entry.owner != UNKNOWN_OWNER:
                return entry.owner if entry.owner < GUEST_FIRST else None
            # A claim of ours comes back from its home without the slot, which our register knows. The
            # home may have raised its epoch. A robot that holds it no more gives it back then.
            ours = self.allocation.entry(number)
            same = (ours.epoch, ours.phase, ours.lamport) == (told.epoch, told.phase, told.lamport)
            known = ours.owner < GUEST_FIRST and self.allocation.key(number) is not None
            return ours.owner if known and (same or told.phase != Phase.DONE) else LAST_SLOT
        home = area.place_of(number).segment
        if entry.owner_segment in area.neighbours:
            return area.guest(entry.owner_segment)
        return area.guest(home) if home in area.neighbours else None  # a neighbour's neighbour

    def _settle(self, change: Change, known: int) -> None:
        """Two claims differ only in their owners: the home decides by raising the epoch."""
        self.counts["ties"] += 1
        if change.section in self.area.borrowed:
            self._news(change)  # the home has to see it
            return
        claim = Claim.unpack(known)
        if claim.phase == Phase.DONE or claim.phase == Phase.FREE:
            return  # nothing to decide
        if claim.epoch == EPOCH_MAX:
            return  # as with `allocation`: there is no later claim
        lamport = min(self.allocation.lamport + 1, LAMPORT_MAX)
        if self.allocation.apply(
            change.section, claim._replace(epoch=claim.epoch + 1, lamport=lamport).pack()
        ):
            self._joined(change)
            self._news(change)

    def _joined(self, change: Change) -> None:
        """Note a change from another segment: for our bus and, if we are the home, for the other
        neighbours.
        """
        self.counts["joined"] += 1
        self._fresh.append(change)
        self._inject.pop(change, None)
        self._inject[change] = None
        self._touch(change)
        if change.section in self.area.lent:
            for neighbour in self.area.concerned(change.section):
                self._outbox[neighbour][change] = None

    # ---------------------------------------------------------------- on our segment

    @property
    def has_frames(self) -> bool:
        """Whether there are frames for our bus."""
        return bool(self._inject)

    def next_frame(self) -> Work:
        """The next frame for our bus; call it only if `has_frames`. Robots join a claim as any other
        announcement.
        """
        change = next(iter(self._inject))
        del self._inject[change]
        if change.kind == BLOCK:
            bits = self.progress.bits(change.section, change.block)
            return WorkProgress(change.section, change.block, bits)
        return TaskClaim(change.section, *self.allocation.entry(change.section))

    def forget_injections(self) -> None:
        """Forget the frames for our bus, because another gateway leads and sends them."""
        self._inject.clear()

    # ---------------------------------------------------------------- anti-entropy

    def home_state(self) -> tuple[int, int]:
        """How many sections of this segment are done, and a 32-bit digest of all of them."""
        total = done = 0
        for section, key in self.allocation.entries().items():
            if section < self.area.home:
                done += key >= DONE_BIT
                total += mix(mix(section) ^ key >> OWNER_BITS)
        return done, (total & 0xFFFF_FFFF_FFFF_FFFF) >> 32

    def digest(self, neighbour: int) -> int:
        """32 bits of all sections shared with a neighbour; equal contents give equal digests on
        both sides.
        """
        total = 0
        for section in self.area.shared_with(neighbour):
            home, number = self.area.place_of(section)
            place = home << 16 | number
            key = self.allocation.key(section)
            if key is not None:
                decided = mix(place << 2 | REGISTER) ^ mix(key >> OWNER_BITS)
                total += mix(decided ^ self._holder(key, home, neighbour))
            for block in range(self._blocks.get(section, 0)):
                bits = self.progress.bits(section, block)
                if bits:
                    total += mix(mix(place << 10 | block << 2 | BLOCK) ^ bits)
        return (total & 0xFFFF_FFFF_FFFF_FFFF) >> 32

    def _holder(self, key: int, home: int, neighbour: int) -> int:
        """The segment that holds a section; a third segment counts as the home on both sides."""
        claim = Claim.unpack(key)
        if claim.phase in (Phase.DONE, Phase.FREE):
            return 0
        segment = self.area.segment_of(claim.owner)
        return segment if segment in (self.area.segment, neighbour) else home

    def on_digest(self, neighbour: int, theirs: int) -> None:
        """Compare a neighbour's digest with ours; after two differences in a row with nothing
        pending, send.

        `theirs`: 32 bits.
        """
        if neighbour not in self._outbox:
            return
        if theirs == self.digest(neighbour):
            self._agreed[neighbour] = self._version
            self._differs.pop(neighbour, None)
            return
        tries = self._differs[neighbour] = self._differs.get(neighbour, 0) + 1
        rare = tries & tries - 1 and tries % REPAIRS_APART_MAX
        if tries < 2 or rare or self._outbox[neighbour]:
            return  # try at 2, 4, 8 ... so that an unrepairable difference costs less
        since = self._agreed.get(neighbour, 0) if tries == 2 else 0
        for change in self._shared_since(neighbour, since):
            self._outbox[neighbour][change] = None
        self.counts["repairs"] += 1

    def _shared_since(self, neighbour: int, version: int) -> Sequence[Change]:
        shared = set(self.area.shared_with(neighbour))
        return [c for c, v in self._changed.items() if v > version and c.section in shared]
