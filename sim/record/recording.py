"""The frames, intents and things of a run, in memory, while it grows or after its end.

Columns are used instead of objects: 21 bytes a frame, so that hours of a full bus fit. One thread
may append while others read, because a row is valid once `count` includes it.
"""

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator
from hashlib import blake2b
from itertools import accumulate
from struct import Struct
from typing import Any

from protocol.frames.frame import Frame
from sim.files.candump import FrameColumns
from sim.record.scene import Scene

FRAMES_MAX = 8_000_000  # 168 MB; two hours of a full bus, half a day of a quiet one
DROP = FRAMES_MAX // 4  # number of the oldest frames that are dropped when it is full
NOW_US = 1_000_000  # an intent is current for this long; robots send five a second
HEAD = Struct("<IB")  # of a frame, for its hash: identifier, bytes of data
Row = tuple[int, Frame]
Notes = list[tuple[int, dict[str, Any]]]  # microseconds, plain values


class Recording:
    """Frames as columns, intents and obstacles with their times, and the scene they belong to."""

    def __init__(self, scene: Scene | None = None) -> None:
        self.scene = scene
        self.first, self.count = 0, 0  # frames `first` .. `count` - 1 are kept
        self.intents: Notes = []  # one robot each, see `sim.record.robot_intent`
        self.things: Notes = []  # obstacles in the world from then on: {"rows": [...]}
        self.ended = False  # whether nothing more will come
        # Microseconds, of a live bus: quiet is time, too.
        self.clock: Callable[[], int] | None = None
        self.forgets = False  # drops old data at any time: see `sim.record.live_recording`
        self.digest = FramesDigest()
        self._begin_at_us = 0
        self._t_us, self._identifiers = array("q"), array("I")
        self._lengths, self._data = bytearray(), bytearray()

    def write(self, t_us: int, frame: Frame) -> None:
        """Add the next frame; a time before that of the previous frame is raised to it."""
        self._t_us.append(max(t_us, self._t_us[-1]) if self._t_us else t_us)
        self._identifiers.append(frame.identifier)
        self._lengths.append(len(frame.data))
        self._data += frame.data.ljust(8, b"\0")
        self.digest.write(t_us, frame)
        self.count += 1
        if self.count - self.first > FRAMES_MAX:
            self._drop()

    def extend(self, columns: FrameColumns) -> None:
        """Add the frames of a log, as `write` does one by one; fewer than `DROP`."""
        if not columns.t_us:
            return
        newest_at_us = self._t_us[-1] if self._t_us else columns.t_us[0]
        all_at_us = accumulate(columns.t_us, max, initial=newest_at_us)
        next(all_at_us)
        self._t_us.extend(all_at_us)
        self._identifiers.extend(columns.identifiers)
        self._lengths += columns.lengths
        self._data += columns.data
        self.digest.extend(columns)
        self.count += len(columns.t_us)
        if self.count - self.first > FRAMES_MAX:
            self._drop()

    def rows(self) -> Iterator[Row]:
        """All frames that are kept; of a recording that is not written meanwhile."""
        lengths, data = bytes(self._lengths), bytes(self._data)
        return FrameColumns(self._t_us, self._identifiers, lengths, data).rows()

    def follow(self, clock: Callable[[], int]) -> None:
        """`clock`: microseconds, on the clock of the coming frames. Time continues on a silent
        bus."""
        self.clock, self._begin_at_us = clock, clock()

    def close(self) -> None:
        """Nothing more will come: a player may stop at the end."""
        self.ended = True

    def _drop(self) -> None:
        del (
            self._t_us[:DROP],
            self._identifiers[:DROP],
            self._lengths[:DROP],
            self._data[: 8 * DROP],
        )
        self.first += DROP
        for notes in (self.intents, self.things):
            del notes[: bisect_left(notes, self.begin_at_us, key=lambda note: note[0])]

    def tell(self, t_us: int, intent: dict[str, Any]) -> None:
        """Keep an intent of one robot, see `sim.record.robot_intent`."""
        self.intents.append((t_us, intent))

    def place(self, t_us: int, rows: Iterable[Iterable[float]]) -> None:
        """Keep obstacles as rows of `sim.world.walls`, metres: shape, x, y, half sides, cosine and
        sine."""
        self.things.append((t_us, {"rows": [list(row) for row in rows]}))

    def intents_at(self, now_us: int) -> Notes:
        """The intents of the second that ends now, oldest first."""
        first = bisect_right(self.intents, now_us - NOW_US, key=lambda note: note[0])
        end = bisect_right(self.intents, now_us, key=lambda note: note[0])
        return self.intents[first:end]

    def __getitem__(self, number: int) -> Row:
        at = number - self.first
        data = bytes(self._data[8 * at : 8 * at + self._lengths[at]])
        return self._t_us[at], Frame(self._identifiers[at], data)

    def t_us(self, number: int) -> int:
        """When the frame with this number was heard. The frame must still be kept."""
        return self._t_us[number - self.first]

    @property
    def begin_at_us(self) -> int:
        """Time of the oldest frame that is kept, or since when nothing was heard."""
        return self.t_us(self.first) if self.count > self.first else self._begin_at_us

    @property
    def end_at_us(self) -> int:
        """The time of the newest row of any kind; of a live bus: now."""
        if self.clock is not None and not self.ended:
            return max(self.clock(), self._newest_at_us or 0)
        ends = [self.t_us(self.count - 1)] if self.count > self.first else [0]
        ends += [notes[-1][0] for notes in (self.intents, self.things) if notes]
        return max(ends)

    @property
    def quiet_for_us(self) -> int:
        """Time since the newest frame of a live bus; 0 for a recording."""
        if self.clock is None or self.ended:
            return 0
        newest_at_us = self._newest_at_us
        return self.end_at_us - (self._begin_at_us if newest_at_us is None else newest_at_us)

    @property
    def _newest_at_us(self) -> int | None:
        return self.t_us(self.count - 1) if self.count > self.first else None


class FramesDigest:
    """One hash of all frames in their order: equal for equal runs, whatever the format of the log.

    Times are not part of it, because formats round them differently.
    """

    def __init__(self) -> None:
        self._hash = blake2b(digest_size=8)

    def write(self, t_us: int, frame: Frame) -> None:
        """Add one frame. Its time does not count, because formats round it."""
        self._hash.update(frame.identifier.to_bytes(4, "little") + bytes((len(frame.data),)))
        self._hash.update(frame.data)

    def extend(self, columns: FrameColumns) -> None:
        """Add the frames of a log, as `write` does one by one."""
        data, head = columns.data, HEAD.pack
        self._hash.update(
            b"".join(
                [
                    head(identifier, length) + data[at : at + length]
                    for identifier, length, at in zip(
                        columns.identifiers, columns.lengths, range(0, len(data), 8), strict=True
                    )
                ]
            )
        )

    def close(self) -> None:
        """Nothing to close; exists so that a digest can replace a log."""

    @property
    def hex(self) -> str:
        """The hash so far, in hexadecimal."""
        return self._hash.hexdigest()
