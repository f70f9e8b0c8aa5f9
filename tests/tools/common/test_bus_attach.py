"""Programs that stay on a bus whose server ends and comes back."""

import asyncio
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Thread

import pytest

from protocol.frames.codec import decode
from protocol.frames.frame import Frame
from protocol.frames.safety_frames import EmergencyStop, Reason
from sim.can.simulated_bus import FieldBus, forget, segment
from sim.can.socketcand_server import Hub
from tools.common import bus_attach
from tools.common.bus_address import AttachError
from tools.common.bus_attach import attach, stay_attached
from tools.inspect import inspection
from tools.inspect.inspector import Inspector
from tools.language.conversation import Conversation
from tools.language.say_options import Options
from tools.operate import estop

ROOT = Path(__file__).parents[3]
CHANNEL, LIMIT_S, LOOK_S, CPU_MAX = "can0", 20.0, 0.5, 0.5
BEAT = Frame(0x18FF1080, bytes(range(8)))


async def passed(for_s: float) -> None:
    """In real time: what is looked at is in the kernel."""
    turn = asyncio.get_running_loop().create_future()
    asyncio.get_running_loop().call_later(for_s, turn.set_result, None)
    await turn


async def until(holds: Callable[[], bool]) -> None:
    async with asyncio.timeout(LIMIT_S):
        while not holds():
            await passed(0.01)


async def begun(name: str, port: int = 0) -> Hub:
    """A bus of this name, and its hub."""
    hub = Hub(segment(name), CHANNEL)
    await hub.start(port=port)
    return hub


async def ended(hub: Hub, name: str) -> int:
    """The port at which the bus can begin again."""
    port = hub.port
    await hub.stop()
    forget(name)
    return port


async def joined(hub: Hub) -> None:
    await until(lambda: any(client.bus is not None for client in hub.clients))


async def share_of_a_core() -> float:
    begun_cpu_s, begun_at_s = time.process_time(), time.monotonic()
    await passed(LOOK_S)
    return (time.process_time() - begun_cpu_s) / (time.monotonic() - begun_at_s)


def test_who_stays_on_a_bus_takes_no_core_without_it_and_hears_the_next_one() -> None:
    """Found: maps and `headland ros2` took a whole core once their launch had ended, and were deaf."""

    async def story() -> None:
        name, heard = "a program that stays", list[Frame]()
        hub = await begun(name)
        bus = await stay_attached("socketcand", CHANNEL, 250_000, "127.0.0.1", hub.port, name)
        bus.subscribe(heard.append)
        for _ in range(2):
            await joined(hub)
            other = FieldBus(name)
            other.submit(BEAT)
            await until(lambda: heard == [BEAT])
            other.shutdown()
            heard.clear()
            port = await ended(hub, name)
            assert await share_of_a_core() < CPU_MAX
            hub = await begun(name, port)
        bus.close()
        await ended(hub, name)

    asyncio.run(story())


def test_a_watch_goes_on_after_a_restart_of_its_bus() -> None:
    async def story() -> None:
        name, told = "a watch", list[int]()
        hub = await begun(name)
        where = ("socketcand", CHANNEL, 250_000, "127.0.0.1", hub.port)
        watching = asyncio.create_task(
            inspection._listen(Inspector(), *where, None, lambda seen: told.append(1))
        )
        await joined(hub)
        port = await ended(hub, name)
        assert await share_of_a_core() < CPU_MAX
        hub = await begun(name, port)
        await joined(hub)
        assert not watching.done()
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        await ended(hub, name)

    asyncio.run(story())


@pytest.mark.parametrize(("hold", "watch"), [(True, False), (False, True), (True, True)])
def test_a_stop_that_is_held_goes_on_after_a_restart_of_its_bus(hold: bool, watch: bool) -> None:
    """Its hub had ended and was started again, and of the press nothing was heard there."""

    async def story() -> None:
        name = f"a stop that is held {hold} {watch}"
        hub = await begun(name)
        where = ("socketcand", CHANNEL, 250_000, "127.0.0.1", hub.port)
        reason = Reason.OPERATOR_INTERVENTION
        held = asyncio.create_task(
            estop._estop(*where, None, reason, 0.1, watch=watch, as_json=False, hold=hold)
        )
        await joined(hub)
        port = await ended(hub, name)
        assert not hold or await share_of_a_core() < CPU_MAX
        heard = list[Frame]()
        segment(name).taps.append(lambda t_us, frame: heard.append(frame))
        hub = await begun(name, port)
        await joined(hub)
        await until(lambda: not hold or any(isinstance(decode(f)[1], EmergencyStop) for f in heard))
        assert not held.done()
        held.cancel()
        await asyncio.gather(held, return_exceptions=True)
        await ended(hub, name)

    asyncio.run(story())


def test_a_stop_in_words_is_said_after_a_restart_of_its_bus(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In a conversation that had begun before, it was said to nobody."""
    monkeypatch.setattr(Conversation, "_listen", lambda conversation: None)

    async def story() -> None:
        name = "a conversation"
        hub = await begun(name)
        where = ("socketcand", CHANNEL, 250_000, "127.0.0.1", hub.port)
        conversation = Conversation(Options(where, timeout_s=0.5))
        talking = asyncio.create_task(conversation.hold(None))
        await joined(hub)
        port = await ended(hub, name)
        heard = list[Frame]()
        segment(name).taps.append(lambda t_us, frame: heard.append(frame))
        hub = await begun(name, port)
        await joined(hub)
        conversation.lines.put_nowait("stop all robots")
        await until(lambda: bool(heard))
        talking.cancel()
        await asyncio.gather(talking, return_exceptions=True)
        await ended(hub, name)

    asyncio.run(story())


def test_a_host_that_is_no_name_is_one_line() -> None:
    """Found: a traceback."""
    with pytest.raises(AttachError, match="cannot open socketcand at"):
        attach("socketcand", CHANNEL, 250_000, "a" * 70, 29536)


@pytest.mark.parametrize("closes", [False, True])
def test_a_server_that_accepts_and_says_nothing_is_told_in_one_line(
    closes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """python-can waits for the greeting without a limit, and `headland stop` hung without a word."""
    monkeypatch.setattr(bus_attach, "REACH_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        if closes:
            Thread(target=lambda: server.accept()[0].close()).start()
        with pytest.raises(AttachError, match=f"127.0.0.1:{port} "):
            bus_attach.attach("socketcand", "can0", 250_000, "127.0.0.1", port)


class Hanging:
    """A server that answers each client with these words, one for each that it hears, and then hangs."""

    def __init__(self, *words: bytes) -> None:
        self.words, self.server = words, socket.create_server(("127.0.0.1", 0))
        self.port, self.taken = self.server.getsockname()[1], list[socket.socket]()

    def __enter__(self) -> "Hanging":
        Thread(target=self.serve, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        for each in (self.server, *self.taken):
            each.close()

    def serve(self) -> None:
        with suppress(OSError):  # closed
            while True:
                self.taken.append(self.server.accept()[0])
                Thread(target=self.answer, args=(self.taken[-1],), daemon=True).start()

    def answer(self, client: socket.socket) -> None:
        with suppress(OSError):
            for word in self.words:
                client.sendall(word)
                client.recv(256)


COMMANDS = (["stop", "--timeout", "2"], ["release", "--timeout", "2"], ["reset", "--timeout", "2"],
            ["inspect", "--seconds", "2"])  # fmt: skip


@pytest.mark.parametrize(
    ("words", "said", "fails"),
    [
        ((b"< hi >",), "does not answer: a server that hangs", 2),
        ((b"< hi >", b"< ok >"), "does not answer: a server that hangs", 2),
        ((b"< hi >", b"< ok >", b"< ok >"), "", 1),  # a bus without devices
    ],
)
def test_commands_end_where_a_hub_greets_and_then_hangs(
    words: tuple[bytes, ...], said: str, fails: int
) -> None:
    """They waited for its next word without a limit."""
    with Hanging(*words) as hub:
        begun = [
            subprocess.Popen(
                [sys.executable, "-m", "tools.cli.headland", *command, "--port", str(hub.port)],
                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
            )
            for command in COMMANDS
        ]  # fmt: skip
        try:
            for command, process in zip(COMMANDS, begun, strict=True):
                _, errors = process.communicate(timeout=LIMIT_S)
                looks = command[0] == "inspect" and not said  # a quiet bus is no fault to look at
                assert process.returncode == (0 if looks else fails), (command, errors)
                assert said in errors and errors.count("\n") <= 1 and "Traceback" not in errors
        finally:
            for process in begun:
                process.kill()
                process.wait()


def test_the_limit_of_an_attachment_ends_with_it() -> None:
    with Hanging(b"< hi >") as hub, pytest.MonkeyPatch.context() as patch:
        patch.setattr(bus_attach, "REACH_S", 0.2)
        with pytest.raises(AttachError, match="does not answer"):
            attach("socketcand", CHANNEL, 250_000, "127.0.0.1", hub.port)
    assert socket.getdefaulttimeout() is None


class Busy(Hanging):
    """A server whose last answer is read with the first frame, by all clients before this one."""

    together = 3  # the first one is that of the greeting

    def answer(self, client: socket.socket) -> None:
        last = (
            b"< ok >< frame 18FF1080 1.000000 00 >"
            if len(self.taken) <= self.together
            else b"< ok >"
        )
        self.words = b"< hi >", b"< ok >", last
        super().answer(client)


def test_an_answer_that_is_read_with_a_frame_is_asked_for_again() -> None:
    """`headland release` ended with 2 on a busy machine: python-can expects the answer alone."""

    async def story() -> None:
        attach("socketcand", CHANNEL, 250_000, "127.0.0.1", hub.port).close()

    with Busy() as hub:
        asyncio.run(story())
        assert len(hub.taken) == Busy.together + 1
    always = Busy()
    always.together = 100
    with always as hub, pytest.raises(AttachError, match="Expected '< ok >'"):
        asyncio.run(story())
