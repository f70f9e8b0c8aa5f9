"""The topics of a live viewer, for a recording: from the frames and intents that a recorder is given.

A viewer that jumps in a recording is given the last message of each topic before that time. So a
message of /scene, /paths and /grid has everything. It is written when something has changed, and more
rarely if it is large.
"""

from collections.abc import Callable
from typing import Any, Final

from protocol.frames.fleet_frames import Pose
from protocol.frames.frame import Frame
from sim.record import foxglove
from sim.record.foxglove import Values
from sim.record.mcap_log import encode_json
from sim.record.scene import Scene
from sim.record.topics import (
    FLEET_TOPIC,
    GRID_TOPIC,
    KINDS,
    PATHS_TOPIC,
    SCENE_TOPIC,
    TF_TOPIC,
    fix_topic,
)
from tools.inspect.inspector import SILENT_S
from tools.livemap.fleet_topics import FleetTopics
from tools.livemap.map_state import STALE_S

MOVE_S: Final = 0.2  # between two transforms of a robot; viewers draw a straight line between them
# Between two places of a robot in the topic of its frames; /can has all of them, twenty a second.
POSE_S: Final = 0.19
TELL_S: Final = 1.0  # between two looks at what changes slowly
# Of one topic, on average: what a message has above that delays the next one.
BYTES_A_SECOND: Final = 20_000


class RecordedTopics(FleetTopics):
    """Says what it hears to a writer of a file."""

    def __init__(self, scene: Scene | None, write: Callable[[str, int, str], object]) -> None:
        """`write`: takes topic, microseconds, and the message as JSON."""
        super().__init__(scene, 0.0)
        self._write = write
        self._move_s = self._tell_s = float("-inf")
        self._due_s: dict[str, float] = {}  # of a topic with large messages
        self._pose_due_s: dict[int, float] = {}  # by address
        self._stale = True  # the scene has changed since it was written
        self._gone: list[Values] = []  # deletions that were not written yet

    def wanted(self, topic: str) -> bool:
        """A file takes everything."""
        return True

    def takes(self, topic: str, t_s: float, source: int) -> bool:
        """Every frame, but fewer places."""
        if topic != KINDS[Pose]:
            return True
        if t_s < self._pose_due_s.get(source, t_s):
            return False
        self._pose_due_s[source] = t_s + POSE_S
        return True

    def put(self, topic: str, t_s: float, value: Values) -> None:
        """Write a message."""
        text = encode_json(value)
        self._due_s[topic] = t_s + len(text) / BYTES_A_SECOND
        self._write(topic, self._us(t_s), text)

    def again(self, t_s: float) -> None:
        """A new file begins, which is whole by itself."""
        self._stale, self._due_s = True, {}
        self._tell_s = float("-inf")
        if self.chart is not None:
            self.changed_patches |= set(self.chart.known_patches())
        self._tell_what_holds(t_s)

    def hear(self, t_s: float, frame: Frame) -> None:
        """Take one frame, and write what it says."""
        super().hear(t_s, frame)
        self._go_on(t_s)

    def intend(self, t_s: float, intent: dict[str, Any]) -> None:
        """Take what a robot says of itself."""
        super().intend(t_s, intent)
        self._go_on(t_s)

    def _go_on(self, t_s: float) -> None:
        if t_s >= self._move_s:
            self._move_s = t_s + MOVE_S
            if (moved := self.transforms(t_s)) is not None:
                self.put(TF_TOPIC, t_s, moved)
        if t_s >= self._tell_s:
            self._tell_s = t_s + TELL_S
            self._tell(t_s)

    def _tell(self, now_s: float) -> None:
        self._tell_of_keys(now_s)
        changed, gone = self.look(now_s)
        self._gone += gone
        self._stale = self._stale or bool(changed or gone)
        if self._stale and self._is_due(SCENE_TOPIC, now_s):
            self._stale, gone, self._gone = False, self._gone, []
            entities = list(self.entities.values())
            self.put(SCENE_TOPIC, now_s, foxglove.update(entities, gone))
        paths = [
            foxglove.path(self._us(now_s), intent)
            for at_s, intent in self.intents.values()
            if now_s - at_s <= STALE_S
        ]
        if paths and self._is_due(PATHS_TOPIC, now_s):
            self.put(PATHS_TOPIC, now_s, foxglove.update(paths))
        if self._is_due(GRID_TOPIC, now_s) and (
            self.changed_patches or GRID_TOPIC not in self._due_s
        ):
            self.changed_patches.clear()
            if (grid := self.grid(now_s)) is not None:
                self.put(GRID_TOPIC, now_s, grid)
        for slot, placed_s in self._placed_s.items():
            robot = self.robots.get(slot)
            if robot is None or now_s - placed_s > SILENT_S:
                continue
            if (fix := self.fix(now_s, robot)) is not None:
                self.put(fix_topic(slot), now_s, fix)
        if self.robots and self._is_due(FLEET_TOPIC, now_s):
            self.put(FLEET_TOPIC, now_s, self.to_dict())

    def _is_due(self, topic: str, now_s: float) -> bool:
        return now_s >= self._due_s.get(topic, now_s)
