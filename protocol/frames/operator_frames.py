"""Frames between a robot and its operator; the commands are in `safety_frames.py`."""

from enum import IntEnum
from struct import Struct
from typing import NamedTuple

PLACE_M = 0.1  # unit of distances in reports
GOAL_M = 0.2  # unit of goals: 15 bits for each coordinate
LOWEST_M = -3276.8  # lowest coordinate, as in POSE; both kinds count steps from it
NUMBERS = 15  # questions are numbered 1 to 15, then from 1 again
REPORT = Struct("<BBHHBB")
GOAL = Struct("<BBHB")
assert REPORT.size == 8 and GOAL.size + 3 == 8
GOAL_VALUES = 1 << 15


class ReportKind(IntEnum):
    """What a robot tells: four bits."""

    ASKING = 0  # something that is no robot is in the way: what now?
    WAITING = 1  # it waits until that has left
    GOING_ROUND = 2  # it drives round it
    GONE = 3  # it has left by itself
    STOPPED = 4  # work given back; it stands until an operator's start
    UNDER_WAY = 5  # to the place it was sent to
    ARRIVED = 6  # there
    REFUSED = 7  # the order cannot be obeyed now
    WORKING = 8  # back from where it was sent to
    STALLED = 9  # it wants to drive, gets nowhere, and plans again


class OperatorReport(NamedTuple):
    """A robot's question to its operators, and what it does about their answer. Priority 4.

    byte  field            type  meaning
    0     slot             u8    who asks
    1     number, matter   bits  of the question in bits 0-3 (0: none was asked); Matter in bits 4-7
    2..3  x_m              u16   0.1 m from -3276.8 east: the obstacle, or where it is going
    4..5  y_m              u16   the same, north
    6     distance_m       u8    0.1 m from the robot's hull, 25.5: that or more
    7     radius_m         u8    0.1 m, of what can be seen of the obstacle
    """

    slot: int
    number: int
    matter: ReportKind
    x_m: float
    y_m: float
    distance_m: float = 0.0
    radius_m: float = 0.0

    def pack(self) -> bytes:
        x, y = (_steps(v - LOWEST_M, 0xFFFF) for v in (self.x_m, self.y_m))
        distance, radius = (_steps(v, 0xFF) for v in (self.distance_m, self.radius_m))
        return REPORT.pack(self.slot, self.number | self.matter << 4, x, y, distance, radius)

    @classmethod
    def unpack(cls, data: bytes) -> "OperatorReport":
        slot, flags, x, y, distance, radius = REPORT.unpack(data)
        return cls(
            slot, flags & 15, ReportKind(flags >> 4),
            x * PLACE_M + LOWEST_M, y * PLACE_M + LOWEST_M, distance * PLACE_M, radius * PLACE_M,
        )  # fmt: skip


def _steps(value_m: float, most: int) -> int:
    return max(0, min(round(value_m / PLACE_M), most))


class OperatorGoal(NamedTuple):
    """One coordinate of a place for one robot; SET_GOAL then means both. Priority 1.

    It must leave before the order that means it, whose counter is younger: hence the priority.

    byte  field           type  meaning
    0     target          u8    slot
    1     operator        u8    operator device (192..254 in a fleet with keys)
    2..3  axis, value     bits  value in bits 0-14: 0.2 m from -3276.8; bit 15: 0 east, 1 north
    4     freshness       u8    low byte of the operator's freshness counter
    5..7  tag             u24   AES-CMAC with the operator's key
    """

    target: int
    operator: int
    value: int  # below GOAL_VALUES
    north: bool
    freshness: int = 0
    tag: int = 0

    @property
    def metres(self) -> float:
        return self.value * GOAL_M + LOWEST_M

    def pack(self) -> bytes:
        head = GOAL.pack(self.target, self.operator, self.value | self.north << 15, self.freshness)
        return head + self.tag.to_bytes(3, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "OperatorGoal":
        target, operator, word, freshness = GOAL.unpack(data[:5])
        tag = int.from_bytes(data[5:], "little")
        return cls(target, operator, word & 0x7FFF, bool(word >> 15), freshness, tag)


def goal_frames(target: int, operator: int, x_m: float, y_m: float) -> tuple[OperatorGoal, ...]:
    """Both coordinates. ValueError if they are out of range.

    >>> [round(frame.metres, 1) for frame in goal_frames(3, 200, 12.34, -7.0)]
    [12.4, -7.0]
    """
    values = [round((v - LOWEST_M) / GOAL_M) for v in (x_m, y_m)]
    if not all(0 <= value < GOAL_VALUES for value in values):
        raise ValueError(f"{x_m}, {y_m} is not within {-LOWEST_M} m of the field origin")
    return tuple(
        OperatorGoal(target, operator, value, north)
        for value, north in zip(values, (False, True), strict=True)
    )


def goal_check(east: int, north: int) -> int:
    """SET_GOAL's argument: it means this pair of values, and no mixture of an old and a new one."""
    return (east + (east >> 8) + 3 * north + 5 * (north >> 8)) & 0xFF
