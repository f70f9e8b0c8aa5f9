"""A playhead over a recording: the time that a person looks at, and the state of the watcher then.

The state at any time is that of the last snapshot before it, and the frames since. Snapshots are made
once for all viewers, by the index, which hears every frame as it comes. For a live bus the snapshots
are kept longer than the frames, and fewer of the older ones are kept.
"""

import pickle
import zlib
from bisect import bisect_right
from collections import deque
from itertools import pairwise
from time import perf_counter
from typing import NamedTuple

from sim.record.recording import Recording
from tools.livemap.event_notes import EventNotes, NotedEvent
from tools.livemap.map_state import Watcher

SNAPSHOT_US = 10_000_000
SPEED_MAX = 256.0
AGES = 16  # snapshots thin out with age: the gap round one is at least its age divided by this
EVENTS_MAX = 512  # most marks on the time line; more cannot be distinguished
FAST = 1  # level of zlib: a snapshot in a millisecond, in a fifth of its size
NOTE_US = 500_000  # of recorded time between two looks for events
QUIET_US = 5_000_000  # without a frame or an intent: nothing changes any more until the next one
LOOK = 512  # rows between two looks at the clock


class Snapshot(NamedTuple):
    """All that a watcher knew at one instant, compressed."""

    t_us: int
    frame: int  # the first frame after it
    state: bytes  # compressed

    def watcher(self) -> Watcher:
        """A copy of the watcher at one time."""
        watcher: Watcher = pickle.loads(zlib.decompress(self.state))
        return watcher


class Reader:
    """A watcher, and how far in the recording it has heard."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.watcher = Watcher(recording.scene)
        self.frame, self.t_us = recording.first, recording.begin_at_us

    def read(self, end_at_us: int, budget_s: float) -> bool:
        """Hear everything up to then; False where the time was not enough."""
        recording, watcher = self.recording, self.watcher
        end_s = perf_counter() + budget_s
        if self.frame < recording.first and recording.begin_at_us <= end_at_us:
            self.frame = recording.first  # what was between is forgotten
        while recording.first <= self.frame < recording.count:
            t_us, frame = recording[self.frame]
            if t_us > end_at_us:
                break
            watcher.hear(t_us / 1e6, frame)
            self.frame, self.t_us = self.frame + 1, t_us
            if self.frame % LOOK == 0 and perf_counter() > end_s:
                return False
        self.t_us = max(self.t_us, end_at_us)
        watcher.now_s = self.t_us / 1e6
        watcher.forget(watcher.now_s)
        return True


class Index:
    """Hears everything once, and keeps snapshots on the way."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.reader = Reader(recording)
        self.snapshots: list[Snapshot] = []
        self.events: deque[NotedEvent] = deque(
            maxlen=EVENTS_MAX
        )  # for the line of time and the list
        self.noted = 0  # events in all
        self._notes = EventNotes()

    @property
    def complete(self) -> bool:
        """Whether every frame of the recording was read."""
        return self.reader.frame >= self.recording.count

    def work(self, budget_s: float) -> None:
        """Hear what is new, for at most this long."""
        end_s = perf_counter() + budget_s
        reader, recording = self.reader, self.recording
        while reader.frame < recording.count and perf_counter() < end_s:
            due_at_us = (
                self.snapshots[-1].t_us + SNAPSHOT_US if self.snapshots else recording.begin_at_us
            )
            left_s = end_s - perf_counter()
            to_us = min(due_at_us, reader.t_us + NOTE_US, recording.end_at_us)
            if reader.read(self._over_quiet(to_us), left_s) and reader.t_us >= due_at_us:
                state = zlib.compress(pickle.dumps(reader.watcher, pickle.HIGHEST_PROTOCOL), FAST)
                self.snapshots.append(Snapshot(reader.t_us, reader.frame, state))
                if recording.forgets:
                    self._thin()
            self._note()
        while (
            not recording.forgets and self.snapshots and self.snapshots[0].frame < recording.first
        ):
            self.snapshots.pop(0)

    def _over_quiet(self, to_us: int) -> int:
        """`to_us`, or the end of a long silence, over which one step leads.

        The clock of a logger may be set by decades between two frames.
        """
        reader, recording = self.reader, self.recording
        frame, intents = max(reader.frame, recording.first), recording.intents
        at = bisect_right(intents, reader.t_us, key=lambda note: note[0])
        latest_us = recording.t_us(frame - 1) if frame > recording.first else recording.begin_at_us
        next_us = recording.t_us(frame)
        if at > 0:
            latest_us = max(latest_us, intents[at - 1][0])
        if at < len(intents):
            next_us = min(next_us, intents[at][0])
        return max(to_us, next_us - 1) if reader.t_us - latest_us > QUIET_US else to_us

    def _thin(self) -> None:
        """As many in each doubling of age: about 250 of a day."""
        newest_us = self.snapshots[-1].t_us
        kept = self.snapshots[:1]
        for snapshot, after in pairwise(self.snapshots[1:]):
            if after.t_us - kept[-1].t_us > (newest_us - snapshot.t_us) / AGES:
                kept.append(snapshot)
        self.snapshots = [*kept, *self.snapshots[1:][-1:]]

    @property
    def begin_at_us(self) -> int:
        """From where on something can be shown."""
        oldest_us = self.recording.begin_at_us
        return min(oldest_us, self.snapshots[0].t_us) if self.snapshots else oldest_us

    def _note(self) -> None:
        watcher, recording = self.reader.watcher, self.recording
        watcher.intents.clear()
        for t_us, intent in recording.intents_at(self.reader.t_us):
            watcher.intend(t_us / 1e6, intent)
        events = self._notes.look(watcher, self.reader.t_us / 1e6)
        watcher.intents.clear()  # so that no snapshot holds them
        self.events.extend(events)
        self.noted += len(events)

    def before(self, t_us: int) -> Snapshot | None:
        """The last snapshot that is not later than `t_us`; the first if all are later; None if
        there is none."""
        at = bisect_right(self.snapshots, t_us, key=lambda snapshot: snapshot.t_us)
        return self.snapshots[max(at - 1, 0)] if self.snapshots else None


class Player:
    """`follow`: at the newest there is; else `playing` at `speed` from where it stands."""

    def __init__(self, index: Index, follow: bool, speed: float) -> None:
        self.index, self.recording = index, index.recording
        self.reader = Reader(self.recording)
        self.follow, self.playing, self.speed = follow, True, speed
        self.goal_us = float(self.recording.begin_at_us)  # where the person wants to be
        self.caught_up = True  # and is
        self.jumps = 0  # how often the past was loaded again
        if follow:
            self.seek(self.recording.end_at_us)

    @property
    def watcher(self) -> Watcher:
        """The fleet as it was at the playhead."""
        return self.reader.watcher

    def seek(self, t_us: int) -> None:
        """Go there; back or far ahead by the nearest snapshot."""
        recording = self.recording
        t_us = min(max(t_us, self.index.begin_at_us), recording.end_at_us)
        snapshot = self.index.before(t_us)
        ahead = snapshot is not None and snapshot.t_us > self.reader.t_us
        if t_us < self.reader.t_us or ahead or self.reader.frame < recording.first:
            self.reader = Reader(recording)
            if snapshot is not None and (snapshot.t_us <= t_us or recording.first > 0):
                self.reader.watcher = snapshot.watcher()
                self.reader.frame, self.reader.t_us = snapshot.frame, snapshot.t_us
            self.jumps += 1
            self.reader.watcher.all_changed()
        self.goal_us, self.caught_up = float(t_us), False

    @property
    def head_us(self) -> float:
        """Where the watcher is; behind the goal while it reads its way there."""
        return self.goal_us if self.caught_up else min(self.goal_us, float(self.reader.t_us))

    def advance(self, elapsed_s: float, budget_s: float) -> None:
        """Time goes on; reading may lag behind and catches up."""
        end_at_us = self.recording.end_at_us
        if self.follow:
            if end_at_us - self.reader.t_us > 2 * SNAPSHOT_US:
                self.seek(end_at_us)
            self.goal_us = float(end_at_us)
        elif self.playing and self.caught_up:
            self.goal_us = min(self.goal_us + elapsed_s * 1e6 * self.speed, float(end_at_us))
        self._over_the_forgotten()
        self.caught_up = self.reader.read(round(self.goal_us), budget_s)
        self._beside()

    def _over_the_forgotten(self) -> None:
        """Where the next frames are gone, from snapshot to snapshot."""
        if self.reader.frame >= self.recording.first:
            return
        snapshot = self.index.before(round(self.goal_us))
        if snapshot is not None and self.reader.t_us < snapshot.t_us <= self.goal_us:
            self.seek(round(self.goal_us))

    def _beside(self) -> None:
        """Intents and things as they were then."""
        watcher, now_us = self.watcher, round(self.head_us)
        watcher.intents.clear()
        for t_us, intent in self.recording.intents_at(now_us):
            watcher.intend(t_us / 1e6, intent)
        at = bisect_right(self.recording.things, now_us, key=lambda note: note[0])
        watcher.things = self.recording.things[at - 1][1]["rows"] if at else []
