"""`can.Bus(interface="fieldbus", channel="...")`: the simulated wire as a python-can interface.

All buses of one channel name in a process share one segment. In an asyncio loop, the loop's timers
drive the segment, in virtual or real time. Without a loop, `recv` and `send` drive it by the wall
clock. There are no threads, and no copy per receiver.
"""

import asyncio
import contextlib
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, Protocol

import can
from can import BusABC, CanOperationError, CanProtocol, Message

from agent.interface.observation import Neighbour
from protocol.frames.agreement_frames import AgreementMessage
from protocol.frames.codec import decode_once
from protocol.frames.fleet_frames import Heartbeat, Pose
from protocol.frames.frame import Frame
from protocol.frames.messages import GROUP_OF
from protocol.frames.messages import Message as AnyMessage
from sim.can.can_wire import PASSIVE, Wire
from sim.can.other_frame import OtherFrame

# Frames kept for a program that does not read; beyond this the newest are dropped.
RX_QUEUE_MAX = 8192
POLL_S = 0.002  # how often a program without an event loop polls the wire

ACTIVE, SHAKEN, OFF = can.BusState.ACTIVE, can.BusState.PASSIVE, can.BusState.ERROR
POSE_PGN: Final = GROUP_OF[Pose].pgn
HEARTBEAT_PGN: Final = GROUP_OF[Heartbeat].pgn
AGREEMENT_PGN: Final = GROUP_OF[AgreementMessage].pgn
_tuple = tuple.__new__
Tap = Callable[[int, Frame], None]  # microseconds, frame
NONE_LOST: Sequence[tuple[Tap, OSError]] = ()
log = logging.getLogger(__name__)


class BufferedBeacon(NamedTuple):
    """A beacon or heartbeat of a robot that is neither stopped nor leaving, or its word in a round of
    agreement, kept for a receiver."""

    source: int
    message: AnyMessage
    t_us: int  # bus time
    seen: Neighbour | None  # for a pose: the new entry about its sender


class Clock(Protocol):
    """What drives a segment's time if it is not an asyncio loop."""

    def now_us(self) -> int:
        """The present time in microseconds; it never goes back."""

    def at(self, t_us: int, call: Callable[[], object]) -> "Alarm":
        """Call `call` when the time is `t_us`. The alarm that is returned can cancel it."""


class Alarm(Protocol):
    """A call that is due later and can still be cancelled."""

    def cancel(self) -> None:
        """Do not make the call. Without effect after it was made."""


def calm(frame: Frame, t_us: int) -> BufferedBeacon | None:
    """A beat that may wait until its receivers take their turns; None for other frames.

    So may what missions agree on: it is answered with the next beat."""
    group = frame[0] >> 8 & 0x3FFFF
    if group != POSE_PGN and group != HEARTBEAT_PGN and group != AGREEMENT_PGN:
        return None
    source, message = decode_once(frame)
    if type(message) is Pose and not message.stopped and message.placed:
        seen = _tuple(Neighbour, (message, t_us))
        return _tuple(BufferedBeacon, (source, message, t_us, seen))
    routine = type(message) is Heartbeat and not message.stopped and not message.leaving
    if routine or type(message) is AgreementMessage:
        return _tuple(BufferedBeacon, (source, message, t_us, None))
    return None


class Segment:
    """One channel: the wire, the buses on it, and what drives its time."""

    def __init__(
        self, channel: str, bitrate: int, seed: int | str, clock: Clock | None = None
    ) -> None:
        assert 1_000_000 % bitrate == 0, "the bit time is a whole number of microseconds"
        self.channel, self.bitrate = channel, bitrate
        self.wire = Wire(seed, 1_000_000 // bitrate)
        self.buses: dict[int, FieldBus] = {}
        self.ears: dict[int, Callable[[Frame], None]] = {}  # callbacks of buses with a subscriber
        # Buffers of buses that accept deferred beats.
        self.buffers: dict[int, list[BufferedBeacon]] = {}
        self.tellers: dict[int, Tap] = {}  # called when a frame of the node has left
        # Of 11-bit and remote frames, which only clients of the hub receive.
        self.other_ears: dict[int, Callable[[OtherFrame], None]] = {}
        self.error_ears: dict[int, Callable[[], None]] = {}  # after frames that were broken
        self._errors = 0  # of the wire, when they were told
        self.taps: list[Tap] = []
        self.taps_lost = 0  # taps that failed to write
        self.lock = threading.RLock()  # programs without an event loop send and receive in threads
        self._loop: asyncio.AbstractEventLoop | None = None
        self._clock = clock
        self._now = clock.now_us if clock is not None else None
        self._at = clock.at if clock is not None else None
        self._fires: Callable[[], None] = self._fire
        self._timer: Alarm | None = None
        self._timer_at_us = 0

    def now_us(self) -> int:
        """Microseconds of the clock that drives this segment: of the simulation, the running
        asyncio loop, or else this machine."""
        if self._now is not None:
            return self._now()
        try:
            return round(asyncio.get_running_loop().time() * 1_000_000)
        except RuntimeError:
            return time.monotonic_ns() // 1000

    def submit(self, node: int, frame: Frame) -> bool:
        """Put a frame into the queue of a controller. False where the queue is full or the
        controller is off the bus."""
        if self._now is not None:  # one thread drives everything
            accepted = self.wire.submit(node, frame, self._now())
            self.arm()
            return accepted
        with self.lock:
            accepted = self.wire.submit(node, frame, self.now_us())
            self.arm()
        return accepted

    def detach(self, node: int) -> None:
        """Take a node off the wire; the others go on."""
        with self.lock:
            self.wire.detach(node, self.now_us())
            for those in (
                self.buses, self.ears, self.buffers, self.tellers, self.other_ears, self.error_ears,
            ):  # fmt: skip
                those.pop(node, None)
            self.arm()

    def arm(self) -> None:
        """Make sure that the segment is called when the next event occurs on the wire."""
        loop: asyncio.AbstractEventLoop | None = None
        if self._clock is None:
            try:
                loop = asyncio.get_running_loop()
            except RuntimeError:
                return
        next_at_us = self.wire.next_at_us
        if next_at_us is None:
            return
        if self._loop is not loop:
            self._loop, self._timer = loop, None
        if self._timer is not None:
            if self._timer_at_us <= next_at_us:
                return
            self._timer.cancel()
        self._timer_at_us = next_at_us
        if loop is not None:
            self._timer = loop.call_at(next_at_us / 1_000_000, self._fire)
        elif self._at is not None:
            self._timer = self._at(next_at_us, self._fires)

    def _fire(self) -> None:
        self._timer = None
        self.pump()
        self.arm()

    def pump(self) -> None:
        """Deliver everything that has ended by now."""
        buses, ears, buffers = self.buses, self.ears, self.buffers
        tellers, lost = self.tellers, NONE_LOST
        for t_us, frame, sender, receivers in self.wire.advance(self.now_us()):
            if frame.__class__ is OtherFrame:
                self._pass_other(t_us, frame, sender, receivers)
                continue
            for tap in self.taps:
                try:
                    tap(t_us, frame)
                except OSError as problem:  # a recorder's disk is full: the recorded run continues
                    lost = [*lost, (tap, problem)]
            if sender in tellers:
                tellers[sender](t_us, frame)
            if buffers:
                beat = calm(frame, t_us)
                if beat is not None:
                    receivers = self._put(beat, receivers)
            for node in receivers:
                ear = ears.get(node)
                if ear is not None:
                    ear(frame)
                elif node in buses:
                    buses[node]._deliver(t_us, frame)
            if lost:
                self._end_taps(lost)
                lost = ()

        if self._errors != self.wire.errors:
            self._errors = self.wire.errors
            for tell in list(self.error_ears.values()):
                tell()

    def _pass_other(self, t_us: int, frame: Frame, sender: int, receivers: tuple[int, ...]) -> None:
        assert isinstance(frame, OtherFrame)
        if sender in self.tellers:
            self.tellers[sender](t_us, frame)
        for node in receivers:
            if node in self.other_ears:
                self.other_ears[node](frame)

    def _end_taps(self, lost: Sequence[tuple[Tap, OSError]]) -> None:
        """Remove the taps that failed."""
        for tap, problem in lost:
            self.taps_lost += 1
            self.taps.remove(tap)
            log.error("%s: a recorder of %s ends", problem, self.channel)

    def _put(self, beat: BufferedBeacon, receivers: tuple[int, ...]) -> tuple[int, ...]:
        """Put a beat into the buffers of receivers that have one; returns the others."""
        others: tuple[int, ...] = ()
        buffers = self.buffers
        for node in receivers:
            buffer = buffers.get(node)
            if buffer is None:
                others = (*others, node)
            else:
                buffer.append(beat)
        return others


_segments: dict[str, Segment] = {}


def segment(
    channel: str, bitrate: int = 250_000, seed: int | str = 0, clock: Clock | None = None
) -> Segment:
    """The segment of a channel name, made at first use."""
    found = _segments.get(channel)
    if found is None:
        found = _segments[channel] = Segment(channel, bitrate, seed, clock)
    return found


def forget(channel: str) -> None:
    """Make the next bus of this name start on a new wire."""
    _segments.pop(channel, None)


class FieldBus(BusABC):
    """A node on a simulated segment."""

    def __init__(
        self,
        channel: Any = "fieldbus",
        bitrate: int = 250_000,
        receive_own_messages: bool = False,
        rx_queue_size: int = RX_QUEUE_MAX,
        seed: int | str = 0,
        **kwargs: Any,
    ) -> None:
        super().__init__(channel=channel, **kwargs)
        self._can_protocol = CanProtocol.CAN_20
        self.segment = segment(str(channel), bitrate, seed)
        self.channel_info = f"fieldbus {channel} at {self.segment.bitrate} bit/s"
        self.node = self.segment.wire.attach(str(channel))
        self.segment.buses[self.node] = self
        self.dropped = 0
        self._inbox: deque[Message] = deque()
        self._inbox_max = rx_queue_size
        self._callback: Callable[[Frame], None] | None = None
        self._fd: int | None = None
        self._open = True
        self._sent = 0  # the number when it was closed
        if receive_own_messages:  # as with SocketCAN: after they have left, not before
            self.tell_sent(self._deliver)

    # ---------------------------------------------------------------- direct interface

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        """Pass every frame to this callback in the loop's thread, and no longer queue it."""
        self._callback = callback
        if self._open:
            self.segment.ears[self.node] = callback

    def buffer_beacons(self, buffer: list[BufferedBeacon] | None) -> None:
        """From now on append routine beacons to `buffer` instead of calling back; None: call back."""
        if buffer is not None and self._open:
            self.segment.buffers[self.node] = buffer
        else:
            self.segment.buffers.pop(self.node, None)

    @property
    def sent(self) -> int:
        """Frames of ours that have left; see `agent.interface.ports.Confirming`."""
        node = self.segment.wire.nodes.get(self.node)
        return self._sent if node is None else node.sent

    def tell_sent(self, callback: Tap) -> None:
        """Call back with each frame of ours that has left."""
        if self._open:
            self.segment.tellers[self.node] = callback

    def submit(self, frame: Frame) -> bool:
        """Queue a frame without a `can.Message`; False if the node cannot accept it."""
        if not self._open:
            return False
        return self.segment.submit(self.node, frame)

    def _deliver(self, t_us: int, frame: Frame) -> None:
        if self._callback is not None:
            self._callback(frame)
            return
        if len(self._inbox) >= self._inbox_max:
            self.dropped += 1
            return
        self._inbox.append(
            Message(t_us / 1_000_000, frame.identifier, is_extended_id=True, data=frame.data,
                    channel=self.segment.channel, check=False)
        )  # fmt: skip
        if self._fd is not None:
            os.eventfd_write(self._fd, 1)

    # ---------------------------------------------------------------- python-can

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Queue one frame; `timeout` in seconds is ignored, because the queue never blocks. Raises
        CanOperationError for a frame that is no classic data frame with 29-bit identifier, and
        where the frame is refused."""
        if not msg.is_extended_id or msg.is_remote_frame or msg.is_fd or msg.is_error_frame:
            raise CanOperationError("fieldbus carries classic data frames with 29-bit identifiers")
        if not self.submit(Frame(msg.arbitration_id, bytes(msg.data))):
            raise CanOperationError("transmit queue full or node off the bus")

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            if not self._looped():
                with self.segment.lock:
                    self.segment.pump()
            if self._inbox:
                if self._fd is not None:
                    with contextlib.suppress(BlockingIOError):
                        os.eventfd_read(self._fd)
                return self._inbox.popleft(), False
            if self._looped() or (deadline is not None and time.monotonic() >= deadline):
                return None, False
            time.sleep(POLL_S)

    @staticmethod
    def _looped() -> bool:
        try:
            asyncio.get_running_loop()
        except RuntimeError:
            return False
        return True

    def fileno(self) -> int:
        """Readable while frames wait (Linux); -1 elsewhere, and outside of an event loop."""
        if not hasattr(os, "eventfd") or not self._looped():
            return -1
        if self._fd is None:
            self._fd = os.eventfd(len(self._inbox), os.EFD_NONBLOCK | os.EFD_SEMAPHORE)
        return self._fd

    @property  # type: ignore[misc]
    def state(self) -> can.BusState:
        """Of the controller: ACTIVE, PASSIVE with an error counter above its limit, or off the bus."""
        node = self.segment.wire.nodes.get(self.node)
        if node is None or node.off_ends_at_us is not None:
            return OFF
        quiet = node.tec <= PASSIVE and node.rec <= PASSIVE
        return ACTIVE if quiet else SHAKEN

    def shutdown(self) -> None:
        """Leave the segment and close the descriptor. What was sent stays known. A second call does
        nothing."""
        if self._open:
            self._open = False
            self._sent = self.sent
            self.segment.detach(self.node)
            if self._fd is not None:
                os.close(self._fd)
                self._fd = None
        super().shutdown()

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        return [{"interface": "fieldbus", "channel": name} for name in sorted(_segments)]
