"""The fleet's map of obstacles that pass. Its clock has no end.

A record has 13 bits of time: 2 h 17 min, one lap of the clock. In the first lap this map is an
`OccupancyMap` of the order LATEST_UPDATE, bit for bit. Only cells that are certain are told, so the
level of confidence says nothing. It counts laps instead: 0 in the first one, and after that 1 to 15
again and again. So a robot that has just booted learns from the first record in which lap its fleet
is, and what it has said before that is old for all.

Keys hold the full time, in seconds since the first lap began. A join is the maximum of keys, and
then records older than the lap before the newest record are dropped. What is dropped depends on the
records alone and on no clock, so robots that have received the same have equal maps. Digests are made
from what is on the wire, so robots that count 15 laps more or less agree.

The price: records of later laps are not recalled after a restart, because their age is not known;
other robots have them. If no robot tells anything for three laps (7 h), a record of before that, told
again, counts as new: clocks jump ahead, and its place is avoided until its time of belief is over.
"""

import numpy as np

from crdt.occupancy import Geometry, Keys, OccupancyMap
from crdt.sighting import OBSERVER_MAX, RECORD_BITS, TIME_MAX, MergeOrder, unpack

LAP_S = TIME_MAX + 1
LAPS = 15  # after the first one
# A lap that is up to this many before ours is over; all others are ahead. Records are younger than two.
LAPS_BEHIND = 3
FIRST_LEVEL = 13  # on the wire in the first lap: the level of certain cells
LEVEL_BITS = 4
TIME_BITS = 13
LAST_TIME = (1 << 36) - 1  # a thousand years; with the record it fits into 63 bits
LAST_LAP = LAST_TIME // LAP_S


def code_of(lap: int) -> int:
    """A lap as records count it, 0 to 15.

    >>> [code_of(lap) for lap in (0, 1, 15, 16, 31)]
    [0, 1, 15, 1, 1]
    """
    return 0 if lap == 0 else (lap - 1) % LAPS + 1


def lap_of(code: int, own: int) -> int:
    """The lap with that code, for a clock in the lap `own`.

    >>> lap_of(0, 9), lap_of(9, 0), lap_of(8, 9), lap_of(10, 9), lap_of(15, 16), lap_of(15, 1)
    (0, 9, 8, 10, 15, 15)
    """
    if code == 0 or own == 0:
        return code
    ahead = (code - own) % LAPS
    if ahead >= LAPS - LAPS_BEHIND and own + ahead - LAPS > 0:
        ahead -= LAPS
    return own + ahead


class PassingMap(OccupancyMap):
    """The replicated map of obstacles of one robot. Times are full seconds of the fleet's clock."""

    def __init__(self, geometry: Geometry) -> None:
        super().__init__(geometry, MergeOrder.LATEST_UPDATE)
        self._lap = 0  # of the newest record

    def base(self, level: int, time: int, observer: int) -> int:
        """The key of a record without its value, as `crdt.sighting.base`; `level` is not used."""
        assert 0 <= time <= LAST_TIME and 0 <= observer <= OBSERVER_MAX
        level, stamp = self.stamp(level, time)
        return time << RECORD_BITS | stamp << 11 | level << 7 | observer << 2

    def stamp(self, level: int, time: int) -> tuple[int, int]:
        """A full time as the wire has it: level and seconds of the lap."""
        lap, stamp = divmod(time, LAP_S)
        return (FIRST_LEVEL + code_of(lap)) % (1 << LEVEL_BITS), stamp

    def time_of(self, level: int, stamp: int, now: int) -> int:
        """The full time, in seconds, of a level and a `stamp` in seconds of its lap. `now`: what our
        clock shows."""
        code = (level - FIRST_LEVEL) % (1 << LEVEL_BITS)
        lap = lap_of(code, now // LAP_S)
        # Each record of a broken or hostile device can move all clocks by eleven laps. None follows the
        # last lap, so such a record is of an old one.
        return (lap if lap <= LAST_LAP else lap - LAPS) * LAP_S + stamp

    def join(self, patch: int, keys: Keys) -> int:
        """Join the 16 `keys` of one patch, shape (16,), as in any map, but none older than the lap
        before the newest one; returns the number of changed cells."""
        changed = super().join(patch, np.where(keys >= self._floor, keys, 0))
        if changed:
            newest = int(self._keys[patch].max()) >> RECORD_BITS + TIME_BITS
            if newest > self._lap:
                self._lap = newest
                self._drop()
        return changed

    @property
    def _floor(self) -> int:
        return max(self._lap - 1, 0) << RECORD_BITS + TIME_BITS

    def _drop(self) -> None:
        old = (self._keys > 0) & (self._keys < self._floor)
        if old.any():
            self._keys[old] = 0
            self._stale.update(np.flatnonzero(old.any(axis=1)).tolist())
            self.version += 1

    def _on_wire(self, keys: Keys) -> Keys:
        laps = keys >> RECORD_BITS + TIME_BITS
        codes = np.where(laps > 0, (laps - 1) % LAPS + 1, 0)
        found: Keys = keys + (codes - laps << RECORD_BITS + TIME_BITS)
        return found

    def _key(self, record: int) -> int:
        value, level, time, observer = unpack(record)
        return self.base(level, time, observer) | value if level == FIRST_LEVEL else 0
