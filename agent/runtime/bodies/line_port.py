"""Lines of text from and to a device: serial, TCP or UDP, read by a thread that reconnects.

serial:/dev/ttyUSB0@115200      tcp://10.0.0.5:2947      udp://0.0.0.0:5017
"""

import select
import socket
import threading
import time
from collections.abc import Callable
from typing import Any, Final, Protocol

CONNECT_S: Final = 2.0
AGAIN_S: Final = 0.5  # between two attempts to connect
LOOK_S: Final = 0.2  # the thread ends within this after `close`
LINE_MAX: Final = 1024  # bytes; a sentence has 82
BAUD: Final = 115_200
Taken = Callable[[bytes, int], None]  # a line without its end, and its arrival, microseconds


class DeviceStream(Protocol):
    """An open device. It never waits."""

    def fileno(self) -> int:
        """The number of its file, for `select`."""
        ...

    def close(self) -> None:
        """Give the device back to the system."""
        ...


class LinePort:
    """One device. Lines are taken in a thread of its own."""

    def __init__(self, address: str, taken: Taken) -> None:
        """Raises ValueError for an address of another form."""
        self.address, self.taken = address, taken
        self.dropped = 0  # lines that the device did not take
        self.overlong = 0  # lines of more than `LINE_MAX`
        self.failed = 0  # lines at which `taken` raised
        self._opens = _opener(address)
        self._stream: Any = None
        self._peer: Any = None  # UDP: who sent last
        self._end = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Connect and begin to read. Raises OSError."""
        self._end.clear()
        try:
            self._stream = self._opens()
        except OSError as problem:
            reason = problem.strerror or str(problem)
            raise OSError(f"{self.address}: {reason}") from None
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def write(self, line: bytes) -> bool:
        """Send one line with its end. False: the device does not take it now, or is gone."""
        stream = self._stream
        try:
            if isinstance(stream, socket.socket):
                udp = stream.type == socket.SOCK_DGRAM
                if udp:
                    count = 0 if self._peer is None else stream.sendto(line, self._peer)
                else:
                    count = stream.send(line)
            else:
                count = 0 if stream is None else stream.write(line)
        except (OSError, ValueError):  # a closed serial port
            count = 0
        self.dropped += count != len(line)
        return bool(count == len(line))

    def close(self) -> None:
        """End the thread and free the device."""
        self._end.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _read(self) -> None:
        rest = b""
        while not self._end.is_set():
            if self._stream is None:
                rest = b""
                try:
                    self._stream = self._opens()
                except OSError:
                    self._end.wait(AGAIN_S)
                continue
            try:
                if not select.select([self._stream], [], [], LOOK_S)[0]:
                    continue
                chunk = self._chunk(self._stream)
            except BlockingIOError:
                continue
            except (OSError, ValueError):
                chunk = b""
            if not chunk:  # it is gone
                self._drop()
                continue
            at_us = time.monotonic_ns() // 1000
            *lines, rest = (rest + chunk).split(b"\n")
            if len(rest) > LINE_MAX:
                rest, self.overlong = b"", self.overlong + 1
            for line in lines:
                if len(line) > LINE_MAX:
                    self.overlong += 1
                    continue
                try:
                    self.taken(line.rstrip(b"\r"), at_us)
                except Exception:  # of a driver: it loses this line and not its thread
                    self.failed += 1
        self._drop()

    def _chunk(self, stream: Any) -> bytes:
        if not isinstance(stream, socket.socket):
            return bytes(stream.read(max(stream.in_waiting, 1)))
        if stream.type == socket.SOCK_DGRAM:
            datagram, self._peer = stream.recvfrom(65_536)
            return datagram if datagram.endswith(b"\n") else datagram + b"\n"
        return stream.recv(65_536)

    def _drop(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()


def _opener(address: str) -> Callable[[], DeviceStream]:
    """What opens an address. Raises ValueError."""
    kind, _, rest = address.partition(":")
    if kind == "serial" and rest:
        path, _, baud = rest.partition("@")
        if baud and not baud.isdecimal():
            raise ValueError(f"{address!r}: {baud!r} is no baud rate")
        return lambda: _serial(path, int(baud or BAUD))
    host, _, port = rest.removeprefix("//").rpartition(":")
    if kind not in ("tcp", "udp") or not port.isdecimal() or not 0 < int(port) < 1 << 16:
        raise ValueError(
            f"{address!r} is not serial:PATH[@BAUD], tcp://HOST:PORT or udp://HOST:PORT"
        )
    where = host, int(port)
    return (lambda: _tcp(where)) if kind == "tcp" else (lambda: _udp(where))


def _tcp(where: tuple[str, int]) -> socket.socket:
    stream = socket.create_connection(where, CONNECT_S)
    stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    stream.setblocking(False)
    return stream


def _udp(where: tuple[str, int]) -> socket.socket:
    stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        stream.bind(where)
    except OSError:
        stream.close()
        raise
    stream.setblocking(False)
    return stream


def _serial(path: str, baud: int) -> DeviceStream:
    try:
        import serial
    except ImportError:
        raise OSError("serial ports need an extra: pip install 'headland[nmea]'") from None
    return serial.Serial(path, baud, timeout=0, write_timeout=0)  # type: ignore[no-any-return]
