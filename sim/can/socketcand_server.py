"""A simulated segment for several processes: a server of the socketcand protocol on loopback.

python-can's own `socketcand` interface, its logger, its viewer and our robots attach as to any bus.
Each client is a separate node on the wire: the frames it sends and receives go through arbitration.
A client that does not read is dropped, so it never slows the wire.

A client may close right after sending; its node stays on the wire until its queue is empty.
Commands are read in small portions, client by client, so that no client delays the others.
"""

import asyncio
import contextlib
import logging
import re
import socket
from typing import cast

from protocol.frames.frame import Frame
from sim.can.simulated_bus import FieldBus, Segment

log = logging.getLogger(__name__)

LINE_MAX = 256  # bytes of a command; the longest valid one has 180, with sign-extended data
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
NO_FRAME = "error not a classic data frame with a 29-bit identifier"


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


class Client(asyncio.BufferedProtocol):
    """One connection: commands of socketcand in, frames out."""

    def __init__(self, hub: "Hub") -> None:
        self.hub = hub
        self.bus: FieldBus | None = None
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
        if problem is not None:
            self._take_what_is_left()
        if self._twin is not None:
            self._twin.close()
            self._twin = None
        self.hub.clients.discard(self)
        if self.bus is not None:
            self.hub.retire(self.bus)
            self.bus = None

    # ---------------------------------------------------------------- commands

    def handle(self, command: str) -> str | None:
        """The answer to one command, without its brackets; None for no answer."""
        words = command.split()
        match words:
            case ["open", channel]:
                if channel != self.hub.channel:
                    return f"error could not open bus {channel}"
                return "ok"
            case ["rawmode"]:
                self._attach()
                return "ok"
            case ["send", identifier, length, *data]:
                return self._send(identifier, length, data)
            case ["echo"]:
                return "echo"
            case ["confirm"]:
                self._confirms = True
                return self._confirm()
            case ["bcmmode"] | ["controlmode"] | ["isotpmode"]:
                return "error only rawmode is served"
        self.errors += 1
        return "error unknown command"

    def _send(self, identifier: str, length: str, data: list[str]) -> str | None:
        frame = frame_of(identifier, length, data)
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
        rarely."""
        self.refused += 1
        if self._confirms:
            return f"refused {self.refused}"
        now_us = self.hub.segment.now_us()
        if now_us - self._told_at_us < REFUSED_US:
            return None
        self._told_at_us = now_us
        return "error the bus takes no frame"

    def _confirm(self) -> str | None:
        """From now on, report how many of its frames have left the wire."""
        if not self._confirms or self.bus is None:
            return None
        self.bus.tell_sent(self._left)
        return f"sent {self.bus.sent}"

    def _left(self, t_us: int, frame: Frame) -> None:
        if self.bus is not None:
            self._write(f"< sent {self.bus.sent} >".encode("ascii"))

    def _attach(self) -> None:
        """Attach to the wire immediately. Received frames follow the answer after a pause."""
        if self.bus is None:
            self.bus = FieldBus(self.hub.segment.channel)
            self.bus.subscribe(self._frame)
            self._quiet = []
            loop = asyncio.get_running_loop()
            loop.call_later(QUIET_S, self._unquiet)
            loop.call_later(LISTENER_S, self.hub.thin_out)

    def _unquiet(self) -> None:
        held, self._quiet = self._quiet, None
        if held:
            self._write(b"".join(held))

    def _frame(self, frame: Frame) -> None:
        t_s = self.hub.segment.now_us() / 1e6
        line = f"< frame {frame.identifier:08X} {t_s:.6f} {frame.data.hex().upper()} >"
        if self._quiet is not None:
            self._quiet.append(line.encode("ascii"))
        else:
            self._write(line.encode("ascii"))

    # ---------------------------------------------------------------- bytes

    def _take(self, data: bytes) -> None:
        *commands, self._pending = (self._pending + data).split(b">")
        self._commands += len(commands)
        for command in commands:
            try:
                answer = self.handle(command.replace(b"<", b" ").decode("ascii").strip())
            except UnicodeDecodeError:
                self._drop("it does not speak the protocol")
                return
            if answer is not None:
                self._write(f"< {answer} >".encode("ascii"))
        if len(self._pending) > LINE_MAX or self.errors > ERRORS_MAX:
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

    def __init__(self, segment: Segment, channel: str = "can0") -> None:
        self.segment, self.channel = segment, channel
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


def _ignore(frame: Frame) -> None:
    """The callback of a node that ignores all frames."""
