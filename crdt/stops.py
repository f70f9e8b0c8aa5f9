"""The stop set: which stops were pressed, and which of them an operator has cleared.

It is two sets of dots that only grow. The fleet is latched while any pressed dot is not cleared. A
reset clears exactly the dots that it names, so an old reset can never mask a new stop (an epoch
that is raised and cleared "up to" can: see `tests/models`).

At most `ACTIVE_MAX` pressed dots are held by name. Further ones are held together as one stop
without a name, `more`, which counts its presses. A reset that names the digest of everything held
clears that one too.
"""

from bisect import bisect_right
from collections.abc import Iterable
from struct import Struct
from typing import Any, Generic, NamedTuple, TypeVar

from crdt.digest import DIGEST_BITS, MASK, mix

ENTRY = Struct("<BBB")
FAR_ENTRY = Struct("<BBBH")
ACTIVE_MAX = 256  # held by name; more are held without a name. 256 of them fill a bus for 0.2 s
OWN_MAX = 64  # for one presser beyond that, because its own presses are always sent by name
MORE_FLAG = 0x8000  # in the count of a serialized set: more stops are held than are named
DOTS_MAX = 4096  # a season's presses; beyond this the oldest cleared dots are forgotten


class StopDot(NamedTuple):
    """One press. It is never reused; therefore the counter is durable before the dot is
    revealed."""

    slot: int
    incarnation: int  # low byte
    counter: int


class RemoteStopDot(NamedTuple):
    """One press in another segment of the fleet."""

    slot: int
    incarnation: int
    counter: int
    segment: int


D = TypeVar("D", StopDot, RemoteStopDot)
Self = TypeVar("Self", bound="DotSet[Any]")


class DotSet(Generic[D]):
    """Dots of one kind; `entry` is the byte layout of a dot."""

    entry: Struct
    kind: type[D]

    def __init__(self) -> None:
        self._pressed: dict[D, None] = {}
        self._cleared: dict[D, None] = {}
        # Pressed and not cleared. Stored separately as values, because both are needed with every
        # frame.
        self.active: frozenset[D] = frozenset()
        self.latched = False
        self.more = 0  # presses that are not held by name

    @property
    def cleared(self) -> frozenset[D]:
        """All dots that are known as cleared, also those whose press was never received."""
        return frozenset(self._cleared)

    @property
    def full(self) -> bool:
        """Whether the next dot would not be held by name."""
        return len(self.active) >= ACTIVE_MAX

    def press(self, dot: D) -> bool:
        """Join one press; True if it was new and is not cleared already. If the set is full, it is
        added to `more`."""
        new = dot not in self._pressed and dot not in self._cleared
        if new and self.full:
            self.press_more()
            return False
        self._pressed.setdefault(dot)
        if dot not in self._cleared:
            self._activate(self.active | {dot})
        self._trim()
        return new

    def press_more(self) -> None:
        """Count one press that is not held by name; the set is latched until `clear_all`."""
        self.more += 1
        self._activate(self.active)

    def clear_all(self) -> list[D]:
        """Clear everything held, with or without a name; returns the named dots."""
        dots, self.more = sorted(self.active), 0
        self._cleared.update(dict.fromkeys(dots))
        self._activate(frozenset())
        self._trim()
        return dots

    def digest(self) -> int:
        """64 bits of everything held; 0 if nothing is held."""
        size = self.entry.size  # so that dots of two kinds with equal numbers differ
        dots = (int.from_bytes(self.entry.pack(*dot), "little") for dot in self.active)
        total = sum(mix(dot << 8 | size) for dot in dots)
        return (total + (mix(self.more << 8) if self.more else 0)) & MASK

    def clear(self, dot: D) -> bool:
        """Join one clearance; True if it was new."""
        new = dot not in self._cleared
        self._cleared.setdefault(dot)
        self._activate(self.active - {dot})
        self._trim()
        return new

    def _activate(self, dots: frozenset[D]) -> None:
        self.active, self.latched = dots, bool(dots) or self.more > 0

    def is_cleared(self, dot: D) -> bool:
        """Whether an operator has cleared this dot, as far as it is remembered."""
        return dot in self._cleared

    def merge(self, other: "DotSet[D]") -> None:
        """Join a whole replica: the union of the pressed and of the cleared dots.

        It clears first. At the limit a press would else find no room that a clearance makes."""
        for dot in other._cleared:
            self.clear(dot)
        for dot in other._pressed:
            self.press(dot)
        if other.more > self.more:
            self.more = other.more
            self._activate(self.active)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, DotSet):
            return NotImplemented
        return (self._pressed.keys(), self._cleared.keys(), self.more > 0) == (
            other._pressed.keys(),
            other._cleared.keys(),
            other.more > 0,
        )

    # It is mutable, so it has no hash: `__eq__` without `__hash__` says so.

    def _trim(self) -> None:
        """Forget the oldest cleared dots; an active stop is never forgotten."""
        while len(self._cleared) > DOTS_MAX:
            dot = next(iter(self._cleared))
            del self._cleared[dot]
            self._pressed.pop(dot, None)

    def serialize(self) -> bytes:
        """The number of pressed dots (u15, and a bit for `more`), then pressed and cleared dots of
        one entry each, sorted."""
        dots = [*sorted(self._pressed), *sorted(self._cleared)]
        count = (len(self._pressed) | (MORE_FLAG if self.more else 0)).to_bytes(2, "little")
        return count + b"".join(self.entry.pack(*dot) for dot in dots)

    @classmethod
    def deserialize(cls: type[Self], data: bytes) -> Self:
        """The set that `serialize` wrote. Raises ValueError if the bytes are none; the caller must
        then stay stopped."""
        if len(data) < 2 or (len(data) - 2) % cls.entry.size:
            raise ValueError("not a stop set")
        dots = [cls.kind(*fields) for fields in cls.entry.iter_unpack(data[2:])]
        head = int.from_bytes(data[:2], "little")
        count = head & ~MORE_FLAG
        if count > len(dots):
            raise ValueError("not a stop set")
        stops = cls()
        for dot in dots[count:]:
            stops.clear(dot)
        for dot in dots[:count]:
            stops.press(dot)
        if head & MORE_FLAG:
            stops.press_more()
        return stops


def next_in_rotation(dots: Iterable[D], after: D | None, count: int) -> list[D]:
    """The next dots after `after`, in cyclic order. So a sender that can send only some at a time
    reaches all of them."""
    row = sorted(dots)
    k = 0 if after is None else bisect_right(row, after)
    return (row[k:] + row[:k])[:count]


class StopSet(DotSet[StopDot]):
    """The stops of this segment."""

    entry, kind = ENTRY, StopDot

    def press_own(self, dot: StopDot) -> None:
        """A press at this machine, held by name; beyond the limit, the oldest own one moves to
        `more`."""
        self._pressed.setdefault(dot)
        own = [held for held in self._pressed if held.slot == dot.slot and held in self.active]
        if len(own) >= OWN_MAX:
            del self._pressed[own[0]]
            self._activate(self.active - {own[0]})
            self.press_more()
        self._activate(self.active | {dot})
        self._trim()

    def unused(self, slot: int, incarnation: int, counter: int) -> tuple[StopDot, int]:
        """The next dot after `counter` that was never pressed or cleared, and its counter.

        After 256 cleared presses, dots of the next incarnations are used. There is always a free
        one, because fewer dots are remembered than exist.
        """
        for ahead in range((DOTS_MAX + ACTIVE_MAX + OWN_MAX) // 256 + 1):
            for _ in range(256):
                counter += 1
                dot = StopDot(slot, incarnation + ahead & 0xFF, counter & 0xFF)
                if not (self.is_cleared(dot) or dot in self._pressed):
                    return dot, counter
        raise AssertionError("more dots are remembered than may be")


class RemoteStopSet(DotSet[RemoteStopDot]):
    """The stops of all other segments."""

    entry, kind = FAR_ENTRY, RemoteStopDot


def held_digest(near: StopSet, far: RemoteStopSet) -> int:
    """24 bits of everything that a robot holds; 0 if it holds nothing."""
    return (near.digest() + far.digest() & MASK) >> 64 - DIGEST_BITS
