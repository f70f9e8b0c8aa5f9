"""The stop set: which stops were pressed, and which of them an operator has cleared.

Two grow-only sets of dots. The fleet is latched while any pressed dot is not cleared. A reset clears
the dots that it names and no other, so an old reset can never mask a new stop (an epoch that is
raised and cleared "up to" can: see `tests/models`).
"""

from collections.abc import Iterable
from struct import Struct
from typing import NamedTuple

ENTRY = Struct("<BBB")
DOTS_MAX = 4096  # a season's presses; beyond it cleared dots are forgotten oldest first


class StopDot(NamedTuple):
    """One press: never reused, which is why the counter is durable before the dot is revealed."""

    slot: int
    incarnation: int  # low byte
    counter: int


class StopSet:
    def __init__(self) -> None:
        self._pressed: dict[StopDot, None] = {}
        self._cleared: dict[StopDot, None] = {}

    @property
    def latched(self) -> bool:
        return bool(self.active)

    @property
    def active(self) -> frozenset[StopDot]:
        """Pressed and not cleared."""
        return frozenset(self._pressed.keys() - self._cleared.keys())

    def press(self, dot: StopDot) -> bool:
        """Join one press; True where it was new and is not cleared already."""
        new = dot not in self._pressed and dot not in self._cleared
        self._pressed.setdefault(dot)
        self._trim()
        return new

    def clear(self, dot: StopDot) -> bool:
        """Join one clearance; True where it was new."""
        new = dot not in self._cleared
        self._cleared.setdefault(dot)
        self._trim()
        return new

    def is_cleared(self, dot: StopDot) -> bool:
        return dot in self._cleared

    def merge(self, other: "StopSet") -> None:
        for dot in other._pressed:
            self.press(dot)
        for dot in other._cleared:
            self.clear(dot)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, StopSet):
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
        """Count of pressed (u16), then pressed and cleared dots of 3 bytes, sorted."""
        pressed, cleared = sorted(self._pressed), sorted(self._cleared)
        dots = [ENTRY.pack(*dot) for dot in (*pressed, *cleared)]
        return len(pressed).to_bytes(2, "little") + b"".join(dots)

    @classmethod
    def deserialize(cls, data: bytes) -> "StopSet":
        """ValueError where the bytes are not a stop set: the caller must then stay stopped."""
        if len(data) < 2 or (len(data) - 2) % ENTRY.size:
            raise ValueError("not a stop set")
        dots = [StopDot(*fields) for fields in ENTRY.iter_unpack(data[2:])]
        pressed = int.from_bytes(data[:2], "little")
        if pressed > len(dots):
            raise ValueError("not a stop set")
        stops = cls()
        _fill(stops, dots[:pressed], dots[pressed:])
        return stops


def _fill(stops: StopSet, pressed: Iterable[StopDot], cleared: Iterable[StopDot]) -> None:
    for dot in pressed:
        stops.press(dot)
    for dot in cleared:
        stops.clear(dot)
