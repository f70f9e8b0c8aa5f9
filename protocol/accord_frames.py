"""The frame by which robots in each other's way agree on who goes where, see `agent/accord.py`."""

from enum import IntEnum
from struct import Struct
from typing import NamedTuple

ACCORD = Struct("<HBHHB")
assert ACCORD.size == 8


class Say(IntEnum):
    """What an ACCORD frame says; a robot says each at most one way in one round."""

    PLACE = 0  # I stand at node `first` and want to node `second`; `detail`: where in the node
    PLAN = 1  # the digest of the plan that I computed: `first` low, `second` high half
    AT = 2  # I have reached the `first`-th node of my route, counted from 1; 0: not yet on it


class Answer(IntEnum):
    """With PLACE: whether this robot clears the way when it is asked to."""

    GRANT = 0
    STOPPED = 1  # refused: an emergency stop, a hold, a fault: it does not move
    BUSY = 2  # refused: it is in the middle of something that must not move, a drop or a charge


class Accord(NamedTuple):
    """One robot's word in one round of agreement. Priority 6.

    byte  field   type  meaning
    0..1  round   u16   a later round (modulo 2^16) makes earlier ones void
    2     say     bits  bits 0-3: 0 PLACE, 1 PLAN, 2 AT; bits 4-7: answer, 0 GRANT, 1 STOPPED, 2 BUSY
    3..4  first   u16   see `Say`
    5..6  second  u16
    7     detail  u8    of PLACE: sixteenths of the pitch east (bits 0-3) and north (4-7) of the
                        node, offset 8
    """

    round: int
    say: int
    answer: int
    first: int
    second: int
    detail: int

    def pack(self) -> bytes:
        mixed = self.say | self.answer << 4
        return ACCORD.pack(self.round, mixed, self.first, self.second, self.detail)

    @classmethod
    def unpack(cls, data: bytes) -> "Accord":
        number, mixed, first, second, detail = ACCORD.unpack(data)
        if mixed & 15 > max(Say) or mixed >> 4 > max(Answer):
            raise ValueError("range")
        return cls(number, mixed & 15, mixed >> 4, first, second, detail)
