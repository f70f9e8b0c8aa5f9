"""The work done: for each section a set of units that only grows, joined by union.

Claims are hints and progress is the truth, because a claim can be lost and a covered unit cannot.
Units are sent in blocks of 40, the bits of one WORK_PROGRESS frame. A block has no Lamport time,
because its join needs none. The version of a block's last growth here tells what a peer lacks
(`protocol/sync/replica.py`).
"""

from collections.abc import Iterator, Mapping
from struct import Struct

from crdt.digest import Sums, short

KIND = 2  # of a progress entry in digests
BLOCK_UNITS = 40
UNITS_MAX = 256 * BLOCK_UNITS  # block is a u8
ENTRY = Struct("<HBIB")
FULL = (1 << BLOCK_UNITS) - 1


def name_of(section: int, block: int) -> int:
    """A block's name in digests: 24 bits, in the order of sections."""
    return section << 8 | block


class Progress:
    """The covered units of all sections. A set that only grows, mutable and owned by one peer."""

    def __init__(self, units: Mapping[int, int] | None = None) -> None:
        """`units`: the number of units of each section; higher bits are refused. Others:
        unlimited."""
        self.units = dict(units or {})
        assert all(0 <= n <= UNITS_MAX for n in self.units.values())
        self._blocks: dict[int, int] = {}  # name -> bits
        self._sums = Sums(KIND, self._blocks)
        self._count: dict[int, int] = {}
        self.refused = 0  # bits of units that do not exist, caused by a different field description

    def cover(self, section: int, unit: int) -> tuple[int, int]:
        """Add one unit; returns (block, present bits of the block) for the announcement."""
        block, bit = divmod(unit, BLOCK_UNITS)
        assert 0 <= unit < self.units.get(section, UNITS_MAX), "no such unit"
        self.apply(section, block, 1 << bit)
        return block, self._blocks[name_of(section, block)]

    def apply(self, section: int, block: int, bits: int) -> bool:
        """Join one block, given as 40 `bits`; True if it grew. Bits of units that do not exist are
        left out and counted in `refused`."""
        name = name_of(section, block)
        known = self._blocks.get(name, 0)
        if not bits & ~known:
            return False
        allowed = self._allowed(section, block)
        if bits & ~allowed:
            self.refused += 1
        grown = known | bits & allowed
        if grown == known:
            return False
        self._sums.changing(name, known or None)
        self._blocks[name] = grown
        self._count[section] = self._count.get(section, 0) + (grown ^ known).bit_count()
        return True

    def take_out(self, section: int, block: int, bits: int) -> bool:
        """Remove units, because the member that vouched for them was revoked; True if some were
        there. This is no join, as `FieldAllocationCRDT.take_out`."""
        name = name_of(section, block)
        known = self._blocks.get(name, 0)
        rest = known & ~bits
        if rest == known:
            return False
        self._sums.changing(name, known)
        if rest:
            self._blocks[name] = rest
        else:
            del self._blocks[name]
        self._count[section] -= (known ^ rest).bit_count()
        return True

    def _allowed(self, section: int, block: int) -> int:
        units = self.units.get(section)
        if units is None:
            return FULL
        inside = min(max(units - block * BLOCK_UNITS, 0), BLOCK_UNITS)
        return (1 << inside) - 1

    def merge(self, other: "Progress") -> set[int]:
        """Join a whole replica; returns the sections that grew."""
        return {s for s, b, bits in other.entries() if self.apply(s, b, bits)}

    def has(self, section: int, unit: int) -> bool:
        """Whether a unit of a section is covered."""
        block, bit = divmod(unit, BLOCK_UNITS)
        return bool(self._blocks.get(name_of(section, block), 0) >> bit & 1)

    def bits(self, section: int, block: int) -> int:
        """The covered units of one block as 40 bits, the lowest for its first unit."""
        return self._blocks.get(name_of(section, block), 0)

    def covered(self, section: int) -> int:
        """The number of covered units of the section."""
        return self._count.get(section, 0)

    def complete(self, section: int) -> bool:
        """Whether all units of a section are covered; KeyError for a section whose size is not
        known."""
        return self.covered(section) >= self.units[section]

    def fraction(self) -> float:
        """Share of all declared units that is covered."""
        total = sum(self.units.values())
        return sum(self._count.get(s, 0) for s in self.units) / total if total else 0.0

    def entries(self) -> Iterator[tuple[int, int, int]]:
        """(section, block, bits) in order."""
        for name in sorted(self._blocks):
            yield name >> 8, name & 0xFF, self._blocks[name]

    def __len__(self) -> int:
        """The number of blocks with a covered unit."""
        return len(self._blocks)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Progress) and self._blocks == other._blocks

    # It is mutable, so it has no hash: `__eq__` without `__hash__` says so.

    @property
    def sums(self) -> Sums:
        """The progress' part of a replica's digest."""
        return self._sums

    @property
    def digest(self) -> int:
        """24 bits that two replicas with equal progress have in common."""
        return short(self._sums.total)

    def serialize(self) -> bytes:
        """8 bytes a block, in order."""
        return b"".join(
            ENTRY.pack(section, block, bits & 0xFFFFFFFF, bits >> 32)
            for section, block, bits in self.entries()
        )

    @classmethod
    def deserialize(cls, data: bytes, units: Mapping[int, int] | None = None) -> "Progress":
        """What `serialize` wrote, for sections of so many `units`. Raises ValueError if the bytes
        are no progress."""
        if len(data) % ENTRY.size:
            raise ValueError(f"progress does not have {len(data)} bytes")
        progress = cls(units)
        for section, block, low, high in ENTRY.iter_unpack(data):
            progress.apply(section, block, low | high << 32)
        return progress
