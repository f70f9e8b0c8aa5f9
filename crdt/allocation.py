"""The owner and state of each section: a map of registers, each joined by maximum, and a Lamport
clock.

Local operations write and return the key to broadcast, or None if the rules do not allow them.
Whether an operation is useful is decided by policy elsewhere.

Registers are Python integers in one dict. Joining a replica is one comparison per entry, and a
register is 8 bytes on the wire and on disk. Limits: 65,536 sections; 255 hand-overs of a section;
2^24 - 1 operations of the whole fleet on one field, after which the Lamport clock stops and the
earlier claim no longer wins.
"""

from collections.abc import Iterator, Mapping
from struct import Struct
from zlib import crc32

from crdt.claim_register import (
    DONE_BIT,
    EPOCH_MAX,
    LAMPORT_MAX,
    Claim,
    Phase,
    bid_of,
    epoch_of,
    lamport_of,
    owner_of,
    pack,
    phase_of,
)
from crdt.digest import Sums, short

KIND = 1  # of an allocation entry in digests
SECTION_MAX = 0xFFFF
ENTRY = Struct("<HBBHBB")  # 8 bytes, as TASK_CLAIM
HEADER = Struct("<I")
assert ENTRY.size == 8
HELD = (Phase.CLAIMED, Phase.STARTED)
BY_NUMBER = {int(phase): phase for phase in Phase}  # calling an Enum is slow; missions ask often


class FieldAllocationCRDT:
    """The registers of all sections of one field, with the Lamport clock that orders their claims.

    Mutable and owned by one peer. A section without a register is FREE at epoch 0.
    """

    def __init__(self, field_hash: int = 0) -> None:
        self.field_hash = field_hash
        self.lamport = 0  # the greatest Lamport time seen or written
        self._keys: dict[int, int] = {}
        self._sums = Sums(KIND, self._keys)
        self._done = 0
        self._held: dict[int, list[int]] = {}  # by owner, cached since the last change
        # Grows with every register that grows, so that readers can skip an unchanged allocation.
        self.changes = 0

    @staticmethod
    def hash_of(description: str) -> int:
        """24 bits of a field or fleet description; replicas with different hashes never merge."""
        return crc32(description.encode()) & 0xFFFFFF

    # ---------------------------------------------------------------- local operations

    def claim(self, section: int, owner: int, bid: int = 0) -> int | None:
        """Claim a free section; returns the register's key. None if the section has an owner or is
        done."""
        key = self._keys.get(section)
        if key is None:
            return self._write(section, 0, Phase.CLAIMED, bid, owner)
        if phase_of(key) != Phase.FREE:
            return None
        return self._write(section, epoch_of(key), Phase.CLAIMED, bid, owner)

    def start(self, section: int, owner: int) -> int | None:
        """Start claimed work; returns the register's key. From now on no cheaper claim of this
        epoch takes the section away. None if `owner` has not claimed it."""
        key = self._keys.get(section)
        if key is None or phase_of(key) != Phase.CLAIMED or owner_of(key) != owner:
            return None
        return self._write(section, epoch_of(key), Phase.STARTED, bid_of(key), owner)

    def done(self, section: int, owner: int) -> int | None:
        """Mark a section as finished, whatever its owner; returns the register's key, which wins
        every join. None if it was done already."""
        key = self._keys.get(section, 0)
        if phase_of(key) == Phase.DONE:
            return None
        return self._write(section, epoch_of(key), Phase.DONE, 0, owner)

    def release(self, section: int, owner: int) -> int | None:
        """Give an own section back; returns the register's key, of the next epoch. None for a
        section that `owner` does not hold, and after 255 hand-overs."""
        key = self._keys.get(section)
        if key is None or owner_of(key) != owner or phase_of(key) not in HELD:
            return None
        return self._raise(section, key, Phase.FREE, 0, owner)

    def takeover(self, section: int, owner: int, bid: int = 0) -> int | None:
        """Take a section from an owner that is gone; returns the register's key.

        The raised epoch rejects later writes of the former owner. None where no other robot holds
        the section, and after 255 hand-overs.
        """
        key = self._keys.get(section)
        if key is None or owner_of(key) == owner or phase_of(key) not in HELD:
            return None
        return self._raise(section, key, Phase.CLAIMED, bid, owner)

    def _raise(self, section: int, key: int, phase: Phase, bid: int, owner: int) -> int | None:
        epoch = epoch_of(key)
        if epoch == EPOCH_MAX:
            return None  # the limit of 255 hand-overs is reached; the section stays with its owner
        return self._write(section, epoch + 1, phase, bid, owner)

    def _write(self, section: int, epoch: int, phase: Phase, bid: int, owner: int) -> int:
        assert 0 <= section <= SECTION_MAX
        # One frame from the wire can carry the clock to its end; it then stops and never wraps.
        self.lamport = min(self.lamport + 1, LAMPORT_MAX)
        key = pack(epoch, phase, bid, self.lamport, owner)
        changed = self.apply(section, key)
        assert changed, "an own operation must be greater than what it has seen"
        return key

    # ---------------------------------------------------------------- joining

    def apply(self, section: int, key: int) -> bool:
        """Join one register; True if it changed."""
        lamport = lamport_of(key)
        if lamport > self.lamport:
            self.lamport = lamport
        known = self._keys.get(section)
        if known is not None and key <= known:
            return False
        self._sums.changing(section, known)
        self._keys[section] = key
        self._changed()
        if key >= DONE_BIT and (known is None or known < DONE_BIT):
            self._done += 1
        return True

    def merge(self, other: "FieldAllocationCRDT") -> set[int]:
        """Join a whole replica; returns the sections that changed. ValueError if it is of another
        field."""
        if other.field_hash != self.field_hash:
            raise ValueError(
                f"replicas of different fields: {self.field_hash:06x} and {other.field_hash:06x}"
            )
        known_of = self._keys.get
        newer = {s: key for s, key in other._keys.items() if key > known_of(s, -1)}
        before = {section: known_of(section) for section in newer}
        self._sums.changing_all(before)
        self._done += sum(key >= DONE_BIT for key in newer.values())
        self._done -= sum(key is not None and key >= DONE_BIT for key in before.values())
        self._keys.update(newer)
        self._changed()
        self.lamport = max(self.lamport, other.lamport)
        return set(newer)

    def take_out(self, section: int, key: int | None) -> None:
        """Set a register to a lesser key, or to none, because the member that vouched for it was
        revoked. This is no join: every replica does it when the fleet's keys change."""
        known = self._keys[section]
        assert key is None or key < known
        self._sums.changing(section, known)
        if key is None:
            del self._keys[section]
        else:
            self._keys[section] = key
        self._done -= known >= DONE_BIT and (key is None or key < DONE_BIT)
        self._changed()

    def _changed(self) -> None:
        self.changes += 1
        if self._held:
            self._held.clear()

    def delta(self, cut: int) -> Iterator[tuple[int, int]]:
        """(section, key) written after Lamport time `cut`, in section order.

        This is all that another replica lacks, provided that no writer was behind `cut` at that
        time. A key at the end of the clock is always included.
        """
        for section in sorted(self._keys):
            key = self._keys[section]
            if lamport_of(key) > cut or lamport_of(key) == LAMPORT_MAX:
                yield section, key

    # ---------------------------------------------------------------- reading

    def key(self, section: int) -> int | None:
        """The register of a section as one integer (`crdt/claim_register.py`); None if it was never
        written."""
        return self._keys.get(section)

    def entry(self, section: int) -> Claim:
        """The fields of the register; a section that was never written is FREE at epoch 0."""
        return Claim.unpack(self._keys.get(section, pack(0, Phase.FREE, 0, 0, 0)))

    def phase_of(self, section: int) -> Phase:
        """How far the work on a section is; FREE if no robot ever claimed it."""
        return BY_NUMBER[phase_of(self._keys.get(section, 0))]

    def owner_of(self, section: int) -> int | None:
        """The slot that holds or finished a section; None if it is free."""
        key = self._keys.get(section)
        return None if key is None or phase_of(key) == Phase.FREE else owner_of(key)

    def stays(self, section: int) -> bool:
        """Whether a section has an owner that cannot hand it over any more: only this one can work it."""
        key = self._keys.get(section, 0)
        return phase_of(key) in HELD and epoch_of(key) == EPOCH_MAX

    def assigned_sections(self, owner: int) -> list[int]:
        """Sections claimed or started by a slot, without the finished ones."""
        held = self._held.get(owner)
        if held is None:
            held = self._held[owner] = sorted(
                s for s, k in self._keys.items() if owner_of(k) == owner and phase_of(k) in HELD
            )
        return held.copy()

    def done_count(self) -> int:
        """Number of finished sections, counted as they are joined."""
        return self._done

    def sections(self) -> list[int]:
        """The numbers of all sections that have a register, in ascending order."""
        return sorted(self._keys)

    def entries(self) -> Mapping[int, int]:
        """All registers, section to key. A view of the live dictionary: it must not be changed."""
        return self._keys

    def __len__(self) -> int:
        return len(self._keys)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, FieldAllocationCRDT):
            return NotImplemented
        return self.field_hash == other.field_hash and self._keys == other._keys

    # It is mutable, so it has no hash: `__eq__` without `__hash__` says so.

    @property
    def sums(self) -> Sums:
        """The allocation's part of a replica's digest."""
        return self._sums

    @property
    def digest(self) -> int:
        """24 bits that two allocations with equal registers have in common."""
        return short(self._sums.total)

    # ---------------------------------------------------------------- bytes

    def serialize(self) -> bytes:
        """4 bytes, then 8 an entry, in section order."""
        parts = [HEADER.pack(self.field_hash)]
        for section in sorted(self._keys):
            epoch, phase, bid, lamport, owner = Claim.unpack(self._keys[section])
            low, high = lamport & 0xFFFF, lamport >> 16
            parts.append(ENTRY.pack(section, epoch, phase | bid << 3, low, high, owner))
        return b"".join(parts)

    @classmethod
    def deserialize(cls, data: bytes) -> "FieldAllocationCRDT":
        """ValueError if the bytes are not a serialized allocation."""
        if (len(data) - HEADER.size) % ENTRY.size or len(data) < HEADER.size:
            raise ValueError(f"an allocation does not have {len(data)} bytes")
        replica = cls(HEADER.unpack_from(data)[0])
        # A tool that only listens reads no disk, and has no numpy.
        from crdt.allocation_rows import read_rows

        keys, replica.lamport = read_rows(data, HEADER.size)
        replica._keys.update(keys)
        replica._sums.changing_all(dict.fromkeys(replica._keys))
        replica._done = sum(key >= DONE_BIT for key in replica._keys.values())
        return replica
