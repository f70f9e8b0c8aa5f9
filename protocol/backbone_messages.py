"""Messages between gateways over the backbone: MessagePack arrays of one header and one body.

    [version, kind, segment, term, candidate, boot, sequence, body]

    STOPS, RESETS   an array of frames, 8 bytes each
    SUMMARY         an array: the fields of `Summary`
    WORK, MAP       an array of entries; an entry is an array: the fields of `Entry`

Every message is idempotent. Dots and resets are grow-only, work is joined by maximum or union, and
of two summaries the newer one is kept. So a message that arrives twice, late, or around a loop has
no further effect. A message that cannot be parsed gives None and is counted; it never raises.
"""

from enum import IntEnum
from typing import Any, NamedTuple

from protocol.frames.layout import FrameLayout
from protocol.frames.segment_frames import (
    FLEET_RESET,
    FLEET_STOP,
    SEGMENT_MAX,
    SEGMENTS,
    FleetReset,
    FleetStop,
)
from protocol.strict_msgpack import U8, U16, U32, StrictReader, packed, unsigned

VERSION = 2  # 1 was a layout of structs; its first byte is no array
FRAME = 8  # bytes of a stop, of half a reset, and of an entry
FRAMES_MAX = 1024  # stops or halves of resets per message
ENTRIES_MAX = 64  # per message, so that no message blocks a link for long
MESSAGE_MAX = 1 << 16  # bytes; longer messages are not ours


class BackboneKind(IntEnum):
    """What the body of a message holds."""

    STOPS = 1
    RESETS = 2
    SUMMARY = 3
    WORK = 4
    MAP = 5


class BackboneHeader(NamedTuple):
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

HEADER_BITS = (U8, U16, U16, U8, U32, U32)
SUMMARY_BITS = (U8, U8, U8, U16, U16, U32, U32, U32)
ENTRY_BITS = (U8, U16, U16, U16, U8)
FRAMES: dict[int, FrameLayout[Any]] = {
    BackboneKind.STOPS: FLEET_STOP,
    BackboneKind.RESETS: FLEET_RESET,
}


class Message(NamedTuple):
    """A header and the body that its kind names."""

    header: BackboneHeader
    body: Body


def pack(header: BackboneHeader, body: Body) -> bytes:
    """The bytes of a message; equal messages have equal bytes.

    Raises ValueError if a number does not fit, and AssertionError if there are too many elements.
    """
    content: object
    if isinstance(body, Summary):
        *numbers, shared, heard = body
        maps = [dict(sorted(pairs.items())) for pairs in (shared, heard)]
        content = (*unsigned(numbers, SUMMARY_BITS), *maps)
    elif header.kind in FRAMES:
        assert len(body) <= FRAMES_MAX
        content = [FRAMES[header.kind].pack(frame) for frame in body]
    else:
        assert len(body) <= ENTRIES_MAX
        content = [(*unsigned(entry[:-1], ENTRY_BITS), entry[-1]) for entry in body]
    return packed((VERSION, *unsigned(header, HEADER_BITS), content))


def unpack(data: bytes) -> Message | None:
    """Parse a message; None if it is not one of ours."""
    if len(data) > MESSAGE_MAX:
        return None
    reader = StrictReader(data, len(Summary._fields), map_max=SEGMENT_MAX, bytes_max=FRAME)
    try:
        message = _message(reader)
        reader.end()
    except ValueError:
        return None
    return message


def _message(reader: StrictReader) -> Message:
    if reader.count(8) != 8 or reader.numbers((U8,)) != [VERSION]:
        raise ValueError("version")
    header = BackboneHeader(*reader.numbers(HEADER_BITS))
    if header.segment not in SEGMENTS:
        raise ValueError("segment")
    match header.kind:
        case BackboneKind.STOPS | BackboneKind.RESETS:
            layout = FRAMES[header.kind]
            frames = [_frame(reader.value()) for _ in range(reader.count(FRAMES_MAX))]
            return Message(header, tuple(map(layout.unpack, frames)))
        case BackboneKind.SUMMARY:
            return Message(header, _summary(reader.value()))
        case BackboneKind.WORK | BackboneKind.MAP:
            entries = [_entry(reader.value()) for _ in range(reader.count(ENTRIES_MAX))]
            return Message(header, tuple(entries))
    raise ValueError("kind")


def _frame(value: object) -> bytes:
    if type(value) is not bytes or len(value) != FRAME:
        raise ValueError("frame")
    return value


def _entry(value: object) -> Entry:
    if type(value) is not tuple or not value:
        raise ValueError("entry")
    return Entry._make((*unsigned(value[:-1], ENTRY_BITS), _frame(value[-1])))


def _summary(value: object) -> Summary:
    if type(value) is not tuple or len(value) != len(Summary._fields):
        raise ValueError("summary")
    *numbers, shared, heard = value
    both = _pairs(shared, (U16, U32)), _pairs(heard, (U16, U16))
    return Summary._make((*unsigned(numbers, SUMMARY_BITS), *both))


def _pairs(value: object, widths: tuple[int, int]) -> dict[int, int]:
    if type(value) is not dict:
        raise ValueError("map")
    for pair in value.items():
        unsigned(pair, widths)
    return value
