"""Attaching to a bus as a device that is not a robot: the options of can_logger, one-line errors."""

import asyncio
import logging
import socket
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from random import Random
from typing import Any, Final, TypeVar

from protocol.links.bus import CanBus, open_bus
from protocol.links.socketcand_link import ANSWER_S, SocketcandLink
from tools.common.bus_address import AttachError, address_of_launch

GREETING = b"< hi >"  # of a socketcand server, before anything else
READ_TOGETHER: Final = (
    "< ok >< frame"  # in what python-can says of an answer with a frame behind it
)
OPEN_TRIES: Final = 5
SILENT = "does not answer: a server that hangs, or no socketcand server"
LOST_LOOK_S: Final = 0.5
REACH_S = 2.0  # a server on this or the next machine answers within milliseconds
T = TypeVar("T")
# What python-can logs when an interface cannot be opened, it also raises: one line is enough.
logging.getLogger("can").addHandler(logging.NullHandler())


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


async def stay_attached(
    interface: str, channel: str, bitrate: int, host: str, port: int, seed: str
) -> CanBus | SocketcandLink:
    """The bus of a program that runs until it is ended. python-can's client of socketcand takes a whole
    core once its server has ended, and hears nothing of the next one. Raises AttachError."""
    if interface == "socketcand":
        return await keep_attached(channel, host, port, seed)
    return attach(interface, channel, bitrate, host, port)


def lost_of(*buses: object) -> str | None:
    """Why one of these interfaces does not come back by itself; None: all are there, or may come back. A
    link of socketcand renews its own."""
    for bus in buses:
        if isinstance(bus, CanBus) and bus.lost is not None:
            return bus.lost
    return None


def connections_of(bus: object) -> int:
    """How often a bus began to hear others; of something else 0.

    A tool has missed what was said before each, and no robot says it again unasked."""
    return bus.connections if isinstance(bus, SocketcandLink | CanBus) else 0


async def while_attached(work: Coroutine[Any, Any, T], *buses: object) -> T:
    """What `work` returns. When one of these interfaces is gone for good, ends the work and raises
    AttachError: a program that went on would be deaf, and nobody would know."""
    working = asyncio.ensure_future(work)
    try:
        while not working.done():
            await asyncio.wait({working}, timeout=LOST_LOOK_S)
            why = lost_of(*buses)
            if why is not None and not working.done():
                raise AttachError(why)
        return working.result()
    finally:
        working.cancel()
        await asyncio.gather(working, return_exceptions=True)


def attach(interface: str, channel: str, bitrate: int, host: str, port: int) -> CanBus:
    """Open the bus. Raises AttachError. Needs a running event loop."""
    options: dict[str, Any] = {}
    if interface == "socketcand":
        if port == 0:
            host, port, channel = address_of_launch()
        options = {"host": host, "port": port}
        _reach(host, port, greets=True)
    try:
        with _answers_within(REACH_S if interface == "socketcand" else None):
            return _opened(interface, channel, bitrate, options)
    except TimeoutError:
        raise AttachError(f"{host}:{port} {SILENT}") from None
    except Exception as problem:  # python-can interfaces raise what they like
        where = f"{host}:{port}" if interface == "socketcand" else channel
        reason = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
        raise AttachError(f"cannot open {interface} at {where}: {reason}") from None


def _opened(interface: str, channel: str, bitrate: int, options: dict[str, Any]) -> CanBus:
    """The bus. python-can takes the server's last answer for wrong if it reads a frame with it, which a
    busy machine makes likely. Then nothing is wrong but the moment."""
    from can import CanError

    for left in reversed(range(OPEN_TRIES)):
        try:
            return open_bus(interface, channel, bitrate, **options)
        except CanError as problem:
            if not left or READ_TOGETHER not in str(problem):
                raise
    raise AssertionError("the last try returns or raises")


@contextmanager
def _answers_within(limit_s: float | None) -> Iterator[None]:
    """python-can waits without a limit for the answers of a socketcand server, and for its reading, and
    has no option for that. A socket that is made meanwhile keeps the limit. None: there is none."""
    before_s = socket.getdefaulttimeout()
    socket.setdefaulttimeout(limit_s)
    try:
        yield
    finally:
        socket.setdefaulttimeout(before_s)


def _reach(host: str, port: int, greets: bool = False) -> None:
    """python-can tries a closed port for ten seconds and prints each try; one try is enough here.

    `greets`: wait for the greeting, too. python-can waits for it without a limit, and a server that
    hangs accepts connections."""
    try:
        with socket.create_connection((host, port), REACH_S) as link:
            if greets and not link.recv(len(GREETING)):
                raise AttachError(
                    f"{host}:{port} is no socketcand server: it closed the connection"
                )
    except TimeoutError:
        raise AttachError(f"{host}:{port} {SILENT}") from None
    except (OSError, OverflowError, UnicodeError) as problem:
        raise AttachError(
            f"cannot open socketcand at {host}:{port}: {problem}; is a launch running there?"
        ) from None
