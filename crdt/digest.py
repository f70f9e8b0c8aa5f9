"""Digests of replicated state: order-independent, kept up to date entry by entry.

An entry (kind, name, value) is mixed to 64 bits with splitmix64's finaliser (Steele, Lea, Flood
2014) and added modulo 2^64 to the sum of its bucket. The transmitted digest is the top 24 bits of
the sum of all buckets. Sums are used and not XOR: both are incremental, but an entry that is
wrongly counted twice cancels in an XOR and shows in a sum. Two different states agree in 24 bits
once in 17 million. The next change of either state gives new digests, so a collision hides a
difference only while nothing changes.
"""

from collections.abc import Mapping
from functools import lru_cache

MASK = (1 << 64) - 1
DIGEST_BITS = 24
BUCKETS = 32  # of the fall-back sync; sent in 11 frames of three digests
# Cached hashes, of each kind: 50 kB in all. Peers in one process hash the same few changes within a
# second; the busiest fleet makes 50 changes a second. A robot alone hashes each change once: its
# caches are full in minutes, and a larger one fills for half an hour.
HASHES_MAX = 1 << 7


def mix(number: int) -> int:
    """A 64-bit number spread over 64 bits."""
    number = (number + 0x9E3779B97F4A7C15) & MASK
    number = ((number ^ number >> 30) * 0xBF58476D1CE4E5B9) & MASK
    number = ((number ^ number >> 27) * 0x94D049BB133111EB) & MASK
    return number ^ number >> 31


@lru_cache(maxsize=HASHES_MAX)
def place(kind: int, name: int) -> int:
    """A 64-bit hash of a name; `kind` separates the collections."""
    return mix(kind << 32 | name)


@lru_cache(maxsize=HASHES_MAX)
def entry_hash(kind: int, name: int, value: int) -> int:
    """The hash of one entry. Values wider than 64 bits would be cut; registers have 49, blocks
    40."""
    return mix(place(kind, name) ^ value)


@lru_cache(maxsize=HASHES_MAX)
def change_of(kind: int, name: int, before: int | None, value: int | None) -> tuple[int, int]:
    """(bucket, value to add to its sum) for a change of an entry from `before` to `value`.

    `before` is None for an entry that is new, `value` for one that is taken out. The addend is
    modulo 2^64.
    """
    change = 0 if value is None else entry_hash(kind, name, value)
    if before is not None:
        change -= entry_hash(kind, name, before)
    return bucket_of(kind, name), change & MASK


def bucket_of(kind: int, name: int) -> int:
    """The bucket of an entry, 0 to `BUCKETS` - 1. It depends on the name alone, not on the value."""
    return place(kind, name) % BUCKETS


def short(total: int) -> int:
    """The 24 bits that are transmitted."""
    return (total & MASK) >> (64 - DIGEST_BITS)


class Sums:
    """The sums of one collection, one a bucket. Reads the collection; never changes it."""

    __slots__ = ("_before", "_sums", "_total", "_values", "kind")

    def __init__(self, kind: int, values: Mapping[int, int]) -> None:
        self.kind, self._values = kind, values
        self._sums = [0] * BUCKETS
        self._total = 0  # of all buckets
        self._before: dict[int, int | None] = {}  # name -> the value that is still in the sums

    def changing(self, name: int, before: int | None) -> None:
        """An entry is about to change from the value `before` (None: it is new). It is hashed only
        when a sum is needed."""
        self._before.setdefault(name, before)

    def changing_all(self, before: Mapping[int, int | None]) -> None:
        """Many entries are about to change; `before` maps their names to their values, None for new
        ones."""
        self._before = {**before, **self._before}

    def buckets(self) -> list[int]:
        """The sum of each bucket, modulo 2^64, after hashing what has changed. The live list: it
        must not be changed."""
        if self._before:
            kind, sums = self.kind, self._sums
            for name, before in self._before.items():
                bucket, change = change_of(kind, name, before, self._values.get(name))
                sums[bucket] = (sums[bucket] + change) & MASK
                self._total = (self._total + change) & MASK
            self._before.clear()
        return self._sums

    @property
    def total(self) -> int:
        """The sum of all buckets, modulo 2^64, with every change so far."""
        self.buckets()
        return self._total
