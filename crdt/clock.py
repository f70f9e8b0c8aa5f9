"""Dots and vector clocks: which events of which replica have been seen.

A `VectorClock` here is a mutable value owned by one peer: a member updates it at heartbeat rate, and
copying 108 entries each time would be the most expensive thing it does. `copy()` and `frozen()`
give values that do not change.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple


class Dot(NamedTuple):
    """The counter-th event of one replica. A dot names one event for ever; it is never reused."""

    replica: int
    counter: int


class VectorClock:
    """How many events of each replica have been seen; replicas never heard of count as 0.

    >>> a, b = VectorClock({1: 2}), VectorClock({1: 1, 2: 1})
    >>> a.concurrent_with(b), a.happens_before(a.merged(b))
    (True, True)
    """

    __slots__ = ("_counts",)

    def __init__(self, counts: Mapping[int, int] | None = None) -> None:
        self._counts: dict[int, int] = {}
        for replica, count in (counts or {}).items():
            assert count >= 0
            if count:
                self._counts[replica] = count

    def __getitem__(self, replica: int) -> int:
        return self._counts.get(replica, 0)

    def __iter__(self) -> Iterator[int]:
        return iter(sorted(self._counts))

    def __len__(self) -> int:
        return len(self._counts)

    def increment(self, replica: int) -> Dot:
        """Count one more own event, and name it."""
        counter = self._counts.get(replica, 0) + 1
        self._counts[replica] = counter
        return Dot(replica, counter)

    def witness(self, replica: int, low: int, bits: int = 16) -> None:
        """Learn a counter of which only the low bits travelled: the nearest value not below ours.

        Right as long as fewer than 2**bits events were missed; at one operation a second a 16-bit
        counter allows 18 hours of silence.
        """
        known, modulus = self._counts.get(replica, 0), 1 << bits
        ahead = (low - known) % modulus
        if 0 < ahead < modulus // 2 or (known == 0 and low):
            self._counts[replica] = known + ahead

    def merge(self, other: "VectorClock") -> None:
        """Join in place: the maximum of each component."""
        counts = self._counts
        for replica, count in other._counts.items():
            if count > counts.get(replica, 0):
                counts[replica] = count

    def merged(self, other: "VectorClock") -> "VectorClock":
        result = self.copy()
        result.merge(other)
        return result

    def covers(self, dot: Dot) -> bool:
        return dot.counter <= self[dot.replica]

    def __le__(self, other: "VectorClock") -> bool:
        counts = other._counts
        return all(count <= counts.get(replica, 0) for replica, count in self._counts.items())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, VectorClock) and self._counts == other._counts

    __hash__ = None  # type: ignore[assignment]  # mutable

    def happens_before(self, other: "VectorClock") -> bool:
        return self <= other and self != other

    def concurrent_with(self, other: "VectorClock") -> bool:
        """Neither is before the other, and they are not the same."""
        return not self <= other and not other <= self

    def copy(self) -> "VectorClock":
        return VectorClock(self._counts)

    def to_dict(self) -> dict[int, int]:
        return {replica: self._counts[replica] for replica in self}

    @classmethod
    def from_dict(cls, counts: Mapping[int, int]) -> "VectorClock":
        return cls(counts)

    def __repr__(self) -> str:
        return f"VectorClock({self.to_dict()})"
