"""Messages between gateways over the backbone: one header, five kinds, bytes.

Every message is idempotent. Dots and resets are grow-only, work is joined by maximum or union, and
of two summaries the newer one is kept. So a message that arrives twice, late, or around a loop has
no further effect. A message that cannot be parsed gives None and is counted; it never raises.
"""

from enum import IntEnum
from struct import Struct
from struct import error as StructError
from typing import NamedTuple

from protocol.frames.codec import packed
from protocol.frames.segment_frames import (
    FLEET_RESET,
    FLEET_STOP,
    SEGMENT_MAX,
    FleetReset,
    FleetStop,
)

VERSION = 1
HEADER = Struct("<BBHHBII")
SUMMARY = Struct("<BBBHHIIIHH")
PAIR, HEARD = Struct("<HI"), Struct("<HH")
ENTRY = Struct("<BHHHB8s")
FRAME = 8  # bytes of a stop or of half a reset
ENTRIES_MAX = 64  # per message, so that no message blocks a link for long
MESSAGE_MAX = 1 << 16  # longer messages are not ours


class Kind(IntEnum):
    STOPS = 1
    RESETS = 2
    SUMMARY = 3
    WORK = 4
    MAP = 5


class Header(NamedTuple):
    """The sender: segment, its gateway's term and number, and which of its messages this is."""

    kind: int
    segment: int
    # Of the election of this segment's gateways; messages of an earlier term are rejected.
    term: int
    candidate: int
    boot: int  # drawn when the gateway started; the sequence restarts with it
    sequence: int


class Summary(NamedTuple):
    """The heartbeats of a segment in one message, and the digests to compare its replicas by."""

    live: int
    silent: int
    halted: int  # robots that are stopped
    done: int  # of the home sections
    home: int  # sections that belong to this segment
    digest: int  # of all that this segment's replica holds of its home sections
    stops: int  # digest of the stops and resets of the whole fleet
    map: int  # digest of the map, if there is one
    shared: dict[int, int]  # neighbour -> digest of what both segments hold
    heard: dict[int, int]  # segment that is received here -> the term of its gateway


class Entry(NamedTuple):
    """One value of a section at the border, in the numbering of its home, or a patch of the map."""

    kind: int  # 1 register, 2 progress block, 3 patch of the map, 4 digests of it
    segment: int  # home of the section
    section: int
    owner_segment: int  # of a register
    owner: int
    data: bytes  # 8 bytes, as the frame of this kind on the bus


Body = tuple[FleetStop, ...] | tuple[FleetReset, ...] | Summary | tuple[Entry, ...]


class Message(NamedTuple):
    header: Header
    body: Body


def pack(header: Header, body: Body) -> bytes:
    kind, *rest = header
    head = HEADER.pack(VERSION, kind, *rest)
    if isinstance(body, Summary):
        *numbers, shared, heard = body
        pairs = b"".join(PAIR.pack(*pair) for pair in sorted(shared.items()))
        terms = b"".join(HEARD.pack(*pair) for pair in sorted(heard.items()))
        return head + SUMMARY.pack(*numbers, len(shared), len(heard)) + pairs + terms
    if kind in (Kind.WORK, Kind.MAP):
        assert len(body) <= ENTRIES_MAX
        return head + b"".join(ENTRY.pack(*entry) for entry in body)
    return head + b"".join(packed(frame) for frame in body)  # type: ignore[arg-type]


def unpack(data: bytes) -> Message | None:
    """Parse a message; None if it is not one of ours."""
    if not HEADER.size <= len(data) <= MESSAGE_MAX:
        return None
    version, *numbers = HEADER.unpack_from(data)
    header, rest = Header(*numbers), data[HEADER.size :]
    if version != VERSION or not 1 <= header.segment <= SEGMENT_MAX:
        return None
    try:
        match header.kind:
            case Kind.STOPS:
                return Message(header, tuple(map(FLEET_STOP.unpack, _slices(rest))))
            case Kind.RESETS:
                return Message(header, tuple(map(FLEET_RESET.unpack, _slices(rest))))
            case Kind.SUMMARY:
                return Message(header, _summary(rest))
            case Kind.WORK | Kind.MAP:
                entries = tuple(Entry(*fields) for fields in ENTRY.iter_unpack(rest))
                return Message(header, entries) if len(entries) <= ENTRIES_MAX else None
    except (ValueError, StructError):
        return None
    return None


def _slices(data: bytes) -> list[bytes]:
    if len(data) % FRAME:
        raise ValueError("length")
    return [data[at : at + FRAME] for at in range(0, len(data), FRAME)]


def _summary(data: bytes) -> Summary:
    *numbers, shared, heard = SUMMARY.unpack_from(data)
    middle = SUMMARY.size + shared * PAIR.size
    pairs, terms = data[SUMMARY.size : middle], data[middle:]
    if len(pairs) != shared * PAIR.size or len(terms) != heard * HEARD.size:
        raise ValueError("length")
    both = dict(PAIR.iter_unpack(pairs)), dict(HEARD.iter_unpack(terms))
    return Summary._make((*numbers, *both))
