"""The duration of a frame: exact bits of a 29-bit-identifier data frame, with CRC and stuffing.

ISO 11898-1: after five equal bits, a bit of the opposite value is stuffed, from start of frame to
the end of the CRC sequence. CRC delimiter, acknowledge slot and delimiter, seven bits end of frame
and three bits interframe space follow without stuffing.
"""

from typing import Final

BIT_US: Final = 4  # at 250 kbit/s
TAIL_BITS: Final = 1 + 2 + 7 + 3  # CRC delimiter, acknowledge, end of frame, interframe space
HEAD_BITS: Final = 1 + 11 + 2 + 18 + 3 + 4  # SOF, base id, SRR and IDE, extension, RTR r1 r0, DLC
CRC_BITS: Final = 15
CRC_POLYNOMIAL: Final = 0x4599
EQUAL_BITS_MAX: Final = 5


def worst_bits(data_bytes: int) -> int:
    """Bits with maximum stuffing: 80 + 10 bits a byte (Davis et al. 2007, g = 54)."""
    stuffable = HEAD_BITS + CRC_BITS + 8 * data_bytes
    return stuffable + (stuffable - 1) // 4 + TAIL_BITS


WORST_BITS = tuple(worst_bits(count) for count in range(9))  # by data bytes
assert WORST_BITS[8] == 160 and WORST_BITS[0] == 80

FREE: Final = -1  # the state before a frame, without a run of equal bits


def run_on(state: int, bits: int, count: int) -> tuple[int, int]:
    """Stuffing over `count` bits, the highest first: (state after them, bits stuffed).

    A state is twice the length of the run of equal bits so far, 1 to 4, and the value of the last.
    """
    stuffed = 0
    for k in range(count - 1, -1, -1):
        bit = bits >> k & 1
        if state == FREE or state & 1 != bit:
            state = 2 | bit
        else:
            state += 2
            if state >> 1 == EQUAL_BITS_MAX:
                state, stuffed = 2 | 1 - bit, stuffed + 1
    return state, stuffed


def divided(crc: int, bits: int, count: int) -> int:
    """The CRC register `crc`, 15 bits, after `count` more bits, the highest first."""
    for k in range(count - 1, -1, -1):
        feedback = (bits >> k ^ crc >> 14) & 1
        crc = crc << 1 & 0x7FFF ^ (CRC_POLYNOMIAL if feedback else 0)
    return crc


def _stuffing(bits: int) -> bytes:
    """For every state and every value of this many bits: state after them, and 16 times the stuffed
    bits."""
    rows = (run_on(state, v, bits) if state > 1 else (0, 0) for state in range(10)
            for v in range(1 << bits))  # fmt: skip
    return bytes(state | stuffed << 4 for state, stuffed in rows)


_BY_BYTE: Final = _stuffing(8)
_BY_SEVEN: Final = _stuffing(7)  # the upper bits of a CRC
_CRC: Final = [divided(0, byte, 8) for byte in range(256)]
_heads: dict[int, tuple[int, int, int]] = {}  # of frames sent before
HEADS_MAX = 4096  # a fleet has a hundred senders with a dozen frame kinds each


def _head(identifier: int, length: int) -> tuple[int, int, int]:
    """(CRC, state, bits stuffed) after the bits before the data."""
    base, extension = identifier >> 18, identifier & 0x3FFFF
    bits = ((base << 2 | 3) << 18 | extension) << 7 | length  # SOF is a 0 in front
    return divided(0, bits, HEAD_BITS), *run_on(FREE, bits, HEAD_BITS)


def frame_bits(identifier: int, data: bytes) -> int:
    """Bits on the wire from start of frame to the end of the interframe space."""
    length = len(data)
    known = _heads.get(identifier << 4 | length)
    if known is None:
        if len(_heads) >= HEADS_MAX:
            _heads.clear()
        known = _heads[identifier << 4 | length] = _head(identifier, length)
    crc, state, stuffed = known
    for byte in data:
        crc = crc << 8 & 0x7FFF ^ _CRC[(crc >> 7 ^ byte) & 0xFF]
        step = _BY_BYTE[state << 8 | byte]
        state, stuffed = step & 15, stuffed + (step >> 4)
    step = _BY_SEVEN[state << 7 | crc >> 8]
    stuffed += step >> 4
    stuffed += _BY_BYTE[(step & 15) << 8 | crc & 0xFF] >> 4
    return HEAD_BITS + 8 * length + CRC_BITS + stuffed + TAIL_BITS
