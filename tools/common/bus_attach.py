"""Attaching to a bus as a device that is not a robot: the options of can_logger, one-line errors."""

import asyncio
import logging
import socket
from pathlib import Path
from random import Random

from agent.runtime.files.given_file import SETTINGS_BYTES_MAX, GivenFileError, read_json
from protocol.links.bus import CanBus, open_bus
from protocol.links.socketcand_link import ANSWER_S, SocketcandLink
from tools.common.process_identity import lives

LAUNCH = Path("runs/launch/bus.json")  # where a launch leaves the address of its bus
CHANNEL = "can0"  # of the bus of a launch
Attached = tuple[str, str, int, str, int]  # interface, channel, bit rate, host, port
REACH_S = 2.0  # a server on this or the next machine answers within milliseconds
# What python-can logs when an interface cannot be opened, it also raises: one line is enough.
logging.getLogger("can").addHandler(logging.NullHandler())


class AttachError(Exception):
    """One line for the person: what is wrong and what to do."""


def address_of_launch() -> tuple[str, int, str]:
    """Host, port and channel of the newest launch in this folder. Raises AttachError if there is
    none, or if it has ended."""
    try:
        where = read_json(LAUNCH, SETTINGS_BYTES_MAX)
        host, port, channel = str(where["host"]), int(where["port"]), str(where["channel"])
        pid, since = int(where["pid"]), str(where.get("started", ""))
    except (GivenFileError, TypeError, ValueError, KeyError, AttributeError):
        raise AttachError(
            f"no bus given and no launch found in {LAUNCH.parent}: "
            "start one with 'headland launch', or name a bus with -i and -c"
        ) from None
    if not lives(pid, since):
        raise AttachError(
            f"the launch in {LAUNCH.parent} was killed (process {pid} is gone): start it again, or name "
            f"its bus if that still runs: --port {port}"
        )
    return host, port, channel


def robots_of_launch(interface: str, host: str, port: int) -> list[int]:
    """Slots of the robots of the newest launch in this folder, where the bus is that launch's."""
    try:
        where = read_json(LAUNCH, SETTINGS_BYTES_MAX)
        same = port == 0 or (host == where["host"] and port == where["port"])
        robots = [int(slot) for slot in where["robots"]]
    except (ValueError, KeyError, TypeError):  # of them GivenFileError
        return []
    return robots if interface == "socketcand" and same else []


def scenario_of_launch(interface: str, host: str, port: int) -> str | None:
    """The scenario of the newest launch in this folder, as a tool here can load it; None: another bus."""
    try:
        where = read_json(LAUNCH, SETTINGS_BYTES_MAX)
        same = port == 0 or (host == where["host"] and port == where["port"])
        scenario = str(where["scenario"])
    except (ValueError, KeyError, TypeError):  # of them GivenFileError
        return None
    return scenario if interface == "socketcand" and same else None


def folder_of_launch(interface: str, host: str, port: int) -> Path | None:
    """The folder of the newest launch here, where the bus is that launch's; None: another bus."""
    try:
        where = read_json(LAUNCH, SETTINGS_BYTES_MAX)
        same = port == 0 or (host == where["host"] and port == where["port"])
        folder = Path(str(where["folder"]))
    except (ValueError, KeyError, TypeError):  # of them GivenFileError
        return None
    return folder if interface == "socketcand" and same else None


def absolute(scenario: str) -> str:
    """The name of a scenario as another process can load it: a file by its absolute path."""
    path = Path(scenario)
    return str(path.absolute()) if path.exists() else scenario


async def keep_attached(channel: str, host: str, port: int, seed: str) -> SocketcandLink:
    """A socketcand bus that is attached again by itself when its server comes back.

    Raises AttachError where there is none now.
    """
    if port == 0:
        host, port, channel = address_of_launch()
    _reach(host, port)
    link = SocketcandLink(host, port, channel, Random(seed))
    try:
        async with asyncio.timeout(ANSWER_S):
            await link.up()
    except TimeoutError:
        link.close()
        raise AttachError(f"{host}:{port} is no socketcand server with a bus {channel}") from None
    return link


def attach(interface: str, channel: str, bitrate: int, host: str, port: int) -> CanBus:
    """Open the bus. Raises AttachError. Needs a running event loop."""
    options: dict[str, object] = {}
    if interface == "socketcand":
        if port == 0:
            host, port, channel = address_of_launch()
        options = {"host": host, "port": port}
        _reach(host, port)
    try:
        return open_bus(interface, channel, bitrate, **options)
    except Exception as problem:  # python-can interfaces raise what they like
        where = f"{host}:{port}" if interface == "socketcand" else channel
        reason = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
        raise AttachError(f"cannot open {interface} at {where}: {reason}") from None


def _reach(host: str, port: int) -> None:
    """python-can tries a closed port for ten seconds and prints each try; one try is enough here."""
    try:
        socket.create_connection((host, port), REACH_S).close()
    except (OSError, OverflowError) as problem:
        raise AttachError(
            f"cannot open socketcand at {host}:{port}: {problem}; is a launch running there?"
        ) from None
