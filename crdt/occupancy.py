"""The fleet's map: for each cell the record of one robot, joined by one total order.

Cells lie in patches of 4 x 4, the content of one frame. Patches are numbered along the Z-order
curve (Morton 1966), so 16 consecutive patches are a square tile of 16 x 16 cells, 16 tiles a square
of tiles, and a digest of any square is a sum over a slice. A patch is a row of `_keys`;
`crdt.sighting` defines a key. The explored cells are a separate set that only grows, so progress
never goes back.
"""

from collections.abc import Iterable, Iterator
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from crdt.sighting import (
    OBSERVER_MAX,
    OBSTACLE,
    RECORD_MASK,
    UNKNOWN,
    VALUE,
    CellObservation,
    MergeOrder,
    base,
    unpack,
)

Keys = NDArray[np.int64]
SIDE = 4  # cells of a patch, each way
CELLS = SIDE * SIDE
FANOUT = 16  # squares in the next larger one
SIDE_MAX = 960  # cells each way: patch numbers stay below 0xFF00; higher numbers are other sections
HEAD = Struct("<HHdddB")  # rows, columns, origin, side of a cell, order
PATCH = Struct("<H")
PATCH_BYTES = 3 * CELLS
EDGE = 1e-6  # of a cell: centres on a border of two cells belong to one of them
ORDERS = tuple(MergeOrder)


class MergeResult(NamedTuple):
    """What a merge of several robots' maps brought."""

    cells_updated: int  # without updates, all robots explore what is known, spread out
    robots_merged: int
    merged_at_us: int


class Geometry(NamedTuple):
    """Maps cells to squares of the world. Row 0 is in the south, column 0 in the west."""

    rows: int
    columns: int
    origin_m: tuple[float, float]  # the south-western corner
    cell_m: float

    def centre(self, row: int, column: int) -> tuple[float, float]:
        """The centre of a cell in the world: metres (x, y)."""
        return (
            self.origin_m[0] + (column + 0.5) * self.cell_m,
            self.origin_m[1] + (row + 0.5) * self.cell_m,
        )

    def cell(self, at: tuple[float, float]) -> tuple[int, int]:
        """Row and column of the cell that contains a place (x, y), in metres; may be outside of the
        map."""
        row = (at[1] - self.origin_m[1]) / self.cell_m
        return int(row // 1), int((at[0] - self.origin_m[0]) / self.cell_m // 1)

    def holds(self, at: tuple[float, float]) -> bool:
        """Whether a place (x, y), in metres, is in a cell of the map."""
        row, column = self.cell(at)
        return 0 <= row < self.rows and 0 <= column < self.columns


def patch_of(row: int, column: int) -> int:
    """The number of the patch of a cell."""
    return _spread(row // SIDE) << 1 | _spread(column // SIDE)


def corner_of(patch: int) -> tuple[int, int]:
    """Row and column of a patch's first cell."""
    return SIDE * _gather(patch >> 1), SIDE * _gather(patch)


def _spread(number: int) -> int:
    return sum((number >> k & 1) << 2 * k for k in range(8))


def _gather(number: int) -> int:
    return sum((number >> 2 * k & 1) << k for k in range(8))


class OccupancyMap:
    """The replicated map of one robot: (rows, columns) cells, stored patch by patch.

    Maps of one `order` join, whatever their geometries are. Mutable and owned by one peer.
    """

    def __init__(self, geometry: Geometry, order: MergeOrder = MergeOrder.MAX_CONFIDENCE) -> None:
        rows, columns, _, cell_m = geometry
        assert 0 < rows <= SIDE_MAX and 0 < columns <= SIDE_MAX and cell_m > 0
        self.geometry, self.order = geometry, order
        r, c = np.arange(rows), np.arange(columns)
        high = np.array([_spread(k) << 1 for k in range((rows + 3) // SIDE)], dtype=np.int64)
        low = np.array([_spread(k) for k in range((columns + 3) // SIDE)], dtype=np.int64)
        patch = high[r // SIDE][:, None] + low[c // SIDE][None, :]
        self._place: Keys = patch * CELLS + (r % SIDE)[:, None] * SIDE + (c % SIDE)[None, :]
        patches = FANOUT
        while patches <= int(patch.max()):
            patches *= FANOUT
        self._keys: Keys = np.zeros((patches, CELLS), dtype=np.int64)
        self._inside = np.zeros((patches, CELLS), dtype=np.bool_)
        self._inside.ravel()[self._place.ravel()] = True
        self._explored = np.zeros((patches, CELLS), dtype=np.bool_)
        self._sums = np.zeros(patches, dtype=np.uint64)
        self._stale: set[int] = set()  # patches whose present content is not in the sums yet
        self.explored_count = 0
        self.refused = 0  # received cells that are not on the map
        self.version = 0  # number of joins that changed the map

    @property
    def patches(self) -> int:
        """The size of the range of patch numbers: a power of 16."""
        return len(self._keys)

    # ---------------------------------------------------------------- joining

    def apply(
        self, patch: int, values: NDArray[np.int64], level: int, time: int, observer: int
    ) -> int:
        """Join one robot's view of one patch at one time; returns the number of changed cells.

        `values` are the 16 cells of the patch row by row, shape (16,); UNKNOWN says nothing of a
        cell. `level` is the confidence, `time` seconds of the fleet's clock.
        """
        keys = np.where(values != UNKNOWN, self.base(level, time, observer) | values, 0)
        return self.join(patch, keys)

    def base(self, level: int, time: int, observer: int) -> int:
        """The key of a record without its value, as `crdt.sighting.base`."""
        return base(self.order, level, time, observer)

    def stamp(self, level: int, time: int) -> tuple[int, int]:
        """A level and a time as the wire has them."""
        return level, time

    def time_of(self, level: int, stamp: int, now: int) -> int:
        """The time, in seconds, of a level and a `stamp` of as many seconds on the wire. `now`: what our
        clock shows."""
        return stamp

    def join(self, patch: int, keys: Keys) -> int:
        """Join the 16 `keys` of one patch, shape (16,), row by row; returns the number of changed
        cells.

        Cells that are not on the map are not joined, only counted in `refused`.
        """
        if patch >= len(self._keys):
            self.refused += int(np.count_nonzero(keys))
            return 0
        outside = (keys > 0) & ~self._inside[patch]
        if outside.any():
            self.refused += int(np.count_nonzero(outside))
            keys = np.where(outside, 0, keys)
        known = self._keys[patch]
        changed = int(np.count_nonzero(keys > known))
        if changed:
            np.maximum(known, keys, out=known)
            self._grow(patch)
        return changed

    def _grow(self, patch: int) -> None:
        explored = self._explored[patch]
        before = int(np.count_nonzero(explored))
        np.logical_or(explored, self._keys[patch] > 0, out=explored)
        self.explored_count += int(np.count_nonzero(explored)) - before
        self._stale.add(patch)
        self.version += 1

    def join_map(self, other: "OccupancyMap") -> int:
        """Join a whole map, of any size, origin and cell size. Returns the number of changed
        cells."""
        assert other.order is self.order, "maps of different orders do not join"
        theirs = other if other.geometry == self.geometry else resample(other, self.geometry)
        keys = theirs._keys
        changed = 0
        for patch in np.flatnonzero((keys > self._keys).any(axis=1)).tolist():
            changed += self.join(patch, keys[patch])
        for patch in np.flatnonzero((theirs._explored & ~self._explored).any(axis=1)).tolist():
            self._explored[patch] |= theirs._explored[patch]
        self.explored_count = int(np.count_nonzero(self._explored))
        return changed

    def merge(self, others: Iterable["OccupancyMap"], merged_at_us: int) -> MergeResult:
        """Join the maps of some robots; returns the values that the mission needs."""
        changed = [self.join_map(other) for other in others]
        return MergeResult(sum(changed), len(changed), merged_at_us)

    # ---------------------------------------------------------------- reading

    def sighting(self, row: int, column: int) -> CellObservation | None:
        """The record of a cell; None if no robot saw it."""
        key = int(self._keys.ravel()[self._place[row, column]])
        return unpack(key) if key else None

    def keys(self) -> Keys:
        """(rows, columns), a copy; 0 for cells that no robot saw."""
        found: Keys = self._keys.ravel()[self._place]
        return found

    def values(self) -> NDArray[np.int64]:
        """(rows, columns): UNKNOWN, FREE or OBSTACLE."""
        return self.keys() & VALUE

    def observers(self) -> NDArray[np.int64]:
        """(rows, columns): the slot whose record is valid; meaningless for cells that no robot
        saw."""
        return self.keys() >> 2 & OBSERVER_MAX

    def explored(self) -> NDArray[np.bool_]:
        """(rows, columns): whether any robot has ever seen a cell; a copy."""
        found: NDArray[np.bool_] = self._explored.ravel()[self._place]
        return found

    @property
    def progress(self) -> float:
        """Share of the cells that any robot has ever seen."""
        return self.explored_count / (self.geometry.rows * self.geometry.columns)

    def patch(self, patch: int) -> Keys:
        """The 16 keys of a patch, row by row, a copy."""
        keys: Keys = self._keys[patch].copy()
        return keys

    def known_patches(self) -> Iterator[int]:
        """The numbers of the patches with at least one record, in ascending order."""
        yield from np.flatnonzero(self._keys.any(axis=1)).tolist()

    # ---------------------------------------------------------------- digests

    def sums(self) -> NDArray[np.uint64]:
        """A hash of each patch, modulo 2**64; 0 if nothing is known of it."""
        if self._stale:
            rows = np.array(sorted(self._stale), dtype=np.int64)
            keys = self._on_wire(self._keys[rows])
            names = rows[:, None] * CELLS + np.arange(CELLS)
            mixed = mix(mix(names.astype(np.uint64)) ^ keys.astype(np.uint64))
            self._sums[rows] = np.where(keys > 0, mixed, np.uint64(0)).sum(axis=1, dtype=np.uint64)
            self._stale.clear()
        return self._sums

    def _on_wire(self, keys: Keys) -> Keys:
        return keys

    @property
    def digest(self) -> int:
        """64 bits of all records."""
        return int(self.sums().sum(dtype=np.uint64))

    # ---------------------------------------------------------------- bytes

    def patch_bytes(self, patch: int) -> bytes:
        """The records of a patch, 3 bytes a cell, row by row, little-endian."""
        records = (self._keys[patch] & RECORD_MASK).astype("<u4")
        return bytes(records.view(np.uint8).reshape(CELLS, 4)[:, :3].tobytes())

    def join_bytes(self, patch: int, data: bytes) -> int:
        """Join what `patch_bytes` made elsewhere; returns the number of changed cells. Raises
        ValueError if these are not the records of a patch."""
        if len(data) != PATCH_BYTES:
            raise ValueError(f"a patch does not have {len(data)} bytes")
        records = [int.from_bytes(data[k : k + 3], "little") for k in range(0, PATCH_BYTES, 3)]
        if any(record & VALUE > OBSTACLE for record in records):
            raise ValueError("a cell has no such value")
        keys = [self._key(record) if record & VALUE else 0 for record in records]
        return self.join(patch, np.array(keys, dtype=np.int64))

    def _key(self, record: int) -> int:
        value, level, time, observer = unpack(record)
        return self.base(level, time, observer) | value

    def serialize(self) -> bytes:
        """Equal maps give equal bytes."""
        rows, columns, origin, cell_m = self.geometry
        head = HEAD.pack(rows, columns, *origin, cell_m, ORDERS.index(self.order))
        known = [PATCH.pack(p) + self.patch_bytes(p) for p in self.known_patches()]
        return head + b"".join(known)

    @classmethod
    def deserialize(cls, data: bytes) -> "OccupancyMap":
        """The map that `serialize` wrote. Raises ValueError if the bytes are not one."""
        size = PATCH.size + PATCH_BYTES
        if len(data) < HEAD.size or (len(data) - HEAD.size) % size:
            raise ValueError(f"a map does not have {len(data)} bytes")
        rows, columns, x, y, cell_m, order = HEAD.unpack_from(data)
        sound = 0 < rows <= SIDE_MAX and 0 < columns <= SIDE_MAX and 0 < cell_m < np.inf
        if not sound or not np.isfinite(x + y) or order >= len(ORDERS):
            raise ValueError("the head of the map is damaged")
        replica = cls(Geometry(rows, columns, (x, y), cell_m), ORDERS[order])
        for at in range(HEAD.size, len(data), size):
            (patch,) = PATCH.unpack_from(data, at)
            replica.join_bytes(patch, data[at + PATCH.size : at + size])
        return replica

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, OccupancyMap):
            return NotImplemented
        same = self.geometry == other.geometry and self.order is other.order
        return same and np.array_equal(self._keys, other._keys)

    # It is mutable, so it has no hash: `__eq__` without `__hash__` says so.


def mix(numbers: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """`crdt.digest.mix` of each of `numbers`, an array of any shape; the result has the same shape."""
    n = numbers + np.uint64(0x9E3779B97F4A7C15)
    n = (n ^ n >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
    n = (n ^ n >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
    return n ^ n >> np.uint64(31)


def resample(source: OccupancyMap, geometry: Geometry) -> OccupancyMap:
    """A map on other cells: each takes the greatest record of the cells with which it shares a
    centre.

    It is a maximum of maxima, so resampling a join equals joining resampled maps, in any order.
    """
    result = OccupancyMap(geometry, source.order)
    coarse, fine = np.zeros((geometry.rows, geometry.columns), dtype=np.int64), source.keys()
    # Our centres in their cells, then their centres in ours.
    rows, columns = _indices(geometry, source.geometry)
    r, c = np.flatnonzero(rows >= 0), np.flatnonzero(columns >= 0)
    coarse[np.ix_(r, c)] = fine[np.ix_(rows[r], columns[c])]
    rows, columns = _indices(source.geometry, geometry)
    r, c = np.flatnonzero(rows >= 0), np.flatnonzero(columns >= 0)
    places = rows[r][:, None] * geometry.columns + columns[c][None, :]
    np.maximum.at(coarse.ravel(), places, fine[np.ix_(r, c)])
    result._keys.ravel()[result._place] = coarse
    for patch in result.known_patches():
        result._grow(patch)
    return result


def _indices(of: Geometry, within: Geometry) -> tuple[Keys, Keys]:
    """For each row and column of `of`, the one of `within` that contains its centre, or -1."""
    found = []
    for count, axis, limit in ((of.rows, 1, within.rows), (of.columns, 0, within.columns)):
        centres = of.origin_m[axis] + (np.arange(count) + 0.5) * of.cell_m
        index = np.floor((centres - within.origin_m[axis]) / within.cell_m + EDGE).astype(np.int64)
        found.append(np.where((index >= 0) & (index < limit), index, -1))
    return found[0], found[1]
