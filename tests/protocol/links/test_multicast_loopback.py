"""UDP multicast returns a robot's own frames to it: they are recognised."""

import asyncio
from collections.abc import Callable, Iterator
from secrets import randbelow

import can
import pytest

from protocol.frames.frame import Frame
from protocol.links.bus import CanBus, open_bus

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
    name = f"239.74.165.{1 + randbelow(250)}"
    try:
        with can.Bus(name, INTERFACE) as out, can.Bus(name, INTERFACE) as back:
            out.send(can.Message(arbitration_id=1, is_extended_id=True))
            heard = back.recv(timeout=2.0)
    except (OSError, can.CanError, ImportError) as problem:
        pytest.skip(f"this machine has no multicast: {problem}")
    if heard is None:
        pytest.skip("this machine does not deliver its own multicast datagrams")
    return name


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
