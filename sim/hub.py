"""A simulated segment for several processes: a server of the socketcand protocol on loopback.

python-can's own `socketcand` interface, its logger, its viewer and our robots attach as to any bus.
Each client is a node of its own on the wire: what it sends goes through arbitration, what it hears
has been through it. A client that does not read is dropped, and never slows the wire.
"""

import asyncio
import contextlib
import logging

from protocol.frame import Frame
from sim.fieldbus import FieldBus, Segment

log = logging.getLogger(__name__)

LINE_MAX = 256  # characters of a command; the longest valid one has 48
BACKLOG_BYTES_MAX = 1 << 20  # unread by a client: about ten seconds of a full bus
QUIET_S = 0.05  # after "rawmode": python-can's client takes what follows in one read for the answer
GOODBYE_S = 0.5  # a closed connection ends its task at once
CLIENTS_MAX = 160  # 108 peers and their tools


class Client:
    """One connection: the commands of socketcand in, frames out."""

    def __init__(self, hub: "Hub", writer: asyncio.StreamWriter) -> None:
        self.hub, self.writer = hub, writer
        self.bus: FieldBus | None = None
        self.errors = 0  # commands that made no sense

    def handle(self, command: str) -> str | None:
        """The answer to one command, without its brackets; None for no answer."""
        words = command.split()
        match words:
            case ["open", channel]:
                if channel != self.hub.channel:
                    return f"error could not open bus {channel}"
                return "ok"
            case ["rawmode"]:
                asyncio.get_running_loop().call_later(QUIET_S, self._attach)
                return "ok"
            case ["send", identifier, length, *data]:
                return self._send(identifier, length, data)
            case ["echo"]:
                return "echo"
            case ["bcmmode"] | ["controlmode"] | ["isotpmode"]:
                return "error only rawmode is served"
        self.errors += 1
        return "error unknown command"

    def _send(self, identifier: str, length: str, data: list[str]) -> str | None:
        try:
            frame = Frame(int(identifier, 16), bytes(int(byte, 16) for byte in data))
            valid = (
                len(identifier) == 8
                and frame.identifier < 1 << 29
                and len(data) == int(length, 16) <= 8
            )
        except ValueError:
            valid = False
        if not valid:
            self.errors += 1
            return "error not a classic data frame with a 29-bit identifier"
        if self.bus is not None:
            self.bus.submit(frame)
        else:
            self.hub.segment.submit(
                self.hub.spare.node, frame
            )  # sent before the first frame is heard
        return None

    def _attach(self) -> None:
        if self.bus is None and not self.writer.is_closing():
            self.bus = FieldBus(self.hub.segment.channel)
            self.bus.subscribe(self._frame)

    def _frame(self, frame: Frame) -> None:
        t_s = self.hub.segment.now_us() / 1e6
        line = f"< frame {frame.identifier:08X} {t_s:.6f} {frame.data.hex().upper()} >"
        self.writer.write(line.encode("ascii"))
        if self.writer.transport.get_write_buffer_size() > BACKLOG_BYTES_MAX:
            log.warning("a client does not read: dropped")
            self.hub.dropped += 1
            self.close()

    def close(self) -> None:
        if self.bus is not None:
            self.bus.shutdown()
            self.bus = None
        self.writer.close()


class Hub:
    def __init__(self, segment: Segment, channel: str = "can0") -> None:
        self.segment, self.channel = segment, channel
        self.spare = FieldBus(segment.channel)
        self.spare.subscribe(lambda frame: None)
        self.clients: set[Client] = set()
        self.dropped = 0
        self.refused = 0
        self.port = 0
        self._server: asyncio.Server | None = None
        self._serving: set[asyncio.Task[None]] = set()

    async def start(self, host: str = "127.0.0.1", port: int = 0) -> None:
        """Listen; the port is in `port`. OSError where it is in use."""
        self._server = await asyncio.start_server(self._serve, host, port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        if self._server is not None:
            self._server.close()
        for client in list(self.clients):
            client.close()
        if self._serving:  # else the end of the loop would cancel them, and say so on stderr
            await asyncio.wait(self._serving, timeout=GOODBYE_S)
        self.spare.shutdown()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        client = Client(self, writer)
        task = asyncio.current_task()
        assert task is not None
        self._serving.add(task)
        task.add_done_callback(self._serving.discard)
        if len(self.clients) >= CLIENTS_MAX:
            self.refused += 1
            writer.close()
            return
        self.clients.add(client)
        writer.write(b"< hi >")
        try:
            await self._commands(reader, client)
        except (ConnectionError, asyncio.IncompleteReadError, UnicodeDecodeError):
            pass
        finally:
            self.clients.discard(client)
            client.close()
            with contextlib.suppress(ConnectionError, OSError):
                await writer.wait_closed()

    async def _commands(self, reader: asyncio.StreamReader, client: Client) -> None:
        pending = ""
        while data := await reader.read(4096):
            pending += data.decode("ascii")
            while (end := pending.find(">")) >= 0:
                command, pending = pending[:end], pending[end + 1 :]
                answer = client.handle(command.replace("<", " ").strip())
                if answer is not None:
                    client.writer.write(f"< {answer} >".encode("ascii"))
            if len(pending) > LINE_MAX:
                client.errors += 1
                return
