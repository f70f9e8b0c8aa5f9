"""Frames of a fleet of several segments: what every robot receives about the other segments.

A robot of such a fleet is (segment, slot). The frames on its own segment do not change. These
frames carry the segment too and have the same bytes on every segment, so tags are valid end to end.
Gateways have fixed addresses, and slots that no robot has.
"""

from typing import NamedTuple

from protocol.frames.layout import ANY_DEVICE, GATEWAY, FrameLayout, flag, integer
from protocol.frames.safety_frames import PRESSER

SEGMENT_BITS = 15
SEGMENT_MAX = (1 << SEGMENT_BITS) - 1
SEGMENTS = range(1, SEGMENT_MAX + 1)  # segment 0: a fleet of one segment
CANDIDATES_MAX = 4  # gateways of one segment; one of them leads
# Of the first gateway; no robot has it, and it is below the slots of operator devices.
GATEWAY_SLOT = 124
GATEWAY_ADDRESS = 240  # of the first gateway: a fixed address above those that robots claim
SEGMENT_GATEWAY = 3  # the election in which candidates vote


def gateway_slot(address: int) -> int | None:
    """The number of the gateway with an address.

    >>> gateway_slot(241), gateway_slot(128)
    (125, None)
    """
    number = address - GATEWAY_ADDRESS
    return GATEWAY_SLOT + number if 0 <= number < CANDIDATES_MAX else None


class FleetStop(NamedTuple):
    """A press of an emergency stop as all segments of a fleet repeat it.

    A robot sends it with its EMERGENCY_STOP, and gateways carry it to every other segment, where
    they repeat it until all robots stand. Receivers brake and latch.
    """

    segment: int
    slot: int
    incarnation: int
    counter: int
    tag: int = 0
    told: bool = False


FLEET_STOP = FrameLayout(
    FleetStop, "FLEET_STOP", pgn=0xFF30, priority=0, sender=ANY_DEVICE,
    fields=(
        integer("segment", SEGMENT_BITS, "where it was pressed", accepted=SEGMENTS),
        flag("told", "repeated for a segment that may not know it; not a new press"),
        integer("slot", 8, PRESSER),
        integer("incarnation", 8, "low byte of the presser's incarnation"),
        integer("counter", 8, "the presser's stop counter; the four numbers are the dot"),
        integer("tag", 24, "AES-CMAC of the dot; 0 in a fleet without keys"),
    ),
)  # fmt: skip


class FleetReset(NamedTuple):
    """One half of the reset that clears one dot in all segments.

    An operator tool or a gateway sends both halves. Receivers clear the dot when they have both and
    the tag is valid.
    """

    segment: int
    part: int
    slot: int
    incarnation: int
    counter: int
    half: int = 0


FLEET_RESET = FrameLayout(
    FleetReset, "FLEET_RESET", pgn=0xFF31, priority=1, sender=GATEWAY,
    fields=(
        integer("segment", SEGMENT_BITS, "of the dot", accepted=SEGMENTS),
        integer("part", 1, "which half of the tag"),
        integer("slot", 8, "of the dot"),
        integer("incarnation", 8, "of the dot"),
        integer("counter", 8, "of the dot"),
        integer("half", 24, "24 of the 48 bits of an AES-CMAC of the dot, with the operator's "
                "secret"),
    ),
)  # fmt: skip


class GatewayBeat(NamedTuple):
    """The sign of life of a gateway, and how many segments it reaches.

    Every gateway sends it every 250 ms. The gateways of a segment count each other by it, and
    robots slow down or stop if they hear no gateway.
    """

    candidate: int
    flags: int
    term: int
    reached: int
    lot: int

    @property
    def leads(self) -> bool:
        """Whether it is the leading gateway of its segment."""
        return bool(self.flags & 1)

    @property
    def ever(self) -> bool:
        """Whether it has reached another segment since it started."""
        return bool(self.flags & 2)


GATEWAY_BEAT = FrameLayout(
    GatewayBeat, "GATEWAY_BEAT", pgn=0xFF32, priority=6, sender=GATEWAY,
    fields=(
        integer("candidate", 8, "its number",
                accepted=range(GATEWAY_SLOT, GATEWAY_SLOT + CANDIDATES_MAX)),
        integer("flags", 8, "bit 0: it leads; bit 1: it has reached another segment since it started",
                accepted=range(4)),
        integer("term", 16, "of the election of gateways"),
        integer("reached", 16, "number of other segments that it hears and that hear it"),
        integer("lot", 16, "drawn at random: tells two with the same number apart"),
    ),
)  # fmt: skip


class SegmentSummary(NamedTuple):
    """The heartbeats of another segment in one frame.

    The leading gateway sends one segment after the other. Robots report it to operators.
    """

    segment: int
    live: int
    silent: int
    halted: int
    done: int
    digest: int


SEGMENT_SUMMARY = FrameLayout(
    SegmentSummary, "SEGMENT_SUMMARY", pgn=0xFF33, priority=7, sender=GATEWAY,
    fields=(
        integer("segment", 16, "that is summarized", accepted=SEGMENTS),
        integer("live", 8, "robots that are received there"),
        integer("silent", 8, "robots that fell silent there"),
        integer("halted", 8, "robots that stand stopped"),
        integer("done", 8, "share of its own sections that are done, in 1/250",
                accepted=range(251)),
        integer("digest", 16, "of what it has done"),
    ),
)  # fmt: skip
