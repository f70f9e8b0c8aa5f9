"""Lines over real sockets: whole lines, a device that goes and comes back, and one that does not read."""

import select
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from queue import SimpleQueue
from typing import Any

import pytest

from agent.runtime.bodies import line_port
from agent.runtime.bodies.line_port import LINE_MAX, LinePort

LIMIT_S = 10.0


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(LIMIT_S)
        yield listening


Open = Callable[[str], tuple[LinePort, "SimpleQueue[bytes]"]]


@pytest.fixture
def opened() -> Iterator[Open]:
    made: list[LinePort] = []

    def make(address: str) -> tuple[LinePort, "SimpleQueue[bytes]"]:
        lines: SimpleQueue[bytes] = SimpleQueue()
        port = LinePort(address, lambda line, at_us: lines.put(line))
        made.append(port)
        port.open()
        return port, lines

    yield make
    for port in made:
        port.close()


def where(server: socket.socket) -> str:
    return f"tcp://127.0.0.1:{server.getsockname()[1]}"


def test_lines_arrive_whole_and_in_order(server: socket.socket, opened: Open) -> None:
    _, lines = opened(where(server))
    device, _ = server.accept()
    for part in (b"on", b"e\r\ntwo\nthr", b"ee\n" + b"x" * (LINE_MAX + 1), b"y\nfour\n"):
        device.sendall(part)
    got = [lines.get(timeout=LIMIT_S) for _ in range(3)]
    assert got == [b"one", b"two", b"three"]
    while (line := lines.get(timeout=LIMIT_S)) != b"four":
        assert len(line) <= LINE_MAX + 2
    device.close()


def test_a_device_that_comes_back_is_read_again(server: socket.socket, opened: Open) -> None:
    port, lines = opened(where(server))
    first, _ = server.accept()
    first.sendall(b"half a li")
    first.close()
    second, _ = server.accept()
    second.sendall(b"whole\n")
    assert lines.get(timeout=LIMIT_S) == b"whole"
    assert port.write(b"told\n") and second.recv(100) == b"told\n"
    second.close()


def test_a_device_that_opens_and_is_gone_at_once_is_not_opened_without_a_pause(
    server: socket.socket, opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A port that is forwarded to nothing was opened 14,000 times a second, beside the robot's thread."""
    monkeypatch.setattr(line_port, "AGAIN_S", 0.1)
    begun_at_s = time.monotonic()
    opened(where(server))
    for _ in range(5):
        server.accept()[0].close()
    device, _ = server.accept()
    assert time.monotonic() - begun_at_s >= 5 * 0.1
    device.close()


def test_a_device_that_does_not_read_never_makes_us_wait(
    server: socket.socket, opened: Open
) -> None:
    port, _ = opened(where(server))
    device, _ = server.accept()
    while port.write(b"x" * 1000):  # until its buffers are full
        pass
    assert port.dropped
    device.close()


def test_a_line_at_which_a_driver_fails_costs_this_line(server: socket.socket) -> None:
    lines: SimpleQueue[bytes] = SimpleQueue()

    def taken(line: bytes, at_us: int) -> None:
        lines.put(bytes([int(line)]))

    port = LinePort(where(server), taken)
    port.open()
    device, _ = server.accept()
    device.sendall(b"1\nno number\n2\n")
    assert [lines.get(timeout=LIMIT_S) for _ in range(2)] == [b"\1", b"\2"] and port.failed == 1
    port.close()
    device.close()


def test_datagrams_are_lines_and_the_last_sender_is_answered(opened: Open) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        device.bind(("127.0.0.1", 0))
        device.settimeout(LIMIT_S)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            number = free.getsockname()[1]
        port, lines = opened(f"udp://127.0.0.1:{number}")
        assert not port.write(b"to nobody yet\n")
        device.sendto(b"one\ntwo", ("127.0.0.1", number))
        assert [lines.get(timeout=LIMIT_S) for _ in range(2)] == [b"one", b"two"]
        assert port.write(b"answer\n") and device.recv(100) == b"answer\n"


def test_an_address_of_ipv6_is_in_brackets(opened: Open) -> None:
    """A robot with tcp://[fd00::5]:2947 ended with "Name or service not known", and was started again
    for ever."""
    try:
        server = socket.create_server(("::1", 0), family=socket.AF_INET6)
    except OSError as problem:
        pytest.skip(f"this machine has no IPv6: {problem}")
    with server:
        server.settimeout(LIMIT_S)
        number = server.getsockname()[1]
        _, lines = opened(f"tcp://[::1]:{number}")
        device, _ = server.accept()
        device.sendall(b"one\n")
        assert lines.get(timeout=LIMIT_S) == b"one"
        device.close()
        port, lines = opened(f"udp://[::1]:{number}")
        with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sender:
            sender.settimeout(LIMIT_S)
            sender.sendto(b"two", ("::1", number))
            assert lines.get(timeout=LIMIT_S) == b"two"
            assert port.write(b"told\n") and sender.recv(100) == b"told\n"


def test_nothing_there_is_one_line(opened: Open) -> None:
    with socket.create_server(("127.0.0.1", 0)) as gone:
        address = where(gone)
    with pytest.raises(OSError, match="refused"):
        opened(address)


@pytest.mark.parametrize(
    "address", ["", "tcp://host", "tcp://host:0", "http://host:80", "serial:", "serial:/dev/x@fast",
     "serial:/dev/x@0", "serial:/dev/x@99999999999"],
)  # fmt: skip
def test_an_address_of_another_form_is_refused(address: str) -> None:
    with pytest.raises(ValueError, match=r"is not|is no"):
        LinePort(address, lambda line, at_us: None)


def test_a_serial_port_is_read_and_written() -> None:
    """A real pseudo-terminal under the real pyserial."""
    pytest.importorskip("serial", reason="the extra nmea is not installed")
    import os
    import pty

    device, name = pty.openpty()
    lines: SimpleQueue[bytes] = SimpleQueue()
    port = LinePort(f"serial:{os.ttyname(name)}@115200", lambda line, at_us: lines.put(line))
    port.open()
    os.write(device, b"$GNHDT,1.0,T*1B\r\n")
    assert lines.get(timeout=LIMIT_S) == b"$GNHDT,1.0,T*1B"
    assert port.write(b"told\n") and os.read(device, 100) == b"told\n"
    port.close()
    os.close(device)
    os.close(name)


def test_a_serial_port_that_takes_nothing_never_makes_us_wait() -> None:
    """The thread of the bus wrote to a pseudo-terminal, as of socat, again and again for ever."""
    pytest.importorskip("serial", reason="the extra nmea is not installed")
    import os
    import pty

    device, name = pty.openpty()
    port = LinePort(f"serial:{os.ttyname(name)}", lambda line, at_us: None)
    port.open()
    told: SimpleQueue[int] = SimpleQueue()

    def tell() -> None:
        while port.dropped < 3:  # the first of them in part
            port.write(b"told\n")
        told.put(port.dropped)

    writing = threading.Thread(target=tell)
    writing.start()
    writing.join(LIMIT_S)
    waits = writing.is_alive()
    while writing.is_alive():  # so that it ends
        os.read(device, 65_536)
        port.dropped = 3
    assert not waits and told.get_nowait() == 3
    port.close()
    os.close(device)
    os.close(name)


@pytest.mark.parametrize("at", ["reset_output_buffer", "reset_input_buffer"])
def test_a_serial_port_that_goes_while_it_is_used_is_opened_again(
    at: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What pyserial raises then is no OSError. It ended the thread: nothing was ever read again."""
    pytest.importorskip("serial", reason="the extra nmea is not installed")
    import os
    import pty
    import termios

    device, name = pty.openpty()
    lines: SimpleQueue[bytes] = SimpleQueue()
    port = LinePort(f"serial:{os.ttyname(name)}", lambda line, at_us: lines.put(line), True)
    monkeypatch.setattr(line_port, "LOOK_S", 0.01)
    monkeypatch.setattr(line_port, "AGAIN_S", 0.01)
    port.open()
    os.write(device, b"one\n")
    assert lines.get(timeout=LIMIT_S) == b"one"
    failed: SimpleQueue[str] = SimpleQueue()
    gone = iter([termios.error(5, "Input/output error"), termios.error(5, "Input/output error")])
    flush = termios.tcflush

    def tcflush(fd: int, queue: int) -> None:
        """As of an adapter that is unplugged: a port in use, or one that is just opened."""
        wanted = termios.TCOFLUSH if at == "reset_output_buffer" else termios.TCIFLUSH
        if queue == wanted and (problem := next(gone, None)) is not None:
            failed.put(at)
            raise problem
        flush(fd, queue)

    monkeypatch.setattr(termios, "tcflush", tcflush)
    monkeypatch.setattr(line_port, "SILENCE_S", 0.01)
    assert failed.get(timeout=LIMIT_S) == at
    monkeypatch.setattr(line_port, "SILENCE_S", LIMIT_S)
    ends_at_s = time.monotonic() + LIMIT_S
    while lines.empty():
        assert time.monotonic() < ends_at_s, "nothing is read any more"
        os.write(device, b"two\n")
        select.select([], [], [], 0.01)
    assert lines.get() == b"two"
    port.close()
    os.close(device)
    os.close(name)


def test_a_serial_port_that_the_other_thread_is_closing_takes_no_line() -> None:
    """pyserial says that it is open for a moment after its file is gone. The drive raised TypeError."""
    pytest.importorskip("serial", reason="the extra nmea is not installed")
    import os
    import pty

    device, name = pty.openpty()
    port = LinePort(f"serial:{os.ttyname(name)}", lambda line, at_us: None)
    stream: Any = port._opens()
    port._stream = stream
    kept, stream.fd = stream.fd, None
    assert not port.write(b"told\n") and port.dropped == 1
    stream.fd = kept
    stream.close()
    os.close(device)
    os.close(name)


def test_hostile_datagrams_cost_themselves_and_no_sentence(opened: Open) -> None:
    """A line of 60 kB that came in one piece was passed on, and only the rest of a piece was counted."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        at = probe.getsockname()
    port, lines = opened(f"udp://127.0.0.1:{at[1]}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for datagram in (
            b"x" * 60_000,
            b"y" * 60_000 + b"\n",
            b"",
            b"\n",
            b"\x00\xff",
            b"one\ntwo",
        ):
            sender.sendto(datagram, at)
        got = [lines.get(timeout=LIMIT_S) for _ in range(5)]
    assert got == [b"", b"", b"\x00\xff", b"one", b"two"] and port.overlong == 2


def test_a_sentence_that_a_serial_adapter_cuts_is_put_together(opened: Open) -> None:
    """An adapter sends a datagram when that is full. The sentence at its end was lost, each time."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        at = probe.getsockname()
    _, lines = opened(f"udp://127.0.0.1:{at[1]}")
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as adapter,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        for datagram in (
            b"$GNHDT,90.0,T*17\r\n$GN",
            b"HDT,91",
            b".0,T*16\r\n$GNHDT,92.0,T*1",
            b"5\r\n$GNHDT,93.0,T*14",  # whole, so it is taken at once
            b"$GNHDT,9",  # its rest is lost
            b"$GNHDT,95.0,T*12\r\n$GNHDT,9",
        ):
            adapter.sendto(datagram, at)
        other.sendto(b"one\n", at)
        got = [lines.get(timeout=LIMIT_S) for _ in range(8)]
    whole = [b"$GNHDT,9%d.0,T*1%d" % (each, 7 - each) for each in (0, 1, 2, 3, 5)]
    assert got == [*whole[:4], b"$GNHDT,9", whole[4], b"$GNHDT,9", b"one"]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says what is unacknowledged")
def test_no_command_waits_behind_old_ones_of_a_controller_that_stalls(
    server: socket.socket, opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A controller that stalled obeyed all that had been queued for it, one command after another."""
    monkeypatch.setattr(line_port, "STALLED_FOR_US", 10**9)
    server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # of what it accepts
    port, _ = opened(where(server))
    device, _ = server.accept()
    while port.write(b"x" * 200):  # until its buffer is full, and more waits in ours
        pass
    while not port.overtaken:
        port.write(b"old\n")
    before = port.dropped
    assert not port.write(b"older than the next\n") and port.dropped == before + 1
    device.settimeout(LIMIT_S)
    got = b""
    while not port.write(b"newest\n"):  # it goes on, and reads what had been sent
        got += device.recv(65_536) if select.select([device], [], [], 0.01)[0] else b""
    while not got.endswith(b"newest\n"):
        got += device.recv(65_536)
    assert b"older than the next" not in got
    device.close()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says what is unacknowledged")
def test_a_controller_that_takes_nothing_is_reconnected_without_the_old_commands(
    server: socket.socket, opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_port, "STALLED_FOR_US", 0)
    server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    port, _ = opened(where(server))
    first, _ = server.accept()
    while port.write(b"x" * 200):
        pass
    while not select.select([server], [], [], 0.01)[0]:
        port.write(b"old\n")
    second, _ = server.accept()
    second.settimeout(LIMIT_S)
    while not port.write(b"new\n"):
        pass
    assert second.recv(100) == b"new\n" and port.renewed == 1
    first.close()
    second.close()


@pytest.mark.parametrize("receives", [True, False])
def test_a_receiver_that_falls_silent_is_reconnected_and_a_controller_is_not(
    receives: bool, server: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A receiver that lost its power said no farewell, and its robot waited for it for ever."""
    monkeypatch.setattr(line_port, "SILENCE_S", 0.01)
    monkeypatch.setattr(line_port, "LOOK_S", 0.01)
    lines: SimpleQueue[bytes] = SimpleQueue()
    port = LinePort(where(server), lambda line, at_us: lines.put(line), receives)
    port.open()
    first, _ = server.accept()
    assert not select.select([server], [], [], 0.1)[0], "it has said nothing yet"
    first.sendall(b"one\n")
    assert lines.get(timeout=LIMIT_S) == b"one"
    assert bool(select.select([server], [], [], LIMIT_S if receives else 0.1)[0]) is receives
    port.close()
    first.close()


def test_a_receiver_that_accepts_and_says_nothing_is_reconnected(
    server: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program that shares a serial port accepted before it had the port, and never sent there."""
    monkeypatch.setattr(line_port, "FIRST_SILENCE_S", 0.05)
    monkeypatch.setattr(line_port, "LOOK_S", 0.01)
    lines: SimpleQueue[bytes] = SimpleQueue()
    port = LinePort(where(server), lambda line, at_us: lines.put(line), receives=True)
    port.open()
    first, _ = server.accept()
    second, _ = server.accept()
    monkeypatch.setattr(line_port, "FIRST_SILENCE_S", LIMIT_S)
    second.sendall(b"one\n")
    while lines.get(timeout=LIMIT_S) != b"one":
        pass
    assert port.renewed >= 1
    port.close()
    first.close()
    second.close()


def test_a_peer_that_is_gone_without_a_word_is_noticed_by_the_system(
    server: socket.socket, opened: Open
) -> None:
    port, _ = opened(where(server))
    stream = port._stream
    assert stream.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        assert stream.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 3000
