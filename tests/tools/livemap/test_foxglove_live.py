"""`--foxglove` as a viewer sees it: by `websockets`, `protobuf` and the description of the protocol.

Nothing of the SDK that serves is used here. https://github.com/foxglove/ws-protocol
"""

import asyncio
import json
import struct
from base64 import b64decode
from collections import defaultdict
from pathlib import Path
from socket import socket
from typing import Any

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="the extra `foxglove` is not installed")
pytest.importorskip("websockets", reason="the extra `operator` is not installed")
pytest.importorskip("google.protobuf", reason="protobuf is not installed")

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from websockets.asyncio.client import connect

from crdt.sighting import FREE, OBSTACLE, MergeOrder
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Member
from protocol.frames.map_frames import MapPatch
from protocol.sync.map_sync import encode_cells
from tests.tools.launching import WAIT_S, call, said, start
from tools.livemap.foxglove_live import FoxgloveFeed
from tools.livemap.foxglove_port import PortTaken, check_port

PROTOCOL = "foxglove.sdk.v1"
CALL = struct.Struct("<BIII")  # opcode, service, call, length of the encoding's name
MESSAGE = struct.Struct("<BIQ")  # opcode, subscription, nanoseconds
TRANSFORM, SCENE = "foxglove.FrameTransform", "foxglove.SceneUpdate"


class Viewer:
    """Subscribes to every topic that is advertised, and keeps what it is sent."""

    def __init__(self, connection: Any) -> None:
        self.connection = connection
        self.channels: dict[int, dict[str, Any]] = {}  # by id, which is our subscription's, too
        self.seen: dict[str, list[Any]] = defaultdict(list)  # topic -> decoded messages
        self.log_ns: list[int] = []
        self.services: dict[str, int] = {}  # name -> id
        self.answers: list[Any] = []
        self._kinds: dict[str, Any] = {}

    async def call(self, name: str, asked: dict[str, Any]) -> Any:
        """The answer of a service; what is published until then is kept."""
        await self.look(lambda _: name in self.services)
        before = len(self.answers)
        head = CALL.pack(2, self.services[name], before, len(b"json")) + b"json"
        await self.connection.send(head + json.dumps(asked).encode())
        await self.look(lambda _: len(self.answers) > before)
        return self.answers[-1]

    async def look(self, enough: Any) -> None:
        """Until `enough(seen)`."""
        async with asyncio.timeout(WAIT_S):
            async for data in self.connection:
                if isinstance(data, str):
                    await self._told(json.loads(data))
                elif data[0] == 1:
                    _, number, log_ns = MESSAGE.unpack_from(data)
                    self.log_ns.append(log_ns)
                    channel = self.channels[number]
                    decoded = self._decode(channel, data[MESSAGE.size :])
                    self.seen[channel["topic"]].append(decoded)
                elif data[0] == 3:
                    *_, length = CALL.unpack_from(data)
                    assert data[CALL.size :][:length] == b"json"
                    self.answers.append(json.loads(data[CALL.size + length :]))
                if enough(self.seen):
                    return
        raise AssertionError("the server has gone")

    async def _told(self, told: dict[str, Any]) -> None:
        if told["op"] == "advertiseServices":
            self.services |= {service["name"]: service["id"] for service in told["services"]}
        if told["op"] != "advertise":
            return
        for channel in told["channels"]:
            self.channels[channel["id"]] = channel
        wanted = [{"id": c["id"], "channelId": c["id"]} for c in told["channels"]]
        await self.connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

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


def connected(url: str) -> Any:
    return connect(url, subprotocols=[PROTOCOL], max_size=None, close_timeout=0.3)  # type: ignore[list-item]


def moved(seen: dict[str, list[Any]]) -> bool:
    """Enough of a fleet at work: transforms, bodies, paths, fixes, frames, and a look at all."""
    paths = {e.id for update in seen["/paths"] for e in update.entities}
    bodies = {e.id for update in seen["/scene"] for e in update.entities}
    return (
        len(seen["/tf"]) > 60
        and {f"path {k}" for k in range(3)} <= paths
        and {"outline 0", "robot 0", "robot 1", "robot 2", "S0"} <= bodies
        and all(seen[f"/robots/{k}/fix"] for k in range(3))
        and len(seen["/can/POSE"]) > 60
        and bool(seen["/fleet"])
        and len(seen["/fleet"][-1]["robots"]) == 3
        and any("WORKING" in line.message for line in seen["/log"])
    )


def test_an_independent_viewer_sees_a_launch_work_and_stop(tmp_path: Path) -> None:
    async def story() -> None:
        launch = await start(tmp_path, "launch", "small", "--foxglove", "0")
        url = await said(launch, r"foxglove: (ws://\S+)")
        try:
            async with connected(url) as connection:
                assert connection.subprotocol == PROTOCOL
                viewer = Viewer(connection)
                await viewer.look(moved)
                names = {c["topic"]: c["schemaName"] for c in viewer.channels.values()}
                assert names["/tf"] == TRANSFORM and names["/scene"] == SCENE
                assert names["/grid"] == "foxglove.Grid" and names["/log"] == "foxglove.Log"
                transform = viewer.seen["/tf"][-1]
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
                await viewer.look(
                    lambda seen: any(
                        "emergency stop" in line.message for line in seen["/log"][early:]
                    )
                )
                said_by = {line.name for line in viewer.seen["/log"][early:]}
                assert "fleet" in said_by
        finally:
            launch.terminate()
            await launch.communicate()

    asyncio.run(story())


def test_a_viewer_of_a_map_stops_and_releases_a_fleet_with_the_key(tmp_path: Path) -> None:
    async def story() -> None:
        launch = await start(tmp_path, "launch", "small")
        await said(launch, r"robot (2):")
        words = ("--page-port", "0", "--foxglove", "0", "--json")
        shown = await start(tmp_path, "map", *words)
        try:
            told = json.loads(await said(shown, r"(\{.*\})"))
            key = told["map"].partition("#")[2]
            async with connected(told["foxglove"]) as connection:
                viewer = Viewer(connection)
                await viewer.look(lambda seen: len(seen["/tf"]) > 60)
                for wrong in ({}, {"key": "guessed"}, {"key": 5}):
                    refused = await viewer.call("/emergency_stop", wrong)
                    assert not refused["success"] and "key" in refused["message"], refused
                answer = await viewer.call("/emergency_stop", {"key": key})
                assert answer["success"], answer

                def states() -> set[str]:
                    robots = viewer.seen["/fleet"][-1]["robots"] if viewer.seen["/fleet"] else []
                    return {robot["state"] for robot in robots}

                await viewer.look(lambda seen: states() == {"EMERGENCY_STOP"})
                answer = await viewer.call("/release", {"key": key})
                assert answer["success"], answer  # beside a launch its keys are taken
                await viewer.look(lambda seen: "EMERGENCY_STOP" not in states())
        finally:
            for process in (shown, launch):
                process.terminate()
                await process.communicate()

    asyncio.run(story())


def test_a_late_viewer_of_a_map_is_told_what_stands_there(tmp_path: Path) -> None:
    async def story() -> None:
        hub = await start(tmp_path, "hub", "--port", "0", "--json")
        port = await said(hub, r'"port": ?(\d+)')
        words = ("--port", port, "--scenario", "small", "--page-port", "0", "--foxglove", "0")
        shown = await start(tmp_path, "map", *words)
        try:
            url = await said(shown, r"foxglove: (ws://\S+)")
            for _ in range(2):  # the second comes when all was told already
                async with connected(url) as connection:
                    viewer = Viewer(connection)
                    await viewer.look(
                        lambda seen: (
                            {"outline 0", "S0"}
                            <= {e.id for update in seen["/scene"] for e in update.entities}
                        )
                    )
        finally:
            for process in (shown, hub):
                process.terminate()
                await process.communicate()

    asyncio.run(story())


def test_a_building_is_a_grid() -> None:
    async def story() -> None:
        walls = {
            "origin": [-1.0, -2.0], "cell_m": 0.5, "rows": 2, "columns": 3,
            "walls": "sA==",  # 101 100: bits from the most significant
        }  # fmt: skip
        feed = FoxgloveFeed({"grid": walls}, 0, 0.0)
        try:
            async with connected(feed.url) as connection:
                viewer = Viewer(connection)
                await viewer.look(lambda seen: bool(seen["/grid"]))
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
            async with connected(feed.url) as connection:
                viewer = Viewer(connection)
                await viewer.look(lambda seen: bool(seen["/grid"]))
                now_s = asyncio.get_running_loop().time()
                feed.hear(now_s, encode(Member(0, 1, 7), 128))
                values = encode_cells(np.asarray([FREE] * 15 + [OBSTACLE]))
                feed.hear(now_s, encode(MapPatch(0, 5, 9, 0, values), 128))
                await viewer.look(lambda seen: any(seen["/grid"][-1].data[3::4]))
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
