"""The beacon of socketcand, as python-can's own listener and a plain socket hear it."""

import asyncio
import contextlib
import select
import socket
import xml.etree.ElementTree as ElementTree
from collections.abc import AsyncIterator, Coroutine
from typing import Any

import can
import pytest
from can.interfaces.socketcand import socketcand

from sim.can import socketcand_beacon as beacon
from tools.cli.hub import _serve
from tools.common.bus_address import CHANNEL
from tools.run.launch_bus import OwnHub

HEARD_S = 5.0  # the first beacon comes at once, the second after three seconds


@pytest.fixture
def listener(monkeypatch: pytest.MonkeyPatch) -> socket.socket:
    """A socket at a port that is free, and beacons that go there."""
    heard = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    heard.bind(("", 0))
    port = heard.getsockname()[1]
    monkeypatch.setattr(beacon, "PORT", port)
    monkeypatch.setattr(socketcand, "DEFAULT_SOCKETCAND_DISCOVERY_PORT", port)
    return heard


@contextlib.asynccontextmanager
async def _during(work: Coroutine[object, object, None]) -> AsyncIterator[None]:
    task = asyncio.create_task(work)
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


def _heard(listening: socket.socket) -> bytes:
    ready, _, _ = select.select([listening], [], [], HEARD_S)
    assert ready, "no beacon"
    return listening.recv(2048)


@pytest.mark.slow
@pytest.mark.asyncio
async def test_a18_a_hub_is_found_by_its_beacon(listener: socket.socket) -> None:
    async with _during(_serve("127.0.0.1", 0, 250_000, 1, True, True)):
        root = ElementTree.fromstring(await asyncio.to_thread(_heard, listener))
        listener.close()  # python-can takes the port for itself
        configurations = await asyncio.to_thread(socketcand.detect_beacon, 5000)
        (found,) = (dict[str, Any](each) for each in configurations)
        assert root.tag == "CANBeacon" and root.attrib["type"] == "SocketCAN"
        assert root.findtext("URL") == f"can://127.0.0.1:{found['port']}"
        assert [bus.attrib["name"] for bus in root.iter("Bus")] == [CHANNEL]
        with await asyncio.to_thread(can.Bus, **found) as bus:  # what it says can be connected to
            await asyncio.to_thread(bus.send, can.Message(0x18EEFF80, data=bytes(8)))


@pytest.mark.asyncio
async def test_a18_a_hub_that_is_told_not_to_says_nothing(listener: socket.socket) -> None:
    with listener:
        async with _during(_serve("127.0.0.1", 0, 250_000, 1, True, False)):
            ready, _, _ = await asyncio.to_thread(select.select, [listener], [], [], 0.5)
            assert not ready


@pytest.mark.asyncio
async def test_a18_a_launch_is_found_as_well(listener: socket.socket) -> None:
    own = OwnHub("127.0.0.1", 0, 250_000, 1)
    with listener:
        await own.start([])
        try:
            heard = await asyncio.to_thread(_heard, listener)
        finally:
            await own.stop()
        assert f"<URL>can://127.0.0.1:{own.port}</URL>".encode() in heard


def test_a18_a_beacon_of_any_names_is_one_short_document() -> None:
    data = beacon.beacon('<&">' * 100, "192.168.1.2", 29536, '"<')
    assert len(data) <= beacon.BYTES_MAX
    root = ElementTree.fromstring(data)
    assert root.attrib["name"] == ('<&">' * 100)[: beacon.NAME_MAX]
    assert [bus.attrib["name"] for bus in root.iter("Bus")] == ['"<']
