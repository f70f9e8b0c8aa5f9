"""Broadcast of each robot's itinerary: its stops, two to a frame, repeated periodically.

A stop is a task, or `TASKS_MAX` plus the number of a charger bay. Other robots plan with the tasks;
people see both, as in [P5, D5, C1].
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from agent.delivery.cost_matrix import FULL
from agent.interface.config import S
from protocol.frames.delivery_frames import NO_TASK, Itinerary

TOLD_US = 5 * S  # an itinerary is sent again this often
FRAMES_A_BEAT = 4
STOPS_MAX = 0xFF  # what a frame can count


class RemoteItinerary(NamedTuple):
    """The itinerary of another robot, as far as it was received."""

    version: int
    tasks: dict[int, int]  # position: task
    length: int
    left: int  # millionths of a battery
    whole: tuple[int, ...]  # the last one that was received completely


class ItineraryBroadcast:
    """Our announced stops, and what all other robots announce."""

    def __init__(self, now_us: int) -> None:
        self.told: dict[int, RemoteItinerary] = {}  # of others
        self.stops: list[int] = []  # ours
        self._version, self._tell_at_us, self._at = 0, now_us + TOLD_US, 0
        self._saying: Sequence[int] = ()

    # ---------------------------------------------------------------- ours

    def changed(self, now_us: int) -> None:
        """Our itinerary is another one: announce it from its beginning."""
        self._version = (self._version + 1) & 0xFF
        self._at, self._tell_at_us = 0, now_us

    def due(self, now_us: int) -> bool:
        """Whether a new announcement begins, so that `stops` must be up to date."""
        return self._at == 0 and now_us >= self._tell_at_us

    def outgoing(self, now_us: int, left: int) -> Iterator[Itinerary]:
        """The frames of our itinerary that go with this beat, at most `FRAMES_A_BEAT`.

        `left`: millionths of our battery.
        """
        if now_us < self._tell_at_us:
            return
        if self._at == 0:
            self._version = (self._version + 1) & 0xFF
            self._saying = tuple(self.stops)
        saying, length = [*self._saying, NO_TASK, NO_TASK], len(self._saying)
        for _ in range(FRAMES_A_BEAT):
            at = self._at
            battery = left * 255 // FULL
            yield Itinerary(self._version, at, length, battery, saying[at], saying[at + 1])
            self._at += 2
            if self._at >= length:
                self._at, self._tell_at_us = 0, now_us + TOLD_US
                return

    # ---------------------------------------------------------------- of others

    def on_message(self, slot: int, m: Itinerary) -> None:
        """Take in one frame of another robot's itinerary."""
        old = self.told.get(slot)
        whole = () if old is None else old.whole
        tasks = {}
        if old is not None and (old.version, old.length) == (m.version, m.length):
            tasks = old.tasks
        tasks[m.first] = m.task
        if m.after != NO_TASK:
            tasks[m.first + 1] = m.after
        if all(k in tasks for k in range(m.length)):
            whole = tuple(tasks[k] for k in range(m.length))
        self.told[slot] = RemoteItinerary(
            m.version, tasks, m.length, m.battery * FULL // 255, whole
        )
