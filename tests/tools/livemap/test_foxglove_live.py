"""`--foxglove` as a viewer sees it: by `websockets`, `protobuf` and the description of the protocol.

Nothing of the SDK that serves is used here. https://github.com/foxglove/ws-protocol
"""

import asyncio
import json
import struct
from asyncio.subprocess import Process
from base64 import b64decode
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from functools import partial
from itertools import pairwise
from pathlib import Path
from socket import SO_RCVBUF, SOL_SOCKET, socket
from typing import Any

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="the extra `foxglove` is not installed")
pytest.importorskip("google.protobuf", reason="protobuf is not installed")

from foxglove.messages import LogLevel
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

from agent.interface.lifecycle import State
from crdt.sighting import FREE, OBSTACLE, MergeOrder
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.map_frames import MapPatch
from protocol.frames.safety_frames import EmergencyReset, EmergencyStop, Reason
from protocol.sync.map_sync import encode_cells
from sim.record.foxglove import INFO
from tests.tools.launching import WAIT_S, call, said, start
from tools.inspect.inspector import NO_KEYS
from tools.livemap.fleet_topics import AHEAD_MAX_S
from tools.livemap.foxglove_live import FoxgloveFeed
from tools.livemap.foxglove_port import PortTaken, check_port
from tools.livemap.foxglove_services import RELEASE, STOP, services_of

PROTOCOL = "foxglove.sdk.v1"
RECEIVED_BYTES = 16_384
CALL = struct.Struct("<BIII")  # opcode, service, call, length of the encoding's name
MESSAGE = struct.Struct("<BIQ")  # opcode, subscription, nanoseconds
BEAT = Heartbeat(0, State.WORKING, False, False, True, False, 1.0, 1, 1)
# Frames of a full bus in eight seconds: no more than the feed keeps, however little the SDK could send.
LINES = 15_000
# All of them are more than the buffers of a socket and the SDK's own 1024 messages.
LINE = "x" * 400
PRESSED = EmergencyStop(0, 1, 5, Reason.OPERATOR_INTERVENTION)
TRANSFORM, SCENE = "foxglove.FrameTransforms", "foxglove.SceneUpdate"


class Viewer:
    """Subscribes to every topic that is advertised, and keeps what it is sent.

    It reads all the time, as a viewer does: what a server keeps for one that does not is limited.
    """

    def __init__(self, connection: Any) -> None:
        self.connection = connection
        self.channels: dict[int, dict[str, Any]] = {}  # by id, which is our subscription's, too
        self.seen: dict[str, list[Any]] = defaultdict(list)  # topic -> decoded messages
        self.drawn: dict[str, set[str]] = defaultdict(set)  # topic -> names of entities
        self.log_ns: list[int] = []
        self.services: dict[str, int] = {}  # name -> id
        self.answers: list[Any] = []
        self._kinds: dict[str, Any] = {}
        self._news = asyncio.Event()
        self.reading = asyncio.create_task(self._read())

    async def call(self, name: str, asked: dict[str, Any]) -> Any:
        """The answer of a service."""
        await self.look({f"service {name}": lambda: name in self.services})
        before = len(self.answers)
        head = CALL.pack(2, self.services[name], before, len(b"json")) + b"json"
        await self.connection.send(head + json.dumps(asked).encode())
        await self.look({f"answer of {name}": lambda: len(self.answers) > before})
        return self.answers[-1]

    async def look(self, conditions: Mapping[str, Callable[[], bool]]) -> None:
        """Until all hold; says which do not, if that takes too long or the server goes."""
        missing: list[str] = []
        try:
            async with asyncio.timeout(WAIT_S):
                while missing := [name for name, holds in conditions.items() if not holds()]:
                    if self.reading.done():
                        break
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            pass
        counts = {topic: len(messages) for topic, messages in self.seen.items()}
        lines = [f"{line.name}: {line.message}" for line in self.seen["/log"]]
        ended = self.reading.exception() if self.reading.done() else "no"
        assert not missing, f"{missing} not seen; ended: {ended}; log {lines}; messages {counts}"

    def logged(self, text: str, since: int = 0) -> bool:
        """Whether a line of the log has it; `since`: so many lines are left out."""
        return any(text in line.message for line in self.seen["/log"][since:])

    async def _read(self) -> None:
        try:
            async for data in self.connection:
                await self._take(data)
                self._news.set()
        finally:
            self._news.set()

    async def _take(self, data: str | bytes) -> None:
        if isinstance(data, str):
            await self._told(json.loads(data))
        elif data[0] == 1:
            _, number, log_ns = MESSAGE.unpack_from(data)
            self.log_ns.append(log_ns)
            channel = self.channels[number]
            decoded = self._decode(channel, data[MESSAGE.size :])
            self.seen[channel["topic"]].append(decoded)
            if channel["schemaName"] == SCENE:
                self.drawn[channel["topic"]] |= {entity.id for entity in decoded.entities}
        elif data[0] == 3:
            *_, length = CALL.unpack_from(data)
            assert data[CALL.size :][:length] == b"json"
            self.answers.append(json.loads(data[CALL.size + length :]))

    async def _told(self, told: dict[str, Any]) -> None:
        if told["op"] == "advertiseServices":
            self.services |= {service["name"]: service["id"] for service in told["services"]}
        if told["op"] != "advertise":
            return
        for channel in told["channels"]:
            self.channels[channel["id"]] = channel
        wanted = [{"id": c["id"], "channelId": c["id"]} for c in self._taken(told["channels"])]
        await self.connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def _taken(self, channels: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Of those that are offered: all."""
        return channels

    def _decode(self, channel: dict[str, Any], data: bytes) -> Any:
        if channel["encoding"] == "json":
            return json.loads(data)
        assert channel["encoding"] == "protobuf" and channel["schemaEncoding"] == "protobuf"
        name = channel["schemaName"]
        if name not in self._kinds:
            files = descriptor_pb2.FileDescriptorSet.FromString(b64decode(channel["schema"]))
            pool = descriptor_pool.DescriptorPool()
            for file in files.file:
                pool.Add(file)
            self._kinds[name] = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
        return self._kinds[name].FromString(data)


class Unlucky(Viewer):
    """Its first subscription to fixes is lost, as the SDK loses some."""

    lost = False

    def _taken(self, channels: list[dict[str, Any]]) -> list[dict[str, Any]]:
        taken = [c for c in channels if self.lost or not c["topic"].endswith("/fix")]
        self.lost = self.lost or taken != channels
        return taken


def connected(url: str) -> Any:
    """With small buffers, as between machines: what waits longer waits at the server."""
    from_server = socket()
    from_server.setsockopt(SOL_SOCKET, SO_RCVBUF, RECEIVED_BYTES)
    from_server.connect(("127.0.0.1", int(url.rpartition(":")[2])))
    return connect(
        url, sock=from_server, subprotocols=[Subprotocol(PROTOCOL)], max_size=None, close_timeout=0.3
    )  # fmt: skip


@asynccontextmanager
async def viewing(url: str, kind: type[Viewer] = Viewer) -> AsyncIterator[Viewer]:
    async with connected(url) as connection:
        assert connection.subprotocol == PROTOCOL
        viewer = kind(connection)
        try:
            yield viewer
        finally:
            viewer.reading.cancel()


@asynccontextmanager
async def running(folder: Path, *words: str) -> AsyncIterator[Process]:
    """A command that ends with the test, also if the test fails before it says a word."""
    process = await start(folder, *words)
    try:
        yield process
    finally:
        if process.returncode is None:
            process.terminate()
        await process.communicate()


def moved(viewer: Viewer) -> dict[str, Callable[[], bool]]:
    """Enough of a fleet at work: transforms, bodies, paths, fixes, frames, and a look at all."""
    seen, drawn = viewer.seen, viewer.drawn
    return {
        "60 transforms": lambda: len(seen["/tf"]) > 60,
        "a path of each robot": lambda: {f"path {k}" for k in range(3)} <= drawn["/paths"],
        "fence, section and bodies": lambda: (
            {"outline 0", "robot 0", "robot 1", "robot 2", "S0"} <= drawn["/scene"]
        ),
        "a fix of each robot": lambda: all(seen[f"/robots/{k}/fix"] for k in range(3)),
        "60 places on the bus": lambda: len(seen["/can/POSE"]) > 60,
        "three robots in /fleet": lambda: (
            bool(seen["/fleet"]) and len(seen["/fleet"][-1]["robots"]) == 3
        ),
        "WORKING in the log": lambda: viewer.logged("WORKING"),
    }


@pytest.mark.slow
def test_an_independent_viewer_sees_a_launch_work_and_stop(tmp_path: Path) -> None:
    async def story() -> None:
        async with (
            running(tmp_path, "launch", "small", "--foxglove", "0") as launch,
            viewing(await said(launch, r"foxglove: (ws://\S+)")) as viewer,
        ):
            await viewer.look(moved(viewer))
            names = {c["topic"]: c["schemaName"] for c in viewer.channels.values()}
            assert names["/tf"] == TRANSFORM and names["/scene"] == SCENE
            assert names["/grid"] == "foxglove.Grid" and names["/log"] == "foxglove.Log"
            (transform, *_) = viewer.seen["/tf"][-1].transforms
            assert transform.parent_frame_id == "field"
            assert transform.child_frame_id in {"robot_0", "robot_1", "robot_2"}
            fix = viewer.seen["/robots/1/fix"][-1]
            assert -90 < fix.latitude < 90 and (fix.latitude, fix.longitude) != (0, 0)
            pose = viewer.seen["/can/POSE"][-1]
            assert pose["robot"] in (0, 1, 2) and {"x_m", "y_m", "speed_m_s"} <= pose.keys()
            assert len(viewer.seen["/fleet"][-1]["robots"]) == 3
            early = len(viewer.seen["/log"])
            code, text = await call(tmp_path, "stop")
            assert code == 0, text
            await viewer.look({"the stop": lambda: viewer.logged("emergency stop", early)})
            assert "fleet" in {line.name for line in viewer.seen["/log"][early:]}

    asyncio.run(story())


@pytest.mark.slow
def test_a_viewer_of_a_map_stops_and_releases_a_fleet_with_the_key(tmp_path: Path) -> None:
    async def story() -> None:
        words = ("map", "--page-port", "0", "--foxglove", "0", "--json")
        async with running(tmp_path, "launch", "small") as launch:
            await said(launch, r"robot (2):")
            async with running(tmp_path, *words) as shown:
                told = json.loads(await said(shown, r"(\{.*\})"))
                async with viewing(told["foxglove"]) as viewer:
                    await stop_and_release(viewer, told["map"].partition("#")[2])

    asyncio.run(story())


@pytest.mark.slow
def test_a_viewer_of_a_launch_stops_and_releases_it_with_the_key(tmp_path: Path) -> None:
    async def story() -> None:
        async with running(tmp_path, "launch", "small", "--foxglove", "0") as launch:
            address, *_, key = (await said(launch, r"foxglove: (ws://\S+ .*)")).split()
            async with viewing(address) as viewer:
                await stop_and_release(viewer, key)

    asyncio.run(story())


async def stop_and_release(viewer: Viewer, key: str) -> None:
    await viewer.look({"60 transforms": lambda: len(viewer.seen["/tf"]) > 60})
    for wrong in ({}, {"key": "guessed"}, {"key": 5}):
        refused = await viewer.call("/emergency_stop", wrong)
        assert not refused["success"] and "key" in refused["message"], refused
    answer = await viewer.call("/emergency_stop", {"key": key})
    assert answer["success"], answer

    def states() -> set[str]:
        robots = viewer.seen["/fleet"][-1]["robots"] if viewer.seen["/fleet"] else []
        return {robot["state"] for robot in robots}

    await viewer.look({"all stand": lambda: states() == {"EMERGENCY_STOP"}})
    answer = await viewer.call("/release", {"key": key})
    assert answer["success"], answer  # beside a launch its keys are taken
    await viewer.look({"nobody stands": lambda: "EMERGENCY_STOP" not in states()})


@pytest.mark.slow
def test_a_late_viewer_of_a_map_is_told_what_stands_there(tmp_path: Path) -> None:
    async def story() -> None:
        async with running(tmp_path, "hub", "--port", "0", "--json") as hub:
            port = await said(hub, r'"port": ?(\d+)')
            words = ("--port", port, "--scenario", "small", "--page-port", "0", "--foxglove", "0")
            async with running(tmp_path, "map", *words) as shown:
                url = await said(shown, r"foxglove: (ws://\S+)")
                for _ in range(2):  # the second comes when all was told already
                    async with viewing(url) as viewer:
                        drawn = viewer.drawn["/scene"]
                        await viewer.look({"fence": partial(drawn.issuperset, {"outline 0", "S0"})})

    asyncio.run(story())


def told_working(feed: FoxgloveFeed, now_s: float) -> None:
    feed.hear(now_s, encode(Member(0, 1, 7), 128))
    feed.hear(now_s, encode(BEAT, 128))


def test_a_late_viewer_is_told_states_and_stops_of_now() -> None:
    async def story() -> None:
        feed = FoxgloveFeed(None, 0, 0.0)
        try:
            now_s = asyncio.get_running_loop().time()
            told_working(feed, now_s)
            feed.hear(now_s, encode(PRESSED, 128))
            async with viewing(feed.url) as viewer:
                await viewer.look({
                    "the state": lambda: viewer.logged("is WORKING"),
                    "the stop": lambda: viewer.logged("emergency stop 0.1.5 holds"),
                })  # fmt: skip
        finally:
            feed.close()

    asyncio.run(story())


def test_a_fleet_without_keys_is_an_error_in_the_log_and_a_red_text_in_the_scene() -> None:
    async def story() -> None:
        feed = FoxgloveFeed(None, 0, 0.0)
        try:
            told_working(feed, asyncio.get_running_loop().time())
            async with viewing(feed.url) as viewer:
                await viewer.look({
                    "the log": lambda: viewer.logged(NO_KEYS),
                    "the scene": lambda: "no keys" in viewer.drawn["/scene"],
                })  # fmt: skip
                line = next(x for x in viewer.seen["/log"] if x.message == NO_KEYS)
                assert line.level == LogLevel.Error
                entities = [e for told in viewer.seen["/scene"] for e in told.entities]
                (text,) = next(e for e in entities if e.id == "no keys").texts
                assert text.text == NO_KEYS and text.color.r > 0.8 > 0.2 > text.color.g
        finally:
            feed.close()

    asyncio.run(story())


def test_transforms_come_twenty_times_a_second_where_poses_are_rarer() -> None:
    async def story() -> None:
        feed = FoxgloveFeed(None, 0, 0.0)
        try:
            async with viewing(feed.url) as viewer:
                await viewer.look({"the topic": lambda: feed.wanted("/tf")})
                now_s = asyncio.get_running_loop().time()
                feed.hear(now_s, encode(Member(0, 1, 7), 128))
                feed.hear(now_s, encode(Pose(3.0, 4.0, 0.0, 1.0, 1, False, 0), 128))
                told_of = viewer.seen["/tf"]
                await viewer.look({"transforms of 0.6 s": lambda: len(told_of) > 12})
            transforms = [each for message in told_of for each in message.transforms]
            times_s = [t.timestamp.seconds + t.timestamp.nanos / 1e9 - now_s for t in transforms]
            assert all(abs(b - a - 0.05) < 0.001 for a, b in pairwise(times_s)), times_s
            for told, at_s in zip(transforms, times_s, strict=True):
                away_m = min(max(at_s, 0.0), AHEAD_MAX_S) * 1.0  # at 1 m/s
                assert abs(told.translation.x - 3.0 - away_m) < 0.02
                assert told.translation.y == pytest.approx(4.0, abs=0.01)
        finally:
            feed.close()

    asyncio.run(story())


@pytest.mark.slow
def test_a_fix_whose_subscription_is_lost_is_offered_again() -> None:
    async def story() -> None:
        feed = FoxgloveFeed({"earth": [48.0, 9.0]}, 0, 0.0)
        try:
            async with viewing(feed.url, Unlucky) as viewer:
                await viewer.look({"the topic": lambda: feed.wanted("/tf")})
                now_s = asyncio.get_running_loop().time()
                feed.hear(now_s, encode(Member(0, 1, 7), 128))
                feed.hear(now_s, encode(Pose(3.0, 4.0, 0.0, 1.0, 1, False, 0), 128))
                await viewer.look({"the fix is taken": lambda: feed._fixes.of(0, 0.0).has_sinks()})
                assert isinstance(viewer, Unlucky) and viewer.lost
                now_s = asyncio.get_running_loop().time()
                feed.hear(now_s, encode(Pose(3.0, 4.0, 0.0, 1.0, 2, False, 0), 128))
                await viewer.look({"a fix": lambda: bool(viewer.seen["/robots/0/fix"])})
        finally:
            feed.close()

    asyncio.run(story())


def test_a_stop_that_is_cleared_at_once_is_in_the_log() -> None:
    async def story() -> None:
        feed = FoxgloveFeed(None, 0, 0.0)
        try:
            async with viewing(feed.url) as viewer:
                now_s = asyncio.get_running_loop().time()
                await viewer.look({"the topic": lambda: feed.wanted("/log")})
                told_working(feed, now_s)
                feed.hear(now_s, encode(PRESSED, 128))
                feed.hear(now_s, encode(EmergencyReset(0, 1, 5, 7), 128))
                await viewer.look({
                    "the stop": lambda: viewer.logged("emergency stop 0.1.5"),
                    "its end": lambda: viewer.logged("all stops are cleared"),
                })  # fmt: skip
        finally:
            feed.close()

    asyncio.run(story())


@pytest.mark.slow
def test_a_viewer_that_stalls_misses_nothing() -> None:
    """A full bus while the viewer's own work keeps it from reading."""

    async def story() -> None:
        feed = FoxgloveFeed(None, 0, 0.0)
        try:
            async with viewing(feed.url) as viewer:
                await viewer.look({"the topic": lambda: feed.wanted("/log")})
                now_s = asyncio.get_running_loop().time()
                told_working(
                    feed, now_s
                )  # its line is the oldest; this loop reads nothing until...
                for _ in range(LINES):
                    feed.say(now_s, "robot 1", INFO, LINE)
                await viewer.look({
                    "all lines": lambda: len(viewer.seen["/log"]) > LINES,
                    "the line": lambda: viewer.logged("-> WORKING"),
                })  # fmt: skip
        finally:
            feed.close()

    asyncio.run(story())


def test_a_building_is_a_grid() -> None:
    async def story() -> None:
        walls = {
            "origin": [-1.0, -2.0], "cell_m": 0.5, "rows": 2, "columns": 3,
            "walls": "sA==",  # 101 100: bits from the most significant
        }  # fmt: skip
        feed = FoxgloveFeed({"grid": walls}, 0, 0.0)
        try:
            async with viewing(feed.url) as viewer:
                await viewer.look({"a grid": lambda: bool(viewer.seen["/grid"])})
            grid = viewer.seen["/grid"][0]
            assert (grid.column_count, grid.cell_size.x, grid.pose.position.x) == (3, 0.5, -1.0)
            reds = list(grid.data[::4])
            assert [red < 100 for red in reds] == [True, False, True, True, False, False]
        finally:
            feed.close()

    asyncio.run(story())


def test_an_explored_map_is_a_grid_that_grows() -> None:
    async def story() -> None:
        cells = {"origin": [0.0, 0.0], "cell_m": 0.5, "rows": 8, "columns": 8}
        feed = FoxgloveFeed({"cells": {**cells, "order": MergeOrder.MAX_CONFIDENCE.value}}, 0, 0.0)
        try:
            async with viewing(feed.url) as viewer:
                grids = viewer.seen["/grid"]
                await viewer.look({"a grid": lambda: bool(grids)})
                now_s = asyncio.get_running_loop().time()
                feed.hear(now_s, encode(Member(0, 1, 7), 128))
                values = encode_cells(np.asarray([FREE] * 15 + [OBSTACLE]))
                feed.hear(now_s, encode(MapPatch(0, 5, 9, 0, values), 128))
                await viewer.look({"known cells": lambda: any(grids[-1].data[3::4])})
            alphas = [list(grid.data[3::4]) for grid in viewer.seen["/grid"]]
            reds = list(viewer.seen["/grid"][-1].data[::4])
            assert not any(alphas[0]) and sum(map(bool, alphas[-1])) == 16
            assert reds[3 * 8 + 3] < reds[0]  # the last cell of the patch
        finally:
            feed.close()

    asyncio.run(story())


def test_a_port_that_is_taken_is_one_line() -> None:
    with socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(PortTaken, match="choose another"):
            check_port(taken.getsockname()[1])


class SlowPanel:
    """A release that waits for robots, and a stop that does not."""

    releases = True

    def __init__(self) -> None:
        self.released, self.releasing = asyncio.Event(), asyncio.Event()

    async def stop(self) -> dict[str, Any]:
        return {"heard": True, "late": [], "stopped": [0]}

    async def release(self, **_: bool) -> dict[str, Any]:
        self.releasing.set()
        await self.released.wait()
        return {"heard": True, "late": [0], "released": True}


def test_a_stop_is_answered_while_a_release_waits_for_the_bus() -> None:
    async def story() -> None:
        panel = SlowPanel()
        feed = FoxgloveFeed(None, 0, 0.0, services_of(panel, "k"))  # type: ignore[arg-type]
        try:
            async with viewing(feed.url) as viewer, viewing(feed.url) as other:
                await viewer.look({"services": lambda: RELEASE in viewer.services})
                await other.look({"services": lambda: STOP in other.services})
                await viewer.connection.send(_call(viewer.services[RELEASE], 1))
                await panel.releasing.wait()
                for each in (other, viewer):
                    await each.connection.send(_call(each.services[STOP], 7))
                    await each.look({"stop": partial(bool, each.answers)})
                    assert each.answers.pop()["success"] and not panel.released.is_set()
                panel.released.set()
                await viewer.look({"release": partial(bool, viewer.answers)})
                told = {"success": False, "message": "not started: robot 0"}
                assert viewer.answers.pop() == told
        finally:
            feed.close()

    asyncio.run(story())


def _call(service: int, number: int) -> bytes:
    return CALL.pack(2, service, number, len(b"json")) + b"json" + json.dumps({"key": "k"}).encode()
