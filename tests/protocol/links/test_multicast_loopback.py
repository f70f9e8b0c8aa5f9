"""UDP multicast returns a robot's own frames to it: they are recognised, and missed."""

import asyncio
import json
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from secrets import randbelow
from typing import Any

import can
import pytest

from protocol.frames.frame import Frame
from protocol.links.bus import DEAF_S, ERROR_GAP_S, CanBus, Loopback, open_bus
from tests.multicast import reached

SCRIPT = Path(__file__).with_name("multicast_in_namespace.py")
NAMESPACE = ("unshare", "-rn")
INTERFACE, LIMIT_S = "udp_multicast", 20.0
STOP, LAST = Frame(0x0CFD0280, b"\x01\xff\xff\xff\xff\xff\xff\xf4"), Frame(0x18FF1081, b"last")


async def until(holds: Callable[[], bool]) -> None:
    """In real time: something is waited for in the kernel."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + LIMIT_S
    while not holds():
        assert loop.time() < end_s
        turn = loop.create_future()
        loop.call_later(0.005, turn.set_result, None)
        await turn


@pytest.fixture
def group() -> str:
    """A channel of datagrams that reach this machine itself."""
    return reached(f"239.74.165.{1 + randbelow(250)}")


@pytest.fixture
def plain(group: str) -> Iterator[can.BusABC]:
    """Another device in the group, by python-can alone."""
    with can.Bus(group, INTERFACE) as bus:
        yield bus


def said(bus: can.BusABC, frame: Frame) -> None:
    bus.send(can.Message(arbitration_id=frame.identifier, data=frame.data, is_extended_id=True))


def test_own_frames_are_not_heard_and_equal_ones_of_another_device_are(
    group: str, plain: can.BusABC
) -> None:
    """A robot took its own stop frame for a button of another maker."""

    async def main() -> None:
        bus, other = open_bus(INTERFACE, group), open_bus(INTERFACE, group)
        heard, heard_there = list[Frame](), list[Frame]()
        bus.subscribe(heard.append)
        other.subscribe(heard_there.append)
        for _ in range(3):
            assert bus.send(STOP)
        said(plain, LAST)
        await until(lambda: LAST in heard)
        assert heard == [LAST], "own frames come back first"
        assert bus.send(STOP) and other.send(STOP)
        said(plain, STOP)
        said(plain, LAST)
        await until(lambda: heard.count(LAST) == 2 and heard_there.count(LAST) == 2)
        assert heard == [LAST, STOP, STOP, LAST], "two other devices have sent it from our address"
        assert heard_there == [STOP, STOP, STOP, LAST, STOP, STOP, LAST]
        bus.close()
        other.close()

    asyncio.run(main())


def test_a_frame_that_is_sent_again_with_our_mark_is_heard(group: str, plain: can.BusABC) -> None:
    """Who reads the mark of a robot cannot make a stop pass for its own."""

    async def main() -> None:
        bus, heard = open_bus(INTERFACE, group), list[Frame]()
        bus.subscribe(heard.append)
        assert bus.send(STOP)
        copied = plain.recv(LIMIT_S)
        assert copied is not None and copied.channel
        plain.send(copied)
        said(plain, LAST)
        await until(lambda: LAST in heard)
        assert heard == [STOP, LAST]
        bus.close()

    asyncio.run(main())


@pytest.mark.parametrize("identifier", [float(LAST.identifier), float("nan"), True])
def test_an_identifier_that_is_no_whole_number_is_counted(
    group: str, plain: can.BusABC, identifier: Any
) -> None:
    """One such datagram ended every robot in its group, with a traceback."""

    async def main() -> None:
        bus, heard = open_bus(INTERFACE, group), list[Frame]()
        bus.subscribe(heard.append)
        for is_error in (False, True):
            message = can.Message(arbitration_id=1, data=b"12345678", is_error_frame=is_error)
            message.arbitration_id = identifier
            plain.send(message)
        said(plain, LAST)
        await until(lambda: bool(heard) and heard[-1] == LAST)
        assert heard == [LAST] and type(heard[0].identifier) is int and bus.ignored == 2
        bus.close()

    asyncio.run(main())


def test_a_frame_that_came_back_confirms_nothing(group: str) -> None:
    """The kernel returns it also while no cable is plugged in: a robot that is alone would drive on."""

    async def main() -> None:
        bus = open_bus(INTERFACE, group)
        bus.subscribe(lambda frame: None)
        assert isinstance(bus, CanBus) and bus._loopback is not None
        assert bus.send(STOP)
        unreturned = bus._loopback._unreturned
        assert len(unreturned) == 1
        await until(lambda: not unreturned)
        assert bus.sent is None
        bus.close()

    asyncio.run(main())


def leave(bus: can.BusABC, group: str) -> None:
    """The socket is no member of its group any more, as after its network interface was removed."""
    request = socket.inet_aton(group) + socket.inet_aton("0.0.0.0")
    with socket.socket(fileno=os.dup(bus.fileno())) as same:
        same.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, request)


class Trial:
    """A bus in a group, and the clock of its loopback, which is set by hand."""

    def __init__(self, group: str) -> None:
        self.now_s = 0.0
        self.bus, self.heard = open_bus(INTERFACE, group), list[Frame]()
        self.bus.subscribe(self.heard.append)
        loopback = self.bus._loopback
        assert loopback is not None
        self.loopback: Loopback = loopback
        self.loopback.clock = lambda: self.now_s

    async def returns(self) -> None:
        """A frame of ours is sent and comes back."""
        assert self.bus.send(STOP)
        await until(lambda: not self.loopback._unreturned)

    def sends_for(self, for_s: float, every_s: float = 0.125) -> None:
        """Frames are sent all that time; what comes back is not read."""
        for _ in range(round(for_s / every_s)):
            self.now_s += every_s
            assert self.bus.send(STOP)


def test_a_bus_whose_own_frames_stop_coming_back_joins_its_group_again(
    group: str, plain: can.BusABC
) -> None:
    """A robot was deaf for ever after its network interface was removed and came back."""

    async def main() -> None:
        trial = Trial(group)
        await trial.returns()
        for word in (b"once", b"twice"):
            before = trial.bus.bus
            leave(before, group)
            trial.sends_for(DEAF_S)
            assert trial.bus.bus is before, "not yet"
            trial.sends_for(0.125)
            assert trial.bus.bus is not before
            said(plain, Frame(2, word))
            await until(lambda word=word: Frame(2, word) in trial.heard)  # type: ignore[misc]
            await trial.returns()
        assert STOP not in trial.heard
        trial.bus.close()

    asyncio.run(main())


def test_a_process_that_was_frozen_and_a_system_that_returns_nothing_do_not_join_again(
    group: str,
) -> None:
    async def main() -> None:
        trial = Trial(group)
        before = trial.bus.bus
        trial.sends_for(10 * DEAF_S)
        assert trial.bus.bus is before, "no frame has ever come back"
        await trial.returns()
        for _ in range(5):
            trial.sends_for(0.5)
            trial.now_s += ERROR_GAP_S + 0.1  # frozen: what came back was not read
        assert trial.bus.bus is before
        trial.bus.close()

    asyncio.run(main())


def test_a_group_that_cannot_be_joined_again_is_tried_later(
    group: str, plain: can.BusABC, caplog: pytest.LogCaptureFixture
) -> None:
    async def main() -> None:
        trial = Trial(group)
        await trial.returns()
        opened, tries = trial.loopback.opened, 0

        def fails() -> can.BusABC:
            nonlocal tries
            tries += 1
            raise can.CanInitializationError("could not create or configure socket")

        leave(trial.bus.bus, group)
        trial.loopback.opened = fails
        trial.sends_for(2 * DEAF_S + 0.25)
        assert tries == 2
        trial.loopback.opened = opened
        trial.sends_for(DEAF_S + 0.125)
        await trial.returns()
        trial.bus.close()

    asyncio.run(main())
    assert len(caplog.records) == 1 and "cannot join the group again" in caplog.text


def in_namespace(*words: str) -> "subprocess.CompletedProcess[str]":
    """A program in a network of its own, which has no interface that is up."""
    tried = [*NAMESPACE, "ip", "link", "add", "veth0", "type", "veth", "peer", "name", "veth1"]
    if not all(map(shutil.which, ("unshare", "ip"))):
        pytest.skip("no programs unshare and ip here")
    if subprocess.run(tried, capture_output=True).returncode:
        pytest.skip("this user cannot make a network with an interface")
    return subprocess.run([*NAMESPACE, *words], capture_output=True, text=True, timeout=120)


def test_a_network_interface_that_was_removed_and_came_back_is_heard_again() -> None:
    found = in_namespace(sys.executable, "-P", str(SCRIPT), "239.74.167.1")
    assert found.returncode == 0, found.stderr
    assert json.loads(found.stdout) == ["after", "before"]
    assert "joined the group again" in found.stderr


def test_who_only_listens_hears_a_network_interface_that_came_back() -> None:
    """The figures of `headland robot --metrics` stood for good, while its robot was heard again."""
    found = in_namespace(sys.executable, "-P", str(SCRIPT), "239.74.167.2", "listens")
    assert found.returncode == 0, found.stderr
    assert json.loads(found.stdout) == ["after", "before"]
    assert "own frames" not in found.stderr, "it has sent none"
