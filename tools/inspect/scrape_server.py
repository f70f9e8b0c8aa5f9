"""The HTTP server of `--metrics`: a thread for each scrape, few of them, and none for long.

The server of prometheus-client has no limits: each connection that says nothing keeps a thread for ever.
"""

import socket
import threading
from collections.abc import Callable, Iterable
from typing import Any, Final
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from tools.common.loopback_host import asked_here, is_loopback

SCRAPES_MAX: Final = 8  # connections at once; Prometheus keeps one
SCRAPE_S: Final = 10.0  # from connection to answer: Prometheus gives up after as long
LINE_BYTES_MAX: Final = 65_536  # of a request line or header, as http.server has it; 100 headers

App = Callable[..., Any]


def only_here(app: App) -> App:
    """The same, but what another site's page asks for is refused."""

    def checked(environ: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
        named = {key: environ.get(f"HTTP_{key}") for key in ("HOST", "ORIGIN")}
        hosts, origins = ([] if value is None else [value] for value in named.values())
        if asked_here(hosts, origins):
            return app(environ, start)  # type: ignore[no-any-return]
        start("403 Forbidden", [("content-type", "text/plain")])
        return [b"not from here\n"]

    return checked


class _Handler(WSGIRequestHandler):
    """One request, which nobody logs."""

    timeout = SCRAPE_S  # of one read

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing."""


class _Server(WSGIServer):
    """Serves each connection in a thread of its own, until its time is over."""

    request_queue_size = SCRAPES_MAX

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.refused = 0  # connections that found no seat
        self._seats = threading.Semaphore(SCRAPES_MAX)
        super().__init__(*args, **kwargs)

    def process_request(self, request: Any, client_address: Any) -> None:
        """In a thread, if a seat is free; else the connection is closed."""
        if not self._seats.acquire(blocking=False):
            self.refused += 1
            self.shutdown_request(request)
            return
        threading.Thread(target=self._serve, args=(request, client_address), daemon=True).start()

    def _serve(self, request: socket.socket, client_address: Any) -> None:
        over = threading.Timer(SCRAPE_S, _cut, (request,))
        over.daemon = True
        over.start()
        try:
            self.finish_request(request, client_address)
        except OSError:
            pass  # it is gone, or was too slow
        finally:
            over.cancel()
            self.shutdown_request(request)
            self._seats.release()


class ScrapeServer:
    """A server that runs in a thread from the start. Raises OSError where the port is taken."""

    def __init__(self, host: str, port: int, app: App) -> None:
        """`port`: 0 for any free one. A host that others reach is asked for by names that we do not know
        here; on loopback, requests by other names are refused."""
        served = only_here(app) if is_loopback(host) else app
        self._server = make_server(host, port, served, _Server, _Handler)
        self.server_port = self._server.server_port
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def shutdown(self) -> None:
        """Take no more scrapes."""
        self._server.shutdown()

    def server_close(self) -> None:
        """Close the port."""
        self._server.server_close()


def _cut(request: socket.socket) -> None:
    try:
        request.shutdown(socket.SHUT_RDWR)
    except OSError:
        return
