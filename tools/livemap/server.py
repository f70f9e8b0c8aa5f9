"""The page and its socket: starlette on loopback, nothing from elsewhere, each page a player of its own.

A page may look, and where there is a live bus it may stop the fleet and release it. Other pages of the
browser may not: requests must name this host and come from this origin.
"""

import asyncio
import contextlib
import json
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from sim.recording import Recording
from tools.livemap.panel import Panel, PanelError
from tools.livemap.player import SPEED_MAX, Index, Player
from tools.livemap.teller import Teller

PAGE = Path(__file__).parent / "page"
PICTURES_A_SECOND = 30
READ_SHARE = 0.5  # of the time between two pictures may be spent on reading
INDEX_SHARE = 0.4  # the same for the index, when it is behind
PAGES_MAX = 16
MESSAGE_MAX = 4096  # characters of a request of the page
HOSTS = ("127.0.0.1", "localhost", "[::1]")
SECURITY = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
FILES = {
    "/": ("index.html", "text/html"),
    "/map.css": ("map.css", "text/css"),
    "/map.js": ("map.js", "text/javascript"),
    "/field.js": ("field.js", "text/javascript"),
    "/side.js": ("side.js", "text/javascript"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
}


class OnlyHere:
    """Refuses what another site's page could send, and what a name server could send here."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {
            name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]
        }
        host, origin = headers.get("host", ""), headers.get("origin")
        known = host.rsplit(":", 1)[0] in HOSTS
        if not known or (origin is not None and origin != f"http://{host}"):
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008})
            else:
                await PlainTextResponse("not from here\n", 403)(scope, receive, send)
            return

        async def secured(message: Any) -> None:
            if message["type"] == "http.response.start":
                plain = [(k.encode(), v.encode()) for k, v in SECURITY.items()]
                message["headers"] = [*message["headers"], *plain]
            await send(message)

        await self.app(scope, receive, secured)


class MapServer:
    def __init__(
        self, recording: Recording, title: str, follow: bool, speed: float,
        panel: Panel | None = None,
    ) -> None:  # fmt: skip
        """`panel`: the operator's device of a live bus; none: a recording cannot be stopped."""
        self.recording, self.title, self.panel = recording, title, panel
        self.follow, self.speed = follow, speed
        self.index = Index(recording)
        self.pages = 0
        self.app = OnlyHere(
            Starlette(
                routes=[
                    *(Route(path, self._file) for path in FILES),
                    Route("/stop", self._stop, methods=["POST"]),
                    Route("/reset", self._reset, methods=["POST"]),
                    WebSocketRoute("/ws", self._page),
                ]
            )
        )

    async def keep_index(self) -> None:
        """For as long as the server runs."""
        period_s = 1 / PICTURES_A_SECOND
        while True:
            self.index.work(period_s * INDEX_SHARE)
            await asyncio.sleep(period_s if self.index.complete else period_s * (1 - INDEX_SHARE))

    async def _file(self, request: Request) -> Response:
        name, kind = FILES[request.url.path]
        return FileResponse(PAGE / name, media_type=kind)

    # ---------------------------------------------------------------- looking

    async def _page(self, socket: WebSocket) -> None:
        if self.pages >= PAGES_MAX:
            await socket.close(1013)
            return
        await socket.accept()
        self.pages += 1
        player = Player(self.index, self.follow, self.speed)
        teller = Teller(player)
        telling = asyncio.create_task(self._tell(socket, player, teller))
        try:
            while True:
                text = await socket.receive_text()
                answer = _obey(text, player, teller)
                if answer is not None:
                    await socket.send_text(json.dumps(answer))
        except (WebSocketDisconnect, RuntimeError):
            pass  # the page is gone
        finally:
            self.pages -= 1
            telling.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await telling

    async def _tell(self, socket: WebSocket, player: Player, teller: Teller) -> None:
        loop = asyncio.get_running_loop()
        scene = {
            "kind": "scene", "title": self.title, "live": self.panel is not None,
            "signed": self.panel is not None and self.panel.signed, "scene": self.recording.scene,
        }  # fmt: skip
        await socket.send_text(json.dumps(scene))
        period_s = 1 / PICTURES_A_SECOND
        last_s = next_s = loop.time()
        while True:
            now_s = loop.time()
            player.advance(now_s - last_s, period_s * READ_SHARE)
            last_s = now_s
            await socket.send_text(json.dumps(teller.tell(), separators=(",", ":")))
            next_s = max(next_s + period_s, loop.time())
            await asyncio.sleep(next_s - loop.time())

    # ---------------------------------------------------------------- stopping

    async def _stop(self, request: Request) -> Response:
        """Asks for nothing: a wrong stop costs time, a missing one more."""
        if self.panel is None:
            return JSONResponse({"problem": "a recording cannot be stopped"}, 409)
        return JSONResponse(await self.panel.stop())

    async def _reset(self, request: Request) -> Response:
        if self.panel is None:
            return JSONResponse({"problem": "a recording has nothing to reset"}, 409)
        try:
            wish = json.loads((await request.body())[:MESSAGE_MAX])
            key, keyless, start = wish["key"], wish["keyless"], wish["start"]
            if not isinstance(key, str) or not (key or keyless is True):
                raise PanelError("name the operator's key file, or say that the fleet has no keys")
            return JSONResponse(await self.panel.reset(key, start is True))
        except (ValueError, KeyError, TypeError):
            return JSONResponse({"problem": "not a request of the map's page"}, 400)
        except PanelError as problem:
            return JSONResponse({"problem": str(problem)}, 400)


def _obey(text: str, player: Player, teller: Teller) -> dict[str, Any] | None:
    """What the page asks; what makes no sense is passed over."""
    try:
        wish = json.loads(text[:MESSAGE_MAX])
        match wish["do"]:
            case "pause":
                player.playing, player.follow = False, False
            case "play":
                player.playing = True
            case "speed":
                player.speed = min(max(float(wish["value"]), 0.01), SPEED_MAX)
                player.follow, player.playing = False, True
            case "seek":
                player.follow = False
                player.seek(round(float(wish["t"]) * 1e6))
            case "follow":
                player.follow, player.playing = True, True
            case "robot":
                return teller.robot(int(wish["slot"]))
    except (ValueError, KeyError, TypeError, OverflowError):
        return None
    return None
