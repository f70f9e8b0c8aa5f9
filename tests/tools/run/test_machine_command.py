"""`headland machine`: what a person is told where a machine does not begin, or does not obey."""

import socket
from threading import Thread

import pytest

from tools.run.machine_command import machine, order


def told(answer: bytes, words: str) -> int:
    """The exit code of an order to a port that answers with this."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            stream, _ = server.accept()
            with stream:
                stream.recv(1000)
                stream.sendall(answer)

        serving = Thread(target=serve)
        serving.start()
        code = order(words, *server.getsockname())
        serving.join()
    return code


@pytest.mark.parametrize("answer", [b"", b"$GNHDT,90.0,T*00\r\n", b"\xff\xfe\n"])
def test_an_order_to_another_port_has_no_effect_and_says_so(
    answer: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    """The port of the receiver sent a sentence, which was printed, and the exit code was 0."""
    code, said = told(answer, "muted 3"), capsys.readouterr()
    assert code == 2 and "takes no orders of a machine" in said.err and not said.out


def test_words_that_are_no_text_are_not_understood(capsys: pytest.CaptureFixture[str]) -> None:
    assert told(b"not understood; it is one of where\n", "muted \udcff") == 2
    assert told(b"ok\n", "muted 3") == 0 and told(b"{}\n", "where") == 0


def test_a_bus_that_does_not_open_blames_no_port(capsys: pytest.CaptureFixture[str]) -> None:
    code = machine(
        "ackermann", (52.0, 5.0), (0.0, 0.0, 0.0), (0, 0, 0), "127.0.0.1", 1, 20.0, True,
        bus="nonsense:0",
    )  # fmt: skip
    said = capsys.readouterr().err
    assert code == 2 and said.startswith("headland: nonsense:0: ") and "ports" not in said
