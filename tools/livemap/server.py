"""The page and its socket: starlette on loopback, nothing from elsewhere, each page a player of its own.

A page may look, and where there is a live bus it may stop the fleet, release it and start it. Other pages
of the browser may not: requests must name this host and come from this origin. Other users of the machine
may not look, release or start: that takes the token of the printed address. A stop takes the token or the
page's own origin. It must work from a page that has lost its token, and a wrong stop only costs time.
"""

import asyncio
import contextlib
import json
from hmac import compare_digest
from math import isfinite
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from sim.files.palette import ROBOTS
from sim.record.recording import Recording
from tools.common.loopback_host import asked_here
from tools.livemap.page_updates import PageUpdates
from tools.livemap.playback import SPEED_MAX, Index, Player
from tools.livemap.stop_panel import Panel, PanelError

PAGE = Path(__file__).parent / "page"
PICTURES_A_SECOND = 30
READ_SHARE = 0.5  # largest share of the time between two pictures that goes into reading
INDEX_SHARE = 0.4  # the same for the index, when it is behind
AHEAD_MAX = 3  # most pictures sent and not yet drawn: a slow page gets fewer, never older ones
PAGES_MAX = 16
MESSAGE_MAX = 4096  # bytes of one message of a page's socket
BODY_MAX = 64 * 1024  # bytes of a POST; the page sends less than 100
PROTOCOL = "headland"  # of the socket; the page offers it with its token as a second one
NO_TOKEN, TOO_MANY, TOO_BIG = 4401, 1013, 1009  # close codes; 4000 to 4999 are for applications
NOT_A_REQUEST = "not a request of the map's page"
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
        if not asked_here(_headers(scope, b"host"), _headers(scope, b"origin")):
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


def _headers(scope: Scope, name: bytes) -> list[str]:
    return [value.decode("latin-1") for key, value in scope["headers"] if key == name]


class MapServer:
    """Serves the page and its assets, and a socket for each page that sends changes and takes stops
    and releases."""

    def __init__(
        self, recording: Recording, title: str, follow: bool, speed: float, token: str,
        panel: Panel | None = None,
    ) -> None:  # fmt: skip
        """`panel`: the operator's device of a live bus; none: a recording cannot be stopped.

        `token`: what a page must know to look, to release and to start.
        """
        self.token = token
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
                    Route("/start", self._start, methods=["POST"]),
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
        offered = socket.scope["subprotocols"]
        named = PROTOCOL if PROTOCOL in offered else None
        await socket.accept(named)  # only after the handshake does a page see why it is closed
        if not any(self._is_token(word) for word in offered):
            await socket.close(NO_TOKEN)
            return
        if self.pages >= PAGES_MAX:
            await socket.close(TOO_MANY, f"{PAGES_MAX} other pages of this map are open")
            return
        self.pages += 1
        player = Player(self.index, self.follow, self.speed)
        teller = PageUpdates(player)
        telling = asyncio.create_task(self._tell(socket, player, teller))
        try:
            while (message := await socket.receive())["type"] == "websocket.receive":
                text = message.get("text") or ""
                if len(text) > MESSAGE_MAX:
                    await socket.close(TOO_BIG)
                    break
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

    async def _tell(self, socket: WebSocket, player: Player, teller: PageUpdates) -> None:
        loop = asyncio.get_running_loop()
        scene = {
            "kind": "scene", "title": self.title, "live": self.panel is not None,
            "signed": self.panel is not None and self.panel.signed,
            "releases": self.panel is not None and self.panel.releases, "scene": self.recording.scene,
            "colours": ROBOTS,
        }  # fmt: skip
        await socket.send_text(json.dumps(scene))
        period_s = 1 / PICTURES_A_SECOND
        last_s = next_s = loop.time()
        while True:
            now_s = loop.time()
            player.advance(now_s - last_s, period_s * READ_SHARE)
            last_s = now_s
            if teller.told - teller.drawn < AHEAD_MAX:
                await socket.send_text(json.dumps(teller.tell(), separators=(",", ":")))
            next_s = max(next_s + period_s, loop.time())
            await asyncio.sleep(next_s - loop.time())

    # ---------------------------------------------------------------- stopping

    def _is_token(self, word: str) -> bool:
        return compare_digest(word.encode(), self.token.encode())

    def _trusted(self, request: Request) -> bool:
        kind, _, word = request.headers.get("authorization", "").partition(" ")
        return kind.lower() == "bearer" and self._is_token(word)

    async def _stop(self, request: Request) -> Response:
        """Asks for nothing but the page's origin: a wrong stop costs time, a missing one more."""
        if "origin" not in request.headers and not self._trusted(request):
            return PlainTextResponse("not from this page\n", 403)
        if self.panel is None:
            return JSONResponse({"problem": "a recording cannot be stopped"}, 409)
        return JSONResponse(await self.panel.stop())

    async def _reset(self, request: Request) -> Response:
        return await self._released(request, reset=True)

    async def _start(self, request: Request) -> Response:
        return await self._released(request, reset=False)

    async def _released(self, request: Request, reset: bool) -> Response:
        """The request says that the fleet has no keys, or this map holds its operator's key."""
        if not self._trusted(request):
            return JSONResponse({"problem": "open the whole address that the map printed"}, 403)
        if self.panel is None:
            return JSONResponse({"problem": "a recording has nothing to release"}, 409)
        try:
            wish = json.loads(await _body(request))
            keyless, start = wish["keyless"] is True, wish.get("start") is True
            return JSONResponse(await self.panel.release(keyless, reset, start or not reset))
        except ClientDisconnect:  # the page went away in the middle of its request
            return PlainTextResponse("", 400)
        except BodyTooBig:
            return JSONResponse({"problem": f"more than {BODY_MAX} bytes"}, 413)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return JSONResponse({"problem": NOT_A_REQUEST}, 400)
        except PanelError as problem:
            return JSONResponse({"problem": str(problem)}, 400)


class BodyTooBig(Exception):
    """More than anything that the page sends."""


async def _body(request: Request) -> bytes:
    """Raises BodyTooBig as soon as it is known, without reading on."""
    told = request.headers.get("content-length", "0")
    if not told.isascii() or not told.isdigit() or len(told) > 9 or int(told) > BODY_MAX:
        raise BodyTooBig
    body = b""
    async for piece in request.stream():
        body += piece
        if len(body) > BODY_MAX:
            raise BodyTooBig
    return body


def _obey(text: str, player: Player, teller: PageUpdates) -> dict[str, Any] | None:
    """What the page asks; what makes no sense is passed over."""
    try:
        wish = json.loads(text)
        match wish["do"]:
            case "pause":
                player.playing, player.follow = False, False
            case "play":
                player.playing = True
            case "speed":
                speed = float(wish["value"])
                if isfinite(speed):
                    player.speed = min(max(speed, 0.01), SPEED_MAX)
                player.follow, player.playing = False, True
            case "seek":
                player.follow = False
                player.seek(round(float(wish["t"]) * 1e6))
            case "follow":
                player.follow, player.playing = True, True
            case "drawn":
                teller.drawn = min(int(wish["count"]), teller.told)
            case "robot":
                return teller.robot(int(wish["slot"]))
            case "why":
                return teller.why(int(wish["section"]))
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None
    return None
