"""The recent frames and intents of a live bus, in memory that is allocated at the start and never
grows.

Frames and intents are stored in rings. For times before the ring of frames, only the snapshots in
the index of a map exist, at intervals that grow with their age. A launch also keeps its logs on
disk.
"""

import json
import zlib
from array import array
from bisect import bisect_right
from typing import Any

from protocol.frames.frame import Frame
from sim.record.recording import Notes, Recording, Row
from sim.record.scene import Scene

FRAMES = 2_000_000  # 42 MB; 22 minutes of a full bus, two and a half hours of ten robots
FINE_BYTES, FINE_ROWS = 24_000_000, 120_000  # every intent: about half an hour of ten robots
# One of each robot in COARSE_US: about four hours of ten.
COARSE_BYTES, COARSE_ROWS = (8_000_000, 40_000)
COARSE_US = 5_000_000
FINE_US = 1_000_000  # robots send five intents a second
FAST = 1  # level of zlib: a tenth of a millisecond for an intent


class LiveRecording(Recording):
    """A recording that forgets: the newest frames are kept, intents finely for a short time and
    coarsely for a long one."""

    def __init__(self, scene: Scene | None = None) -> None:
        super().__init__(scene)
        self.forgets = True
        self._t_us, self._identifiers = array("q", bytes(8 * FRAMES)), array("I", bytes(4 * FRAMES))
        # Made from bytes, not from a size, because memory that is only reserved would be allocated
        # gradually.
        self._lengths, self._data = bytearray(bytes(FRAMES)), bytearray(bytes(8 * FRAMES))
        self._fine = NoteRing(FINE_BYTES, FINE_ROWS)
        self._coarse = NoteRing(COARSE_BYTES, COARSE_ROWS)
        self._coarse_at_us: dict[int, int] = {}

    def write(self, t_us: int, frame: Frame) -> None:
        at = self.count % FRAMES
        newest_at_us = self.t_us(self.count - 1) if self.count else t_us
        self._t_us[at], self._identifiers[at] = max(t_us, newest_at_us), frame.identifier
        self._lengths[at] = len(frame.data)
        self._data[8 * at : 8 * at + 8] = frame.data.ljust(8, b"\0")
        self.digest.write(t_us, frame)
        self.count += 1
        self.first = max(self.count - FRAMES, 0)

    def __getitem__(self, number: int) -> Row:
        at = number % FRAMES
        data = bytes(self._data[8 * at : 8 * at + self._lengths[at]])
        return self._t_us[at], Frame(self._identifiers[at], data)

    def t_us(self, number: int) -> int:
        """When the frame with this number was heard. The frame must still be kept."""
        return self._t_us[number % FRAMES]

    def tell(self, t_us: int, intent: dict[str, Any]) -> None:
        """Keep an intent in the fine ring, and now and then in the coarse one."""
        self._fine.append(t_us, intent)
        slot = int(intent["slot"])
        if t_us - self._coarse_at_us.get(slot, t_us - COARSE_US) >= COARSE_US:
            self._coarse_at_us[slot] = t_us
            self._coarse.append(t_us, intent)

    def intents_at(self, now_us: int) -> Notes:
        """For old times, the newest intent of each robot, as if it were sent then."""
        if now_us - FINE_US >= self._fine.begin_at_us:
            return self._fine.between(now_us - FINE_US, now_us)
        return [(now_us, note) for _, note in self._coarse.between(now_us - COARSE_US, now_us)]


class NoteRing:
    """Plain values with their times, in a fixed number of bytes and rows; the oldest are dropped
    first."""

    def __init__(self, size: int, rows: int) -> None:
        """`size`: bytes, compressed."""
        self.first, self.count = 0, 0
        # `_end`: number of all bytes ever written.
        self._size, self._rows, self._end = size, rows, 0
        self._data = bytearray(bytes(size))
        self._t_us, self._at = array("q", bytes(8 * rows)), array("q", bytes(8 * rows))
        self._lengths = array("I", bytes(4 * rows))

    def append(self, t_us: int, value: dict[str, Any]) -> None:
        """`t_us`: not before the previous one. A value larger than the ring is skipped."""
        # Rounded decimals compress better than MessagePack's doubles: by a fifth to a third.
        data = zlib.compress(json.dumps(value, separators=(",", ":")).encode(), FAST)
        if len(data) > self._size:
            return
        left = self._size - self._end % self._size
        begin = self._end if len(data) <= left else self._end + left  # so that it is contiguous
        at = begin % self._size
        self._data[at : at + len(data)] = data
        self._end = begin + len(data)
        row = self.count % self._rows
        self._t_us[row], self._at[row], self._lengths[row] = t_us, begin, len(data)
        self.count += 1
        self.first = max(self.first, self.count - self._rows)
        while self._at[self.first % self._rows] < self._end - self._size:
            self.first += 1

    @property
    def begin_at_us(self) -> int:
        """Time of the oldest note that is kept; 0 if there is none."""
        return self._t_us[self.first % self._rows] if self.count else 0

    def between(self, begin_at_us: int, end_at_us: int) -> Notes:
        """Values later than the first time and not later than the second; oldest first."""
        rows = range(self.first, self.count)

        def time_of(number: int) -> int:
            return self._t_us[number % self._rows]

        begin = bisect_right(rows, begin_at_us, key=time_of)
        end = bisect_right(rows, end_at_us, key=time_of)
        return [self._note(number) for number in rows[begin:end]]

    def _note(self, number: int) -> tuple[int, dict[str, Any]]:
        row = number % self._rows
        at = self._at[row] % self._size
        data = self._data[at : at + self._lengths[row]]
        return self._t_us[row], json.loads(zlib.decompress(data))
