"""Which robots know of worked units, seen from outside.

A robot knows what was told while it was up, and what its disk has. S24 (`sim/world/repeated_work.py`)
needs it: a unit that every robot forgot may be worked once more, and so may any unit while robots
cannot hear each other.
"""

from collections.abc import Container, Iterable, Iterator, Mapping

from crdt.progress import BLOCK_UNITS
from sim.world.repeated_work import Unit


def units_of(blocks: Mapping[tuple[int, int], int]) -> Iterator[Unit]:
    """The units of these blocks, (section, block) -> bits of its units."""
    for (section, block), bits in blocks.items():
        yield from (
            (section, block * BLOCK_UNITS + k) for k in range(bits.bit_length()) if bits >> k & 1
        )


class UnitKnowledge:
    """The units that were told in one run, and the robots that know each of them."""

    def __init__(self, exchanged_for_us: int) -> None:
        """`exchanged_for_us`: this long after a trouble all robots know again what one of them knows."""
        self.exchanged_for_us = exchanged_for_us
        self._told_at_us: dict[Unit, int] = {}  # when each unit was told first, to a second
        self._knowing: dict[Unit, set[int]] = {}
        self._apart: list[tuple[int, int]] = []  # begins and ends of troubles of links and members

    def told(self, by: Mapping[int, Iterable[Unit]], now_us: int) -> None:
        """Robots that are up, and the units that each of them has told as its own until now.

        All of them know a new one, or those alone that tell it, while some may not hear the others."""
        apart = self.is_apart(now_us)
        for slot, units in by.items():
            for unit in units:
                if unit not in self._told_at_us:
                    self._told_at_us[unit], self._knowing[unit] = now_us, set(() if apart else by)
                    self._knowing[unit].add(slot)

    def forgets(self, slot: int, but: Container[Unit] = ()) -> None:
        """It is off, or boots with another memory, and knows only the units `but`."""
        for unit, knowing in self._knowing.items():
            if unit not in but:
                knowing.discard(slot)

    def exchanged(self, up: Iterable[int], now_us: int) -> None:
        """A trouble has been over for long enough: unless there is another one, all robots that are `up`
        know what one of them knows."""
        if self.is_apart(now_us):
            return
        for knowing in self._knowing.values():
            if knowing:
                knowing.update(up)

    def parts(self, now_us: int, end_at_us: int) -> int:
        """Robots may be unable to hear each other until then. Returns when they have exchanged what they
        know after it."""
        exchanged_at_us = max(now_us, end_at_us) + self.exchanged_for_us
        self._apart.append((now_us, exchanged_at_us))
        return exchanged_at_us

    @property
    def known_at_us(self) -> Mapping[Unit, int]:
        """When each unit was told first that a robot still knows."""
        return {unit: at_us for unit, at_us in self._told_at_us.items() if self._knowing[unit]}

    def is_apart(self, at_us: int) -> bool:
        """Whether some robots may not know then what others know."""
        return any(begin_at_us <= at_us < end_at_us for begin_at_us, end_at_us in self._apart)
