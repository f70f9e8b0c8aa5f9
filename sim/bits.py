"""How long a frame takes: exact bits of a 29-bit-identifier data frame, with CRC and stuffing.

ISO 11898-1: after five equal bits a bit of the other value is stuffed, from start of frame to the
end of the CRC sequence. Then CRC delimiter, acknowledge slot and delimiter, seven bits end of frame
and three bits interframe space, which are not stuffed.
"""

import numpy as np
from numba import njit

BIT_US = 4  # at 250 kbit/s
TAIL_BITS = 1 + 2 + 7 + 3  # CRC delimiter, acknowledge, end of frame, interframe space
HEAD_BITS = 1 + 11 + 2 + 18 + 3 + 4  # SOF, base id, SRR and IDE, extension, RTR r1 r0, DLC
CRC_BITS = 15
CRC_POLYNOMIAL = 0x4599


def worst_bits(data_bytes: int) -> int:
    """With the most stuffing there can be: 80 + 10 bits a byte (Davis et al. 2007, g = 54)."""
    stuffable = HEAD_BITS + CRC_BITS + 8 * data_bytes
    return stuffable + (stuffable - 1) // 4 + TAIL_BITS


WORST_BITS = tuple(worst_bits(count) for count in range(9))  # by data bytes
assert WORST_BITS[8] == 160 and WORST_BITS[0] == 80


@njit(cache=True)
def _stuffed(identifier, low, high, length):  # type: ignore[no-untyped-def]
    bits = np.empty(128, dtype=np.uint8)
    n = 0
    bits[n] = 0
    n += 1
    for k in range(28, 17, -1):
        bits[n] = (identifier >> k) & 1
        n += 1
    bits[n] = 1
    bits[n + 1] = 1
    n += 2
    for k in range(17, -1, -1):
        bits[n] = (identifier >> k) & 1
        n += 1
    for _ in range(3):
        bits[n] = 0
        n += 1
    for k in range(3, -1, -1):
        bits[n] = (length >> k) & 1
        n += 1
    for i in range(length):
        byte = low >> 8 * i if i < 4 else high >> 8 * (i - 4)
        for k in range(7, -1, -1):
            bits[n] = (byte >> k) & 1
            n += 1
    crc = 0
    for i in range(n):
        feedback = bits[i] ^ (crc >> 14 & 1)
        crc = (crc << 1) & 0x7FFF
        if feedback:
            crc ^= 0x4599
    for k in range(14, -1, -1):
        bits[n] = (crc >> k) & 1
        n += 1
    stuff, run, last = 0, 0, 2
    for i in range(n):
        if bits[i] == last:
            run += 1
        else:
            run, last = 1, bits[i]
        if run == 5:
            stuff += 1
            run, last = 1, 1 - last
    return n + stuff


def frame_bits(identifier: int, data: bytes) -> int:
    """Bits on the wire from start of frame to the end of the interframe space."""
    word = int.from_bytes(data, "little")  # two halves: integers are handed over faster than arrays
    stuffed: int = _stuffed(identifier, word & 0xFFFFFFFF, word >> 32, len(data))
    return stuffed + TAIL_BITS
