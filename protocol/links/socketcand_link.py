"""A bus behind a socketcand server; the link reconnects by itself when the connection ends.

    link = SocketcandLink("127.0.0.1", 29536, "can0", Random(f"line of robot {slot}"))
    await link.up()            # the first connection; then it is a `Bus` like any other

The end of a server is detected immediately by the end of the stream. A server that hangs or is cut
off is detected by its silence, because a socketcand server answers `echo`. From then on the
controller is off the bus: no frame is accepted or received, and `health` reports it, which stops a
robot. python-can's client detects neither case (measured with 4.5: after the server's end its
thread reads empty data in a busy loop, and `sendall` blocks on a server that hangs).

The command `confirm` asks our own server to report which frames have left the wire and which it
could not accept. It answers `sent N` and `refused N`, counted since the connection. Other servers
do not know this command. Behind them `sent` is None because it cannot be known, and a robot that
receives no other member stands.

When a connection is given up, both sides discard the frames under way, because a beat that arrives
seconds late would be believed.
"""

import asyncio
import socket
import struct
from collections.abc import Callable
from random import Random
from typing import cast

from protocol.controller_health import Health
from protocol.frames.frame import Frame

LINE_MAX = 256  # bytes of an answer; a frame has 52
ANSWER_S = 2.0  # for a connection and its greeting; takes milliseconds with a healthy server
ASK_S = 0.3  # after this silence we ask; a fleet sends 20 beats a second
DEAD_S = 1.0  # without an answer either: three questions, and ten times what a busy machine takes
UNSENT_MAX = 16_384  # bytes waiting for the server: 300 frames, a sixth of a second of a full bus
FIRST_S = 0.1  # before the next try, doubled each time
LAST_S = 1.0  # upper limit; at this limit a whole fleet makes a hundred tries a second
STANDARD_DIGITS = 3  # of an 11-bit identifier
COUNT_DIGITS_MAX = 18  # of a number of frames: more than any wire will ever carry
NO_LINGER = struct.pack("ii", 1, 0)  # close discards what the other side has not read


class SocketcandLink(asyncio.Protocol):
    """A `Bus` over one TCP connection, which is made again whenever it ends or hangs."""

    def __init__(self, host: str, port: int, channel: str, rng: Random) -> None:
        """`rng`: makes the pauses differ, so that not all robots reconnect at the same time."""
        self.host, self.port, self.channel, self._rng = host, port, channel, rng
        self.connections = 0  # established so far
        self.malformed = 0  # answers that could not be parsed
        self.other_frames = 0  # 11-bit and remote frames of other devices, which no robot reads
        self.refused = 0  # frames that were not accepted
        # Frames that have left the wire; see `agent.interface.ports.Confirming`.
        self.sent: int | None = None
        self._sent_before = 0  # in earlier connections
        self._full = False  # the server's latest report is that it could not accept a frame
        self._callback: Callable[[Frame], None] | None = None
        self._transport: asyncio.Transport | None = None
        self._raw = asyncio.Event()  # set while frames go both ways
        self._over = asyncio.Event()  # set when this connection has ended
        self._answers = 0  # answers received during the greeting
        self._pending = b""
        self._heard_at_s = 0.0
        self._task: asyncio.Task[None] | None = None

    # ---------------------------------------------------------------- the port of a runner

    def send(self, frame: Frame) -> bool:
        """Write a frame to the server; False if there is no connection or either side is full."""
        transport = self._transport
        if transport is None or not self._raw.is_set() or transport.is_closing():
            taken = False
        else:
            taken = transport.get_write_buffer_size() < UNSENT_MAX
        if taken:
            assert transport is not None
            data = " ".join(f"{byte:02X}" for byte in frame.data)
            transport.write(f"< send {frame.identifier:08X} {len(frame.data)} {data} >".encode())
            taken = not self._full
        self.refused += not taken
        return taken

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        """Pass every received frame to the callback, in the loop's thread, and begin to connect."""
        self._callback = callback
        self._begin()

    @property
    def health(self) -> Health:
        """ACTIVE while frames go both ways, else OFF."""
        return Health.ACTIVE if self._raw.is_set() else Health.OFF

    def close(self) -> None:
        """End the connection and connect no more."""
        if self._task is not None:
            self._task.cancel()
        if self._transport is not None:
            self._transport.close()

    async def up(self) -> None:
        """Wait until the connection is established."""
        self._begin()
        await self._raw.wait()

    # ---------------------------------------------------------------- connections

    def _begin(self) -> None:
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._keep())

    async def _keep(self) -> None:
        pause_for_s = FIRST_S
        while True:
            self._answers, self._pending, self._full = 0, b"", False
            self._sent_before = self.sent or 0
            self._over.clear()
            if await self._connect():
                pause_for_s = FIRST_S
                await self._watch()
            self._drop()
            await asyncio.sleep(pause_for_s * self._rng.uniform(0.5, 1.0))
            pause_for_s = min(2 * pause_for_s, LAST_S)

    async def _connect(self) -> bool:
        loop = asyncio.get_running_loop()
        raw, over = asyncio.create_task(self._raw.wait()), asyncio.create_task(self._over.wait())
        try:
            async with asyncio.timeout(ANSWER_S):
                await loop.create_connection(lambda: self, self.host, self.port)
                await asyncio.wait((raw, over), return_when=asyncio.FIRST_COMPLETED)
        except (OSError, TimeoutError):
            return False
        finally:
            raw.cancel()
            over.cancel()
        return self._raw.is_set()

    async def _watch(self) -> None:
        """Wait until the connection ends or falls silent."""
        loop = asyncio.get_running_loop()
        while not self._over.is_set():
            due_at_s = loop.time() + ASK_S
            try:
                async with asyncio.timeout_at(due_at_s):
                    await self._over.wait()
            except TimeoutError:
                # Our own process hung, so data that has arrived is not read yet.
                if loop.time() - due_at_s > ASK_S:
                    self._heard_at_s = loop.time()
                if loop.time() - self._heard_at_s > DEAD_S:
                    return
                if loop.time() - self._heard_at_s > ASK_S and self._transport is not None:
                    self._transport.write(b"< echo >")

    def _drop(self) -> None:
        self._raw.clear()
        if self._transport is not None:
            tcp = self._transport.get_extra_info("socket")
            if tcp is not None and tcp.fileno() >= 0:
                tcp.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, NO_LINGER)
            self._transport.abort()
            self._transport = None

    # ---------------------------------------------------------------- callbacks of asyncio

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """asyncio calls this with the transport of a new connection; the server greets first."""
        self._transport = cast(asyncio.Transport, transport)

    def connection_lost(self, problem: Exception | None) -> None:
        """asyncio calls this when a connection has ended, whichever side ended it."""
        self._raw.clear()
        self._over.set()

    def data_received(self, data: bytes) -> None:
        """asyncio calls this with bytes from the server: whole answers are handled, the rest is
        kept."""
        self._heard_at_s = asyncio.get_running_loop().time()
        *answers, self._pending = (self._pending + data).split(b">")
        for answer in answers:
            self._answer(answer.strip(b"< \r\n").split())
        if len(self._pending) > LINE_MAX:
            self.malformed += 1
            self._pending = b""

    def _answer(self, words: list[bytes]) -> None:
        if words[:1] == [b"frame"]:
            frame = _frame(words)
            if frame is None and len(words) > 2 and len(words[1]) == STANDARD_DIGITS:
                self.other_frames += 1
            elif frame is None:
                self.malformed += 1
            elif self._raw.is_set() and self._callback is not None:
                self._callback(frame)
            return
        if words[:1] == [b"rtr"]:
            self.other_frames += 1
            return
        if self._raw.is_set() and self._count(words):
            return
        expected = ([b"hi"], [b"ok"], [b"ok"])
        if self._answers < len(expected) and words == expected[self._answers]:
            self._greet()
        # The reply of other servers to `confirm`.
        elif words != [b"echo"] and words[:2] != [b"error", b"unknown"]:
            self.malformed += 1

    def _count(self, words: list[bytes]) -> bool:
        """Handle `sent N` or `refused N` of our server."""
        if (
            len(words) != 2
            or words[0] not in (b"sent", b"refused")
            or len(words[1]) > COUNT_DIGITS_MAX
        ):
            return False
        if not words[1].isdigit():
            return False
        self._full = words[0] == b"refused"
        if not self._full:
            self.sent = max(self.sent or 0, self._sent_before + int(words[1]))
        return True

    def _greet(self) -> None:
        """Send the next command of socketcand's greeting: hi, open, rawmode."""
        self._answers += 1
        assert self._transport is not None
        if self._answers == 1:
            self._transport.write(f"< open {self.channel} >".encode())
        elif self._answers == 2:
            self._transport.write(b"< rawmode >")
        else:
            self.connections += 1
            self._raw.set()
            self._transport.write(b"< confirm >")


def _frame(words: list[bytes]) -> Frame | None:
    """Parse `frame ID TIME DATA`; None if it is no data frame with a 29-bit identifier."""
    try:
        identifier, data = int(words[1], 16), bytes.fromhex(b"".join(words[3:]).decode("ascii"))
    except (ValueError, IndexError):
        return None
    if len(words[1]) != 8 or identifier >> 29 or identifier < 0 or len(data) > 8:
        return None
    return Frame(identifier, data)
