"""What a fleet that is heard looks like in Foxglove, topic by topic, for live viewers and for recordings.

The taker decides when each topic is told: `foxglove_live` for viewers, `recorded_topics` for a file.
"""

from collections.abc import Callable
from math import cos, sin
from typing import Any, Final

from protocol.frames.codec import UNKNOWN, Malformed, decode_once
from protocol.frames.fleet_frames import Pose, Standstill
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop, HeldReset
from sim.record import foxglove
from sim.record.foxglove import ERROR, INFO, Values
from sim.record.scene import Scene
from sim.record.topics import KINDS, LOG_TOPIC, frame_values
from tools.inspect.inspector import NO_KEYS, SILENT_S, Inspector, Seen
from tools.livemap.map_state import Watcher

AHEAD_MAX_S = 0.5  # a place is carried on by its speed for this long after its pose
NO_KEYS_ENTITY = "no keys"
# Of a grid, by the value of a cell; alpha 0: unknown ground is not drawn.
NOTHING, OPEN, SOLID = (0, 0, 0, 0), (220, 220, 220, 255), (60, 60, 60, 255)
RADIUS_M = 0.8  # of a body whose scene is not known
Dot = tuple[int, int, int]  # of a stop: slot, incarnation, counter
Degrees = Callable[[float, float], tuple[float, float]]
KINDS_OF_STOPS: Final = (EmergencyStop, EmergencyReset, HeldReset, Standstill)


class FleetTopics(Watcher):
    """A listener that says what it hears as messages of `sim.record.topics`."""

    def __init__(self, scene: Scene | None, epoch_s: float) -> None:
        """`scene`: what stands there; None: not known. `epoch_s`: what a message says at zero of the
        clock of the frames."""
        super().__init__(scene)
        self.epoch_s = epoch_s
        self.entities: dict[str, Values] = {}  # of the scene, as they were last told
        self._looks: dict[str, object] = {}  # entity -> how it was told
        self._placed_s: dict[int, float] = {}  # when the newest pose of a robot came
        self._to_degrees = _to_degrees(self.scene)
        self._latched: set[Dot] = set()  # that the log has told
        self._keyless_told = False  # the log says that the fleet has no keys

    # ------------------------------------------------------------ of the taker

    def wanted(self, topic: str) -> bool:
        """Whether anybody takes this topic now."""
        raise NotImplementedError

    def takes(self, topic: str, t_s: float, source: int) -> bool:
        """Whether anybody takes a frame of this kind from this address now."""
        return self.wanted(topic)

    def put(self, topic: str, t_s: float, value: Values) -> None:
        """Pass a message on."""
        raise NotImplementedError

    # ------------------------------------------------------------ what is heard

    def hear(self, t_s: float, frame: Frame) -> None:
        """Take one frame, and say what it says."""
        Inspector.hear(self, t_s, frame)  # no topic shows the load of the last second
        source, message = decode_once(frame)
        if message is UNKNOWN or isinstance(message, Malformed):
            return
        if isinstance(message, KINDS_OF_STOPS):
            self._tell_stops(t_s)
        topic = KINDS.get(type(message))
        if topic is not None and self.takes(topic, t_s, source):
            self.put(topic, t_s, frame_values(source, self.slot_of.get(source, -1), message))

    def _read(self, t_s: float, frame: Frame) -> None:
        """Four frames of five are places of robots that are known: straight to what they change."""
        source, message = decode_once(frame)
        slot = self.slot_of.get(source)
        if slot is None or not isinstance(message, Pose):
            super()._read(t_s, frame)
            return
        robot, kind = self.robots[slot], Pose.__name__
        self.kinds[kind] += 1
        robot.frames[kind] += 1
        robot.last_s = t_s
        self._robot(t_s, robot, kind, message)

    def _explain(self, t_s: float, frame: Frame, slot: int | None, message: Any) -> None:
        """No topic shows what led to a claim."""

    def _robot(self, t_s: float, robot: Seen, kind: str, message: Any) -> None:
        super()._robot(t_s, robot, kind, message)
        if isinstance(message, Pose) and message.placed:
            self._placed_s[robot.slot] = t_s
            self._place(t_s, robot)

    def _place(self, t_s: float, robot: Seen) -> None:
        """A robot has said where it is."""

    def _state(self, t_s: float, robot: Seen, state: int, kind: str) -> None:
        before = robot.state
        super()._state(t_s, robot, state, kind)
        if robot.state != before:
            level = foxglove.level_of(robot.state)
            self.say(t_s, f"robot {robot.slot}", level, f"{before} -> {robot.state}")

    def say(self, t_s: float, name: str, level: int, text: str) -> None:
        """A line of the log."""
        self.put(LOG_TOPIC, t_s, foxglove.said(self._us(t_s), name, level, text))

    def _tell_stops(self, t_s: float) -> None:
        """What a frame has changed: at once, because a stop and its reset may be close together."""
        latched = set(self.latched)
        for dot in sorted(latched - self._latched):
            self.say(t_s, "fleet", ERROR, _stop_named(dot))
        if self._latched and not latched and not self.latched_more:
            self.say(t_s, "fleet", INFO, "all stops are cleared")
        self._latched = latched

    def _tell_what_holds(self, now_s: float) -> None:
        """States and stops of now, for viewers that were not there when they came."""
        for slot, robot in sorted(self.robots.items()):
            if not robot.left:
                level = foxglove.level_of(robot.state)
                self.say(now_s, f"robot {slot}", level, f"is {robot.state}")
        for dot in sorted(self._latched):
            self.say(now_s, "fleet", ERROR, f"{_stop_named(dot)} holds")
        self._keyless_told = False

    def _tell_of_keys(self, now_s: float) -> None:
        if self.keyed is False and not self._keyless_told:
            self._keyless_told = True
            self.say(now_s, "fleet", ERROR, NO_KEYS)

    # ------------------------------------------------------------ what it looks like

    def transforms(self, t_s: float) -> Values | None:
        """Where the newest poses and speeds put the robots; a silent robot has no newer place."""
        told = []
        for slot, placed_s in self._placed_s.items():
            robot = self.robots.get(slot)
            if robot is None or robot.left or t_s - placed_s > SILENT_S:
                continue
            course_rad = self.course.get(slot, 0.0)
            way_m = robot.speed_m_s * min(max(t_s - placed_s, 0.0), AHEAD_MAX_S)
            x_m, y_m = robot.x_m + way_m * cos(course_rad), robot.y_m + way_m * sin(course_rad)
            heading_rad = self._heading(t_s, slot)
            told.append(foxglove.transform(self._us(t_s), slot, x_m, y_m, heading_rad))
        return {"transforms": told} if told else None

    def _heading(self, t_s: float, slot: int) -> float:
        """Of its body, where it tells; else the direction in which it drives."""
        intent = self.intent(slot, t_s)
        told: float = self.course.get(slot, 0.0) if intent is None else intent["heading"]
        return told

    def fix(self, t_s: float, robot: Seen) -> Values | None:
        """None where the place of the field on earth is not known."""
        if self._to_degrees is None:
            return None
        longitude, latitude = self._to_degrees(robot.x_m, robot.y_m)
        return foxglove.fix(self._us(t_s), robot.slot, latitude, longitude)

    def look(self, now_s: float) -> tuple[list[Values], list[Values]]:
        """Entities of the scene that look different than they were told, and deletions."""
        t_us, changed, gone = self._us(now_s), [], []
        for robot in self.robots.values():
            name, silent = f"robot {robot.slot}", now_s - robot.last_s > SILENT_S
            if not self._new(name, (robot.state, silent, robot.left)):
                continue
            if robot.left:
                self.entities.pop(name, None)
                gone.append(foxglove.deletion(t_us, name))
                continue
            radius_m = float(self.scene.get("radius_m", RADIUS_M))
            changed.append(foxglove.body(t_us, robot.slot, robot.state, silent, radius_m))
        if self.keyed is False and self._new(NO_KEYS_ENTITY, True):
            changed.append(foxglove.warning(t_us, NO_KEYS_ENTITY, NO_KEYS))
        for number, ring in enumerate(self.scene.get("rings", ())):
            if ring and self._new(f"outline {number}", True):
                changed.append(foxglove.outline(t_us, number, ring))
        for section in self.scene.get("sections", ()):
            number, phase = section["id"], self.allocation.phase_of(section["id"])
            if self._new(f"S{number}", phase):
                changed.append(foxglove.section(t_us, number, section["swaths"], phase))
        self.entities |= {entity["id"]: entity for entity in changed}
        return changed, gone

    def _new(self, name: str, looks: object) -> bool:
        """Whether it was not yet told as it is."""
        if self._looks.get(name) == looks:
            return False
        self._looks[name] = looks
        return True

    def grid(self, now_s: float) -> Values | None:
        """The explored map of an arena, or the walls of a building."""
        kinds = self.ground_kinds()
        if kinds is None:
            return None
        import numpy as np  # a tool that only listens has none, and no grid

        origin, cell_m = self.ground_frame()
        data = np.asarray((NOTHING, OPEN, SOLID), dtype=np.uint8)[kinds]
        return foxglove.grid(self._us(now_s), origin, cell_m, kinds.shape[1], data.tobytes())

    def _us(self, t_s: float) -> int:
        return round((self.epoch_s + t_s) * 1e6)


def _to_degrees(scene: Scene) -> Degrees | None:
    """Metres to longitude and latitude in degrees; None where the place on earth is not known."""
    origin = scene.get("earth")
    if not origin:
        return None
    from pyproj import (
        CRS,
        Transformer,
    )  # of the extra `robot`, which a program that knows a field has

    from agent.runtime.files.field_file import plane

    latitude, longitude = map(float, origin)
    made = Transformer.from_crs(plane((latitude, longitude)), CRS("EPSG:4326"), always_xy=True)
    convert: Degrees = made.transform
    return convert


def _stop_named(dot: Dot) -> str:
    return f"emergency stop {'.'.join(map(str, dot))}"
