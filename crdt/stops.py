"""The stop set: which stops were pressed, and which of them an operator has cleared.

Two grow-only sets of dots. The fleet is latched while any pressed dot is not cleared. A reset clears
the dots that it names and no other, so an old reset can never mask a new stop (an epoch that is
raised and cleared "up to" can: see `tests/models`).
"""

from bisect import bisect_right
from collections.abc import Iterable
from struct import Struct
from typing import Any, Generic, NamedTuple, TypeVar

ENTRY = Struct("<BBB")
FAR_ENTRY = Struct("<BBBH")
DOTS_MAX = 4096  # a season's presses; beyond it cleared dots are forgotten oldest first


class StopDot(NamedTuple):
    """One press: never reused, which is why the counter is durable before the dot is revealed."""

    slot: int
    incarnation: int  # low byte
    counter: int


class FarDot(NamedTuple):
    """One press in another segment of the fleet."""

    slot: int
    incarnation: int
    counter: int
    segment: int


D = TypeVar("D", StopDot, FarDot)
Self = TypeVar("Self", bound="DotSet[Any]")


class DotSet(Generic[D]):
    """Dots of one kind; `entry` is how one is laid out in bytes."""

    entry: Struct
    kind: type[D]

    def __init__(self) -> None:
        self._pressed: dict[D, None] = {}
        self._cleared: dict[D, None] = {}
        # Pressed and not cleared. Kept beside them, as values: both are asked for with every frame.
        self.active: frozenset[D] = frozenset()
        self.latched = False

    @property
    def cleared(self) -> frozenset[D]:
        return frozenset(self._cleared)

    def press(self, dot: D) -> bool:
        """Join one press; True where it was new and is not cleared already."""
        new = dot not in self._pressed and dot not in self._cleared
        self._pressed.setdefault(dot)
        if dot not in self._cleared:
            self._activate(self.active | {dot})
        self._trim()
        return new

    def clear(self, dot: D) -> bool:
        """Join one clearance; True where it was new."""
        new = dot not in self._cleared
        self._cleared.setdefault(dot)
        self._activate(self.active - {dot})
        self._trim()
        return new

    def _activate(self, dots: frozenset[D]) -> None:
        self.active, self.latched = dots, bool(dots)

    def is_cleared(self, dot: D) -> bool:
        return dot in self._cleared

    def merge(self, other: "DotSet[D]") -> None:
        for dot in other._pressed:
            self.press(dot)
        for dot in other._cleared:
            self.clear(dot)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, DotSet):
            return NotImplemented
        return (self._pressed.keys(), self._cleared.keys()) == (
            other._pressed.keys(),
            other._cleared.keys(),
        )

    __hash__ = None  # type: ignore[assignment]  # mutable

    def _trim(self) -> None:
        """Forget the oldest finished business; an active stop is never forgotten."""
        while len(self._cleared) > DOTS_MAX:
            dot = next(iter(self._cleared))
            del self._cleared[dot]
            self._pressed.pop(dot, None)

    def serialize(self) -> bytes:
        """Count of pressed (u16), then pressed and cleared dots of one entry each, sorted."""
        dots = [*sorted(self._pressed), *sorted(self._cleared)]
        count = len(self._pressed).to_bytes(2, "little")
        return count + b"".join(self.entry.pack(*dot) for dot in dots)

    @classmethod
    def deserialize(cls: type[Self], data: bytes) -> Self:
        """ValueError where the bytes are not a stop set: the caller must then stay stopped."""
        if len(data) < 2 or (len(data) - 2) % cls.entry.size:
            raise ValueError("not a stop set")
        dots = [cls.kind(*fields) for fields in cls.entry.iter_unpack(data[2:])]
        count = int.from_bytes(data[:2], "little")
        if count > len(dots):
            raise ValueError("not a stop set")
        stops = cls()
        for dot in dots[:count]:
            stops.press(dot)
        for dot in dots[count:]:
            stops.clear(dot)
        return stops


def turn(dots: Iterable[D], after: D | None, count: int) -> list[D]:
    """The next ones behind that one, in their order and round again: who can say only some at a time
    gets to all of them."""
    row = sorted(dots)
    k = 0 if after is None else bisect_right(row, after)
    return (row[k:] + row[:k])[:count]


class StopSet(DotSet[StopDot]):
    """Of this segment."""

    entry, kind = ENTRY, StopDot

    def unused(self, slot: int, incarnation: int, counter: int) -> tuple[StopDot, int]:
        """The next dot after `counter` that nobody has pressed or cleared, and the counter then.

        After 256 cleared presses the dots of the next incarnations are taken: as many as are ever
        remembered are fewer than there are.
        """
        for ahead in range(DOTS_MAX // 256 + 1):
            for _ in range(256):
                counter += 1
                dot = StopDot(slot, incarnation + ahead & 0xFF, counter & 0xFF)
                if not (self.is_cleared(dot) or dot in self._pressed):
                    return dot, counter
        raise AssertionError("more dots are remembered than may be")


class FarStopSet(DotSet[FarDot]):
    """Of all other segments."""

    entry, kind = FAR_ENTRY, FarDot
