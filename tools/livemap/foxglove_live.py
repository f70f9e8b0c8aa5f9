"""`--foxglove`: a live fleet for Foxglove and Lichtblick, over their WebSocket protocol, by foxglove-sdk.

What is published, topic by topic, is in docs/use/foxglove.md; `tools/livemap/fleet_topics.py` makes it.
A topic to which nobody subscribes costs nothing but a look whether somebody does. What viewers may call:
`tools/livemap/foxglove_services.py`.
"""

import asyncio
import time
from collections.abc import Callable, Sequence
from typing import Any

import foxglove
from foxglove.websocket import Capability, ChannelView, Client, ServerListener, Service

from sim.record import foxglove as pictures
from sim.record.foxglove import LOCATION_FIX, Values
from sim.record.mcap_schema import SCHEMAS
from sim.record.scene import Scene
from sim.record.topics import (
    FLEET_TOPIC,
    GRID_TOPIC,
    KINDS,
    LOG_TOPIC,
    PATHS_TOPIC,
    SCENE_TOPIC,
    TF_TOPIC,
    TOPICS,
    schema_of,
)
from tools.inspect.inspector import Seen
from tools.inspect.metrics_address import LOOPBACK
from tools.livemap.fleet_topics import FleetTopics
from tools.livemap.foxglove_fixes import FixTopics
from tools.livemap.foxglove_messages import Maker, channel_of, is_typed, maker_of
from tools.livemap.foxglove_port import PortTaken

FIX_S = 1.0  # between two fixes of a robot, as most receivers of GNSS tell them
PATH_S = 1.0  # between two paths of a robot, which have many points and change by what it drives
SOON_S = 0.05  # after the first of several topics that one viewer subscribes to
MOVE_S = 0.05  # between two transforms of a robot, whatever the period of poses on the bus
LATE_MAX_S = 0.25  # a feed that is behind by more leaves transforms out
TELL_S = 1.0  # between two looks at what changes slowly
# Messages kept for a viewer that reads slowly; the oldest are dropped. A full bus (1900 frames a second)
# fills the 1024 of the SDK in half a second, and a line of the log that is dropped never comes again.
BACKLOG_MESSAGES = 16_384
FRAME_TOPICS = frozenset(KINDS.values())


class FoxgloveFeed(FleetTopics):
    """A fleet that is heard, published to its subscribers."""

    def __init__(
        self, scene: Scene | None, port: int, epoch_s: float, services: Sequence[Service] = ()
    ) -> None:
        """`scene`: what stands there; None: not known. `port`: of loopback, 0: any free one.
        `epoch_s`: the time of day at zero of the clock of the frames. `services`: what viewers may
        call. Raises PortTaken.
        """
        super().__init__(scene, epoch_s)
        self._loop = asyncio.get_running_loop()
        context = foxglove.Context()
        self._channels: dict[str, Any] = {}
        self._makers: dict[str, Maker] = {}
        for topic, schema in TOPICS.items():
            if is_typed(schema):
                self._channels[topic] = channel_of(schema)(topic, context=context)
                self._makers[topic] = maker_of(schema)
        for topic in (FLEET_TOPIC, *KINDS.values()):
            self._channels[topic] = foxglove.Channel(
                topic, schema=schema_of(topic), context=context
            )
        self._fixes = FixTopics(context)
        self._fix_of = maker_of(SCHEMAS[LOCATION_FIX])
        self._fixed_s: dict[int, float] = {}
        self._pathed_s: dict[int, float] = {}
        # Frames and fixes since the last transforms: each message that goes alone wakes the server.
        self._waiting: list[tuple[Any, Any, int]] = []  # channel, message, time in nanoseconds
        self._again: asyncio.TimerHandle | None = None
        self._log_asked = False  # by a viewer that has not been told yet what holds now
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

    def wanted(self, topic: str) -> bool:
        """Whether somebody subscribes."""
        asked: bool = self._channels[topic].has_sinks()
        return asked

    def put(self, topic: str, t_s: float, value: Values) -> None:
        """Publish; a frame goes with the next transforms."""
        make, channel, t_ns = self._makers.get(topic), self._channels[topic], self._ns(t_s)
        if topic in FRAME_TOPICS:
            self._waiting.append((channel, value, t_ns))
        else:
            channel.log(value if make is None else make(value), log_time=t_ns)

    def intend(self, t_s: float, intent: dict[str, Any]) -> None:
        """Take what a robot says of itself beside the bus, and publish its path."""
        super().intend(t_s, intent)
        slot = intent["slot"]
        due = t_s - self._pathed_s.get(slot, -PATH_S) >= PATH_S
        if due and self.wanted(PATHS_TOPIC):
            self._pathed_s[slot] = t_s
            self.put(PATHS_TOPIC, t_s, pictures.update([pictures.path(self._us(t_s), intent)]))

    def _state(self, t_s: float, robot: Seen, state: int, kind: str) -> None:
        before = robot.state
        super()._state(t_s, robot, state, kind)
        if robot.state != before:
            self._draw(t_s)

    def _place(self, t_s: float, robot: Seen) -> None:
        if t_s - self._fixed_s.get(robot.slot, 0.0) < FIX_S:
            return
        self._fixed_s[robot.slot] = t_s
        if self._to_degrees is None:
            return
        channel = self._fixes.of(robot.slot, t_s)
        if channel.has_sinks():
            self._waiting.append((channel, self._fix_of(self.fix(t_s, robot)), self._ns(t_s)))

    async def _keep_moving(self) -> None:
        """Transforms at a rate of their own: in a large fleet, or on a busy machine, poses are rarer."""
        due_s = self._loop.time()
        while True:
            due_s = max(due_s + MOVE_S, self._loop.time() - LATE_MAX_S)
            await asyncio.sleep(due_s - self._loop.time())
            for channel, message, t_ns in self._waiting:
                channel.log(message, log_time=t_ns)
            self._waiting.clear()
            if self.wanted(TF_TOPIC) and (moved := self.transforms(due_s)) is not None:
                self.put(TF_TOPIC, due_s, moved)

    # ------------------------------------------------------------ what stands, and changes slowly

    def _newcomer(self, topic: str) -> None:
        """Somebody subscribed, in a thread of the server: tell again what is told on a change only."""
        if topic in (SCENE_TOPIC, GRID_TOPIC, LOG_TOPIC):
            self._loop.call_soon_threadsafe(self._tell_soon, topic == LOG_TOPIC)

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
        self._looks.clear()
        self._tell(now_s, again=True)

    async def _keep_telling(self) -> None:
        while True:
            await asyncio.sleep(TELL_S)
            self._tell(self._loop.time(), again=False)

    def _tell(self, now_s: float, again: bool) -> None:
        self._tell_of_keys(now_s)
        if self.wanted(TF_TOPIC):
            self._fixes.offer_again(now_s)
        self._draw(now_s)
        if self.wanted(GRID_TOPIC) and (again or self.changed_patches):
            self.changed_patches.clear()
            if (grid := self.grid(now_s)) is not None:
                self.put(GRID_TOPIC, now_s, grid)
        if self.wanted(FLEET_TOPIC):
            self.put(FLEET_TOPIC, now_s, self.to_dict())

    def _draw(self, now_s: float) -> None:
        """What looks different than viewers were told."""
        if not self.wanted(SCENE_TOPIC):
            return
        changed, gone = self.look(now_s)
        if changed or gone:
            self.put(SCENE_TOPIC, now_s, pictures.update(changed, gone))

    def _ns(self, t_s: float) -> int:
        return self._us(t_s) * 1000


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
