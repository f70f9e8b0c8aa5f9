"""`--foxglove`: a live fleet for Foxglove and Lichtblick, over their WebSocket protocol, by foxglove-sdk.

What is published, topic by topic, is in docs/use/foxglove.md. A topic to which nobody subscribes costs
nothing but a look whether somebody does. What viewers may call: `tools/livemap/foxglove_services.py`.
"""

import asyncio
import time
from base64 import b64decode
from collections.abc import Callable, Sequence
from math import cos, sin
from typing import Any, Final, get_type_hints

import foxglove
import numpy as np
from foxglove import channels, messages
from foxglove.websocket import Capability, ChannelView, Client, ServerListener, Service

from agent.interface.lifecycle import State
from crdt import Phase
from protocol.frames.codec import UNKNOWN, Malformed, decode
from protocol.frames.fleet_frames import Pose
from protocol.frames.frame import Frame
from protocol.frames.messages import GROUPS, Message
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop, HeldReset
from sim.files.palette import rgb_of
from sim.record.scene import Scene
from tools.inspect.inspector import NO_KEYS, SILENT_S, Seen
from tools.livemap.foxglove_fixes import FixTopics
from tools.livemap.foxglove_port import LOOPBACK, PortTaken
from tools.livemap.map_state import Watcher

FIELD = "field"  # the frame of all coordinates: metres, x east, y north
HEIGHT_M = 0.6
TEXT_PX = 14.0
FIX_S = 0.2  # between two fixes of a robot: a map panel does not need each pose
SOON_S = 0.05  # after the first of several topics that one viewer subscribes to
MOVE_S = 0.05  # between two transforms of a robot, whatever the period of poses on the bus
LATE_MAX_S = 0.25  # a feed that is behind by more leaves transforms out
AHEAD_MAX_S = 0.5  # a place is carried on by its speed for this long after its pose
TELL_S = 1.0  # between two looks at what changes slowly
# Messages kept for a viewer that reads slowly; the oldest are dropped. A full bus (1900 frames a second)
# fills the 1024 of the SDK in half a second, and a line of the log that is dropped never comes again.
BACKLOG_MESSAGES = 16_384
GREY = (0.5, 0.5, 0.5)
COLOURS = {
    Phase.FREE: (0.55, 0.55, 0.55), Phase.CLAIMED: (0.9, 0.75, 0.2), Phase.STARTED: (0.2, 0.55, 0.9),
    Phase.DONE: (0.2, 0.65, 0.3),
}  # fmt: skip
RED: Final = (0.9, 0.1, 0.1)
# Of a grid, by the value of a cell; alpha 0: unknown ground is not drawn.
NOTHING, OPEN, SOLID = (0, 0, 0, 0), (220, 220, 220, 255), (60, 60, 60, 255)
RGB = tuple[float, float, float]
Dot = tuple[int, int, int]  # of a stop: slot, incarnation, counter


class FoxgloveFeed(Watcher):
    """A fleet that is heard, published to whoever subscribes."""

    def __init__(
        self, scene: Scene | None, port: int, epoch_s: float, services: Sequence[Service] = ()
    ) -> None:
        """`scene`: what stands there; None: not known. `port`: of loopback, 0: any free one.
        `epoch_s`: the time of day at zero of the clock of the frames. `services`: what viewers may
        call. Raises PortTaken.
        """
        super().__init__(scene)
        self.scene, self.epoch_s = scene or {}, epoch_s
        self._loop = asyncio.get_running_loop()
        context = foxglove.Context()
        self._tf = channels.FrameTransformChannel("/tf", context=context)
        self._scene = channels.SceneUpdateChannel("/scene", context=context)
        self._paths = channels.SceneUpdateChannel("/paths", context=context)
        self._grid = channels.GridChannel("/grid", context=context)
        self._log = channels.LogChannel("/log", context=context)
        self._fleet = foxglove.Channel("/fleet", message_encoding="json", context=context)
        self._kinds = {
            group.kind: foxglove.Channel(
                f"/can/{group.name}", schema=_schema_of(group.kind), context=context
            )
            for group in GROUPS
        }
        self._fixes = FixTopics(context)
        self._fixed_s: dict[int, float] = {}
        self._placed_s: dict[int, float] = {}  # when the newest pose of a robot came
        self._drawn: dict[str, object] = {}  # entity -> what was last published of it
        self._to_degrees = _to_degrees(self.scene)
        self._again: asyncio.TimerHandle | None = None
        self._log_asked = False  # by a viewer that has not been told yet what holds now
        self._latched: set[Dot] = set()  # that the log has told
        self._keyless_told = False  # the log says that the fleet has no keys
        try:
            self._server = foxglove.start_server(
                name="headland", host=LOOPBACK, port=port, context=context,
                server_listener=_Newcomers(self._newcomer), services=list(services),
                message_backlog_size=BACKLOG_MESSAGES,
                capabilities=[Capability.Services] if services else [],
            )  # fmt: skip
        except (OSError, RuntimeError) as problem:
            raise PortTaken(f"--foxglove {port}: {problem}") from None
        self.url = f"ws://{LOOPBACK}:{self._server.port}"
        self._telling = self._loop.create_task(self._keep_telling())
        self._moving = self._loop.create_task(self._keep_moving())

    def close(self) -> None:
        """Tell viewers nothing more, and close the port."""
        self._telling.cancel()
        self._moving.cancel()
        if self._again is not None:
            self._again.cancel()
        self._server.stop()

    # ------------------------------------------------------------ what is heard

    def hear(self, t_s: float, frame: Frame) -> None:
        """Take one frame, and publish what it says."""
        super().hear(t_s, frame)
        source, message = decode(frame)
        if message is UNKNOWN or isinstance(message, Malformed):
            return
        if isinstance(message, EmergencyStop | EmergencyReset | HeldReset):
            self._tell_stops(t_s)
        channel = self._kinds.get(type(message))
        if channel is not None and channel.has_sinks():
            told = {"source": source, "robot": self.slot_of.get(source, -1)}
            channel.log({**told, **_plain(message)}, log_time=self._ns(t_s))

    def intend(self, t_s: float, intent: dict[str, Any]) -> None:
        """Take what a robot says of itself beside the bus, and publish its path."""
        super().intend(t_s, intent)
        if self._paths.has_sinks():
            slot = int(intent["slot"])
            way = [(intent["x"], intent["y"]), *intent["path"]]
            line = _strip(way, rgb_of(slot), 0.15)
            self._put(self._paths, t_s, self._entity(t_s, f"path {slot}", lines=[line]))

    def _robot(self, t_s: float, robot: Seen, kind: str, message: Any) -> None:
        super()._robot(t_s, robot, kind, message)
        if isinstance(message, Pose) and message.placed:
            self._place(t_s, robot)

    def _state(self, t_s: float, robot: Seen, state: int, kind: str) -> None:
        before = robot.state
        super()._state(t_s, robot, state, kind)
        if robot.state != before:
            text = f"{before} -> {robot.state}"
            self._say(t_s, f"robot {robot.slot}", _level_of(robot.state), text)
            self._draw_robot(t_s, robot)

    def _place(self, t_s: float, robot: Seen) -> None:
        self._placed_s[robot.slot] = t_s
        if self._to_degrees is not None and t_s - self._fixed_s.get(robot.slot, 0.0) >= FIX_S:
            self._fix(t_s, robot, self._to_degrees)

    async def _keep_moving(self) -> None:
        """Transforms at a rate of their own: in a large fleet, or on a busy machine, poses are rarer."""
        due_s = self._loop.time()
        while True:
            due_s = max(due_s + MOVE_S, self._loop.time() - LATE_MAX_S)
            await asyncio.sleep(due_s - self._loop.time())
            if self._tf.has_sinks():
                for slot, placed_s in self._placed_s.items():
                    self._move(due_s, placed_s, self.robots[slot])

    def _move(self, t_s: float, placed_s: float, robot: Seen) -> None:
        """Where its newest pose and speed put it at `t_s`; a silent robot has no newer place."""
        if robot.left or t_s - placed_s > SILENT_S:
            return
        course_rad = self.course.get(robot.slot, 0.0)
        way_m = robot.speed_m_s * min(max(t_s - placed_s, 0.0), AHEAD_MAX_S)
        x_m, y_m = robot.x_m + way_m * cos(course_rad), robot.y_m + way_m * sin(course_rad)
        self._tf.log(
            messages.FrameTransform(
                timestamp=self._stamp(t_s), parent_frame_id=FIELD,
                child_frame_id=_frame_of(robot.slot),
                translation=messages.Vector3(x=x_m, y=y_m, z=0.0),
                rotation=_turn(self._heading(t_s, robot)),
            ),
            log_time=self._ns(t_s),
        )  # fmt: skip

    def _fix(self, t_s: float, robot: Seen, to_degrees: Callable[..., Any]) -> None:
        self._fixed_s[robot.slot] = t_s
        channel = self._fixes.of(robot.slot, t_s)
        if channel.has_sinks():
            longitude, latitude = to_degrees(robot.x_m, robot.y_m)
            channel.log(
                messages.LocationFix(
                    timestamp=self._stamp(t_s), frame_id=_frame_of(robot.slot),
                    latitude=latitude, longitude=longitude, color=_colour(rgb_of(robot.slot)),
                    position_covariance_type=messages.LocationFixPositionCovarianceType.Unknown,
                ),
                log_time=self._ns(t_s),
            )  # fmt: skip

    def _heading(self, t_s: float, robot: Seen) -> float:
        """Of its body, where it tells; else the direction in which it drives."""
        intent = self.intent(robot.slot, t_s)
        told: float = self.course.get(robot.slot, 0.0) if intent is None else intent["heading"]
        return told

    def _say(self, t_s: float, name: str, level: messages.LogLevel, text: str) -> None:
        said = messages.Log(timestamp=self._stamp(t_s), level=level, message=text, name=name)
        self._log.log(said, log_time=self._ns(t_s))

    # ------------------------------------------------------------ what stands, and changes slowly

    def _newcomer(self, topic: str) -> None:
        """Somebody subscribed, in a thread of the server: tell again what is told on a change only."""
        if topic in (self._scene.topic(), self._grid.topic(), self._log.topic()):
            self._loop.call_soon_threadsafe(self._tell_soon, topic == self._log.topic())

    def _tell_soon(self, log_asked: bool) -> None:
        """Once for a viewer that subscribes to all of them."""
        self._log_asked = self._log_asked or log_asked
        if self._again is None:
            self._again = self._loop.call_later(SOON_S, self._tell_again)

    def _tell_again(self) -> None:
        self._again = None
        now_s = self._loop.time()
        if self._log_asked:
            self._log_asked = False
            self._tell_what_holds(now_s)
        self._drawn.clear()
        self._tell(now_s, again=True)

    def _tell_what_holds(self, now_s: float) -> None:
        """States and stops of now, for a viewer that was not there when they came."""
        for slot, robot in sorted(self.robots.items()):
            if not robot.left:
                text = f"is {robot.state}"
                self._say(now_s, f"robot {slot}", _level_of(robot.state), text)
        for dot in sorted(self._latched):
            self._say(now_s, "fleet", messages.LogLevel.Error, f"{_stop_named(dot)} holds")
        self._keyless_told = False

    def _tell_stops(self, t_s: float) -> None:
        """What a frame has changed: at once, because a stop and its reset may be close together."""
        latched = set(self.latched)
        for dot in sorted(latched - self._latched):
            self._say(t_s, "fleet", messages.LogLevel.Error, _stop_named(dot))
        if self._latched and not latched:
            self._say(t_s, "fleet", messages.LogLevel.Info, "all stops are cleared")
        self._latched = latched

    async def _keep_telling(self) -> None:
        while True:
            await asyncio.sleep(TELL_S)
            self._tell(self._loop.time(), again=False)

    def _tell(self, now_s: float, again: bool) -> None:
        if self.keyed is False and not self._keyless_told:
            self._keyless_told = True
            self._say(now_s, "fleet", messages.LogLevel.Error, NO_KEYS)
        if self._tf.has_sinks():
            self._fixes.offer_again(now_s)
        if self._scene.has_sinks():
            for robot in self.robots.values():
                self._draw_robot(now_s, robot)
            self._draw_scene(now_s)
        if self._grid.has_sinks() and (again or self.changed_patches):
            self.changed_patches.clear()
            self._draw_grid(now_s)
        if self._fleet.has_sinks():
            self._fleet.log(self.to_dict(), log_time=self._ns(now_s))

    def _draw_scene(self, now_s: float) -> None:
        if self.keyed is False and self._new("no keys", True):
            text = messages.TextPrimitive(
                pose=_at(0.0, 0.0, HEIGHT_M), billboard=True, font_size=TEXT_PX,
                scale_invariant=True, color=_colour(RED), text=NO_KEYS,
            )  # fmt: skip
            entity = messages.SceneEntity(
                timestamp=self._stamp(now_s), frame_id=FIELD, id="no keys", texts=[text]
            )
            self._put(self._scene, now_s, entity)
        for number, ring in enumerate(self.scene.get("rings", ())):
            name = f"outline {number}"
            if ring and self._new(name, True):
                line = _strip([*ring, ring[0]], GREY, 0.3)
                self._put(self._scene, now_s, self._entity(now_s, name, lines=[line]))
        for section in self.scene.get("sections", ()):
            name, phase = f"S{section['id']}", self.allocation.phase_of(section["id"])
            if self._new(name, phase):
                lines = [_strip(swath, COLOURS[phase], 0.4) for swath in section["swaths"]]
                self._put(self._scene, now_s, self._entity(now_s, name, lines=lines))

    def _draw_robot(self, now_s: float, robot: Seen) -> None:
        """Its body follows its frame, so that it is told again only when it looks different."""
        if not self._scene.has_sinks():
            return
        name = f"robot {robot.slot}"
        silent = now_s - robot.last_s > SILENT_S
        looks = (robot.state, silent, robot.left)
        if not self._new(name, looks):
            return
        if robot.left:
            gone = messages.SceneEntityDeletion(
                timestamp=self._stamp(now_s),
                type=messages.SceneEntityDeletionType.MatchingId,
                id=name,
            )
            update = messages.SceneUpdate(deletions=[gone], entities=[])
            self._scene.log(update, log_time=self._ns(now_s))
            return
        colour = GREY if silent else rgb_of(robot.slot)
        length_m = 2.0 * float(self.scene.get("radius_m", 0.8))
        body = messages.CubePrimitive(
            pose=_at(0.0, 0.0, HEIGHT_M / 2), color=_colour(colour),
            size=messages.Vector3(x=length_m, y=0.8 * length_m, z=HEIGHT_M),
        )  # fmt: skip
        stopped = robot.state == "EMERGENCY_STOP"
        text = messages.TextPrimitive(
            pose=_at(0.0, 0.0, HEIGHT_M + 0.5), billboard=True, font_size=TEXT_PX,
            scale_invariant=True, color=_colour(RED if stopped else (1.0, 1.0, 1.0)),
            text=f"{robot.slot} {'SILENT' if silent else robot.state}",
        )  # fmt: skip
        entity = messages.SceneEntity(
            timestamp=self._stamp(now_s), frame_id=_frame_of(robot.slot), id=name,
            frame_locked=True, cubes=[body], texts=[text],
        )  # fmt: skip
        self._put(self._scene, now_s, entity)

    def _draw_grid(self, now_s: float) -> None:
        """The explored map of an arena, or the walls of a building."""
        if self.chart is not None:
            geometry = self.chart.geometry
            kinds = np.zeros((geometry.rows, geometry.columns), dtype=np.int64)
            for row, column, *values in self.cells(self.chart.known_patches()):
                block = np.asarray(values).reshape(4, 4)
                part = kinds[row : row + 4, column : column + 4]
                part[:] = block[: part.shape[0], : part.shape[1]]
            origin, cell_m = geometry.origin_m, geometry.cell_m
        elif (told := self.scene.get("grid")) is not None:
            bits = np.unpackbits(np.frombuffer(b64decode(told["walls"]), dtype=np.uint8))
            rows, columns = int(told["rows"]), int(told["columns"])
            kinds = bits[: rows * columns].reshape(rows, columns).astype(np.int64) + 1
            origin, cell_m = tuple(told["origin"]), float(told["cell_m"])
        else:
            return
        data = np.asarray((NOTHING, OPEN, SOLID), dtype=np.uint8)[np.minimum(kinds, 2)]
        byte = messages.PackedElementFieldNumericType.Uint8
        names = ("red", "green", "blue", "alpha")
        grid = messages.Grid(
            timestamp=self._stamp(now_s), frame_id=FIELD, pose=_at(origin[0], origin[1], 0.0),
            column_count=kinds.shape[1], cell_size=messages.Vector2(x=cell_m, y=cell_m),
            row_stride=4 * kinds.shape[1], cell_stride=4, data=data.tobytes(),
            fields=[
                messages.PackedElementField(name=name, offset=offset, type=byte)
                for offset, name in enumerate(names)
            ],
        )  # fmt: skip
        self._grid.log(grid, log_time=self._ns(now_s))

    def _new(self, name: str, looks: object) -> bool:
        """Whether it was not yet published as it is."""
        if self._drawn.get(name) == looks:
            return False
        self._drawn[name] = looks
        return True

    def _put(
        self, channel: channels.SceneUpdateChannel, t_s: float, entity: messages.SceneEntity
    ) -> None:
        channel.log(messages.SceneUpdate(deletions=[], entities=[entity]), log_time=self._ns(t_s))

    def _entity(self, t_s: float, name: str, lines: list[Any]) -> messages.SceneEntity:
        return messages.SceneEntity(
            timestamp=self._stamp(t_s), frame_id=FIELD, id=name, lines=lines
        )

    def _ns(self, t_s: float) -> int:
        return round((self.epoch_s + t_s) * 1e9)

    def _stamp(self, t_s: float) -> messages.Timestamp:
        seconds, ns = divmod(self._ns(t_s), 1_000_000_000)
        return messages.Timestamp(seconds, ns)


def start_feed(scene: Scene | None, port: int, services: Sequence[Service] = ()) -> FoxgloveFeed:
    """A feed whose frames come with the time of the running loop. Raises PortTaken."""
    return FoxgloveFeed(scene, port, time.time() - asyncio.get_running_loop().time(), services)


class _Newcomers(ServerListener):
    """Calls back when somebody subscribes."""

    def __init__(self, came: Callable[[str], None]) -> None:
        self.came = came

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """From a thread of the server."""
        self.came(channel.topic)


def _to_degrees(scene: Scene) -> Callable[..., Any] | None:
    """Metres to longitude and latitude in degrees; None where the place on earth is not known."""
    origin = scene.get("earth")
    if not origin:
        return None
    from pyproj import CRS, Transformer  # of the extra `robot`: who knows a field has it

    from agent.runtime.files.field_file import plane

    latitude, longitude = map(float, origin)
    made = Transformer.from_crs(plane((latitude, longitude)), CRS("EPSG:4326"), always_xy=True)
    convert: Callable[..., Any] = made.transform
    return convert


def _schema_of(message: type[Message]) -> dict[str, Any]:
    """A JSON schema, so that fields can be plotted by name."""
    kinds = {int: "integer", float: "number", bool: "boolean", str: "string"}
    hints = get_type_hints(message)
    fields = {name: {"type": kinds[hint]} if hint in kinds else {} for name, hint in hints.items()}
    own = {"source": {"type": "integer"}, "robot": {"type": "integer"}}
    return {"type": "object", "title": message.__name__, "properties": {**own, **fields}}


def _plain(message: Any) -> dict[str, Any]:
    """Of a frame: bytes as hexadecimal digits, numbers as they are."""
    return {
        name: value.hex() if isinstance(value, bytes) else value
        for name, value in message._asdict().items()
    }


def _level_of(state: str) -> messages.LogLevel:
    stopped = state == State.EMERGENCY_STOP.name
    return messages.LogLevel.Warning if stopped else messages.LogLevel.Info


def _stop_named(dot: Dot) -> str:
    return f"emergency stop {'.'.join(map(str, dot))}"


def _frame_of(slot: int) -> str:
    return f"robot_{slot}"


def _colour(colour: RGB) -> messages.Color:
    return messages.Color(r=colour[0], g=colour[1], b=colour[2], a=1.0)


def _turn(heading_rad: float) -> messages.Quaternion:
    return messages.Quaternion(x=0.0, y=0.0, z=sin(heading_rad / 2), w=cos(heading_rad / 2))


def _at(x_m: float, y_m: float, z_m: float) -> messages.Pose:
    return messages.Pose(position=messages.Vector3(x=x_m, y=y_m, z=z_m), orientation=_turn(0.0))


def _strip(points: Any, colour: RGB, thickness_m: float) -> messages.LinePrimitive:
    return messages.LinePrimitive(
        type=messages.LinePrimitiveLineType.LineStrip, pose=_at(0.0, 0.0, 0.0),
        thickness=thickness_m, color=_colour(colour),
        points=[messages.Point3(x=x, y=y, z=0.05) for x, y in points],
    )  # fmt: skip
