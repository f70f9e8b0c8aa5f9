"""Every place in the sources that opens a listening socket has a row with its limits."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tools.cli.socket_limits import NONE, PROBES, SOCKETS, SocketRow, sockets_page

ROOT = Path(__file__).parents[3]
PACKAGES = ("agent", "crdt", "headland", "protocol", "sim", "tools", "examples")
# What opens a socket for others, of asyncio, socket, http.server,
# socketserver, wsgiref, websockets, foxglove, prometheus-client, aiohttp and zenoh.
OPENERS = frozenset((
    "start_server", "create_server", "start_unix_server", "create_unix_server",
    "create_datagram_endpoint", "start_http_server", "start_wsgi_server",
    "HTTPServer", "ThreadingHTTPServer", "TCPServer", "ThreadingTCPServer", "UDPServer",
    "UnixStreamServer", "XMLRPCServer", "TCPSite", "UnixSite", "run_app",
))  # fmt: skip
# Methods whose names others have, too: only of these modules, or on a socket.
OF_MODULES = {"open": ("zenoh",), "serve": ("websockets", "server"), "run": ("uvicorn",)}


def opened(path: Path) -> Iterator[str]:
    """`file function` of each call in a file that opens a socket for others."""
    text = path.read_text(encoding="utf-8")
    tree, name = ast.parse(text), path.relative_to(ROOT).as_posix()
    has_sockets = "socket" in text
    wsgi = "wsgiref" in text  # others have a `make_server`, too

    def walk(node: ast.AST, scope: tuple[str, ...]) -> Iterator[str]:
        for child in ast.iter_child_nodes(node):
            inner = scope
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                inner = (*scope, child.name)
            elif isinstance(child, ast.Call) and opens(child, has_sockets, wsgi):
                yield f"{name} {'.'.join(scope[:2])}"
            yield from walk(child, inner)

    yield from walk(tree, ())


def opens(call: ast.Call, has_sockets: bool, wsgi: bool = False) -> bool:
    if isinstance(call.func, ast.Name):
        return call.func.id in OPENERS or (wsgi and call.func.id == "make_server")
    if not isinstance(call.func, ast.Attribute):
        return False
    attribute, value = call.func.attr, call.func.value
    if attribute in OPENERS:
        return True
    if attribute == "bind":
        return has_sockets and isinstance(value, ast.Name)
    return isinstance(value, ast.Name) and value.id in OF_MODULES.get(attribute, ())


def found() -> set[str]:
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    return {place for path in paths for place in opened(path)}


def test_every_socket_that_is_opened_has_its_row() -> None:
    assert found() == {row.place for row in SOCKETS} | {row.place for row in PROBES}


def test_the_search_finds_what_it_should() -> None:
    hidden = "import socket\nasync def a():\n    await asyncio.start_server(b, 'x', 1)\n"
    hidden += "def c():\n    s.bind(('', 1))\n    zenoh.open(d)\n    ThreadingHTTPServer(e, f)\n"
    calls = [node for node in ast.walk(ast.parse(hidden)) if isinstance(node, ast.Call)]
    assert sum(opens(call, True) for call in calls) == 4


@pytest.mark.parametrize("row", SOCKETS, ids=lambda row: row.place)
def test_each_row_has_its_numbers_and_its_attack(row: SocketRow) -> None:
    path, _, test = row.shown_by.partition("::")
    assert f"def {test}(" in (ROOT / path).read_text(encoding="utf-8")
    for limit in (row.connections, row.length, row.memory, row.time):
        assert limit and (not limit.startswith(NONE) or ":" in limit), "none needs its reason"
    assert row.reason


def test_the_page_has_every_row() -> None:
    assert all(row.what in sockets_page() for row in SOCKETS)
