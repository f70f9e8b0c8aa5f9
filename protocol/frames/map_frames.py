"""Frames of the fleet's map: one robot's view of a patch of 16 cells, and digests of squares."""

from struct import Struct
from typing import NamedTuple

WORD = Struct("<Q")
CELLS = 16  # of a patch
CODES = 3**CELLS  # each cell is unknown, free or an obstacle: 25.4 bits
DIGEST_BITS = 3
FANOUT = 16  # children of a node
# Nodes of one size have numbers in a row: tiles of 16 patches first, then squares of 16 tiles, ...
FIRST_NODES = (0, 4096, 4096 + 256, 4096 + 256 + 16)
NODES = FIRST_NODES[-1] + 1  # the last one is the whole of the greatest map
SALTS = 8


class MapPatch(NamedTuple):
    """Cells of a patch as one robot saw them, all with one time and confidence. Priority 7.

    bits    field     meaning
    0..15   patch     its number along the Z-order curve
    16..28  time      seconds of the fleet's clock
    29..32  level     of confidence: (level + 1) / 16
    33..37  observer  slot
    38..63  cells     16 digits to the base 3, the first cell lowest: 0 nothing said, 1 free, 2 obstacle
    """

    patch: int
    time: int
    level: int
    observer: int
    cells: int

    def pack(self) -> bytes:
        return WORD.pack(
            self.patch | self.time << 16 | self.level << 29 | self.observer << 33 | self.cells << 38
        )

    @classmethod
    def unpack(cls, data: bytes) -> "MapPatch":
        (word,) = WORD.unpack(data)
        cells = word >> 38
        if cells >= CODES:
            raise ValueError("range")
        return cls(word & 0xFFFF, word >> 16 & 0x1FFF, word >> 29 & 15, word >> 33 & 31, cells)


class MapDigests(NamedTuple):
    """Digests of the 16 squares that make up a greater one, or of the patches of a tile. Priority 7.

    bits    field    meaning
    0..12   node     which square: 0 to 4095 tiles, then 256 of 16 tiles, 16 of 256, and the whole
    13..15  salt     mixed into the digests: what collides with one salt differs with another
    16..63  digests  16 of 3 bits, in the order of the Z curve
    """

    node: int
    salt: int
    digests: tuple[int, ...]

    def pack(self) -> bytes:
        word = self.node | self.salt << 13
        for k, digest in enumerate(self.digests):
            word |= digest << 16 + DIGEST_BITS * k
        return WORD.pack(word)

    @classmethod
    def unpack(cls, data: bytes) -> "MapDigests":
        (word,) = WORD.unpack(data)
        if word & 0x1FFF >= NODES:
            raise ValueError("range")
        digests = tuple(word >> 16 + DIGEST_BITS * k & 7 for k in range(FANOUT))
        return cls(word & 0x1FFF, word >> 13 & 7, digests)
