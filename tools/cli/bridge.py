"""`headland bridge`: a gateway between a bus and the rest of the fleet, over Eclipse Zenoh.

Start two or more on a segment: one leads, all carry stops, and another leads when that one dies. A
gateway on a socketcand bus is back by itself when the server of that bus is. In a fleet with keys it
needs the file of panels to pass on work, and reads it again when it has changed.
"""

import asyncio
import secrets
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agent.interface.ports import Bus
from agent.runtime.end_signals import on_end
from agent.runtime.files.given_file import SETTINGS_BYTES_MAX, read_toml
from agent.runtime.gateway_runner import GatewayRunner
from agent.runtime.gc_tuning import freeze_gc
from agent.segments.gateway import Gateway, Publish
from agent.segments.map_relay import MapRelay
from agent.segments.segment_area import Area, SegmentPlace
from crdt.allocation import SECTION_MAX
from protocol.backbone_messages import BackboneKind
from protocol.controller_health import Health
from protocol.frames.segment_frames import SEGMENT_MAX
from protocol.links.zenoh_link import LinkError, ZenohBus, ZenohLink, configure
from protocol.name import GATEWAY_FUNCTION, Name
from sim.files.strict_json import dumps
from tools.common.bus_address import AttachError
from tools.common.bus_attach import attach, keep_attached, while_attached
from tools.common.exit_codes import wrong
from tools.common.panel_keys import PanelKeys
from tools.inspect.metrics_address import MetricsAddress, MetricsError, metrics_address

if TYPE_CHECKING:
    from tools.inspect.prometheus_metrics import MetricsServer

NOT_IN_NAMES = "/*$?#"  # Zenoh reads them as levels of a key, or as patterns of other fleets' names
TELL_S = 5.0  # a status line this often


class ZenohBackbone:
    """One segment's end of the backbone. Keys: headland/FLEET/SEGMENT/KIND[/TARGET]."""

    def __init__(self, link: ZenohLink, fleet: str, segment: int) -> None:
        self.link, self.fleet, self.segment = link, fleet, segment
        self.sent = 0

    def publish(self, message: Publish) -> None:
        """Send a message to the other segments. Stops and resets overtake everything else."""
        self.sent += 1
        target = f"/{message.target}" if message.target else ""
        key = f"headland/{self.fleet}/{self.segment}/{message.kind.name.lower()}{target}"
        self.link.put(key, message.data, message.kind in (BackboneKind.STOPS, BackboneKind.RESETS))

    def subscribe(self, callback: Callable[[bytes], None]) -> None:
        """Call `callback` with each message that is meant for all segments, or for this one."""

        def key(kind: BackboneKind) -> str:
            return f"headland/{self.fleet}/*/{kind.name.lower()}"

        for kind in (BackboneKind.STOPS, BackboneKind.RESETS):
            self.link.subscribe(key(kind), callback, keep=True)
        for kind in (BackboneKind.SUMMARY, BackboneKind.MAP):
            self.link.subscribe(key(kind), callback)
        self.link.subscribe(f"{key(BackboneKind.WORK)}/{self.segment}", callback)

    def close(self) -> None:
        """Leave the backbone: nothing is sent or received any more."""
        self.link.close()


def read_area(segment: int, file: Path | None) -> Area:
    """A TOML file of the borders; none: a segment that shares no section. Raises AttachError.

    home = 40                                       # sections 0 to 39 are this segment's
    lent = [{ section = 39, to = [2] }]             # shared with segment 2
    borrowed = [{ section = 40, of = 2, there = 0 }]  # here 40, at its home, segment 2, section 0
    """
    if not 1 <= segment <= SEGMENT_MAX:
        raise AttachError(f"--segment {segment}: a number from 1 to {SEGMENT_MAX}")
    if file is None:
        return Area(segment, 0)
    try:
        told = _known(read_toml(file, SETTINGS_BYTES_MAX), "home", "lent", "borrowed")
        home = _number(told.get("home", 0), 0, SECTION_MAX)
        return Area(segment, home, _lent(told, segment, home), _borrowed(told, segment))
    except (ValueError, KeyError, TypeError, AssertionError) as problem:
        raise AttachError(f"{file} does not describe an area: {problem}") from None


def _lent(told: dict[str, Any], segment: int, home: int) -> dict[int, frozenset[int]]:
    """A section may have several rows. Raises ValueError, KeyError or TypeError."""
    lent: dict[int, frozenset[int]] = {}
    for said in told.get("lent", ()):
        row = _known(said, "section", "to")
        section = _section(row["section"])
        if section >= home:
            raise ValueError(f"section {section} is lent, and home is {home}")
        others = frozenset(_other(each, segment) for each in row["to"])
        lent[section] = lent.get(section, frozenset()) | others
    return lent


def _borrowed(told: dict[str, Any], segment: int) -> dict[int, SegmentPlace]:
    """Raises ValueError, KeyError or TypeError."""
    borrowed: dict[int, SegmentPlace] = {}
    for said in told.get("borrowed", ()):
        row = _known(said, "section", "of", "there")
        section = _section(row["section"])
        place = SegmentPlace(_other(row["of"], segment), _section(row["there"]))
        if section in borrowed:
            raise ValueError(f"section {section} is borrowed twice")
        if place in borrowed.values():
            raise ValueError(
                f"section {place.section} of segment {place.segment} is borrowed twice"
            )
        borrowed[section] = place
    return borrowed


def _known(said: Any, *names: str) -> dict[str, Any]:
    """A table that has no other names, which would count for nothing. Raises ValueError."""
    if not isinstance(said, dict):
        raise ValueError(f"{said} is not a table of {', '.join(names)}")
    for name in said:
        if name not in names:
            raise ValueError(f"{name} is none of {', '.join(names)}")
    return said


def _number(said: Any, least: int, greatest: int) -> int:
    """A number that the messages of the backbone can carry. Raises ValueError."""
    if type(said) is not int:
        raise ValueError(f"{said} is no whole number")
    if not least <= said <= greatest:
        raise ValueError(f"{said} is not from {least} to {greatest}")
    return said


def _section(said: Any) -> int:
    return _number(said, 0, SECTION_MAX)


def _other(said: Any, segment: int) -> int:
    """The number of another segment. Raises ValueError."""
    number = _number(said, 1, SEGMENT_MAX)
    if number == segment:
        raise ValueError(f"segment {segment} shares no section with itself")
    return number


def read_map(segment: int, arena: str, now_us: int) -> MapRelay | None:
    """The map of an arena that all segments explore. Raises AttachError."""
    if not arena:
        return None
    from sim.scenarios.exploration_scenario import ExplorationSetup, load_arena
    from sim.scenarios.scenario import ScenarioError

    try:
        setting = ExplorationSetup(load_arena(arena))
    except ScenarioError as problem:
        raise AttachError(f"--arena: {problem}") from None
    return MapRelay(segment, setting.geometry, setting.order, now_us)


async def open_bus_of(
    interface: str, channel: str, bitrate: int, host: str, port: int, link: ZenohLink, key: str
) -> Bus:
    """A CAN bus, or for `-i zenoh` the one that robots on the backbone share."""
    if interface == "zenoh":
        return ZenohBus(link, key)
    if interface == "socketcand":
        return await keep_attached(channel, host, port, key)
    return attach(interface, channel, bitrate, host, port)


async def carry(
    area: Area, bus: Bus, backbone: ZenohBackbone, as_json: bool, seconds: float | None, arena: str,
    served: MetricsAddress | None = None, keys: PanelKeys | None = None,
) -> None:  # fmt: skip
    """Until a signal, or for the given time."""
    loop = asyncio.get_running_loop()
    end = asyncio.Event()
    on_end(loop, end.set)
    if seconds is not None:
        loop.call_later(seconds, end.set)

    def now_us() -> int:
        return round(loop.time() * 1e6)

    boot = secrets.randbits(32)
    name = Name(boot & 0x1FFFFF, function=GATEWAY_FUNCTION, arbitrary_address=0)
    chart = read_map(area.segment, arena, now_us())
    gateway = Gateway(area, name, boot, now_us(), chart, None if keys is None else keys.keys)

    def at(t_us: int, call: Callable[[], None]) -> asyncio.TimerHandle:
        return loop.call_at(t_us / 1e6, call)

    runner = GatewayRunner(gateway, bus, backbone, now_us, at)
    freeze_gc()

    def told() -> dict[str, Any]:
        return {**gateway.status(now_us()), "bus": bus.health.name}

    metrics = None if served is None else _metrics_of(told, served)
    runner.start()
    try:
        await _tell(gateway, told, keys, as_json, end, now_us)
    finally:
        runner.stop()
        if metrics is not None:
            metrics.close()


async def _tell(
    gateway: Gateway, told: Callable[[], dict[str, Any]], keys: PanelKeys | None, as_json: bool,
    end: asyncio.Event, now_us: Callable[[], int],
) -> None:  # fmt: skip
    """A line of status whenever there is news, and new keys when their file has changed."""
    shown: object = None
    while not end.is_set():
        renewed = None if keys is None else keys.renewed()
        if renewed is not None:
            gateway.rekey(renewed, now_us())
        status = told()
        news = (status["number"], status["leads"], status["reached"], status["bus"])
        if news != shown:
            shown = news
            print(dumps(status) if as_json else _line(status), flush=True)
        try:
            await asyncio.wait_for(end.wait(), 0.2)
        except TimeoutError:
            continue


def _metrics_of(status: Callable[[], dict[str, Any]], served: MetricsAddress) -> "MetricsServer":
    from tools.inspect.prometheus_metrics import GatewayCollector, MetricsServer

    server = MetricsServer(served)
    GatewayCollector(status, server.registry)
    print(f"metrics: {server.start()}", file=sys.stderr, flush=True)
    return server


def _line(status: dict[str, Any]) -> str:
    if status["number"] is None:
        return f"segment {status['segment']}: listening who is there"
    if status["bus"] != Health.ACTIVE.name:
        return f"segment {status['segment']}: its bus is {status['bus']}; it is tried again"
    role = "leads" if status["leads"] else "stands by"
    reached = ", ".join(map(str, status["reached"])) or "none: this segment is alone"
    return f"segment {status['segment']}: gateway {status['number']} {role}; reaches {reached}"


def bridge(
    segment: int, interface: str, channel: str, bitrate: int, host: str, port: int, fleet: str,
    connect: list[str], listen: list[str], mode: str, config: Path | None, area: Path | None,
    seconds: float | None, as_json: bool, arena: str = "", metrics: str | None = None,
    keys: Path | None = None,
) -> int:  # fmt: skip
    """The exit code of `headland bridge`: 0 after `seconds` or Ctrl-C, 2 where bus, backbone or
    area are wrong."""

    async def run() -> None:
        if not connect and not listen and config is None:
            raise AttachError("name the backbone: --zenoh tcp/HOST:PORT, or --listen tcp/HOST:PORT")
        if not fleet or any(sign in NOT_IN_NAMES for sign in fleet):
            raise AttachError(f"--fleet {fleet!r}: a name without any of {NOT_IN_NAMES}")
        served = None if metrics is None else metrics_address(metrics)
        place, own = read_area(segment, area), None if keys is None else PanelKeys(keys)
        link = ZenohLink(configure(connect, listen, mode, config), asyncio.get_running_loop())
        key = f"headland/{fleet}/{segment}/bus"
        bus = await open_bus_of(interface, channel, bitrate, host, port, link, key)
        backbone = ZenohBackbone(link, fleet, segment)
        carrying = carry(place, bus, backbone, as_json, seconds, arena, served, own)
        await while_attached(carrying, bus)

    try:
        asyncio.run(run())
    except (AttachError, LinkError, MetricsError) as problem:
        return wrong(problem)
    return 0
