"""Frames of the fleet's map: one robot's view of a patch of 16 cells, and digests of squares."""

from typing import NamedTuple

from protocol.frames.layout import ROBOT, FrameLayout, integer, integers

CELLS = 16  # of a patch
CODES = 3**CELLS  # each cell is unknown, free or an obstacle: 25.4 bits
DIGEST_BITS = 3
FANOUT = 16  # children of a node
# Nodes of one size have numbers in a row: tiles of 16 patches first, then squares of 16 tiles, ...
FIRST_NODES = (0, 4096, 4096 + 256, 4096 + 256 + 16)
NODES = FIRST_NODES[-1] + 1  # the last one is the whole of the greatest map
SALTS = 8


class MapPatch(NamedTuple):
    """The cells of a patch as one robot saw them, all with one time and one confidence.

    A robot sends it once when it sees something new, and again when another robot's digest differs.
    Receivers join the cells to their map by the order of `crdt/sighting.py`.
    """

    patch: int
    time: int
    level: int
    observer: int
    cells: int


MAP_PATCH = FrameLayout(
    MapPatch, "MAP_PATCH", pgn=0xFF16, priority=7, sender=ROBOT,
    fields=(
        integer("patch", 16, "its number along the Z-order curve"),
        integer("time", 13, "of the fleet's common clock", unit="s"),
        integer("level", 4, "of confidence: (level + 1) / 16; of passing obstacles: 13 in the first lap "
                "of the clock, and one more in each later lap, modulo 16 without 13"),
        integer("observer", 5, "slot"),
        integer("cells", 26, "16 digits to the base 3, the first cell lowest: 0 nothing said, 1 free, "
                "2 obstacle", accepted=range(CODES)),
    ),
)  # fmt: skip


class MapDigests(NamedTuple):
    """Digests of the 16 parts of a square of the map.

    Every 62 ms one robot sends those of the whole map. A robot that has another digest of a part
    answers with the digests of that part, or, at the lowest level, with the patches.
    """

    node: int
    salt: int
    digests: tuple[int, ...]


MAP_DIGESTS = FrameLayout(
    MapDigests, "MAP_DIGESTS", pgn=0xFF17, priority=7, sender=ROBOT,
    fields=(
        integer("node", 13, "which square: 0 to 4095 tiles of 16 patches, then 256 squares of 16 "
                "tiles, 16 of 256 tiles, and the whole map", accepted=range(NODES)),
        integer("salt", 3, "mixed into the digests: what collides with one salt differs with "
                "another"),
        integers("digests", DIGEST_BITS, FANOUT, "in the order of the Z curve"),
    ),
)  # fmt: skip
