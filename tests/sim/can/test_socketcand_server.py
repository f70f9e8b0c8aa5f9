"""The hub: no frame of a client is lost, and no client costs the others theirs."""

import asyncio
import contextlib
import os
import socket
import sys
import time
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


def test_t15_a_client_of_python_can_hears_on_after_the_bus_took_none_of_its_frames() -> None:
    """It read the word after `error` as a number, and again with all that came later. So
    `headland stop --hold` heard no robot confirm when a flood had ended."""

    def flood(port: int) -> can.BusABC:
        bus = can.Bus("can0", "socketcand", host="127.0.0.1", port=port)
        for k in range(1_000):  # more than its controller holds
            bus.send(can.Message(arbitration_id=0x18FFFF00, data=[k & 0xFF]))
        return bus

    async def story(served: Served) -> None:
        with await asyncio.to_thread(flood, served.hub.port) as bus:
            (client,) = served.hub.clients
            babbler = FieldBus(served.segment.channel)

            def refused() -> bool:
                while babbler.submit(Frame(0x4D, bytes(8))):  # the most urgent frames
                    pass
                return client.refused > 0

            await served.until(refused)
            babbler.shutdown()
            device = FieldBus(served.segment.channel)
            device.submit(Frame(0x77, b"\1"))
            heard = set[int]()
            async with asyncio.timeout(LIMIT_S):
                while 0x77 not in heard:
                    message = await asyncio.to_thread(bus.recv, 0.1)
                    heard |= set() if message is None else {message.arbitration_id}
            device.shutdown()
            assert 0x004 in heard, "an error frame of the controller"

    on_a_hub("python-can in a flood", story)


def test_frames_for_another_bus_are_not_put_on_this_one() -> None:
    """A client that does not wait for the answer to `open` stopped the robots of the wrong bus."""

    async def story(served: Served) -> None:
        for words in (
            b"< open can1 >< send 18FFFF01 1 01 >",
            b"< open can0 >< send 18FFFF02 1 02 >",
        ):
            _, writer = await asyncio.open_connection("127.0.0.1", served.hub.port)
            writer.write(words)
            await writer.drain()
            await served.until(lambda: bool(served.frames) or not served.hub.clients)
            writer.close()
        await served.until(lambda: bool(served.frames))
        assert [frame.identifier for frame in served.frames] == [0x18FFFF02]

    on_a_hub("another bus", story)


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
            sock.shutdown(socket.SHUT_WR)
            while sock.recv(
                4096
            ):  # closed with unread answers, TCP resets, and what is unread is lost
                pass

    async def story(served: Served) -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, what: complaints.append(what))
        await asyncio.to_thread(attack, served.hub.port)
        await served.until(lambda: Frame(0x18FFFF01, b"") in served.frames)
        assert served.frames == [Frame(0x18FFFF01, b"")]

    on_a_hub("odd", story)
    assert complaints == []


# A filter whose length has more digits than Python's `int` reads. The word at the front lets a line be so
# long.
LONG_FILTER = b"< filter muxfilter 0 123 " + b"9" * 5_000 + b" >"


def left_at_the_hub(name: str, sent: bytes) -> tuple[tuple[int, int], list[dict[str, Any]]]:
    """What a client that sends `sent` and goes leaves: seats taken, and nodes on the wire beyond those of
    before. And complaints of asyncio."""
    complaints: list[dict[str, Any]] = []
    left: list[tuple[int, int]] = []

    def attack(port: int) -> None:
        with contextlib.suppress(OSError), greeted(port) as sock:
            told(sock, b"< rawmode >", b"< ok >")
            sock.sendall(sent)
            sock.shutdown(socket.SHUT_WR)
            while sock.recv(4096):
                pass

    async def story(served: Served) -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, what: complaints.append(what))
        nodes = len(served.segment.wire.nodes)
        await asyncio.to_thread(attack, served.hub.port)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(5.0):
                await served.until(
                    lambda: not served.hub.clients and len(served.segment.wire.nodes) == nodes
                )
        left.append((len(served.hub.clients), len(served.segment.wire.nodes) - nodes))

    on_a_hub(name, story)
    return left[0], complaints


def test_a_filter_with_a_length_of_thousands_of_digits_keeps_no_seat() -> None:
    """`int` raised, and again where the rest was read, so that seat, descriptor and node stayed."""
    assert left_at_the_hub("digits", b"< bcmmode >" + 4 * LONG_FILTER) == ((0, 0), [])


def test_a_command_that_raises_keeps_no_seat(monkeypatch: pytest.MonkeyPatch) -> None:
    def handle(client: hub_module.Client, command: str) -> str | None:
        if command.startswith("filter"):
            raise ValueError(command[:20])
        return real(client, command)

    real = hub_module.Client.handle
    monkeypatch.setattr(hub_module.Client, "handle", handle)
    seats_and_nodes, complaints = left_at_the_hub("raises", b"< bcmmode >" + 4 * LONG_FILTER)
    assert seats_and_nodes == (0, 0)
    assert complaints, "what is wrong is still told"


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


@pytest.mark.sampled(1)
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


def answered(sock: socket.socket, words: bytes, until: bytes = b">") -> bytes:
    """What comes after these words, until that ends it."""
    sock.sendall(words)
    heard = b""
    while not heard.endswith(until):
        part = sock.recv(1)
        if not part:
            return heard + b"closed"
        heard += part
    return heard


def clients(name: str, story: Callable[[int, Hub], None]) -> None:
    async def run(served: Served) -> None:
        await asyncio.to_thread(story, served.hub.port, served.hub)

    on_a_hub(name, run)


def test_frames_of_every_kind_pass_between_clients_of_python_can() -> None:
    """11-bit identifiers both ways, and python-can's own reading of them."""

    def story(port: int, hub: Hub) -> None:
        with (
            can.Bus("can0", "socketcand", host="127.0.0.1", port=port) as one,
            can.Bus("can0", "socketcand", host="127.0.0.1", port=port) as other,
        ):
            for message in (
                can.Message(arbitration_id=0x123, data=[1, 2], is_extended_id=False),
                can.Message(arbitration_id=0x7FF, data=[], is_extended_id=False),
                can.Message(arbitration_id=0x18FFFF20, data=[3], is_extended_id=True),
            ):
                one.send(message)
                heard = other.recv(LIMIT_S)
                assert heard is not None
                assert heard.arbitration_id == message.arbitration_id
                assert heard.is_extended_id == message.is_extended_id
                assert heard.data == message.data
                assert abs(heard.timestamp - time.time()) < LIMIT_S  # the wall clock

    clients("kinds", story)


def test_remote_frames_are_told_as_rtr() -> None:
    def story(port: int, hub: Hub) -> None:
        with greeted(port) as one, greeted(port) as other:
            told(other, b"< rawmode >", b"< ok >")
            for words, answer in (
                (b"< sendrtr 123 4 >", b"< rtr 123 "),
                (b"< sendrtr 1AAAAAAA 2 >", b"< rtr 1AAAAAAA "),
            ):
                one.sendall(words)
                line = answered(other, b"")
                assert line.startswith(answer) and line.endswith(words[-4:]), line
            assert answered(one, b"< sendrtr 800 4 >") == b"< error not a classic CAN frame >"
            assert answered(one, b"< sendrtr 123 9 >") == b"< error not a classic CAN frame >"

    clients("remote", story)


def test_the_broadcast_manager_sends_and_filters() -> None:
    """`open` leads to its mode; a second client in raw mode hears what it sends."""

    def story(port: int, hub: Hub) -> None:
        with greeted(port) as manager, greeted(port) as raw:
            told(raw, b"< rawmode >", b"< ok >")
            manager.sendall(b"< add 0 20000 123 2 42 43 >")
            lines = [answered(raw, b"").split() for _ in range(3)]
            assert {(line[1], line[2], line[4]) for line in lines} == {(b"frame", b"123", b"4243")}
            manager.sendall(b"< update 123 1 44 >")
            while answered(raw, b"").split()[4] != b"44":
                pass
            manager.sendall(b"< delete 123 >")
            assert (
                answered(manager, b"< delete 123 >") == b"< error no send job of this identifier >"
            )

            told(manager, b"< subscribe 0 0 18FFFF20 >< echo >", b"< echo >")
            raw.sendall(b"< send 18FFFF21 1 1 >< send 18FFFF20 1 2 >")
            assert answered(manager, b"").split()[2::2][:2] == [b"18FFFF20", b"02"]
            told(manager, b"< unsubscribe 18FFFF20 >< filter 0 0 124 1 F0 >< echo >", b"< echo >")
            raw.sendall(b"< send 18FFFF20 1 3 >< send 124 1 10 >< send 124 1 11 >< send 124 1 20 >")
            assert [answered(manager, b"").split()[4] for _ in range(2)] == [b"10", b"20"]
            mux = b"< muxfilter 0 0 125 2 FF 00 00 00 00 00 00 00 33 FF FF FF FF FF FF FF >< echo >"
            told(manager, mux, b"< echo >")
            raw.sendall(b"< send 125 2 33 1 >< send 125 2 44 1 >< send 125 2 33 2 >")
            assert [answered(manager, b"").split()[4] for _ in range(2)] == [b"3301", b"3302"]

            # Its jobs and filters end with the mode, and so do its commands.
            told(manager, b"< add 0 20000 126 0 >< rawmode >", b"< ok >")
            refused = b"< error add is a command of bcmmode >"
            manager.sendall(b"< add 0 20000 123 0 >")
            line = b""
            while not line.startswith(b"< error"):
                line = answered(manager, b"")
            assert line == refused

    clients("manager", story)


def test_statistics_come_in_control_mode() -> None:
    def story(port: int, hub: Hub) -> None:
        with greeted(port) as one, greeted(port) as other:
            told(one, b"< controlmode >", b"< ok >")
            one.sendall(b"< statistics 10 >")
            assert answered(one, b"") == b"< stat 0 0 0 0 >"
            other.sendall(b"< send 18FFFF21 2 1 2 >")
            one.sendall(b"< send 123 1 1 >")
            while answered(one, b"") != b"< stat 2 1 1 1 >":
                pass
            one.sendall(b"< statistics 0 >< echo >")
            while answered(one, b"") != b"< echo >":
                pass
            assert answered(other, b"< statistics 10 >").startswith(b"< error statistics is a")

    clients("statistics", story)


@pytest.mark.parametrize("mode", [b"rawmode", b"bcmmode"])
def test_statistics_end_with_control_mode(mode: bytes) -> None:
    """As in socketcand. A client in raw mode was told them for as long as it was there."""

    def story(port: int, hub: Hub) -> None:
        with greeted(port) as one:
            told(one, b"< controlmode >", b"< ok >")
            one.sendall(b"< statistics 10 >")
            assert answered(one, b"") == b"< stat 0 0 0 0 >"
            one.sendall(b"< " + mode + b" >< echo >")
            while answered(one, b"") != b"< echo >":
                pass
            (client,) = hub.clients
            assert client._statistics_timer is None

    clients(f"statistics end {mode.decode()}", story)


def test_a_wrong_bus_ends_the_connection() -> None:
    def story(port: int, hub: Hub) -> None:
        with socket.create_connection(("127.0.0.1", port), LIMIT_S) as sock:
            told(sock, b"", b"< hi >")
            assert answered(sock, b"< open can7 >") == b"< error could not open bus can7 >"
            assert sock.recv(1) == b""

    clients("wrong bus", story)


def test_broken_frames_are_told_where_the_hub_tells_errors() -> None:
    """python-can reads them as error frames."""

    async def main() -> None:
        line = segment("errors", seed=3)
        hub = Hub(line, errors=True)
        await hub.start()
        line.wire.faults.error = 1.0
        try:
            await asyncio.to_thread(story, hub.port)
        finally:
            await hub.stop()
            forget("errors")

    def story(port: int) -> None:
        with (
            can.Bus("can0", "socketcand", host="127.0.0.1", port=port) as one,
            can.Bus("can0", "socketcand", host="127.0.0.1", port=port) as other,
        ):
            one.send(can.Message(arbitration_id=0x18FFFF20, data=[1]))
            heard = other.recv(LIMIT_S)
            assert heard is not None and heard.is_error_frame and heard.arbitration_id == 0x088
            kinds = set()
            while 0x040 not in kinds:  # bus-off after 32 of them
                heard = one.recv(LIMIT_S)
                assert heard is not None and heard.is_error_frame
                kinds.add(heard.arbitration_id)
            # A hub that is kept waiting may look at the controller when it is bus-off already.
            assert {0x088, 0x040} <= kinds <= {0x088, 0x004, 0x040}

    asyncio.run(main())


def test_our_robots_count_frames_of_other_kinds_and_read_none() -> None:
    async def story(served: Served) -> None:
        link, heard = SocketcandLink("127.0.0.1", served.hub.port, "can0", Random(1)), list[Frame]()
        link.subscribe(heard.append)
        await link.up()
        with await asyncio.to_thread(greeted, served.hub.port) as sock:
            await asyncio.to_thread(
                sock.sendall, b"< send 123 1 1 >< sendrtr 123 2 >< send 18FFFF20 1 2 >"
            )
            await served.until(lambda: heard == [Frame(0x18FFFF20, b"\x02")])
        assert link.other_frames == 2 and link.malformed == 0
        link.close()

    on_a_hub("robots and others", story)


COMMANDS = (
    "open", "rawmode", "bcmmode", "controlmode", "isotpmode", "send", "sendrtr", "add", "update",
    "delete", "subscribe", "unsubscribe", "filter", "muxfilter", "statistics", "echo", "confirm",
)  # fmt: skip


def test_the_documents_have_every_command() -> None:
    text = Path("docs/use/bus.md").read_text()
    for command in COMMANDS:
        assert f"| `< {command}" in text, command
