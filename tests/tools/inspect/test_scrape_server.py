"""Clients of the metrics that are slow, silent or say too much."""

import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, suppress
from http.client import HTTPConnection
from typing import Any
from urllib.request import urlopen

import pytest

from tools.inspect import scrape_server
from tools.inspect.scrape_server import LINE_BYTES_MAX, SCRAPES_MAX, ScrapeServer

SOON_S = 0.5  # instead of `SCRAPE_S`
WAIT_S = 20.0


def app(environ: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
    start("200 OK", [("content-type", "text/plain")])
    return [b"figures"]


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[ScrapeServer]:
    monkeypatch.setattr(scrape_server, "SCRAPE_S", SOON_S)
    made = ScrapeServer("127.0.0.1", 0, app)
    yield made
    made.shutdown()
    made.server_close()


def scraped(server: ScrapeServer) -> bytes:
    with urlopen(f"http://127.0.0.1:{server.server_port}/metrics", timeout=WAIT_S) as answer:
        return bytes(answer.read())


def opened(server: ScrapeServer) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.server_port), WAIT_S)


def ended(client: socket.socket) -> bool:
    with suppress(ConnectionError):
        while client.recv(65_536):
            pass
    return True


def test_slow_and_idle_clients_are_closed_and_the_next_scrape_is_answered(
    server: ScrapeServer,
) -> None:
    idle = [opened(server) for _ in range(SCRAPES_MAX - 1)]
    slow = opened(server)
    slow.sendall(b"GET /metrics HT")
    assert all(ended(client) for client in (*idle, slow)), "after their time"
    assert scraped(server) == b"figures"
    for client in (*idle, slow):
        client.close()


@pytest.mark.slow
def test_more_connections_than_seats_are_closed_at_once(server: ScrapeServer) -> None:
    clients = [opened(server) for _ in range(4 * SCRAPES_MAX)]
    assert all(ended(client) for client in clients)
    assert scraped(server) == b"figures"
    for client in clients:
        client.close()


@pytest.mark.parametrize(
    "said",
    [
        b"GET /" + b"x" * (2 * LINE_BYTES_MAX),
        b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 1000 + b"\r\n",
        b"POST /metrics HTTP/1.1\r\nContent-Length: 700000000\r\n\r\n" + b"x" * 100_000,
    ],
    ids=["long line", "many headers", "giant post"],
)
def test_a_client_that_says_too_much_is_closed(server: ScrapeServer, said: bytes) -> None:
    client = opened(server)
    with suppress(ConnectionError):
        client.sendall(said)
    assert ended(client)
    assert scraped(server) == b"figures"
    client.close()


def answered(server: ScrapeServer, *headers: tuple[str, str]) -> tuple[int, bytes]:
    """The status and body for a request with these headers alone."""
    client = HTTPConnection("127.0.0.1", server.server_port, timeout=WAIT_S)
    client.putrequest("GET", "/metrics", skip_host=True)
    for name, value in headers:
        client.putheader(name, value)
    client.endheaders()
    answer = client.getresponse()
    with closing(client):
        return answer.status, answer.read()


def test_figures_are_not_for_pages_of_other_sites(server: ScrapeServer) -> None:
    """A name that leads to this machine (DNS rebinding) got the figures."""
    port = server.server_port
    own = ("127.0.0.1", f"127.0.0.1:{port}", f"localhost:{port}", "localhost:80", f"[::1]:{port}")
    for host in own:
        assert answered(server, ("Host", host)) == (200, b"figures"), host
        assert answered(server, ("Host", host), ("Origin", f"http://{host}"))[0] == 200
    for host in (
        "evil.example",
        f"evil.example:{port}",
        "localhost.evil.example",
        "127.0.0.1.nip.io",
    ):
        assert answered(server, ("Host", host)) == (403, b"not from here\n"), host
    here = ("Host", f"localhost:{port}")
    assert answered(server, here, ("Origin", "http://evil.example"))[0] == 403
    assert answered(server, here, ("Host", "evil.example"))[0] == 403
    assert answered(server)[0] == 403


def test_a_host_that_is_named_answers_every_client() -> None:
    """Prometheus elsewhere may know the machine by any name."""
    made = ScrapeServer("0.0.0.0", 0, app)
    try:
        assert answered(made, ("Host", "tractor.example:9464")) == (200, b"figures")
    finally:
        made.shutdown()
        made.server_close()
