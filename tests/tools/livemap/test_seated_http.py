"""Many idle connections and slow posts at the map's server: a page still gets in."""

import asyncio
import socket
from contextlib import suppress

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.routing import Route

from tools.livemap.seated_http import seated

CONNECTIONS, REQUEST_S = 8, 0.4
WAIT_S = 20.0


async def _stop(request: Request) -> PlainTextResponse:
    return PlainTextResponse(str(len(await request.body())))


async def _ask(port: int, body: bytes = b"7") -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    head = f"POST /stop HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Length: {len(body)}\r\n\r\n"
    writer.write(head.encode() + body)
    answer = await asyncio.wait_for(reader.read(), WAIT_S)
    writer.close()
    return answer


async def _gone(reader: asyncio.StreamReader) -> bool:
    with suppress(ConnectionError):
        await asyncio.wait_for(reader.read(), WAIT_S)
    return True


def test_idle_connections_and_slow_posts_keep_no_page_out() -> None:
    async def story() -> None:
        listener = socket.create_server(("127.0.0.1", 0))
        port = listener.getsockname()[1]
        app = Starlette(routes=[Route("/stop", _stop, methods=["POST"])])
        told = {"lifespan": "off", "log_level": "error", "timeout_graceful_shutdown": 1}
        http = seated(CONNECTIONS, REQUEST_S)
        web = uvicorn.Server(uvicorn.Config(app, http=http, **told))  # type: ignore[arg-type]
        serving = asyncio.create_task(web.serve([listener]))
        try:
            idle = [
                await asyncio.open_connection("127.0.0.1", port) for _ in range(5 * CONNECTIONS)
            ]
            assert (await _ask(port)).endswith(b"1"), "a newcomer gets the seat of the oldest"
            slow = await asyncio.open_connection("127.0.0.1", port)
            slow[1].write(b"POST /stop HTTP/1.1\r\nHost: x\r\nContent-Length: 99\r\n\r\nx")
            await slow[1].drain()
            for reader, _ in (*idle, slow):
                assert await _gone(reader)
            assert (await _ask(port, b"x" * 500)).endswith(b"500")
            for _, writer in (*idle, slow):
                writer.close()
        finally:
            web.should_exit = True
            await asyncio.wait_for(serving, WAIT_S)

    asyncio.run(story())
