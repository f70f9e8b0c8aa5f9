"""A robot's durable memory in a simulation: plain, or on a disk that can lose power between two
writes.

`Disk` keeps synced data apart from data that was only written. A power cut keeps any first part of
the unsynced writes, tears the next one sector by sector, and drops the rest. POSIX allows this, and
it is worse than what a good disk does. `LogJournal` is the `Journal` port on such a disk.
"""

from collections.abc import Iterable, Mapping
from random import Random
from struct import Struct
from zlib import crc32

from agent.interface.effects import Persist
from agent.peer.journal_recovery import LOST

SECTOR = 512  # a disk writes these bytes whole or not at all; a torn sector may hold anything
HEAD = Struct("<III")  # length, number and CRC-32 of a batch
FIELD = Struct("<HI")  # lengths of key and value


class PowerCut(Exception):
    """The process that was writing has lost its power."""


class MemoryJournal:
    """The `Journal` port, kept outside of the robot, so that it survives the robot's death."""

    def __init__(self) -> None:
        self.records: dict[str, bytes] = {}
        self.writes = 0

    def load(self) -> Mapping[str, bytes]:
        """A copy of all records."""
        return dict(self.records)

    def write(self, records: Iterable[Persist]) -> None:
        """Keep the newest value of each key."""
        self.writes += 1
        self.records.update(records)


class Disk:
    """One file on a disk. Every write and every sync is a step; a fault can be set at any step."""

    def __init__(self, image: bytes = b"") -> None:
        self.steps = 0
        self.cut_at: int | None = None  # this step is not executed and raises PowerCut
        self.fail_at: int | None = None  # this step and all later ones raise OSError
        self._synced = bytearray(image)
        self._unsynced: list[tuple[int, bytes]] = []

    def fill(self) -> None:
        """From now on every write fails."""
        self.fail_at = self.steps + 1

    @property
    def full(self) -> bool:
        """Whether writes fail from now on."""
        return self.fail_at is not None and self.steps + 1 >= self.fail_at

    def write(self, at: int, data: bytes) -> None:
        """Write bytes from position `at` on. They are durable only after the next sync."""
        self._step()
        self._unsynced.append((at, bytes(data)))

    def sync(self) -> None:
        """Make everything durable that was written before."""
        self._step()
        for at, data in self._unsynced:
            _put(self._synced, at, data)
        self._unsynced.clear()

    def read(self) -> bytes:
        """The content as a living process reads it, synced or not."""
        seen = bytearray(self._synced)
        for at, data in self._unsynced:
            _put(seen, at, data)
        return bytes(seen)

    def after_cut(self, rng: Random) -> "Disk":
        """One of the states that a power cut now may leave on the disk, drawn at random."""
        image, unsynced = bytearray(self._synced), self._unsynced
        kept = rng.randint(0, len(unsynced))
        for at, data in unsynced[:kept]:
            _put(image, at, data)
        if kept < len(unsynced):
            tear(image, *unsynced[kept], rng)
        return Disk(bytes(image))

    def _step(self) -> None:
        self.steps += 1
        if self.cut_at is not None and self.steps >= self.cut_at:
            raise PowerCut(f"at step {self.steps}")
        if self.fail_at is not None and self.steps >= self.fail_at:
            raise OSError("input/output error")


def _put(image: bytearray, at: int, data: bytes) -> None:
    if len(image) < at:
        image.extend(bytes(at - len(image)))
    image[at : at + len(data)] = data


def tear(image: bytearray, at: int, data: bytes, rng: Random) -> None:
    """Apply an interrupted write: each sector is old, new, or (at most one of them) garbage."""
    first, last = at // SECTOR, (at + len(data) - 1) // SECTOR
    # Values beyond `last`, half of the cases, mean none.
    garbled = rng.randint(first, 2 * last - first + 1)
    for sector in range(first, last + 1):
        begin, end = max(at, sector * SECTOR), min(at + len(data), (sector + 1) * SECTOR)
        if sector == garbled:
            _put(image, begin, rng.randbytes(end - begin))
        elif rng.random() < 0.5:
            _put(image, begin, data[begin - at : end - at])


class LogJournal:
    """The `Journal` port as a log of numbered, checked batches on a `Disk`.

    The mark is a second place that holds the number of the newest batch. A log that ends before its
    mark was rolled back; it recalls only that its memory is lost.
    (`agent/runtime/sqlite_journal.py` does the same with files.)

    `synced=False` is the planted bug: a journal that forgets to sync, and that a campaign must
    find.
    """

    def __init__(self, disk: Disk, synced: bool = True, mark: int = 0) -> None:
        self.disk, self.synced, self.mark = disk, synced, mark
        # A person restored an earlier state; then a loss of memory is no fault.
        self.restored = False
        self._records: dict[str, bytes] = {}
        self._end = self._batches = 0
        # Check of the previous batch: a batch that was written after another one does not match.
        self._last = 0
        self._recover(disk.read())
        if self._rolled_back:
            self._forget("the journal was rolled back")

    @property
    def _rolled_back(self) -> bool:
        return self._batches < self.mark

    def _forget(self, why: str) -> None:
        self.disk, self.mark = Disk(), 0
        self._end = self._batches = self._last = 0
        self._records = {LOST: why.encode()}

    def earlier(self, share: float) -> "LogJournal":
        """A fault: the journal with this share of its batches, but with the newest mark."""
        image, end = self.disk.read(), 0
        for _ in range(int(self._batches * share)):
            end += HEAD.size + HEAD.unpack_from(image, end)[0]
        journal = LogJournal(Disk(image[:end]), self.synced, self.mark)
        journal.restored = True
        return journal

    def after_cut(self, rng: Random) -> "LogJournal":
        """One of the states that a power cut now may leave of the journal, drawn at random."""
        return LogJournal(self.disk.after_cut(rng), mark=self.mark)

    def load(self) -> Mapping[str, bytes]:
        """The newest value of each key, from the batches that were whole."""
        return dict(self._records)

    def write(self, records: Iterable[Persist]) -> None:
        """Write all of them or none."""
        batch = list(records)
        body = b"".join(
            FIELD.pack(len(key.encode()), len(value)) + key.encode() + value for key, value in batch
        )
        check = self._check(self._batches, body)
        self.disk.write(self._end, HEAD.pack(len(body), self._batches, check) + body)
        if self.synced:
            self.disk.sync()
        self._last = check
        self._end += HEAD.size + len(body)
        self._batches += 1
        self._records.update(batch)
        self.mark = self._batches

    def _recover(self, image: bytes) -> None:
        """Read batches up to the first incomplete one, which was never acknowledged."""
        while self._end + HEAD.size <= len(image):
            length, number, check = HEAD.unpack_from(image, self._end)
            body = image[self._end + HEAD.size : self._end + HEAD.size + length]
            whole = len(body) == length and number == self._batches
            if not whole or check != self._check(number, body):
                return
            at = 0
            while at < length:
                key_size, value_size = FIELD.unpack_from(body, at)
                middle = at + FIELD.size + key_size
                key = body[at + FIELD.size : middle].decode()
                self._records[key] = body[middle : middle + value_size]
                at = middle + value_size
            self._last = check
            self._end += HEAD.size + length
            self._batches += 1

    def _check(self, number: int, body: bytes) -> int:
        return crc32(body, self._last ^ (number + 1))
