"""The broadcast manager of SocketCAN, as socketcand offers it to each client: cyclic sending, filters.

Sans I/O: commands and frames with their time go in, what is to be sent or told comes out. The rules are
those of doc/protocol.md of socketcand and of the Linux broadcast manager behind it.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

from protocol.frames.frame import Frame

JOBS_MAX: Final = 64  # cyclic frames of one client
FILTERS_MAX: Final = 256  # identifiers of one client
PERIOD_MIN_US: Final = 1_000  # a shorter one would fill the bus with one frame
NEVER_US: Final = 1 << 62
MASKS_MAX: Final = 257  # one multiplex mask and 256 contents, as in Linux

Key = tuple[bool, int]  # whether the identifier has 29 bits, and the identifier


class BroadcastError(Exception):
    """A command that cannot be obeyed; the text says why."""


class _Job:
    """A frame that is sent cyclically."""

    def __init__(self, frame: Frame, period_us: int, now_us: int) -> None:
        self.frame, self.period_us = frame, period_us
        self.due_at_us = now_us + period_us if period_us else NEVER_US


class _Filter:
    """What a client gets of one identifier: all frames, or those whose content changes under a mask."""

    def __init__(self, masks: tuple[bytes, ...], gap_for_us: int) -> None:
        self.masks, self.gap_for_us = masks, gap_for_us  # no masks: every frame
        self.last: dict[int, bytes] = {}  # by number of the mask
        self.held: Frame | None = None  # the newest, until it may be told
        self.due_at_us = NEVER_US  # when the next may be told; NEVER: at once

    def takes(self, data: bytes) -> bool:
        """Whether this content is new."""
        if not self.masks:
            return True
        number = self._which(data)
        if number is None:
            return False
        mask = self.masks[number]
        content = _masked(data, mask)
        known = self.last.get(number)
        self.last[number] = content
        return known != content

    def _which(self, data: bytes) -> int | None:
        """The mask that counts: the only one, or that of the multiplex number in the data."""
        if len(self.masks) == 1:
            return 0
        where = self.masks[0]
        told = _masked(data, where)
        return next(
            (k for k in range(1, len(self.masks)) if _masked(self.masks[k], where) == told), None
        )


class BroadcastManager:
    """The jobs and filters of one client."""

    def __init__(self) -> None:
        self._jobs: dict[Key, _Job] = {}
        self._filters: dict[Key, _Filter] = {}

    @property
    def due_at_us(self) -> int:
        """When `on_timer` next has something to do."""
        jobs = (job.due_at_us for job in self._jobs.values())
        filters = (f.due_at_us for f in self._filters.values())
        return min(min(jobs, default=NEVER_US), min(filters, default=NEVER_US))

    def add(self, key: Key, frame: Frame, period_us: int, now_us: int) -> Frame:
        """Send a frame now and then each `period_us`; 0: only now. Returns the frame to send now.

        A job of the same identifier is replaced. Raises BroadcastError if there are too many.
        """
        if key not in self._jobs and len(self._jobs) >= JOBS_MAX:
            raise BroadcastError(f"{JOBS_MAX} send jobs at most")
        self._jobs[key] = _Job(frame, max(period_us, PERIOD_MIN_US) if period_us else 0, now_us)
        return frame

    def update(self, key: Key, frame: Frame) -> None:
        """New content for a job; its time stays. Raises BroadcastError if there is no such job."""
        if key not in self._jobs:
            raise BroadcastError("no send job of this identifier")
        self._jobs[key].frame = frame

    def delete(self, key: Key) -> None:
        """End a job. Raises BroadcastError if there is none."""
        if self._jobs.pop(key, None) is None:
            raise BroadcastError("no send job of this identifier")

    def subscribe(self, key: Key, gap_for_us: int, masks: tuple[bytes, ...] = ()) -> None:
        """Tell frames of this identifier, at most one each `gap_for_us`.

        `masks`: none: every frame; one: frames that change under it; more: the first is the
        multiplex mask, the others are a multiplex number with its mask. Replaces an earlier one.
        Raises BroadcastError if there are too many.
        """
        if key not in self._filters and len(self._filters) >= FILTERS_MAX:
            raise BroadcastError(f"{FILTERS_MAX} filters at most")
        self._filters[key] = _Filter(masks, gap_for_us)

    def unsubscribe(self, key: Key) -> None:
        """End the subscription of this identifier. Raises BroadcastError if there is none."""
        if self._filters.pop(key, None) is None:
            raise BroadcastError("no subscription of this identifier")

    def hear(self, key: Key, frame: Frame, now_us: int) -> Frame | None:
        """A frame on the bus: returned if it is to be told now."""
        found = self._filters.get(key)
        if found is None or not found.takes(frame.data):
            return None
        if found.due_at_us != NEVER_US and now_us < found.due_at_us:
            found.held = frame
            return None
        if found.gap_for_us:
            found.due_at_us = now_us + found.gap_for_us
        return frame

    def on_timer(self, now_us: int) -> "Iterator[Due]":
        """What is due: frames to send, and frames that were held back to tell."""
        for job in self._jobs.values():
            if job.due_at_us <= now_us:
                missed = (now_us - job.due_at_us) // job.period_us
                job.due_at_us += (missed + 1) * job.period_us
                yield Due(job.frame, True)
        for found in self._filters.values():
            if found.due_at_us > now_us:
                continue
            held, found.held = found.held, None
            found.due_at_us = now_us + found.gap_for_us if held is not None else NEVER_US
            if held is not None:
                yield Due(held, False)


class Due(NamedTuple):
    """A frame to send to the bus, or to tell the client."""

    frame: Frame
    sends: bool


def _masked(data: bytes, mask: bytes) -> bytes:
    """The bits that count; data that ends before the mask has zeros there."""
    return bytes(a & b for a, b in zip(data.ljust(8, b"\0"), mask.ljust(8, b"\0"), strict=True))
