"""A CAN adapter that is unplugged, and a link that goes down: what a bus says of both."""

import asyncio
import logging
import os
import socket
import tty
from collections.abc import Callable
from contextlib import suppress
from errno import EIO, ENETDOWN, ENODEV, ENXIO
from typing import Any

import can
import pytest

from protocol.controller_health import BUS_OFF, CONTROLLER, RESTARTED
from protocol.frames.frame import Frame
from protocol.links.bus import LOST_S, CanBus, InterfaceErrors, open_bus
from tools.common.bus_attach import connections_of

FRAME = Frame(0x18FEF100, b"\1")
LIMIT_S = 10.0


class Adapter(can.BusABC):
    """An interface of python-can whose faults are those of Linux: an error waits until it is received."""

    def __init__(self, by_file: bool) -> None:
        self.ours, self.theirs = socket.socketpair()
        self.ours.setblocking(False)
        self.by_file = by_file
        self.faults: list[int] = []
        self.fails_to_send = 0
        self.channel_info = "adapter"
        super().__init__("adapter")

    def fileno(self) -> int:
        if not self.by_file:
            raise NotImplementedError
        return self.ours.fileno()

    def happens(self, fault: int = 0) -> None:
        """A frame, or an error, can be received."""
        self.faults.append(fault)
        self.theirs.send(b"x")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self.ours.settimeout(timeout)
        try:
            self.ours.recv(1)
        except (TimeoutError, BlockingIOError):
            return None, False
        return self.received(self.faults.pop(0)), False

    def received(self, fault: int) -> can.Message:
        """What comes of one fault; 0: a frame."""
        if fault:
            raise can.CanOperationError("Error receiving", fault)
        return can.Message(arbitration_id=1, is_extended_id=True)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.fails_to_send:
            raise can.CanOperationError("Failed to transmit", self.fails_to_send)

    def shutdown(self) -> None:
        super().shutdown()
        self.ours.close()
        self.theirs.close()


class Trial:
    """A bus on an adapter, with a clock that is set by hand."""

    def __init__(self, by_file: bool = True) -> None:
        self.now_s = 0.0
        self.adapter = Adapter(by_file)
        self.bus = CanBus(self.adapter)
        self.noted = asyncio.Event()
        self.bus.errors = InterfaceErrors(self._clock)
        self.bus.subscribe(lambda frame: self.noted.set())

    def _clock(self) -> float:
        """What is noticed is noticed at a time. The class itself may be compiled, and then no class of a
        test can extend it."""
        self.noted.set()
        return self.now_s

    async def errs(self, fault: int) -> None:
        """An error of reception has been noticed."""
        self.noted.clear()
        self.adapter.happens(fault)
        await asyncio.wait_for(self.noted.wait(), LIMIT_S)

    async def hears(self) -> None:
        """A frame has been heard."""
        await self.errs(0)


def played(play: Callable[[Trial], Any], by_file: bool = True) -> None:
    async def whole() -> None:
        trial = Trial(by_file)
        try:
            await play(trial)
        finally:
            trial.bus.close()

    asyncio.run(whole())


class Buffered(Adapter):
    """An interface that takes all bytes that wait at once, and returns one frame a call, as robotell."""

    def __init__(self) -> None:
        super().__init__(by_file=True)
        self.kept = b""

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self.ours.settimeout(0.0 if self.kept else timeout)
        with suppress(TimeoutError, BlockingIOError):
            self.kept += self.ours.recv(64)
        if not self.kept:
            return None, False
        identifier, self.kept = self.kept[0], self.kept[1:]
        return can.Message(arbitration_id=identifier, is_extended_id=True), False


def test_frames_that_an_interface_has_buffered_are_heard_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of two frames at once the second was heard with the next one: a stop fell ever further behind."""
    adapter = Buffered()
    monkeypatch.setattr(can, "Bus", lambda **options: adapter)

    async def main() -> None:
        bus, heard, all_heard = open_bus("robotell", "/dev/ttyUSB0"), list[int](), asyncio.Event()

        def hear(frame: Frame) -> None:
            heard.append(frame.identifier)
            if len(heard) == 3:
                all_heard.set()

        bus.subscribe(hear)
        adapter.theirs.send(b"\x01\x02\x03")
        try:
            await asyncio.wait_for(all_heard.wait(), LIMIT_S)
        finally:
            bus.close()
        assert heard == [1, 2, 3]

    asyncio.run(main())


@pytest.mark.parametrize("by_file", [True, False])
def test_an_adapter_that_was_unplugged_is_lost_and_told_in_one_line(
    by_file: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """Its robot stood for ever beside the adapter that was plugged in again, and printed tracebacks."""

    async def play(trial: Trial) -> None:
        await trial.hears()
        for _ in range(5):
            await trial.errs(ENODEV)
        assert trial.bus.lost is None, "not yet"
        trial.now_s += LOST_S
        assert trial.bus.lost is not None and "gone" in trial.bus.lost

    with caplog.at_level(logging.WARNING):
        played(play, by_file)
    assert len(caplog.records) == 1 and "Traceback" not in caplog.text


class Garbled(Adapter):
    """It has received a frame of slcan that is no number, has nowhere to send it, and is unplugged."""

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self.ours.settimeout(timeout)
        with suppress(TimeoutError, BlockingIOError):
            self.ours.recv(1)
            raise ValueError("invalid literal for int() with base 16: 'zzzzzzzz'")
        return None, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise AttributeError("'NoneType' object has no attribute 'write'")

    def shutdown(self) -> None:
        super().shutdown()
        raise can.CanOperationError("Could not write to serial device")


@pytest.mark.parametrize("by_file", [True, False])
def test_what_an_interface_raises_of_any_kind_is_counted_and_told(
    by_file: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """A line of garbage was a traceback in the log. A robot whose adapter was unplugged ended with one,
    and with code 1, because its bus could not be closed."""

    async def main() -> None:
        adapter = Garbled(by_file)
        bus, noted = CanBus(adapter), asyncio.Event()

        def clock() -> float:
            noted.set()
            return 0.0

        bus.errors = InterfaceErrors(clock)
        bus.subscribe(lambda frame: None)
        adapter.theirs.send(b"x")
        await asyncio.wait_for(noted.wait(), LIMIT_S)
        assert bus.errors.count == 1 and "zzzzzzzz" in bus.errors.newest
        assert not bus.send(FRAME) and bus.refused == 1
        bus.close()

    with caplog.at_level(logging.WARNING):
        asyncio.run(main())
    assert "Traceback" not in caplog.text and "callback" not in caplog.text
    assert caplog.records[-1].message == "bus: cannot close: Could not write to serial device"


@pytest.mark.parametrize("by_file", [True, False])
def test_a_byte_of_noise_on_a_serial_line_costs_its_own_frame_only(
    by_file: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each frame after a byte 0xFF was an error, so a robot on a quiet bus was deaf for good."""
    pytest.importorskip("serial", reason="pyserial is not installed")
    if not by_file:
        monkeypatch.setattr("protocol.links.bus.BY_FILE", frozenset())
    adapter, computer = os.openpty()
    tty.setraw(computer)

    async def main() -> None:
        bus = open_bus("slcan", os.ttyname(computer), sleep_after_open=0.0)
        heard, last_heard = list[int](), asyncio.Event()

        def hear(frame: Frame) -> None:
            heard.append(frame.identifier)
            if frame.identifier == 4:
                last_heard.set()

        bus.subscribe(hear)
        os.write(adapter, b"T0000000111\xff\rT00000002122\rT00000003133\rT00000004144\r")
        try:
            await asyncio.wait_for(last_heard.wait(), LIMIT_S)
        finally:
            bus.close()
        assert heard == [2, 3, 4] and bus.errors.count == 1

    try:
        asyncio.run(main())
    finally:
        os.close(adapter)
        os.close(computer)


def test_an_adapter_to_which_only_sending_fails_is_lost_too() -> None:
    async def play(trial: Trial) -> None:
        trial.adapter.fails_to_send = ENXIO
        assert not trial.bus.send(FRAME)
        trial.now_s += LOST_S
        assert trial.bus.lost is not None

    played(play)


@pytest.mark.parametrize("by_file", [True, False])
def test_a_link_that_goes_down_comes_back_by_itself(by_file: bool) -> None:
    async def play(trial: Trial) -> None:
        await trial.errs(ENETDOWN)
        trial.adapter.fails_to_send = ENETDOWN
        for _ in range(100):
            trial.now_s += 1.0
            assert not trial.bus.send(FRAME) and trial.bus.lost is None
        trial.adapter.fails_to_send = 0
        await trial.hears()
        assert trial.bus.send(FRAME) and trial.bus.lost is None

    played(play, by_file)


def test_errors_without_end_are_a_lost_interface_and_errors_between_frames_are_not() -> None:
    async def play(trial: Trial) -> None:
        for _ in range(40):
            trial.now_s += 0.1
            await trial.errs(EIO)
            await trial.hears()
            assert trial.bus.lost is None
        for _ in range(40):
            trial.now_s += 0.1
            await trial.errs(EIO)
        assert trial.bus.lost is not None and "cannot receive" in trial.bus.lost

    played(play)


class Controlled(Adapter):
    """Its controller tells by error frames what becomes of it: their classes are its faults."""

    def received(self, fault: int) -> can.Message:
        return can.Message(
            arbitration_id=fault or 1,
            is_extended_id=not fault,
            is_error_frame=bool(fault),
            data=bytes(8),
        )


def test_a_tool_asks_again_after_a_link_was_down() -> None:
    """Sections that were done meanwhile stayed undone on the map for good."""

    async def play(trial: Trial) -> None:
        await trial.hears()
        first = connections_of(trial.bus)
        await trial.errs(ENETDOWN)
        assert connections_of(trial.bus) == first, "it is still down"
        for _ in range(3):
            await trial.hears()
            assert connections_of(trial.bus) == first + 1
        await trial.errs(EIO)
        await trial.hears()
        assert connections_of(trial.bus) == first + 1, "an error between two frames is no absence"

    played(play)


def test_a_tool_asks_again_after_its_controller_was_off_the_bus() -> None:
    async def main() -> None:
        adapter = Controlled(by_file=True)
        bus, heard = CanBus(adapter), asyncio.Event()
        bus.subscribe(lambda frame: heard.set())
        first = connections_of(bus)
        for told, returned in ((CONTROLLER, 0), (BUS_OFF, 0), (RESTARTED, 1), (RESTARTED, 1)):
            heard.clear()
            adapter.happens(told)
            adapter.happens()
            await asyncio.wait_for(heard.wait(), LIMIT_S)
            assert connections_of(bus) == first + returned
        bus.close()

    asyncio.run(main())
