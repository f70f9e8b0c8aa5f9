"""Frames to messages and back. Decoding never raises: an unreadable frame is a value to count."""

from typing import NamedTuple

from protocol.frames.frame import Frame
from protocol.frames.identifier import Identifier
from protocol.frames.messages import GROUP_OF, GROUPS, Message


class Malformed(NamedTuple):
    """A frame we could not read. The reasons are few, so that they can be counted."""

    reason: str


UNKNOWN, LENGTH, RANGE = Malformed("unknown PGN"), Malformed("length"), Malformed("range")

# Addressed groups (PF < 240) carry the destination in the low byte, so all values map to the group.
_LAYOUTS = {
    layout.pgn | low: layout
    for layout in GROUPS
    for low in (range(256) if layout.pgn >> 8 & 0xFF < 240 else (0,))
}
_HEADS = {
    kind: (layout.priority << 26 | layout.pgn << 8, layout.pgn >> 8 & 0xFF < 240)
    for kind, layout in GROUP_OF.items()
}


_tuple = tuple.__new__


def encode(message: Message, source: int, destination: int = 255) -> Frame:
    """The frame that carries a message. `destination` counts for addressed groups only.

    Raises AssertionError or struct.error if a value does not fit its field: our own code is wrong.
    """
    head, addressed = _HEADS[type(message)]
    assert 0 <= source <= 255 and 0 <= destination <= 255
    identifier = head | (destination << 8 if addressed else 0) | source
    return _tuple(Frame, (identifier, packed(message)))


_packed: tuple[Message | None, bytes] = (None, b"")  # the newest


def packed(message: Message) -> bytes:
    """The data of a message; a second call for the message just sent returns the cached data."""
    global _packed
    last, data = _packed
    if last is not message:
        data = GROUP_OF[type(message)].pack(message)
        _packed = (message, data)
    return data


def decode(frame: Frame) -> tuple[int, Message | Malformed]:
    """(source address, message or Malformed) of any identifier and any bytes."""
    identifier, data = frame
    layout = _LAYOUTS.get(identifier >> 8 & 0x3FFFF)
    if layout is None:
        return identifier & 0xFF, UNKNOWN
    if len(data) != layout.length:
        if not layout.padded or len(data) < layout.length:
            return identifier & 0xFF, LENGTH
        data = data[: layout.length]
    try:
        return identifier & 0xFF, layout.unpack(data)
    except ValueError:
        return identifier & 0xFF, RANGE


_decoded: tuple[Frame | None, tuple[int, Message | Malformed]] = (None, (0, UNKNOWN))  # the newest


def decode_once(frame: Frame) -> tuple[int, Message | Malformed]:
    """`decode`, for simulators, where all receivers get the same frame object one after another."""
    global _decoded
    last, result = _decoded
    if last is not frame:
        result = decode(frame)
        _decoded = (frame, result)
    return result


def destination_of(frame: Frame) -> int:
    """The address that a frame goes to; 255 for all devices."""
    return Identifier.unpack(frame.identifier).destination
