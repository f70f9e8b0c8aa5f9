"""Dots and vector clocks: which events of which replica have been seen.

A `VectorClock` is mutable and owned by one peer. With 108 members it is updated at a hundred
heartbeats a second, and an immutable one would copy 108 entries each time. `copy()` gives an
independent one; no dictionary that is passed in or out is shared with the clock.

A component is never removed. A clock without it would forget which events it covers, and a replica
that came back would number its events from 1 again: two events with one dot. A replica that leaves
forever is retired instead: it keeps its last count and gets no further dot.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple


class Dot(NamedTuple):
    """The counter-th event of one replica. A dot names one event forever; it is never reused."""

    replica: int
    counter: int


class VectorClock:
    """How many events of each replica have been seen; unknown replicas count as 0.

    >>> a, b = VectorClock({1: 2}), VectorClock({1: 1, 2: 1})
    >>> a.concurrent_with(b), a.happens_before(a.merged(b))
    (True, True)
    """

    __slots__ = ("_counts", "_retired")

    def __init__(self, counts: Mapping[int, int] | None = None) -> None:
        self._counts: dict[int, int] = {}
        self._retired: set[int] = set()  # local knowledge, not part of the clock's value
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
        """Count one more own event, and return its dot."""
        assert replica not in self._retired, "a retired replica writes under a new identity"
        counter = self._counts.get(replica, 0) + 1
        self._counts[replica] = counter
        return Dot(replica, counter)

    def retire(self, replica: int) -> None:
        """The replica gives no more events: keep its count, and number no event after it."""
        self._retired.add(replica)

    def witness(self, replica: int, low: int, bits: int = 16) -> None:
        """Learn a counter of which only the low bits travelled: the nearest value not below ours.

        Right as long as fewer than 2**bits events were missed; at one operation a second a 16-bit
        counter allows 18 hours of silence.
        """
        assert 0 <= low < 1 << bits
        known, modulus = self._counts.get(replica, 0), 1 << bits
        ahead = (low - known) % modulus
        if 0 < ahead < modulus // 2 or (known == 0 and low):
            self._counts[replica] = known + ahead

    def settle(self, replica: int, low: int) -> None:
        """Learn a counter from the replica itself, of which the low 16 bits travelled: the nearest value.

        It may be below ours. Fewer bits that another replica told can have moved ours too far.
        """
        assert 0 <= low < 1 << 16
        known = self._counts.get(replica, 0)
        ahead = (low - known) % (1 << 16)
        back = (1 << 16) - ahead
        count = known - back if back < ahead and back <= known else known + ahead
        if count:
            self._counts[replica] = count
        else:
            self._counts.pop(replica, None)

    def merge(self, other: "VectorClock") -> None:
        """Join in place: the maximum of each component."""
        counts = self._counts
        for replica, count in other._counts.items():
            if count > counts.get(replica, 0):
                counts[replica] = count

    def merged(self, other: "VectorClock") -> "VectorClock":
        """The join of both clocks as a new one; neither is changed."""
        result = self.copy()
        result.merge(other)
        return result

    def covers(self, dot: Dot) -> bool:
        """Whether the event of a dot has been seen."""
        return dot.counter <= self[dot.replica]

    def __le__(self, other: "VectorClock") -> bool:
        counts = other._counts
        return all(count <= counts.get(replica, 0) for replica, count in self._counts.items())

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, VectorClock):
            return NotImplemented
        return self._counts == other._counts

    # It is mutable, so it has no hash: `__eq__` without `__hash__` says so.

    def happens_before(self, other: "VectorClock") -> bool:
        """Whether the other clock has seen all that this one has, and more."""
        return self <= other and self != other

    def concurrent_with(self, other: "VectorClock") -> bool:
        """Whether neither is before the other, and they are not equal."""
        return not self <= other and not other <= self

    def copy(self) -> "VectorClock":
        """An independent clock with the same counts and the same retired replicas."""
        clock = VectorClock(self._counts)
        clock._retired = set(self._retired)
        return clock

    def to_dict(self) -> dict[int, int]:
        """A new dictionary, replica to number of its events, in order of replicas."""
        return {replica: self._counts[replica] for replica in self}

    def __repr__(self) -> str:
        return f"VectorClock({self.to_dict()})"
