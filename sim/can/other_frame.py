"""Frames that are not those of our fleet: 11-bit identifiers and remote frames of other devices.

They take their place in arbitration and on the wire. Only clients of the hub receive them, because no
robot reads them.
"""

from typing import Final

from protocol.frames.frame import Frame
from sim.can.frame_timing import CRC_BITS, FREE, TAIL_BITS, divided, run_on

LENGTH_MAX: Final = 8


class OtherFrame(Frame):
    """A frame with an 11-bit identifier, or a remote frame. `identifier` is what it arbitrates with."""

    number: int
    extended: bool
    remote: bool
    length: int  # of the data; of a remote frame: of the data that it asks for
    bits: int  # on the wire, with the interframe space

    @classmethod
    def of(
        cls, number: int, data: bytes, extended: bool = False, remote: int | None = None
    ) -> "OtherFrame":
        """`remote`: the length that a remote frame asks for; None: a data frame.

        Raises ValueError for an identifier or a length that CAN does not have.
        """
        length = len(data) if remote is None else remote
        if not 0 <= number < 1 << (29 if extended else 11) or not 0 <= length <= LENGTH_MAX:
            raise ValueError("no classic CAN frame")
        # An 11-bit identifier is compared with the upper 11 bits of a longer one.
        frame = cls(number if extended else number << 18, data if remote is None else b"")
        frame.number, frame.extended, frame.length = number, extended, length
        frame.remote = remote is not None
        frame.bits = _bits(frame)
        return frame


def _bits(frame: OtherFrame) -> int:
    remote = int(frame.remote)
    if frame.extended:
        base, extension = frame.number >> 18, frame.number & 0x3FFFF
        head, count = (((base << 2 | 3) << 18 | extension) << 1 | remote) << 2, 35
    else:
        head, count = (frame.number << 1 | remote) << 2, 15
    head, count = head << 4 | frame.length, count + 4
    for byte in frame.data:
        head, count = head << 8 | byte, count + 8
    crc = divided(0, head, count)
    run = head << CRC_BITS | crc
    count += CRC_BITS
    return count + run_on(FREE, run, count)[1] + TAIL_BITS
