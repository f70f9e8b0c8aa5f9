"""One robot's observation of one cell, as a whole record, and the order in which records replace
others.

The parts of two records are never mixed: a join takes one of them as it is. A key is `rank << 24 |
record`, and the join of two keys is the greater integer. The record is part of the key, so the
order is total and two different records never tie. The rank depends on the configured order:

    MAX_CONFIDENCE  the confidence, then the later
    LATEST_UPDATE   the later, then the confidence
    DECAYED         ln(confidence) + rate * time

DECAYED contains both. If every confidence fades as c * exp(-rate * age) with one rate, the order of
two faded confidences is the same at every later time. So comparing the rank once compares the faded
confidences forever. A rate towards 0 gives MAX_CONFIDENCE, a large one LATEST_UPDATE. 0.05 a second
is the mission's factor 0.995 ten times a second, to 0.02 %: after 14 s, a certain cell loses to a
new observation of half its confidence.
"""

from enum import Enum
from math import log
from typing import NamedTuple

UNKNOWN, FREE, OBSTACLE = range(3)  # of a cell
LEVELS = 16  # of confidence: level k is (k + 1) / 16
# Seconds: two and a quarter hours of one exploration; after that, later is not newer. A map of
# obstacles that pass goes on (`crdt/passing_map.py`).
TIME_MAX = (1 << 13) - 1
OBSERVER_MAX = (1 << 5) - 1  # slots 0 to 31
RECORD_BITS = 24
RECORD_MASK = (1 << RECORD_BITS) - 1
VALUE = 3  # the bits of a key that are the value
# Factor for the confidence when another robot reads it; never stored, so never compounded.
SECOND_HAND = 0.8
RATE = 50  # of DECAYED, in thousandths a second
# Of confidence, from level 0 up; rounded once.
_LOGS = [round(1000 * log(k + 1)) for k in range(LEVELS)]


class MergeOrder(Enum):
    """Which of two records of one cell is kept; see the top of this module."""

    MAX_CONFIDENCE = "max_confidence"
    LATEST_UPDATE = "latest_update"
    DECAYED = "decayed"


class CellObservation(NamedTuple):
    """The fields of one record. No record has the value UNKNOWN."""

    value: int
    level: int  # of confidence
    time: int  # seconds of the fleet's clock
    observer: int  # slot

    def confidence(self, reader: int) -> float:
        """The confidence, 0 to 1, for the slot `reader`: another robot's observation counts for
        less."""
        own = (self.level + 1) / LEVELS
        return own if reader == self.observer else own * SECOND_HAND


def base(order: MergeOrder, level: int, time: int, observer: int) -> int:
    """The key of a record without its value, which is in the lowest two bits."""
    assert 0 <= level < LEVELS and 0 <= time <= TIME_MAX and 0 <= observer <= OBSERVER_MAX
    if order is MergeOrder.MAX_CONFIDENCE:
        rank = level
    elif order is MergeOrder.LATEST_UPDATE:
        rank = time
    else:
        rank = _LOGS[level] + RATE * time
    return rank << RECORD_BITS | time << 11 | level << 7 | observer << 2


def pack(order: MergeOrder, sighting: CellObservation) -> int:
    """The key of a record: greater keys replace smaller ones, whole."""
    assert sighting.value in (FREE, OBSTACLE)
    return base(order, sighting.level, sighting.time, sighting.observer) | sighting.value


def unpack(key: int) -> CellObservation:
    """The fields of a key or of its record alone."""
    assert key > 0
    return CellObservation(
        key & VALUE, key >> 7 & 15, key >> 11 & TIME_MAX, key >> 2 & OBSERVER_MAX
    )


def level_of(confidence: float) -> int:
    """The level nearest to a confidence of 0 to 1."""
    return min(max(round(confidence * LEVELS) - 1, 0), LEVELS - 1)
