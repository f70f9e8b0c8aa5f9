"""`headland map`: the fleet in a browser, from a live bus, a launch, or a recording of either."""

import asyncio
import contextlib
import secrets
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from agent.runtime.files.given_file import (
    REPORT_BYTES_MAX,
    GivenFileError,
    read_json,
)
from agent.runtime.files.key_file import OPERATOR, KeyFileError, read
from agent.runtime.gc_tuning import freeze_gc
from protocol.frames.frame import Frame
from protocol.links.bus import CanBus
from protocol.links.socketcand_link import SocketcandLink
from sim.files.strict_json import dumps
from sim.record.live_recording import LiveRecording
from sim.record.mcap_log import MCAP, McapMissing, add_notes, read_recording
from sim.record.recording import Recording
from sim.record.scene import Scene, drawable, in_folder
from tools.common.bus_address import LAUNCH, AttachError, robots_of_launch
from tools.common.bus_attach import stay_attached, while_attached
from tools.common.exit_codes import wrong
from tools.common.running_launch import RunningLaunch, running_launch, watch_intents
from tools.inspect.bus_load import BIT_RATE
from tools.inspect.log_frames import NO_LOG, SourceError, columns_of
from tools.inspect.measured_inspector import MeasuredInspector
from tools.inspect.metrics_address import MetricsAddress, MetricsError, metrics_address
from tools.livemap.foxglove_port import PortTaken, check_port
from tools.livemap.stop_panel import Panel
from tools.operate.estop import stop_keys

if TYPE_CHECKING:
    from tools.livemap.foxglove_live import FoxgloveFeed
    from tools.livemap.server import MapServer

Heard = Callable[[float, Frame], None]  # seconds of the loop's clock
HOST = "127.0.0.1"  # not visible from other machines; there is no option for that
RECORDED_SPEED = 10.0
TOKEN_BYTES = 16  # 128 bits: not to be guessed
NO_SERVER = "the map needs the operator extra: pip install 'headland[operator]'"


def show_map(
    source: Path | None, interface: str, channel: str, bitrate: int, host: str, port: int,
    keys: Path | None, scenario: str | None, page_port: int, as_json: bool,
    speed: float = RECORDED_SPEED, operator_key: Path | None = None, metrics: str | None = None,
    foxglove: int | None = None,
) -> int:  # fmt: skip
    """Serve the map until Ctrl-C, and return the exit code of the command: 2 where the source, the
    bus or the port is wrong.

    `speed`: of a recording, as a factor of real time; 0: the usual one. `operator_key`: the file by which
    the page may release a fleet with keys. `metrics`: PORT or HOST:PORT of figures for Prometheus.
    `foxglove`: a port for viewers.
    """
    try:
        scene = None if scenario is None else scene_named_by(scenario)
        launch = None
        if interface == "socketcand" and port == 0:
            launch = running_launch(LAUNCH if source is None else source / LAUNCH.name)
        with contextlib.closing(listen(page_port)) as listener:
            if source is None or launch is not None:
                where = (interface, channel, bitrate, host, port)
                own = KeyFiles(keys, operator_key)
                served = None if metrics is None else metrics_address(metrics)
                if foxglove is not None:
                    check_port(foxglove)
                return _live(scene, launch, where, own, listener, as_json, served, foxglove)
            live = {
                "--metrics": metrics, "--foxglove": foxglove, "--keys": keys,
                "--operator-key": operator_key,
            }  # fmt: skip
            if given := [option for option, value in live.items() if value is not None]:
                raise MetricsError(f"{', '.join(given)}: of a live bus; a recording has no present")
            with _reading(source, as_json):
                recording = recorded(source, scene)
            server = make_server(recording, str(source), False, speed or RECORDED_SPEED)
            _announce(as_json, url_of(listener, server))
            asyncio.run(serve(server, listener))
    except (
        AttachError, SourceError, McapMissing, ServerError, MetricsError,
        PortTaken,
    ) as problem:  # fmt: skip
        return wrong(problem)
    return 0


def check_operator_key(path: Path | None) -> None:
    """Raises AttachError: what is wrong with the file is said before anybody relies on it."""
    try:
        if path is not None:
            read(path, OPERATOR)
    except KeyFileError as problem:
        raise AttachError(f"--operator-key {problem}") from None


class ServerError(Exception):
    """One line for the person."""


def make_server(
    recording: Recording, title: str, follow: bool, speed: float, panel: Panel | None = None
) -> "MapServer":
    """A server of the map with a new token. `speed`: of a recording, a factor of real time. Raises
    ServerError if starlette or uvicorn is not installed."""
    try:
        from tools.livemap.server import MapServer
    except ImportError:
        raise ServerError(NO_SERVER) from None
    return MapServer(recording, title, follow, speed, secrets.token_urlsafe(TOKEN_BYTES), panel)


def listen(port: int) -> socket.socket:
    """A socket on loopback; raises ServerError where it is taken."""
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
        listener.listen()
    except OSError as problem:
        listener.close()
        raise ServerError(
            f"--page-port {port}: {problem.strerror}; choose another, or 0 for any free one"
        ) from None
    return listener


def url_of(listener: socket.socket, server: "MapServer") -> str:
    """With the token behind the #: browsers keep that part to themselves."""
    return f"http://{HOST}:{listener.getsockname()[1]}/#{server.token}"


def _announce(as_json: bool, url: str, **more: str | None) -> None:
    others = {name: address for name, address in more.items() if address}
    if as_json:
        print(dumps({"map": url, **others}), flush=True)
        return
    print(f"map: {url}   (Ctrl-C ends it)", flush=True)
    for name, address in others.items():
        print(f"{name}: {address}", flush=True)


def _reading(source: Path, as_json: bool) -> AbstractContextManager[object]:
    """Says at a terminal that a long recording is being read."""
    from rich.console import Console  # a tenth of the map's start; a live bus does without
    from rich.markup import escape

    return Console(stderr=as_json).status(escape(f"reading {source}"))


async def serve(server: "MapServer", listener: socket.socket) -> None:
    """Until Ctrl-C, or the task is cancelled."""
    import uvicorn

    from tools.livemap.seated_http import seated
    from tools.livemap.server import MESSAGE_MAX

    config = uvicorn.Config(
        server.app, log_level="warning", lifespan="off", ws_per_message_deflate=False,
        access_log=False, timeout_graceful_shutdown=1, ws_max_size=MESSAGE_MAX,
        http=seated(),
    )  # fmt: skip
    index = asyncio.create_task(server.keep_index())
    web = uvicorn.Server(config)
    freeze_gc()  # the page presses stops, too
    try:
        await web.serve([listener])
    finally:
        index.cancel()
        listener.close()


class MapThread:
    """The map beside a run in virtual time, which has the main thread for itself."""

    def __init__(self, recording: Recording, title: str, page_port: int) -> None:
        """Raises ServerError."""
        self.server = make_server(recording, title, True, RECORDED_SPEED)
        self.listener = listen(page_port)
        self.url = url_of(self.listener, self.server)
        self._thread = threading.Thread(target=self._run, daemon=True, name="map")
        self._thread.start()

    def _run(self) -> None:
        asyncio.run(serve(self.server, self.listener))

    def join(self) -> None:
        """Until Ctrl-C."""
        with contextlib.suppress(KeyboardInterrupt):
            self._thread.join()


# -------------------------------------------------------------------- recordings


def recorded(source: Path, scene: Scene | None, notes: bool = True) -> Recording:
    """Of a run folder or any log; its intents and things only with `notes`. Raises SourceError and
    McapMissing."""
    path = source / MCAP if source.is_dir() and not (source / "can.log").is_file() else source
    if not path.exists():
        raise SourceError(f"{source}: {NO_LOG}")
    with _one_line(source):
        if path.suffix == ".mcap":
            recording = read_recording(path, notes)
        else:
            recording = Recording(scene_beside(source))
            for columns in columns_of(source):
                recording.extend(columns)
            if notes:
                _note(recording, source)
    recording.scene = scene or recording.scene
    recording.close()
    return recording


def recorded_notes(source: Path) -> Recording:
    """What `recorded` leaves out without notes. Raises SourceError and McapMissing."""
    recording = Recording()
    with _one_line(source):
        _note(recording, source)
    return recording


def _note(recording: Recording, source: Path) -> None:
    path = notes_file(source)
    if path.is_file():
        add_notes(recording, path)


def notes_file(source: Path) -> Path:
    """Where a recording has what does not go over the bus."""
    if source.suffix == ".mcap" and not source.is_dir():
        return source
    return (source if source.is_dir() else source.parent) / MCAP


@contextlib.contextmanager
def _one_line(source: Path) -> Iterator[None]:
    try:
        yield
    except ValueError as problem:
        raise SourceError(f"{source}: {problem}") from None
    except OSError as problem:
        raise SourceError(f"{source}: cannot be read: {problem.strerror}") from None


def scene_named_by(scenario: str) -> Scene:
    """Raises SourceError. Only here the map and the node of ROS 2 need the simulator's packages."""
    from sim.record.scene_builder import scene_named
    from sim.scenarios.scenario import ScenarioError

    try:
        return scene_named(scenario)
    except ScenarioError as problem:
        raise SourceError(str(problem)) from None


def scene_beside(source: Path) -> Scene | None:
    """The scene that a run has left in its folder, or beside its log; None: none that can be drawn."""
    try:
        return drawable(read_json(in_folder(source), REPORT_BYTES_MAX))
    except GivenFileError:
        return None


# -------------------------------------------------------------------- live


class KeyFiles(NamedTuple):
    """Files of the person who starts the map; None: the fleet has no keys, or it may only be stopped."""

    panel: Path | None  # --keys
    operator: Path | None  # --operator-key


def _live(
    scene: Scene | None, launch: RunningLaunch | None, where: tuple[str, str, int, str, int],
    keys: KeyFiles, listener: socket.socket, as_json: bool,
    served: MetricsAddress | None, foxglove: int | None,
) -> int:  # fmt: skip
    if launch is not None and keys == KeyFiles(None, None):
        keys = KeyFiles(launch.keys, launch.keys)
    stopping = stop_keys(keys.panel)
    check_operator_key(keys.operator)
    interface, channel, bitrate, host, port = where
    if launch is not None:
        host, port, channel = launch.host, launch.port, launch.channel
        scene = scene or scene_beside(launch.folder)
    title = f"launch {host}:{port}" if interface == "socketcand" else f"{interface} {channel}"

    async def run() -> None:
        bus = await stay_attached(interface, channel, bitrate, host, port, "map")
        robots = robots_of_launch(interface, host, port, keys.panel)
        recording, panel = LiveRecording(scene), Panel(bus, stopping, keys.operator, robots)
        loop = asyncio.get_running_loop()
        recording.follow(lambda: round(loop.time() * 1e6))
        server = make_server(recording, title, True, 1.0, panel)
        with (
            _metrics(served, scene) as (metrics, count),
            _viewers(foxglove, scene, panel, server.token) as feed,
            _hearing(bus, recording, panel, [h for h in (count, feed and feed.hear) if h]),
        ):
            beside = [asyncio.create_task(panel.keep_asking())]
            if launch is not None and launch.bodies is not None:
                intend = _intents_to(recording, feed)
                beside.append(asyncio.create_task(watch_intents(launch.bodies, intend)))
            seen_at = None if feed is None else feed.url
            own = url_of(listener, server)
            _announce(as_json, own, metrics=metrics, foxglove=seen_at)
            try:
                await while_attached(serve(server, listener), bus)
            finally:
                for task in beside:
                    task.cancel()

    asyncio.run(run())
    return 0


@contextlib.contextmanager
def _metrics(
    served: MetricsAddress | None, scene: Scene | None
) -> Iterator[tuple[str | None, Heard | None]]:
    """Figures for Prometheus, at the URL, of the frames that are passed on; None: not asked for. Raises
    MetricsError."""
    if served is None:
        yield None, None
        return
    from tools.inspect.prometheus_metrics import FleetCollector, MetricsServer

    clock = asyncio.get_running_loop().time
    known = scene or {}
    inspector = MeasuredInspector(
        frozenset(int(section["id"]) for section in known.get("sections", ())),
        int(known.get("bitrate", BIT_RATE)),
    )
    server = MetricsServer(served)
    FleetCollector(inspector, clock, server.registry)
    url = server.start()
    try:
        yield url, inspector.hear
    finally:
        server.close()


@contextlib.contextmanager
def _viewers(
    port: int | None, scene: Scene | None, panel: Panel, token: str
) -> Iterator["FoxgloveFeed | None"]:
    """A feed for viewers; None: not asked for. `token`: of the page, and of the services. Raises
    PortTaken."""
    if port is None:
        yield None
        return
    from tools.livemap.foxglove_live import start_feed
    from tools.livemap.foxglove_services import services_of

    feed = start_feed(scene, port, services_of(panel, token))
    try:
        yield feed
    finally:
        feed.close()


@contextlib.contextmanager
def _hearing(
    bus: CanBus | SocketcandLink, recording: Recording, panel: Panel, listeners: Sequence[Heard]
) -> Iterator[None]:
    loop = asyncio.get_running_loop()

    def heard(frame: Frame) -> None:
        now_s = loop.time()
        recording.write(round(now_s * 1e6), frame)
        panel.hear(now_s, frame)
        for hear in listeners:
            hear(now_s, frame)

    bus.subscribe(heard)
    try:
        yield
    finally:
        bus.close()


def _intents_to(
    recording: Recording, feed: "FoxgloveFeed | None"
) -> Callable[[dict[str, Any]], None]:
    """What takes the intents of robots: the recording, and viewers."""
    loop = asyncio.get_running_loop()

    def intend(intent: dict[str, Any]) -> None:
        recording.tell(round(loop.time() * 1e6), intent)
        if feed is not None:
            feed.intend(loop.time(), intent)

    return intend
