"""Messages between the processes of one owner: a unix socket in a folder that no other user can
enter.

A socket that moves machines must not be open to every user of a computer, as a port on loopback is.
The folder is created with mode 0700, and the kernel reports the user at the other end; another user
is counted and disconnected. A message is a length and that many bytes. A reader that is too slow
loses the newest messages, as it would lose datagrams; this is acceptable because the messages
expire soon.
"""

import asyncio
import os
import shutil
import socket
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Self, cast

LENGTH = struct.Struct("<H")
MESSAGE_MAX = 8_192  # bytes; 720 rays and 32 parcels take half of it
LINKS_MAX = 256  # of one server: 108 robots, those that restart, and listeners
BACKLOG_MAX = 64 * 1024  # bytes that wait for a slow reader: a quarter of a second of a world
CREDENTIALS = struct.Struct("3i")  # process, user, group of the other end, as reported by Linux
ROOT = 0
SOCKET = "bodies"  # name of the socket in its folder


class Link(asyncio.Protocol):
    """One end of a connection."""

    def __init__(self) -> None:
        self.dropped = self.malformed = 0  # messages
        self._transport: asyncio.Transport | None = None
        self._received = bytearray()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the transport (asyncio calls it)."""
        self._transport = cast(asyncio.Transport, transport)

    def connection_lost(self, problem: Exception | None) -> None:
        """Forget the transport; what is sent from now on is dropped."""
        self._transport = None

    @property
    def open(self) -> bool:
        """Whether messages can still be sent."""
        return self._transport is not None and not self._transport.is_closing()

    def data_received(self, data: bytes) -> None:
        """Cut what arrived into messages by their length, and pass each on. A length above
        `MESSAGE_MAX` ends the link."""
        self._received += data
        while len(self._received) >= LENGTH.size:
            (length,) = LENGTH.unpack_from(self._received)
            if length > MESSAGE_MAX:
                self.malformed += 1
                self.end()
                return
            if len(self._received) < LENGTH.size + length:
                return
            message = bytes(self._received[LENGTH.size : LENGTH.size + length])
            del self._received[: LENGTH.size + length]
            self.take(message)

    def take(self, message: bytes) -> None:
        """Handle a received message."""

    def send(self, message: bytes) -> None:
        """Send; the message is dropped and counted if the other end does not read."""
        assert len(message) <= MESSAGE_MAX
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        if transport.get_write_buffer_size() > BACKLOG_MAX:
            self.dropped += 1
            return
        transport.write(LENGTH.pack(len(message)) + message)

    def end(self) -> None:
        """Break the connection now, without sending what waits."""
        if self._transport is not None:
            self._transport.abort()

    async def connect(self, path: Path) -> Self:
        """Connect to a server on this computer. Raises OSError."""
        await asyncio.get_running_loop().create_unix_connection(lambda: self, str(path))
        return self


class LinkServer:
    """Accepts links of the same owner; others are counted in `foreign`."""

    def __init__(self, made: Callable[[], Link]) -> None:
        self.made = made
        self.foreign = self.crowded = 0  # of other users, and beyond `LINKS_MAX`
        self.links: set[Link] = set()
        self.path: Path | None = None
        self._server: asyncio.Server | None = None

    async def start(self, folder: Path | None = None) -> Path:
        """Listen in a new folder of the owner, or in this one; returns the path. Raises OSError."""
        own = Path(tempfile.mkdtemp(prefix="headland-")) if folder is None else folder
        own.chmod(0o700)
        self.path = own / SOCKET
        self.path.unlink(missing_ok=True)
        loop = asyncio.get_running_loop()
        self._server = await loop.create_unix_server(lambda: _Arrival(self), str(self.path))
        self.path.chmod(0o600)
        return self.path

    def close(self) -> None:
        """Close the server and remove the folder."""
        if self._server is not None:
            self._server.close()
        for link in list(self.links):
            link.end()
        if self.path is not None:
            shutil.rmtree(self.path.parent, ignore_errors=True)


class _Arrival(asyncio.Protocol):
    """A connection whose owner is not known yet."""

    def __init__(self, server: LinkServer) -> None:
        self.server = server
        self._link: Link | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        ours = _is_ours(transport)
        if not ours or len(self.server.links) >= LINKS_MAX:
            self.server.foreign += not ours
            self.server.crowded += ours
            cast(asyncio.Transport, transport).abort()
            return
        self._link = self.server.made()
        self.server.links.add(self._link)
        self._link.connection_made(transport)

    def data_received(self, data: bytes) -> None:
        if self._link is not None:
            self._link.data_received(data)

    def connection_lost(self, problem: Exception | None) -> None:
        if self._link is not None:
            self.server.links.discard(self._link)
            self._link.connection_lost(problem)


def _is_ours(transport: asyncio.BaseTransport) -> bool:
    """Whether the other end is our user or root. If the kernel reports none, the folder decides."""
    if not hasattr(socket, "SO_PEERCRED"):
        return True
    end = transport.get_extra_info("socket")
    raw = end.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS.size)
    return CREDENTIALS.unpack(raw)[1] in (os.getuid(), ROOT)
