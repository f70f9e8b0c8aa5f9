"""Tools of python-can on a hub, run as they are printed and documented (finding A7)."""

import asyncio
import contextlib
import json
import os
import shlex
import signal
import sys
from asyncio.subprocess import DEVNULL, Process
from collections.abc import Awaitable, Callable
from pathlib import Path

import can
import pytest

from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member, Pose
from protocol.frames.frame import Frame
from sim.can.simulated_bus import FieldBus, forget, segment
from sim.can.socketcand_server import Hub
from tests.tools.documented import blocks, lines_of
from tools.inspect.inspection import inspect
from tools.inspect.inspector import Inspector
from tools.operate.foreign_groups import NAMES
from tools.run.launch_bus import viewer_command

LIMIT_S = 60.0


def documented(tool: str, port: int) -> list[str]:
    """The line of the document that runs it, with the port."""
    shown = [line for _, block in blocks("use/bus.md") for line in lines_of(block)]
    lines = [line for line in shown if f"-m {tool} " in line]
    assert len(lines) == 1, lines
    return words(lines[0].replace("PORT", str(port)))


def words(command: str) -> list[str]:
    return [sys.executable, *shlex.split(command)[1:]]


async def until(holds: Callable[[], bool]) -> None:
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(LIMIT_S):
        while not holds():
            turn = loop.create_future()
            loop.call_later(0.02, turn.set_result, None)
            await turn


def on_a_hub(story: Callable[[Hub, FieldBus], Awaitable[None]]) -> None:
    async def main() -> None:
        hub = Hub(segment("bus tools"))
        await hub.start()
        other = FieldBus(hub.segment.channel)
        try:
            await story(hub, other)
        finally:
            other.shutdown()
            await hub.stop()
            forget("bus tools")

    asyncio.run(main())


async def ended(process: Process) -> int:
    async with asyncio.timeout(LIMIT_S):
        return await process.wait()


@pytest.mark.skipif(sys.platform == "win32", reason="the viewer needs a terminal")
@pytest.mark.parametrize("source", ["launch", "document"])
def test_a7_the_viewer_shows_frames(source: str) -> None:
    pty = pytest.importorskip("pty", reason="this system has no pseudo-terminals")

    async def story(hub: Hub, other: FieldBus) -> None:
        printed = words(viewer_command("127.0.0.1", hub.port))
        command = printed if source == "launch" else documented("can.viewer", hub.port)
        master, terminal = pty.openpty()
        process = await asyncio.create_subprocess_exec(
            *command, stdin=terminal, stdout=terminal, stderr=terminal,
            env={**os.environ, "TERM": "xterm", "LINES": "40", "COLUMNS": "120"},
        )  # fmt: skip
        os.close(terminal)
        os.set_blocking(master, False)
        seen = b""

        def shown() -> bool:
            nonlocal seen
            with contextlib.suppress(OSError):
                seen += os.read(master, 65536)
            assert process.returncode is None, seen.decode()
            if any(client.bus is not None for client in hub.clients):
                other.submit(Frame(0x18ABCD80, b"\x01"))
            return b"18ABCD80" in seen

        await until(shown)
        os.write(master, b"q")
        assert await ended(process) == 0, seen.decode()
        os.close(master)

    on_a_hub(story)


TRIES = 5


def test_a7_the_logger_writes_what_the_player_plays(tmp_path: Path) -> None:
    frames = [Frame(0x18FFFF00 | n, bytes((n,))) for n in range(50)]

    async def story(hub: Hub, other: FieldBus) -> None:
        heard: list[int] = []

        def count(t_us: int, frame: Frame) -> None:
            heard.append(frame.identifier)

        hub.segment.taps.append(count)
        played: list[int] = []
        for _ in range(TRIES):  # an interrupt may come before the logger has read anything
            heard.clear()
            log = documented("can.logger", hub.port)
            logger = await asyncio.create_subprocess_exec(*log, cwd=tmp_path, stdout=DEVNULL)
            await until(lambda: any(client.bus is not None for client in hub.clients))
            for frame in frames:
                other.submit(frame)
            await until(lambda: len(heard) == len(frames))
            client = next(client for client in hub.clients if client.bus is not None)
            await until(lambda client=client: client.unread_bytes == 0)  # type: ignore[misc]
            logger.send_signal(signal.SIGINT)
            assert await ended(logger) == 0
            await until(lambda: not any(client.bus is not None for client in hub.clients))
            with can.LogReader(tmp_path / "run.blf") as kept:
                played = [m.arbitration_id for m in kept]
            if played:
                break
        # Its end may come before it has read the last ones.
        assert played and played == [frame.identifier for frame in frames[: len(played)]]
        heard.clear()
        play = documented("can.player", hub.port)
        player = await asyncio.create_subprocess_exec(*play, cwd=tmp_path, stdout=DEVNULL)
        assert await ended(player) == 0
        await until(lambda: len(heard) == len(played))

    on_a_hub(story)


def test_a14_frames_of_others_are_unknown_by_their_group_and_not_malformed() -> None:
    inspector = Inspector()
    for number in range(5):
        inspector.hear(number, Frame(0x0CF00400, b"\xff" * 8))
        inspector.hear(number, Frame(0x0CAB2680, b"\xff" * 8))  # to a destination
        inspector.hear(number, Frame(0x18FEFF80, b""))
    told = inspector.to_dict()
    assert told["malformed"] == {} and len(NAMES) >= 20
    assert told["unknown"] == {
        "PGN 61444 (EEC1: engine speed)": 5,
        "PGN 43776 (file server to device)": 5,
        "PGN 65279": 5,
    }
    inspector.hear(9.0, Frame(0x14FF1080, b"\x00"))
    assert inspector.to_dict()["malformed"] == {"length": 1}


def test_a14_frames_that_no_robot_reads_are_counted_in_a_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """11-bit identifiers, remote and error frames of a shared bus are neither malformed nor lost."""
    log = tmp_path / "shared.log"
    log.write_text(
        "(1.000000) can0 0CFF1080#0000000000000000\n(1.1) can0 123#0102\n(1.2) can0 123#R\n"
        "(1.3) can0 20000088#0000000000000000\n(1.4) can0 0CFE0C26#01FFFFFFFFFFFFFF\n"
    )
    words = (log, "socketcand", "can0", 250_000, "127.0.0.1", 0, None, False, None)
    assert inspect(*words, as_json=True) == 0
    seen = json.loads(capsys.readouterr().out)
    assert seen["other_frames"] == 3 and seen["malformed"] == {}
    assert seen["unknown"] == {"PGN 65036 (working set member)": 1}


def test_a_live_bus_is_told_in_seconds_since_we_listen(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """`WORKING@1318.1` was a time of the machine's own clock."""

    async def story(hub: Hub, other: FieldBus) -> None:
        loop = asyncio.get_running_loop()
        beats = loop.create_task(said_again(other))
        where = ("socketcand", "can0", 250_000, "127.0.0.1", hub.port)
        words = (False, None, True, None, True)  # no diagram, no why, JSON, no traces, plain
        told = await asyncio.to_thread(inspect, None, *where, 1.0, *words)
        beats.cancel()
        assert told == 0

    on_a_hub(story)
    (robot,) = json.loads(capsys.readouterr().out)["robots"]
    assert robot["transitions"], robot
    assert all(0.0 <= step["t_s"] <= LIMIT_S for step in robot["transitions"])


async def said_again(bus: FieldBus) -> None:
    """A robot that works, as its frames tell it, ten times a second."""
    loop = asyncio.get_running_loop()
    said = (
        Member(3, 1, 0), Heartbeat(3, 1, False, False, True, False, 1.0, 0, 0),
        Pose(1.0, 2.0, 0.0, 1.0, 1, False, 255),
    )  # fmt: skip
    while True:
        for frame in (encode(each, 0x83) for each in said):
            bus.send(can.Message(arbitration_id=frame.identifier, data=frame.data))
        turn = loop.create_future()
        loop.call_later(0.1, turn.set_result, None)
        await turn
