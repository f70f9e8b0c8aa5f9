"""A simulated segment for several processes: a server of the socketcand protocol on loopback.

python-can's own `socketcand` interface, its logger, its viewer and our robots attach as to any bus.
Each client is a separate node on the wire: the frames it sends and receives go through arbitration.
A client that does not read is dropped, so it never slows the wire.

A client may close right after sending; its node stays on the wire until its queue is empty.
Commands are read in small portions, client by client, so that no client delays the others.

`docs/use/bus.md` lists the commands. Modes, as in socketcand: after `open` a client is in the mode of the
broadcast manager; `rawmode` sends it every frame, `controlmode` statistics.
"""

import asyncio
import contextlib
import logging
import re
import socket
import time
from collections.abc import Sequence
from enum import Enum
from typing import cast

import can

from protocol.frames.frame import Frame
from sim.can.broadcast_manager import (
    MASKS_MAX,
    NEVER_US,
    BroadcastError,
    BroadcastManager,
    Key,
)
from sim.can.other_frame import OtherFrame
from sim.can.simulated_bus import FieldBus, Segment

log = logging.getLogger(__name__)

LINE_MAX = 256  # bytes of a command; the longest valid one has 180, with sign-extended data
FILTER_LINE_MAX = 8192  # of a filter for multiplexed messages: 257 times eight bytes
READ_BYTES = 1024  # of one client in one turn: fifty frames, a millisecond of work
# Not read by a client, answers included: about ten seconds of a full bus.
BACKLOG_BYTES_MAX = 1 << 20
ERRORS_MAX = 1000  # invalid commands; after this many, the client is dropped
# Of one client per second: a whole bus of 250 kbit/s. A faster client is read more slowly.
COMMANDS_S = 2000
# After "rawmode": python-can's client takes data that follows in the same read for the answer.
QUIET_S = 0.05
DRAIN_S = 2.0  # time limit for the queue of a closed client: 256 frames are 0.15 s of a whole bus
DRAIN_LOOK_S = 0.01  # interval of checks whether it is empty
LEFT_BYTES_MAX = 65_536  # read from a connection that was reset while we wrote to it
OPEN_S = 30.0  # time for a connection to ask for frames; a person who types may take a while
SPEAKS_S = 5.0  # a client that sent within this time keeps its seat; robots beat every 50 to 200 ms
GOODBYE_S = 0.5  # time limit; a closed connection normally ends immediately
REFUSED_US = 1_000_000  # a client without `confirm` gets a report of refused frames once a second
CLIENTS_MAX = 160  # 108 peers and their tools
# Attached clients that have never sent a frame: viewers and loggers. Each frame is written to each
# of them. With 150 that did not even read, one core was fully loaded and the fleet stood for
# minutes.
LISTENERS_MAX = 32
LISTENER_S = 5.0  # by then a robot or a tool has sent its first frame
EFF_FLAG = 1 << 31  # SocketCAN's flag of a 29-bit identifier, which some clients leave in it
HEX = re.compile(r"[0-9A-Fa-f]+")
BYTE_DIGITS_MAX = 16  # some clients extend the sign of a byte to 32 or 64 bits
RTR_FLAG = 1 << 30  # SocketCAN's flag of a remote frame
NO_FRAME = "error not a classic CAN frame"
NO_NUMBER = "error not a number"
STATISTICS_MIN_MS = 10
INTERVAL_MAX_S = 1_000_000
# Classes of SocketCAN's error frames (linux/can/error.h).
BUS_ERROR, CONTROLLER, BUS_OFF, RESTARTED = 0x088, 0x004, 0x040, 0x100


class Mode(Enum):
    """What a client receives, and which commands it may give."""

    BROADCAST_MANAGER = "bcmmode"
    RAW = "rawmode"
    CONTROL = "controlmode"


COMMANDS = {  # of one mode only
    "add": Mode.BROADCAST_MANAGER, "update": Mode.BROADCAST_MANAGER,
    "delete": Mode.BROADCAST_MANAGER, "subscribe": Mode.BROADCAST_MANAGER,
    "unsubscribe": Mode.BROADCAST_MANAGER, "filter": Mode.BROADCAST_MANAGER,
    "muxfilter": Mode.BROADCAST_MANAGER, "statistics": Mode.CONTROL,
}  # fmt: skip


class CommandError(Exception):
    """A command that cannot be obeyed; the text is the answer."""


def frame_of(identifier: str, length: str, data: list[str]) -> Frame | None:
    """The frame of a `send` command; None if it is no frame that our bus carries.

    As socketcand reads them: an identifier may carry the EFF flag, and of each byte the low 8 bits
    count. Signs, underscores and prefixes, which Python's `int` would take, are no digits.
    """
    if len(identifier) != 8 or len(length) > 2 or len(data) > 8:
        return None
    if not all(HEX.fullmatch(word) for word in (identifier, length, *data)):
        return None
    if any(len(byte) > BYTE_DIGITS_MAX for byte in data) or int(length, 16) != len(data):
        return None
    number = int(identifier, 16) & ~EFF_FLAG
    if number >= 1 << 29:
        return None
    return Frame(number, bytes(int(byte, 16) & 0xFF for byte in data))


def any_frame_of(identifier: str, length: str, data: Sequence[str]) -> Frame | None:
    """The frame of a command, also with an 11-bit identifier: up to three digits. None: no frame."""
    if len(identifier) == 8:
        return frame_of(identifier, length, list(data))
    if len(identifier) > 3 or not HEX.fullmatch(identifier):
        return None
    found = frame_of("00000000", length, list(data))
    return None if found is None else _other(identifier, found.data)


def remote_frame_of(identifier: str, length: str) -> Frame | None:
    """The remote frame of a `sendrtr` command; None if it is none."""
    if not HEX.fullmatch(identifier) or len(length) > 2 or not HEX.fullmatch(length):
        return None
    return _other(identifier, b"", int(length, 16))


def _other(identifier: str, data: bytes, remote: int | None = None) -> OtherFrame | None:
    extended, number = len(identifier) == 8, int(identifier, 16)
    if extended:
        number &= ~(EFF_FLAG | RTR_FLAG)
    try:
        return OtherFrame.of(number, data, extended, remote)
    except ValueError:
        return None


def key_of(identifier: str) -> Key:
    """What the broadcast manager knows an identifier by. Raises CommandError."""
    extended = len(identifier) == 8
    if not HEX.fullmatch(identifier) or (not extended and len(identifier) > 3):
        raise CommandError(NO_FRAME)
    number = int(identifier, 16) & ~EFF_FLAG if extended else int(identifier, 16)
    if number >= 1 << (29 if extended else 11):
        raise CommandError(NO_FRAME)
    return extended, number


def _interval_for_us(seconds: str, microseconds: str) -> int:
    """The time of a command. Raises CommandError."""
    if not (seconds.isdecimal() and microseconds.isdecimal()) or len(seconds + microseconds) > 20:
        raise CommandError(NO_NUMBER)
    return min(int(seconds), INTERVAL_MAX_S) * 1_000_000 + min(int(microseconds), 1_000_000_000)


def _octets(words: Sequence[str]) -> bytes:
    """The bytes of a command. Raises CommandError."""
    if not all(HEX.fullmatch(word) and len(word) <= BYTE_DIGITS_MAX for word in words):
        raise CommandError(NO_FRAME)
    return bytes(int(word, 16) & 0xFF for word in words)


class Client(asyncio.BufferedProtocol):
    """One connection: commands of socketcand in, frames out."""

    def __init__(self, hub: "Hub") -> None:
        self.hub = hub
        self.bus: FieldBus | None = None
        self.mode = Mode.BROADCAST_MANAGER
        self.manager = BroadcastManager()
        self._manager_timer: asyncio.TimerHandle | None = None
        self._statistics_timer: asyncio.TimerHandle | None = None
        self._received = [0, 0]  # bytes, frames
        self._sent_bytes = 0
        self._state = can.BusState.ACTIVE  # of its controller, as it was told
        self._elsewhere = False  # it has asked for a bus that is not here
        self.errors = 0  # invalid commands
        self.refused = 0  # frames that the wire did not accept
        self._confirms = False  # whether it asked for reports about its frames
        self._told_at_us = -REFUSED_US
        self.connected_at_s = self.spoke_at_s = 0.0  # times of connection and of its last frame
        self.spoke = False
        self._transport: asyncio.Transport | None = None
        self._twin: socket.socket | None = None  # used to read the remaining data after a reset
        self._buffer = bytearray(READ_BYTES)
        self._pending = b""
        self._quiet: list[bytes] | None = None  # held back, because the client may not be ready
        self._commands = 0  # since `_window_at_s`
        self._window_at_s = 0.0

    # ---------------------------------------------------------------- callbacks of asyncio

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a seat at the hub and greet as socketcand does, or close the connection if no seat
        is free."""
        self._transport = cast(asyncio.Transport, transport)
        loop = asyncio.get_running_loop()
        self.connected_at_s = self.spoke_at_s = self._window_at_s = loop.time()
        if not self.hub.seat(self):
            self._transport.abort()
            return
        self._twin = transport.get_extra_info("socket").dup()
        loop.call_later(OPEN_S, self._hurry)
        self._write(b"< hi >")

    def get_buffer(self, sizehint: int) -> bytearray:
        """The one buffer of this connection, whatever the number of bytes `sizehint` asks for
        (asyncio calls it)."""
        return self._buffer

    def buffer_updated(self, count: int) -> None:
        """Read the first `count` bytes of the buffer as commands, and slow the client down if it
        sends too much."""
        self._take(bytes(self._buffer[:count]))
        self._pace()

    def eof_received(self) -> bool:
        """False: close the connection, because a client that sends no more is gone."""
        return False

    def connection_lost(self, problem: Exception | None) -> None:
        """Deliver what arrived before the connection broke, give up the seat, and let the bus of
        this client go."""
        try:
            if problem is not None:
                self._take_what_is_left()
        finally:  # whatever a command of it raises, its seat and its descriptor are free
            if self._twin is not None:
                self._twin.close()
                self._twin = None
            self.hub.clients.discard(self)
            self._end_timers()
            if self.bus is not None:
                self.hub.retire(self.bus)
                self.bus = None

    # ---------------------------------------------------------------- commands

    def handle(self, command: str) -> str | None:
        """The answer to one command, without its brackets; None for no answer."""
        words = command.split()
        match words:
            case ["open", channel]:
                return self._open(channel)
            case ["rawmode"] | ["bcmmode"] | ["controlmode"]:
                self._enter(Mode(words[0]))
                return "ok"
            case ["send", identifier, length, *data]:
                return self._send(any_frame_of(identifier, length, data))
            case ["sendrtr", identifier, length]:
                return self._send(remote_frame_of(identifier, length))
            case ["echo"]:
                return "echo"
            case ["confirm"]:
                self._confirms = True
                return self._confirm()
            case ["isotpmode"]:
                return "error isotpmode is not served"
            case [command, *rest] if command in COMMANDS:
                return self._in_mode(command, rest)
        self.errors += 1
        return "error unknown command"

    def _open(self, channel: str) -> str | None:
        if channel == self.hub.channel:
            return "ok"
        # As socketcand does: the connection ends. What was sent behind this was for the other bus.
        self._elsewhere = True
        self._write(f"< error could not open bus {channel} >".encode("ascii"))
        if self._transport is not None:
            self._transport.close()
        return None

    def _enter(self, mode: Mode) -> None:
        """Change the mode. The jobs and filters of the broadcast manager end with its mode, and
        statistics with control mode."""
        self.mode, self.manager = mode, BroadcastManager()
        self._arm()
        self._end_statistics()
        if mode is Mode.RAW:
            begins = self.bus is None
            self._attach()
            if begins:
                self._quiet = []
                asyncio.get_running_loop().call_later(QUIET_S, self._unquiet)

    def _in_mode(self, command: str, words: list[str]) -> str | None:
        """A command of one mode only."""
        mode = COMMANDS[command]
        try:
            if self.mode is not mode:
                raise CommandError(f"error {command} is a command of {mode.value}")
            self._attach()
            if command == "statistics":
                self._statistics(words)
            elif command in ("add", "update", "delete"):
                self._job(command, words)
            else:
                self._filter(command, words)
        except (CommandError, BroadcastError) as problem:
            self.errors += 1
            return str(problem) if isinstance(problem, CommandError) else f"error {problem}"
        self._arm()
        return None

    def _job(self, command: str, words: list[str]) -> None:
        match command, words:
            case "delete", [identifier]:
                self.manager.delete(key_of(identifier))
                return
            case "add", [seconds, microseconds, identifier, length, *data]:
                period_us = _interval_for_us(seconds, microseconds)
            case "update", [identifier, length, *data]:
                period_us = 0
            case _:
                raise CommandError("error unknown command")
        key, frame = key_of(identifier), any_frame_of(identifier, length, data)
        if frame is None:
            raise CommandError(NO_FRAME)
        if command == "update":
            self.manager.update(key, frame)
            return
        now_us = self.hub.segment.now_us()
        self._send(self.manager.add(key, frame, period_us, now_us))

    def _filter(self, command: str, words: list[str]) -> None:
        match command, words:
            case "unsubscribe", [identifier]:
                self.manager.unsubscribe(key_of(identifier))
                return
            case "subscribe", [seconds, microseconds, identifier]:
                masks: tuple[bytes, ...] = ()
            case "filter", [seconds, microseconds, identifier, length, *data]:
                octets = _octets(data)
                count = int(length) if length.isdecimal() and len(length) <= 2 else -1
                if len(octets) > 8 or count != len(octets):
                    raise CommandError(NO_FRAME)
                masks = (octets,)
            case "muxfilter", [seconds, microseconds, identifier, number, *data]:
                octets = _octets(data)
                count = int(number) if number.isdecimal() and len(number) <= 3 else 0
                if not 2 <= count <= MASKS_MAX or len(octets) != 8 * count:
                    raise CommandError("error muxfilter takes 2 to 257 times eight bytes")
                masks = tuple(octets[8 * k : 8 * k + 8] for k in range(count))
            case _:
                raise CommandError("error unknown command")
        self.manager.subscribe(key_of(identifier), _interval_for_us(seconds, microseconds), masks)

    def _statistics(self, words: list[str]) -> None:
        if len(words) != 1 or not words[0].isdecimal() or len(words[0]) > 9:
            raise CommandError(NO_NUMBER)
        self._end_statistics()
        if int(words[0]):
            self._tell_statistics(max(int(words[0]), STATISTICS_MIN_MS) / 1e3, tells=False)

    def _end_statistics(self) -> None:
        if self._statistics_timer is not None:
            self._statistics_timer.cancel()
            self._statistics_timer = None

    def _tell_statistics(self, period_s: float, tells: bool = True) -> None:
        if tells and self.bus is not None:
            count, frames = self._received
            line = f"< stat {count} {frames} {self._sent_bytes} {self.bus.sent} >"
            self._write(line.encode("ascii"))
        loop = asyncio.get_running_loop()
        self._statistics_timer = loop.call_later(period_s, self._tell_statistics, period_s)

    def _arm(self) -> None:
        """Wake at the next thing that the broadcast manager has to do."""
        if self._manager_timer is not None:
            self._manager_timer.cancel()
            self._manager_timer = None
        due_at_us = self.manager.due_at_us
        if due_at_us < NEVER_US:
            loop = asyncio.get_running_loop()
            self._manager_timer = loop.call_at(due_at_us / 1e6, self._manage)

    def _manage(self) -> None:
        for due in self.manager.on_timer(self.hub.segment.now_us()):
            if due.sends:
                self._send(due.frame)
            else:
                self._tell(due.frame)
        self._arm()

    def _end_timers(self) -> None:
        if self._manager_timer is not None:
            self._manager_timer.cancel()
            self._manager_timer = None
        self._end_statistics()

    def _send(self, frame: Frame | None) -> str | None:
        if frame is None:
            self.errors += 1
            return NO_FRAME
        self.spoke, self.spoke_at_s = True, asyncio.get_running_loop().time()
        if self.bus is not None:
            taken = self.bus.submit(frame)
        else:  # sent before the first frame is received
            taken = self.hub.segment.submit(self.hub.spare.node, frame)
        return None if taken else self._refuse()

    def _refuse(self) -> str | None:
        """The wire has rejected a frame. A client with `confirm` gets a report for each, others
        rarely. In raw mode that is an error frame: python-can's client reads a time after the word
        `error`, and is deaf for good if there is another word."""
        self.refused += 1
        if self._confirms:
            return f"refused {self.refused}"
        now_us = self.hub.segment.now_us()
        if now_us - self._told_at_us < REFUSED_US:
            return None
        self._told_at_us = now_us
        if self.mode is Mode.RAW:
            return f"error {CONTROLLER:03X} {self._now_s():.6f}"
        return "error the bus takes no frame"

    def _confirm(self) -> str | None:
        """From now on, report how many of its frames have left the wire."""
        if not self._confirms or self.bus is None:
            return None
        return f"sent {self.bus.sent}"

    def _left(self, t_us: int, frame: Frame) -> None:
        self._sent_bytes += len(frame.data)
        if self._confirms and self.bus is not None:
            self._write(f"< sent {self.bus.sent} >".encode("ascii"))

    def _attach(self) -> None:
        """Attach to the wire immediately. Received frames follow `rawmode`'s answer after a pause."""
        if self.bus is None:
            self.bus = FieldBus(self.hub.segment.channel)
            self.bus.subscribe(self._frame)
            self.bus.tell_sent(self._left)
            segment, node = self.hub.segment, self.bus.node
            segment.other_ears[node] = self._frame
            if self.hub.errors:
                segment.error_ears[node] = self._broken
            asyncio.get_running_loop().call_later(LISTENER_S, self.hub.thin_out)

    def _unquiet(self) -> None:
        held, self._quiet = self._quiet, None
        if held:
            self._write(b"".join(held))

    def _frame(self, frame: Frame) -> None:
        self._received[0] += len(frame.data)
        self._received[1] += 1
        if self._state is not can.BusState.ACTIVE:
            self._tell_state()
        if self.mode is Mode.RAW:
            self._tell(frame)
        elif self.mode is Mode.BROADCAST_MANAGER:
            told = self.manager.hear(_key(frame), frame, self.hub.segment.now_us())
            if told is not None:
                self._tell(told)
                self._arm()

    def _broken(self) -> None:
        """A frame on the wire was broken by an error."""
        self._line(f"< error {BUS_ERROR:03X} {self._now_s():.6f} >")
        self._tell_state()

    def _tell_state(self) -> None:
        """Tell a change of its controller, where the hub tells errors."""
        if self.bus is None or self.bus.state is self._state:
            return
        was, self._state = self._state, self.bus.state
        kind = CONTROLLER
        if self._state is can.BusState.ERROR:
            kind = BUS_OFF
        elif was is can.BusState.ERROR:
            kind = RESTARTED
        self._line(f"< error {kind:03X} {self._now_s():.6f} >")

    def _now_s(self) -> float:
        """The time of the wall clock at which the bus is now."""
        return (self.hub.segment.now_us() + self.hub.epoch_at_us) / 1e6

    def _tell(self, frame: Frame) -> None:
        t_s = self._now_s()
        if isinstance(frame, OtherFrame):
            name = f"{frame.number:08X}" if frame.extended else f"{frame.number:03X}"
            if frame.remote:
                self._line(f"< rtr {name} {t_s:.6f} {frame.length:X} >")
                return
        else:
            name = f"{frame.identifier:08X}"
        self._line(f"< frame {name} {t_s:.6f} {frame.data.hex().upper()} >")

    def _line(self, line: str) -> None:
        if self._quiet is not None:
            self._quiet.append(line.encode("ascii"))
        else:
            self._write(line.encode("ascii"))

    # ---------------------------------------------------------------- bytes

    def _take(self, data: bytes) -> None:
        *commands, self._pending = (self._pending + data).split(b">")
        self._commands += len(commands)
        for command in commands:
            if self._elsewhere:
                return
            try:
                answer = self.handle(command.replace(b"<", b" ").decode("ascii").strip())
            except UnicodeDecodeError:
                self._drop("it does not speak the protocol")
                return
            if answer is not None:
                self._write(f"< {answer} >".encode("ascii"))
        longest = FILTER_LINE_MAX if b"muxfilter" in self._pending[:32] else LINE_MAX
        if len(self._pending) > longest or self.errors > ERRORS_MAX:
            self._drop("it does not speak the protocol")

    def _take_what_is_left(self) -> None:
        """Read the last data of a client that closed with frames unread. That resets the
        connection, and if we notice it by a write, its last data is still to be read."""
        left, self._transport = b"", None
        if self._twin is not None:
            self._twin.setblocking(False)
            with contextlib.suppress(OSError):
                while len(left) < LEFT_BYTES_MAX and (data := self._twin.recv(READ_BYTES)):
                    left += data
        self._take(left)

    def _pace(self) -> None:
        """Stop reading a client with too many commands for a while."""
        loop, transport = asyncio.get_running_loop(), self._transport
        due_at_s = self._window_at_s + self._commands / COMMANDS_S
        if due_at_s <= loop.time():
            self._window_at_s, self._commands = loop.time(), 0
        elif (
            due_at_s > loop.time() + QUIET_S
            and transport is not None
            and not transport.is_closing()
        ):
            transport.pause_reading()
            loop.call_at(due_at_s, self._resume)

    def _resume(self) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.resume_reading()

    def _write(self, data: bytes) -> None:
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        transport.write(data)
        if transport.get_write_buffer_size() > BACKLOG_BYTES_MAX:
            self._drop("it does not read")

    def _hurry(self) -> None:
        if self.bus is None and not self.spoke:
            self._drop("it has not asked for frames")

    def _drop(self, why: str) -> None:
        transport = self._transport
        if transport is not None and not transport.is_closing():
            log.warning("a client is dropped: %s", why)
            self.hub.dropped += 1
            transport.abort()

    @property
    def unread_bytes(self) -> int:
        """Bytes written for it that are still in this process."""
        held = sum(map(len, self._quiet or ()))
        return held + (0 if self._transport is None else self._transport.get_write_buffer_size())

    def close(self) -> None:
        """Break the connection now, without sending what is queued."""
        if self._transport is not None:
            self._transport.abort()

    @property
    def listens(self) -> bool:
        """Whether it receives every frame, and has sent none although it had the time."""
        now_s = asyncio.get_running_loop().time()
        return self.bus is not None and not self.spoke and now_s - self.connected_at_s >= LISTENER_S

    def give_up_seat(self) -> None:
        """Close the connection of a client that has said nothing, so that a waiting one gets its
        place."""
        self._drop("it says nothing, and somebody else wants its seat")


class Hub:
    """The server: its clients, at most a fixed number, each with a controller of its own on the
    simulated segment."""

    def __init__(self, segment: Segment, channel: str = "can0", errors: bool = False) -> None:
        """`errors`: clients are told error frames, as with the option -e of socketcand."""
        self.segment, self.channel, self.errors = segment, channel, errors
        self.epoch_at_us = (
            0  # added to the time of the bus, so that clients get that of the wall clock
        )
        self.spare = FieldBus(segment.channel)
        self.spare.subscribe(_ignore)
        self.clients: set[Client] = set()
        self.dropped = 0
        self.refused = 0
        self.port = 0
        self._server: asyncio.Server | None = None
        self._retiring: dict[FieldBus, float] = {}  # of closed clients, until when at most

    async def start(self, host: str = "127.0.0.1", port: int = 0) -> None:
        """Listen; the port is in `port`. OSError if it is in use."""
        loop = asyncio.get_running_loop()
        self.epoch_at_us = time.time_ns() // 1000 - self.segment.now_us()
        self._server = await loop.create_server(lambda: Client(self), host, port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        """Close the server and all connections, wait a bounded time for their ends, and shut down
        their buses."""
        if self._server is not None:
            self._server.close()
        for client in list(self.clients):
            client.close()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(GOODBYE_S):
                while self.clients:
                    await asyncio.sleep(0)
        for bus in [*self._retiring, self.spare]:
            bus.shutdown()
        self._retiring.clear()

    def seat(self, client: Client) -> bool:
        """Find a seat. If all are taken, the client that was silent for the longest time loses its
        seat."""
        if len(self.clients) >= CLIENTS_MAX:
            now_s = asyncio.get_running_loop().time()
            silent = [c for c in self.clients if not c.spoke or now_s - c.spoke_at_s > SPEAKS_S]
            if not silent:
                self.refused += 1
                return False
            least = min(silent, key=lambda c: (c.spoke, c.spoke_at_s))
            self.clients.discard(least)
            least.give_up_seat()
        self.clients.add(client)
        return True

    def thin_out(self) -> None:
        """If too many clients only listen, drop the oldest of them."""
        listening = sorted((c for c in self.clients if c.listens), key=lambda c: c.connected_at_s)
        for client in listening[: max(len(listening) - LISTENERS_MAX, 0)]:
            self.clients.discard(client)
            client.give_up_seat()

    def retire(self, bus: FieldBus) -> None:
        """Its client has closed: the node receives nothing more, and is removed when its queue is
        empty."""
        bus.subscribe(_ignore)
        self._retiring[bus] = asyncio.get_running_loop().time() + DRAIN_S
        self._look_after(bus)

    def _look_after(self, bus: FieldBus) -> None:
        end_at_s = self._retiring.get(bus)
        if end_at_s is None:
            return
        loop, node = asyncio.get_running_loop(), self.segment.wire.nodes.get(bus.node)
        if node is not None and node.queue and loop.time() < end_at_s:
            loop.call_later(DRAIN_LOOK_S, self._look_after, bus)
            return
        del self._retiring[bus]
        bus.shutdown()


def _key(frame: Frame) -> Key:
    if isinstance(frame, OtherFrame):
        return frame.extended, frame.number
    return True, frame.identifier


def _ignore(frame: Frame) -> None:
    """The callback of a node that ignores all frames."""
