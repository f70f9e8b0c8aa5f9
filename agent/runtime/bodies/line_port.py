"""Lines of text from and to a device: serial, TCP or UDP, read by a thread that reconnects.

serial:/dev/ttyUSB0@115200      tcp://10.0.0.5:2947      tcp://[fd00::5]:2947      udp://0.0.0.0:5017

UDP listens at its address, which is one of this computer, and answers the address that sent last. The
end of a datagram ends a line. A sentence without its checksum goes on in the next datagram, because
serial adapters cut a stream where a datagram is full.

What is written to a device that has stalled waits in a queue, and is obeyed when it is old. So a line is
not written while an older one waits for longer than a command lives: the newest line wins.
"""

import re
import select
import socket
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from math import inf
from typing import Any, Final, Protocol

from agent.interface.config import ACTUATOR_TTL_US, S

try:
    from termios import error as terminal_error
except ImportError:  # not on every system
    TERMINAL_ERRORS: tuple[type[Exception], ...] = ()
else:
    TERMINAL_ERRORS = (terminal_error,)  # of a serial port that is gone: it is no OSError

CONNECT_S: Final = 2.0
AGAIN_S: Final = 0.5  # between two attempts to connect
LOOK_S: Final = 0.2  # the thread ends within this after `close`
SILENCE_S: Final = 3.0  # a receiver that said something says something at least once a second
# A connection on which nothing came yet: a receiver that starts needs its time, and a program that shares
# its port may have accepted before it has the receiver.
FIRST_SILENCE_S: Final = 10.0
WAITS_FOR_US: Final = ACTUATOR_TTL_US  # a command that has waited for longer has expired
STALLED_FOR_US: Final = S  # a device that takes nothing for this long is reconnected
SIOCOUTQ: Final = 0x5411  # of Linux (linux/sockios.h): bytes that were sent and not acknowledged
# A peer that is gone without a word: asked after 1 s of silence, every second, and given up after 3 s.
PROBES: Final = {
    "TCP_KEEPIDLE": 1, "TCP_KEEPINTVL": 1, "TCP_KEEPCNT": 3, "TCP_USER_TIMEOUT": 3000,
}  # fmt: skip
DISCARD: Final = struct.pack("ii", 1, 0)  # SO_LINGER: closing drops what was not sent
LINE_MAX: Final = 1024  # bytes; a sentence has 82
BAUD: Final = 115_200
BAUD_MAX: Final = 4_000_000
BEGINNINGS: Final = (b"$", b"!")  # of a sentence
CHECKED: Final = re.compile(rb"\*[0-9A-Fa-f]{2}\s*\Z")  # the end of a whole sentence
FORMS: Final = "serial:PATH[@BAUD], tcp://HOST:PORT or udp://HOST:PORT"  # of an address
# What a device raises that is gone, is being closed by the other thread, or does not open any more.
DEVICE_ERRORS: Final[tuple[type[Exception], ...]] = (
    OSError, ValueError, TypeError, *TERMINAL_ERRORS,
)  # fmt: skip
Taken = Callable[[bytes, int], None]  # a line without its end, and its arrival, microseconds


class DeviceStream(Protocol):
    """An open device. It never waits."""

    def fileno(self) -> int:
        """The number of its file, for `select`."""
        ...

    def close(self) -> None:
        """Give the device back to the system."""
        ...


class UnsentBytes:
    """The bytes that were written to one stream and are still on their way."""

    def __init__(self, stream: Any) -> None:
        """`stream`: a socket or a serial port."""
        self.stream = stream
        self._written = 0  # bytes, since the beginning
        self._waiting: deque[tuple[int, int]] = deque()  # `_written` after a line, and when

    def add(self, count: int, now_us: int) -> None:
        """So many bytes were written now."""
        self._written += count
        self._waiting.append((self._written, now_us))

    def waits_for_us(self, now_us: int) -> int:
        """Since when the oldest bytes wait, microseconds; 0 if none do."""
        gone = self._written - _queued(self.stream)
        while self._waiting and self._waiting[0][0] <= gone:
            self._waiting.popleft()
        return now_us - self._waiting[0][1] if self._waiting else 0


class LinePort:
    """One device. Lines are taken in a thread of its own."""

    def __init__(self, address: str, taken: Taken, receives: bool = False) -> None:
        """`receives`: the device speaks all the time, so that its silence says that it is gone. Raises
        ValueError for an address of another form."""
        self.address, self.taken = address, taken
        self.receives = receives and not address.startswith("udp:")  # which has no connection
        self.dropped = 0  # lines that the device did not take
        self.overtaken = 0  # of these: lines that would have waited behind older ones
        self.renewed = 0  # connections that were given up because nothing came or went
        self.overlong = 0  # lines of more than `LINE_MAX`
        self.failed = 0  # lines at which `taken` raised
        self._opens = _opener(address)
        self._stream: Any = None
        self._peer: Any = None  # UDP: who sent last
        self._begun = b""  # UDP: the beginning of a sentence whose rest is in the next datagram
        self._end = threading.Event()
        self._thread: threading.Thread | None = None
        self._unsent = UnsentBytes(None)
        self._stalled: Any = None  # a stream that takes nothing, for the thread to drop

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
        now_us = time.monotonic_ns() // 1000
        if self._unsent.stream is not stream:
            self._unsent = UnsentBytes(stream)
        waits_for_us = self._unsent.waits_for_us(now_us)
        if waits_for_us > WAITS_FOR_US:
            self.dropped += 1
            self.overtaken += 1
            if waits_for_us > WAITS_FOR_US + STALLED_FOR_US:
                self._stalled = stream
            return False
        try:
            if isinstance(stream, socket.socket):
                udp = stream.type == socket.SOCK_DGRAM
                if udp:
                    count = 0 if self._peer is None else stream.sendto(line, self._peer)
                else:
                    count = stream.send(line)
            else:
                count = stream.write(line) if _has_room(stream) else 0
        except DEVICE_ERRORS:
            count = 0
        self._unsent.add(count, now_us)
        self.dropped += count != len(line)
        return bool(count == len(line))

    def close(self) -> None:
        """End the thread and free the device."""
        self._end.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _read(self) -> None:
        rest, silent_at_s = b"", self._silent_at_s()
        again_at_s = time.monotonic() + AGAIN_S
        while not self._end.is_set():
            if self._stream is None:
                # Some devices open and are gone at once, as a port forwarded to nothing.
                if self._end.wait(max(again_at_s - time.monotonic(), 0.0)):
                    break
                with suppress(*DEVICE_ERRORS):
                    self._stream = self._opens()
                again_at_s = time.monotonic() + AGAIN_S
                rest, silent_at_s = b"", self._silent_at_s()
                continue
            silent = self.receives and time.monotonic() > silent_at_s
            if silent or self._stalled is self._stream:
                self.renewed += 1
                self._drop(discard=True)
                continue
            try:
                if not select.select([self._stream], [], [], LOOK_S)[0]:
                    continue
                chunk = self._chunk(self._stream)
            except BlockingIOError:
                continue
            except DEVICE_ERRORS:
                chunk = b""
            if not chunk:  # it is gone
                self._drop()
                continue
            at_us, silent_at_s = time.monotonic_ns() // 1000, time.monotonic() + SILENCE_S
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

    def _silent_at_s(self) -> float:
        """When a connection on which nothing came is given up. A serial port has none."""
        return time.monotonic() + FIRST_SILENCE_S if self.address.startswith("tcp:") else inf

    def _chunk(self, stream: Any) -> bytes:
        if not isinstance(stream, socket.socket):
            return bytes(stream.read(max(stream.in_waiting, 1)))
        if stream.type == socket.SOCK_DGRAM:
            datagram, sender = stream.recvfrom(65_536)
            return self._lines_of(datagram, sender)
        return stream.recv(65_536)

    def _lines_of(self, datagram: bytes, sender: Any) -> bytes:
        """Whole lines with their ends. Raises BlockingIOError if there is only a part of one."""
        if self._begun and (sender != self._peer or datagram.startswith(BEGINNINGS)):
            self._begun += b"\n"  # its rest was lost
        self._peer = sender
        text = self._begun + datagram
        end = text.rfind(b"\n") + 1
        tail = text[end:]
        if not tail.startswith(BEGINNINGS) or CHECKED.search(tail) or len(tail) > LINE_MAX:
            self._begun = b""
            return text + b"\n" if tail or not text else text
        self._begun = tail
        if not end:
            raise BlockingIOError
        return text[:end]

    def _drop(self, discard: bool = False) -> None:
        """Close the stream. `discard`: with what still waits to be sent, which is old."""
        stream, self._stream, self._stalled = self._stream, None, None
        if stream is None:
            return
        if discard:
            with suppress(*DEVICE_ERRORS):
                if isinstance(stream, socket.socket):
                    stream.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, DISCARD)
                else:
                    stream.reset_output_buffer()
        with suppress(*DEVICE_ERRORS):
            stream.close()


def _has_room(stream: Any) -> bool:
    """Whether a serial port takes a byte now. pyserial would try again for ever where it takes none."""
    return stream is not None and bool(select.select([], [stream], [], 0.0)[1])


def _queued(stream: Any) -> int:
    """Bytes that a device has not taken, as far as the system says; else 0."""
    if stream is None:
        return 0
    with suppress(*DEVICE_ERRORS):  # it cannot say, or is closed, which `write` notices
        if not isinstance(stream, socket.socket):
            return int(getattr(stream, "out_waiting", 0))
        if sys.platform == "linux" and stream.type == socket.SOCK_STREAM:
            from fcntl import ioctl  # not on every system

            return int(struct.unpack("i", ioctl(stream, SIOCOUTQ, bytes(4)))[0])
    return 0


def _opener(address: str) -> Callable[[], DeviceStream]:
    """What opens an address. Raises ValueError."""
    kind, _, rest = address.partition(":")
    if kind == "serial" and rest:
        path, _, baud = rest.partition("@")
        if baud and not (baud.isdecimal() and len(baud) < 9 and 0 < int(baud) <= BAUD_MAX):
            raise ValueError(f"{address!r}: {baud!r} is no baud rate up to {BAUD_MAX}")
        return lambda: _serial(path, int(baud or BAUD))
    host, _, port = rest.removeprefix("//").rpartition(":")
    if kind not in ("tcp", "udp") or not port.isdecimal() or not 0 < int(port) < 1 << 16:
        raise ValueError(f"{address!r} is not {FORMS}")
    if host.startswith("[") and host.endswith("]"):  # IPv6, as URLs have it
        host = host[1:-1]
    try:
        host.encode("idna")
    except UnicodeError:
        raise ValueError(f"{address!r}: the host is no name of a computer") from None
    where = host, int(port)
    return (lambda: _tcp(where)) if kind == "tcp" else (lambda: _udp(where))


def _tcp(where: tuple[str, int]) -> socket.socket:
    stream = socket.create_connection(where, CONNECT_S)
    stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in PROBES.items():
        if hasattr(socket, name):
            stream.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
    stream.setblocking(False)
    return stream


def _udp(where: tuple[str, int]) -> socket.socket:
    family = socket.AF_INET6 if ":" in where[0] else socket.AF_INET
    stream = socket.socket(family, socket.SOCK_DGRAM)
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
    try:
        return serial.Serial(path, baud, timeout=0, write_timeout=0)  # type: ignore[no-any-return]
    except TERMINAL_ERRORS as problem:  # it went away while it was opened
        raise OSError(*problem.args) from None
