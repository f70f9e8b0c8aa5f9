"""The hub: no frame of a client is lost, and no client costs the others theirs."""

import asyncio
import contextlib
import os
import socket
import sys
from asyncio.subprocess import DEVNULL
from collections.abc import Awaitable, Callable
from pathlib import Path
from random import Random
from typing import Any

import can
import pytest

from protocol.frames.frame import Frame
from protocol.links.socketcand_link import SocketcandLink
from sim.can import socketcand_server as hub_module
from sim.can.simulated_bus import FieldBus, forget, segment
from sim.can.socketcand_server import CLIENTS_MAX, LISTENERS_MAX, Hub, frame_of

LIMIT_S = 30.0


def test_a_client_that_is_still_there_is_no_error() -> None:
    complaints: list[dict[str, Any]] = []

    async def main() -> bytes:
        asyncio.get_running_loop().set_exception_handler(lambda _, what: complaints.append(what))
        hub = Hub(segment("hub end"))
        await hub.start()
        reader, writer = await asyncio.open_connection("127.0.0.1", hub.port)
        greeting = await reader.readexactly(6)
        await hub.stop()
        writer.close()
        return greeting

    assert asyncio.run(main()) == b"< hi >"
    assert complaints == []
    forget("hub end")


class Served:
    """A hub and everything that passes on its wire; `until` looks again with each frame."""

    def __init__(self, name: str) -> None:
        self.segment = segment(name)
        self.hub = Hub(self.segment)
        self.frames: list[Frame] = []
        self._passed = asyncio.Event()
        self.segment.taps.append(self._tap)

    def _tap(self, t_us: int, frame: Frame) -> None:
        self.frames.append(frame)
        self._passed.set()

    async def until(self, holds: Callable[[], bool]) -> None:
        async with asyncio.timeout(LIMIT_S):
            while not holds():
                self._passed.clear()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._passed.wait(), 0.05)


def on_a_hub(name: str, story: Callable[[Served], Awaitable[None]]) -> None:
    async def main() -> None:
        served = Served(name)
        await served.hub.start()
        try:
            await story(served)
        finally:
            await served.hub.stop()
            forget(name)

    asyncio.run(main())


def told(sock: socket.socket, words: bytes, answer: bytes) -> None:
    sock.sendall(words)
    heard = b""
    while len(heard) < len(answer):
        heard += sock.recv(len(answer) - len(heard))
    assert heard == answer, heard


def greeted(port: int) -> socket.socket:
    sock = socket.create_connection(("127.0.0.1", port), LIMIT_S)
    told(sock, b"", b"< hi >")
    told(sock, b"< open can0 >", b"< ok >")
    return sock


def send_and_close(port: int, number: int) -> None:
    with greeted(port) as sock:
        sock.sendall(b"< rawmode >" + b"< send 18FFFF%02X 1 %02X >" % (number, number))


def send_by_python_can(port: int, number: int) -> None:
    with can.Bus("can0", "socketcand", host="127.0.0.1", port=port) as bus:
        bus.send(can.Message(arbitration_id=0x18FFFF00 | number, data=[number]))


@pytest.mark.parametrize("client", [send_and_close, send_by_python_can])
@pytest.mark.parametrize("busy", [False, True], ids=["idle bus", "busy bus"])
def test_a5_one_frame_of_a_client_that_closes_arrives_20_of_20(
    client: Callable[[int, int], None], busy: bool
) -> None:
    async def story(served: Served) -> None:
        loop = asyncio.get_running_loop()
        other = FieldBus(served.segment.channel)

        def babble() -> None:  # so that the client closes with frames unread
            other.submit(Frame(0x0CFF1080, b"\xff" * 8))
            loop.call_later(0.002, babble)

        if busy:
            babble()
        for number in range(20):
            await asyncio.to_thread(client, served.hub.port, number)
        single = [Frame(0x18FFFF00 | number, bytes((number,))) for number in range(20)]
        await served.until(lambda: set(single) <= set(served.frames))
        assert [frame for frame in served.frames if frame.identifier >> 24 == 0x18] == single
        await served.until(lambda: len(served.segment.buses) == 2)
        other.shutdown()

    on_a_hub(f"close {client.__name__} {busy}", story)


def test_a5_every_frame_of_can_player_arrives(tmp_path: Path) -> None:
    """4,000 frames, the last of which the player closes behind."""
    log = tmp_path / "can.log"
    log.write_text("".join(f"({n * 0.0005:.6f}) can0 18FFFF20#{n:04X}\n" for n in range(4000)))

    async def story(served: Served) -> None:
        player = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "can.player", "-i", "socketcand", "-c", "can0",
            "--bus-kwargs", "host=127.0.0.1", f"port={served.hub.port}", "--", str(log),
        )  # fmt: skip
        assert await player.wait() == 0
        await served.until(lambda: len(served.frames) >= 4000)
        assert [int(frame.data.hex(), 16) for frame in served.frames] == list(range(4000))

    on_a_hub("player", story)


def test_a6_nothing_is_missed_from_rawmode_on() -> None:
    """A question in the same packet as `rawmode`: the answer comes within a millisecond."""

    def ask(port: int) -> bytes:
        with greeted(port) as sock:
            told(sock, b"< rawmode >< send 18EAFFFE 3 00 EE 00 >", b"< ok >")
            assert sock.recv(256).startswith(b"< frame 18EEFF80 ")
        return b""

    async def story(served: Served) -> None:
        device = FieldBus(served.segment.channel)

        def answer(frame: Frame) -> None:
            device.submit(Frame(0x18EEFF80, frame.data))

        device.subscribe(answer)
        for _ in range(10):
            await asyncio.to_thread(ask, served.hub.port)
        device.shutdown()

    on_a_hub("rawmode", story)


ODD = [
    "-0000001",
    "+8FFFF00",
    "0x18FFFF",
    "18_FFF00",
    " 8FFFF00",
    "18FFFF0",
    "38FFFF00",
    "١8FFFF00",
]


def test_l4_numbers_that_only_python_reads_are_no_frames() -> None:
    assert frame_of("18FFFF00", "1", ["0a"]) == Frame(0x18FFFF00, b"\x0a")
    for identifier in ODD:
        assert frame_of(identifier, "0", []) is None, identifier
    for length in ("-1", "+1", "0x1", "1_", "2", "ff"):
        assert frame_of("18FFFF00", length, ["00"]) is None, length
    for byte in ("-1", "+1", "0x1", "1_1", "", "g", "f" * 17):
        assert frame_of("18FFFF00", "1", [byte]) is None, byte


def test_l4_odd_commands_cost_nobody_a_frame() -> None:
    complaints: list[dict[str, Any]] = []

    def attack(port: int) -> None:
        with greeted(port) as sock:
            told(sock, b"< rawmode >", b"< ok >")
            for word in ODD[:-1]:
                sock.sendall(b"< send %s 8 00 00 00 00 00 00 00 00 >" % word.encode())
            sock.sendall(b"< send 18FFFF01 0 >")

    async def story(served: Served) -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, what: complaints.append(what))
        await asyncio.to_thread(attack, served.hub.port)
        await served.until(lambda: Frame(0x18FFFF01, b"") in served.frames)
        assert served.frames == [Frame(0x18FFFF01, b"")]

    on_a_hub("odd", story)
    assert complaints == []


def test_a18_the_eff_flag_and_sign_extended_bytes_are_taken_as_socketcand_does() -> None:
    """The bytes that SavvyCAN sends."""
    sent = frame_of("98eafffe", "3", ["0", "ffffffffffffffee", "0"])
    assert sent == Frame(0x18EAFFFE, b"\x00\xee\x00")


def test_l5_160_idle_connections_keep_nobody_out() -> None:
    def stop(port: int) -> None:
        idle = [socket.create_connection(("127.0.0.1", port), LIMIT_S) for _ in range(CLIENTS_MAX)]
        listening = [greeted(port) for _ in range(CLIENTS_MAX)]
        for sock in listening:
            sock.sendall(b"< rawmode >")
        for number in range(20):
            send_by_python_can(port, number)
        for sock in (*idle, *listening):
            sock.close()

    async def story(served: Served) -> None:
        robot = await asyncio.to_thread(greeted, served.hub.port)
        robot.sendall(b"< rawmode >< send 18FFFF80 0 >")
        await served.until(lambda: len(served.frames) == 1)
        await asyncio.to_thread(stop, served.hub.port)
        await served.until(lambda: len(served.frames) == 21)
        assert len(served.hub.clients) <= CLIENTS_MAX and served.hub.refused == 0
        robot.sendall(b"< send 18FFFF80 0 >")  # who speaks has kept its seat
        await served.until(lambda: len(served.frames) == 22)
        robot.close()

    on_a_hub("idle", story)


def test_l5_150_clients_that_only_listen_are_thinned_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each frame is written to each of them: the newest few stay, and all that have sent."""
    monkeypatch.setattr(hub_module, "LISTENER_S", 0.2)

    async def story(served: Served) -> None:
        robot = await asyncio.to_thread(greeted, served.hub.port)
        robot.sendall(b"< rawmode >< send 18FFFF80 0 >")
        await served.until(lambda: len(served.frames) == 1)

        def listen() -> list[socket.socket]:
            listening = [greeted(served.hub.port) for _ in range(CLIENTS_MAX - 10)]
            for sock in listening:
                sock.sendall(b"< rawmode >")
            return listening

        listening = await asyncio.to_thread(listen)
        await served.until(lambda: len(served.hub.clients) == LISTENERS_MAX + 1)
        robot.sendall(b"< send 18FFFF80 0 >")
        await served.until(lambda: len(served.frames) == 2)
        await served.until(lambda: len(served.segment.wire.nodes) <= LISTENERS_MAX + 2)
        for sock in (robot, *listening):
            sock.close()

    on_a_hub("listeners", story)


POUR = """
import socket, sys
port, words = int(sys.argv[1]), sys.argv[2].encode()
with socket.create_connection(("127.0.0.1", port)) as sock:
    sock.sendall(b"< open can0 >< rawmode >")
    while True:
        sock.sendall(words * 1000)
"""


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize("flood", ["<>", "< echo >", "< send 18FFFF01 0 >"])
def test_l6_clients_that_do_not_read_cost_little_and_starve_nobody(flood: str) -> None:
    """Eight of them, each as fast as it can: what the hub holds for them is bounded, and a client that
    beats every 50 ms is heard."""

    async def story(served: Served) -> None:
        loop, sent = asyncio.get_running_loop(), 0
        heard, behind = list[int](), list[int]()
        good = SocketcandLink("127.0.0.1", served.hub.port, "can0", Random(1))
        await good.up()

        def beat() -> None:
            nonlocal sent
            sent += 1
            good.send(Frame(0x0CFF1080, b""))
            loop.call_later(0.05, beat)

        def tap(t_us: int, frame: Frame) -> None:
            if frame.identifier == 0x0CFF1080:
                heard.append(t_us)
                behind.append(sent - len(heard))

        served.segment.taps.append(tap)
        before = resident_bytes()
        beat()
        bad = [
            await asyncio.create_subprocess_exec(
                sys.executable, "-c", POUR, str(served.hub.port), flood, stderr=DEVNULL
            )
            for _ in range(8)
        ]
        await served.until(lambda: len(heard) >= 100)
        held = resident_bytes() - before
        good.close()
        for process in bad:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
        print(f"{flood}: at most {max(behind)} beats wait, memory {held / 1e6:.1f} MB")
        assert max(behind) < 20 and held < 60e6

    on_a_hub(f"flood {flood}", story)
