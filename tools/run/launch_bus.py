"""The bus of a launch: a hub of its own, or one that runs as `headland hub` and may come and go."""

import asyncio
import os
from collections.abc import Callable
from random import Random
from typing import Protocol

from protocol.frames.frame import Frame
from protocol.links.socketcand_link import ANSWER_S, SocketcandLink
from sim.can.simulated_bus import FieldBus, forget, segment
from sim.can.socketcand_beacon import announce
from sim.can.socketcand_server import Hub
from tools.common.bus_address import CHANNEL

Tap = Callable[[int, Frame], None]  # microseconds of the monotonic clock, as the event loop's


def viewer_command(host: str, port: int) -> str:
    """What shows the frames of the bus at a terminal; python-can from 4.6 takes it."""
    return f"python -m can.viewer -i socketcand -c {CHANNEL} --bus-kwargs host={host} port={port}"


class LaunchBus(Protocol):
    """What a launch needs of its bus, whichever process has it."""

    port: int
    taps: list[Tap]  # get every frame, ours too

    async def start(self, taps: list[Tap]) -> None:
        """Raises OSError."""
        ...

    def say(self, frame: Frame) -> None:
        """Send a frame as a device of the launch."""

    async def stop(self) -> None:
        """Leave the bus, or end it."""


class OwnHub:
    """A hub within the process of the launch, announced by its beacon."""

    def __init__(self, host: str, port: int, bitrate: int, seed: int) -> None:
        self.host, self.port = host, port
        self.wire = segment(f"launch {os.getpid()}", bitrate, seed)
        self.hub = Hub(self.wire, CHANNEL)
        self.taps = self.wire.taps
        self._desk: FieldBus | None = None
        self._beacon: asyncio.Task[None] | None = None

    async def start(self, taps: list[Tap]) -> None:
        """Open the port and begin to announce it. Raises OSError if the port is taken."""
        await self.hub.start(self.host, self.port)
        self.port = self.hub.port
        self.taps += taps
        self._beacon = asyncio.create_task(announce(self.host, self.port, CHANNEL))

    def say(self, frame: Frame) -> None:
        """Send a frame as a device of the launch, which gets a controller for its first one."""
        if self._desk is None:
            self._desk = FieldBus(self.wire.channel)
        self._desk.submit(frame)

    async def stop(self) -> None:
        """Close the hub and forget the wire."""
        if self._beacon is not None:
            self._beacon.cancel()
        await self.hub.stop()
        self.wire.taps.clear()
        forget(self.wire.channel)  # another launch of this process begins from zero


class OutsideHub:
    """We listen on it like any device. Frames that are sent while it is gone are lost."""

    def __init__(self, host: str, port: int) -> None:
        self.host, self.port = host, port
        self.link = SocketcandLink(host, port, CHANNEL, Random(f"listening at {port}"))
        self.taps: list[Tap] = []

    def _heard(self, frame: Frame) -> None:
        t_us = round(asyncio.get_running_loop().time() * 1e6)
        for tap in self.taps:
            tap(t_us, frame)

    def say(self, frame: Frame) -> None:
        """Send a frame, and pass it to the taps, because a hub returns no frame to its sender."""
        if self.link.send(frame):
            self._heard(frame)  # a hub does not return its own frames

    async def start(self, taps: list[Tap]) -> None:
        """Connect, and pass frames to the taps from now on. Raises OSError if no hub answers in
        time."""
        self.taps += taps
        self.link.subscribe(self._heard)
        try:
            async with asyncio.timeout(ANSWER_S):
                await self.link.up()
        except TimeoutError:
            raise OSError(
                f"no hub answers at {self.host}:{self.port}; headland hub starts one"
            ) from None

    async def stop(self) -> None:
        """Close the connection; the hub goes on."""
        self.link.close()
