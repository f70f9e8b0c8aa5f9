"""What happened in a recording, as a list for people: stops, silences, splits, questions, takeovers.

The index looks at its watcher twice a second of recorded time. An event is what differs from the look
before, so its time is right to half a second, and exact where the watcher knows the instant.
"""

from typing import NamedTuple

from crdt.allocation import HELD
from tools.inspect.inspector import SILENT_S
from tools.livemap.map_state import Watcher

ROBOTS_END = 128  # a stop from a number beyond was pressed at an operator's device


class NotedEvent(NamedTuple):
    """One line of the list. `kind` chooses the mark on the line of time."""

    at_s: float
    kind: str
    text: str


class EventNotes:
    """Remembers one look, and says what the next one has that is new."""

    def __init__(self) -> None:
        self._stops: set[tuple[int, int, int]] = set()
        self._cleared: set[tuple[int, int, int]] = set()
        self._silent: set[int] = set()
        self._left: set[int] = set()
        self._asking: set[int] = set()
        self._islands: list[list[int]] = []  # at the look before
        self._split_noted: list[list[int]] = []  # what the list says now
        self._owners: dict[int, int | None] = {}

    def look(self, watcher: Watcher, now_s: float) -> list[NotedEvent]:
        """Events since the look before, oldest first. `watcher`: with the intents of this instant."""
        found = [
            *self._pressed(watcher, now_s), *self._robots(watcher, now_s),
            *self._split(watcher, now_s), *self._taken_over(watcher, now_s),
        ]  # fmt: skip
        return sorted(found, key=lambda event: event.at_s)

    def _pressed(self, watcher: Watcher, now_s: float) -> list[NotedEvent]:
        found = []
        for dot in sorted(set(watcher.stops) - self._stops):
            whose = f"at robot {dot[0]}" if dot[0] < ROBOTS_END else "at an operator's device"
            found.append(NotedEvent(watcher.stops[dot], "stop", f"stop pressed {whose}"))
        cleared = set(watcher.cleared) - self._cleared
        if cleared:
            found.append(
                NotedEvent(min(watcher.cleared[dot] for dot in cleared), "reset", "stop released")
            )
        if (self._cleared & watcher.stops.keys()) - watcher.cleared.keys():  # others are forgotten
            found.append(NotedEvent(now_s, "stop", "the release was refused: robots hold the stop"))
        self._stops, self._cleared = set(watcher.stops), set(watcher.cleared)
        return found

    def _robots(self, watcher: Watcher, now_s: float) -> list[NotedEvent]:
        found = []
        left = {slot for slot, robot in watcher.robots.items() if robot.left}
        silent = {
            slot: robot.last_s
            for slot, robot in watcher.robots.items()
            if not robot.left and now_s - robot.last_s > SILENT_S
        }
        for slot in sorted(set(silent) - self._silent):
            found.append(NotedEvent(silent[slot], "silent", f"robot {slot} falls silent"))
        for slot in sorted(self._silent - set(silent) - left):
            found.append(NotedEvent(now_s, "back", f"robot {slot} is heard again"))
        for slot in sorted(left - self._left):
            found.append(NotedEvent(watcher.robots[slot].last_s, "left", f"robot {slot} leaves"))
        for slot in sorted(set(watcher.asking) - self._asking):
            found.append(NotedEvent(now_s, "asks", f"robot {slot} asks an operator"))
        self._silent, self._left, self._asking = set(silent), left, set(watcher.asking)
        return found

    def _split(self, watcher: Watcher, now_s: float) -> list[NotedEvent]:
        """A split is noted at the second look that shows it: robots that boot, or one that dies, are
        heard by some and not by others for less than that."""
        islands = watcher.islands(now_s)
        lasts = islands == self._islands
        self._islands = islands
        if len(islands) > 1 and lasts and islands != self._split_noted:
            self._split_noted = islands
            parts = " | ".join(" ".join(map(str, island)) for island in islands)
            return [NotedEvent(now_s, "split", f"bus split: {parts}")]
        if len(islands) == 1 and self._split_noted:
            self._split_noted = []
            return [NotedEvent(now_s, "back", "the bus is one again")]
        return []

    def _taken_over(self, watcher: Watcher, now_s: float) -> list[NotedEvent]:
        found = []
        for section in watcher.changed_sections:
            owner = watcher.allocation.owner_of(section)
            before = self._owners.get(section)
            held = watcher.allocation.phase_of(section) in HELD
            if (
                held
                and owner is not None
                and before in self._silent | self._left
                and owner != before
            ):
                text = f"robot {owner} takes S{section} over from robot {before}"
                found.append(NotedEvent(now_s, "takeover", text))
            self._owners[section] = owner
        watcher.changed_sections.clear()
        return found
