"""Programs that stay on a bus whose server ends and comes back."""

import asyncio
import socket
import time
from collections.abc import Callable
from threading import Thread

import pytest

from protocol.frames.frame import Frame
from sim.can.simulated_bus import FieldBus, forget, segment
from sim.can.socketcand_server import Hub
from tools.common import bus_attach
from tools.common.bus_address import AttachError
from tools.common.bus_attach import attach, stay_attached
from tools.inspect import inspection
from tools.inspect.inspector import Inspector

CHANNEL, LIMIT_S, LOOK_S, CPU_MAX = "can0", 20.0, 0.5, 0.5
BEAT = Frame(0x18FF1080, bytes(range(8)))


async def passed(for_s: float) -> None:
    """In real time: what is looked at is in the kernel."""
    turn = asyncio.get_running_loop().create_future()
    asyncio.get_running_loop().call_later(for_s, turn.set_result, None)
    await turn


async def until(holds: Callable[[], bool]) -> None:
    async with asyncio.timeout(LIMIT_S):
        while not holds():
            await passed(0.01)


async def joined(hub: Hub) -> None:
    await until(lambda: any(client.bus is not None for client in hub.clients))


async def share_of_a_core() -> float:
    begun_cpu_s, begun_at_s = time.process_time(), time.monotonic()
    await passed(LOOK_S)
    return (time.process_time() - begun_cpu_s) / (time.monotonic() - begun_at_s)


def test_who_stays_on_a_bus_takes_no_core_without_it_and_hears_the_next_one() -> None:
    """Found: maps and `headland ros2` took a whole core once their launch had ended, and were deaf."""

    async def story() -> None:
        name, heard = "a program that stays", list[Frame]()
        hub = Hub(segment(name), CHANNEL)
        await hub.start()
        bus = await stay_attached("socketcand", CHANNEL, 250_000, "127.0.0.1", hub.port, name)
        bus.subscribe(heard.append)
        for _ in range(2):
            await joined(hub)
            other = FieldBus(name)
            other.submit(BEAT)
            await until(lambda: heard == [BEAT])
            other.shutdown()
            heard.clear()
            port = hub.port
            await hub.stop()
            forget(name)
            assert await share_of_a_core() < CPU_MAX
            hub = Hub(segment(name), CHANNEL)
            await hub.start(port=port)
        bus.close()
        await hub.stop()
        forget(name)

    asyncio.run(story())


def test_a_watch_goes_on_after_a_restart_of_its_bus() -> None:
    async def story() -> None:
        name, told = "a watch", list[int]()
        hub = Hub(segment(name), CHANNEL)
        await hub.start()
        where = ("socketcand", CHANNEL, 250_000, "127.0.0.1", hub.port)
        watching = asyncio.create_task(
            inspection._listen(Inspector(), *where, None, lambda seen: told.append(1))
        )
        await joined(hub)
        port = hub.port
        await hub.stop()
        forget(name)
        assert await share_of_a_core() < CPU_MAX
        hub = Hub(segment(name), CHANNEL)
        await hub.start(port=port)
        await joined(hub)
        assert not watching.done()
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        await hub.stop()
        forget(name)

    asyncio.run(story())


def test_a_host_that_is_no_name_is_one_line() -> None:
    """Found: a traceback."""
    with pytest.raises(AttachError, match="cannot open socketcand at"):
        attach("socketcand", CHANNEL, 250_000, "a" * 70, 29536)


@pytest.mark.parametrize("closes", [False, True])
def test_a_server_that_accepts_and_says_nothing_is_told_in_one_line(
    closes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """python-can waits for the greeting without a limit, and `headland stop` hung without a word."""
    monkeypatch.setattr(bus_attach, "REACH_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        if closes:
            Thread(target=lambda: server.accept()[0].close()).start()
        with pytest.raises(AttachError, match=f"127.0.0.1:{port} "):
            bus_attach.attach("socketcand", "can0", 250_000, "127.0.0.1", port)
