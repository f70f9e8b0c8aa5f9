"""Frames by which robots agree on who goes where. One use is robots in each other's way
(`agent/mapf/joint_plan_agreement.py`), the other a grid that robots cover together
(`agent/coverage/plan_agreement.py`). A fleet has one of the two uses."""

from enum import IntEnum
from struct import Struct
from typing import NamedTuple

from protocol.frames.fleet_frames import LENGTH_M

ACCORD = Struct("<HBHHB")
assert ACCORD.size == 8


class AgreementKind(IntEnum):
    """What an ACCORD frame says; a robot says each at most one way in one round."""

    PLACE = 0  # I stand at node `first` and want to node `second`; `detail`: where in the node
    PLAN = 1  # the digest of the plan that I computed: `first` low, `second` high half
    AT = 2  # I have reached the `first`-th node of my route, counted from 1; 0: not yet on it
    BODY = 3  # on a grid: something is in cell `first`; `second`: its slot, 0xFFFF: not a robot;
    # `detail`: 1 where it is taken to stay. Else: something that I see stands on node `first`
    # On a grid PLACE has a cell as `first` and a digest of what is covered as `second` and `detail`;
    # AT has a step of the plan as `first` and the low half of the plan's digest as `second`.


class AgreementReply(IntEnum):
    """With PLACE: whether this robot clears the way when it is asked to."""

    GRANT = 0
    STOPPED = 1  # refused: an emergency stop, a hold, a fault: it does not move
    BUSY = 2  # refused: it is in the middle of something that must not move, a drop or a charge
    # refused: it does not receive a member that others receive, so it cannot agree with all.
    DEAF = 3


class Accord(NamedTuple):
    """One robot's word in one round of agreement. Priority 6.

    byte  field   type  meaning
    0..1  round   u16   a later round (modulo 2^16) makes earlier ones void
    2     say     bits  bits 0-3: 0 PLACE, 1 PLAN, 2 AT, 3 BODY; bits 4-7: answer, 0 GRANT,
                        1 STOPPED, 2 BUSY, 3 DEAF
    3..4  first   u16   see `AgreementKind`
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
        if mixed & 15 > max(AgreementKind) or mixed >> 4 > max(AgreementReply):
            raise ValueError("range")
        return cls(number, mixed & 15, mixed >> 4, first, second, detail)


PLACES = 1 << 16  # offset of coordinates, as in POSE
STAMP_MAX = (1 << 22) - 1


class Fallen(NamedTuple):
    """Where a member stands that has fallen silent, as its last beat said. Priority 6.

    bits    field  unit, meaning
    0..16   x_m    0.05 m, offset 2^16, as in POSE
    17..33  y_m    the same
    34..41  slot   of the silent member
    42..63  stamp  quarters of a second of the fleet's common clock: when that beat was heard; the
                   latest word of a member counts
    """

    x_m: float
    y_m: float
    slot: int
    stamp: int

    def pack(self) -> bytes:
        x, y = round(self.x_m / LENGTH_M) + PLACES, round(self.y_m / LENGTH_M) + PLACES
        return (x | y << 17 | self.slot << 34 | self.stamp << 42).to_bytes(8, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "Fallen":
        word = int.from_bytes(data, "little")
        x, y = (word & 0x1FFFF) - PLACES, (word >> 17 & 0x1FFFF) - PLACES
        return cls(x * LENGTH_M, y * LENGTH_M, word >> 34 & 0xFF, word >> 42)
