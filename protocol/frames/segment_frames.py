"""Frames of a fleet of several segments: what every robot receives about the other segments.

A robot of such a fleet is (segment, slot). The frames on its own segment do not change. These
frames carry the segment too and have the same bytes on every segment, so tags are valid end to end.
Gateways have fixed addresses, and slots that no robot has.
"""

from struct import Struct
from typing import NamedTuple

SEGMENT_MAX = 0x7FFF  # 15 bits; segment 0: a fleet of one segment
TOLD_FLAG = 0x8000  # above a segment: the stop is sent to a segment that may not know it
CANDIDATES_MAX = 4  # gateways of one segment; one of them leads
# Of the first gateway; no robot has it, and it is below the slots of operator devices.
GATEWAY_SLOT = 124
GATEWAY_ADDRESS = 240  # of the first gateway: a fixed address above those that robots claim
SEGMENT_GATEWAY = 3  # the election in which candidates vote

BEAT = Struct("<BBHHH")
SUMMARY = Struct("<HBBBBH")
assert BEAT.size == SUMMARY.size == 8


def gateway_slot(address: int) -> int | None:
    """The number of the gateway with an address.

    >>> gateway_slot(241), gateway_slot(128)
    (125, None)
    """
    number = address - GATEWAY_ADDRESS
    return GATEWAY_SLOT + number if 0 <= number < CANDIDATES_MAX else None


class FleetStop(NamedTuple):
    """A stop as all segments say it. Priority 0.

    byte  field        type  meaning
    0..1  segment      bits  where it was pressed in bits 0-14; bit 15: told again, no press of now
    2     slot         u8    who pressed: robot slot, or 128.. for a panel or an operator device
    3     incarnation  u8    low byte of the presser's incarnation
    4     counter      u8    the presser's stop counter: the four are the dot
    5..7  tag          u24   AES-CMAC of the dot, little-endian; 0 in a fleet without keys
    """

    segment: int
    slot: int
    incarnation: int
    counter: int
    tag: int = 0
    told: bool = False  # by one that holds the stop, to one that may not know it; not by its press

    def pack(self) -> bytes:
        dot = bytes((self.slot, self.incarnation, self.counter))
        head = self.segment | (TOLD_FLAG if self.told else 0)
        return head.to_bytes(2, "little") + dot + self.tag.to_bytes(3, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "FleetStop":
        head = int.from_bytes(data[:2], "little")
        segment, told = head & SEGMENT_MAX, bool(head & TOLD_FLAG)
        if not segment:
            raise ValueError("range")
        tag = int.from_bytes(data[5:], "little")
        return cls(segment, data[2], data[3], data[4], tag, told)


class FleetReset(NamedTuple):
    """One half of what clears the one dot it names in all segments; it needs both. Priority 1.

    byte  field          type  meaning
    0..1  segment, part  bits  segment of the dot in bits 0-14; bit 15: which half of the tag
    2..4  dot            3 u8  slot, incarnation, counter of the stop it clears
    5..7  half           u24   24 of 48 bits of an AES-CMAC of the dot, with the operator's secret
    """

    segment: int
    part: int
    slot: int
    incarnation: int
    counter: int
    half: int = 0

    def pack(self) -> bytes:
        head = (self.segment | self.part << 15).to_bytes(2, "little")
        dot = bytes((self.slot, self.incarnation, self.counter))
        return head + dot + self.half.to_bytes(3, "little")

    @classmethod
    def unpack(cls, data: bytes) -> "FleetReset":
        head = int.from_bytes(data[:2], "little")
        segment, part = head & SEGMENT_MAX, head >> 15
        if not segment:
            raise ValueError("range")
        return cls(segment, part, data[2], data[3], data[4], int.from_bytes(data[5:], "little"))


class GatewayBeat(NamedTuple):
    """A gateway is here, and this is how far it reaches. Priority 6.

    byte  field      type  meaning
    0     candidate  u8    its number: 124 to 127
    1     flags      bits  bit 0: it leads; bit 1: it has reached another segment since it started
    2..3  term       u16   of the election of gateways
    4..5  reached    u16   other segments that it hears and that hear it
    6..7  lot        u16   by which two with one number tell each other apart
    """

    candidate: int
    flags: int
    term: int
    reached: int
    lot: int

    @property
    def leads(self) -> bool:
        return bool(self.flags & 1)

    @property
    def ever(self) -> bool:
        return bool(self.flags & 2)

    def pack(self) -> bytes:
        return BEAT.pack(*self)

    @classmethod
    def unpack(cls, data: bytes) -> "GatewayBeat":
        beat = cls._make(BEAT.unpack(data))
        if not 0 <= beat.candidate - GATEWAY_SLOT < CANDIDATES_MAX or beat.flags > 3:
            raise ValueError("range")
        return beat


class SegmentSummary(NamedTuple):
    """The heartbeats of another segment in one. Priority 7.

    byte  field    type  meaning
    0..1  segment  u16   which
    2     live     u8    robots that are heard there
    3     silent   u8    robots that fell silent there
    4     halted   u8    robots that stand stopped
    5     done     u8    share of its own sections that are done, 1/250
    6..7  digest   u16   of what it has done
    """

    segment: int
    live: int
    silent: int
    halted: int
    done: int
    digest: int

    def pack(self) -> bytes:
        return SUMMARY.pack(*self)

    @classmethod
    def unpack(cls, data: bytes) -> "SegmentSummary":
        summary = cls._make(SUMMARY.unpack(data))
        if not 1 <= summary.segment <= SEGMENT_MAX or summary.done > 250:
            raise ValueError("range")
        return summary
