"""Which sections concern a segment: its own, and those at the border that neighbours share with it.

Every section belongs to one segment, its home, and only the home decides about it. A home lends
sections at its border to neighbours. These keep a copy under their own number and may request the
section; the copy follows the decisions of the home. So the state of a robot is bounded by its area
and its borders and does not grow with the fleet. An owner in a register is one byte. So all robots
of a neighbour appear under one number, that of the neighbour.
"""

from collections.abc import Mapping
from typing import NamedTuple

GUEST_FIRST = 108  # owners of other segments in registers; slots of robots are below
NEIGHBOURS_MAX = 16  # owner numbers from `GUEST_FIRST` up to the numbers of gateways


class SegmentPlace(NamedTuple):
    """A section of the whole fleet: its home segment, and its number there."""

    segment: int
    section: int


class Area:
    """The sections of one segment, and with which neighbours it shares some of them."""

    def __init__(
        self,
        segment: int,
        home: int,
        lent: Mapping[int, frozenset[int]] | None = None,
        borrowed: Mapping[int, SegmentPlace] | None = None,
    ) -> None:
        """`home`: sections 0 to home - 1 are this segment's. `lent`: home section -> neighbours
        that share it. `borrowed`: section number here, from `home` on -> place in its home segment.
        """
        self.segment, self.home = segment, home
        self.lent, self.borrowed = dict(lent or {}), dict(borrowed or {})
        assert all(0 <= section < home for section in self.lent)
        assert all(section >= home for section in self.borrowed), "numbers of copies are above"
        assert all(place.segment != segment for place in self.borrowed.values())
        # Segments that share a section with this one, sorted.
        beside = {place.segment for place in self.borrowed.values()}
        self.neighbours: tuple[int, ...] = tuple(sorted(beside.union(*self.lent.values())))
        assert len(self.neighbours) <= NEIGHBOURS_MAX, "a register cannot name more neighbours"
        # The number here of every section that is lent or borrowed, by its place.
        self.number_of = {place: section for section, place in self.borrowed.items()}
        self.number_of |= {SegmentPlace(segment, section): section for section in self.lent}

    def place_of(self, section: int) -> SegmentPlace:
        """The home segment of a section of ours, and its number there."""
        return self.borrowed.get(section, SegmentPlace(self.segment, section))

    def shared_with(self, neighbour: int) -> list[int]:
        """Numbers here of all sections that we and this neighbour both hold."""
        lent = [s for s, segments in self.lent.items() if neighbour in segments]
        borrowed = [s for s, place in self.borrowed.items() if place.segment == neighbour]
        return sorted(lent + borrowed)

    def concerned(self, section: int) -> tuple[int, ...]:
        """The neighbours that must receive changes of this section."""
        place = self.borrowed.get(section)
        return tuple(sorted(self.lent.get(section, ()))) if place is None else (place.segment,)

    def guest(self, segment: int) -> int:
        """The owner number for all robots of a neighbour in registers here. Raises ValueError for a
        segment that is no neighbour.
        """
        return GUEST_FIRST + self.neighbours.index(segment)

    def segment_of(self, owner: int) -> int:
        """The segment of an owner in a register here; 0 if it is unknown."""
        if owner < GUEST_FIRST:
            return self.segment
        index = owner - GUEST_FIRST
        return self.neighbours[index] if index < len(self.neighbours) else 0
