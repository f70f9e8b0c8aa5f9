"""Hostile clients of the ports of a simulated machine."""

import asyncio
from contextlib import suppress

import can

from sim.machines.isobus_machine import IsobusMachine
from sim.machines.nmea_machine import CLIENTS_MAX, LINE_MAX, Dimensions, NmeaMachine, WheeledBody

ORIGIN = (52.0, 11.0)
WAIT_S = 20.0
PAIR = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def _opened(port: int) -> PAIR:
    return await asyncio.open_connection("127.0.0.1", port)


async def _where(port: int) -> bytes:
    reader, writer = await _opened(port)
    writer.write(b"where\n")
    answer = await asyncio.wait_for(reader.readline(), WAIT_S)
    writer.close()
    return answer


async def _long_line_ends_one_client(control: int) -> None:
    reader, writer = await _opened(control)
    writer.write(b"x" * (4 * LINE_MAX) + b"\n")
    with suppress(ConnectionError):
        assert await asyncio.wait_for(reader.read(), WAIT_S) == b""
    assert b"x_m" in await _where(control), "the next one is served"


def test_hostile_clients_of_a_machine_keep_no_robot_out() -> None:
    async def story() -> None:
        made = NmeaMachine(WheeledBody(Dimensions(), 0.0, 0.0, 0.0), ORIGIN)
        gnss, wheels, control = await made.start("127.0.0.1", 0, 0, 0)
        idle: list[PAIR] = []
        for port in (gnss, wheels, control):
            idle += [await _opened(port) for _ in range(4 * CLIENTS_MAX)]
        robot, _ = await _opened(gnss)
        assert (await asyncio.wait_for(robot.readline(), WAIT_S)).startswith(b"$GN")
        _, talker = await _opened(gnss)  # a receiver is told nothing, and keeps nothing
        for _ in range(64):
            talker.write(bytes(65_536))
        with suppress(ConnectionError):
            await asyncio.wait_for(talker.drain(), WAIT_S)
        await _long_line_ends_one_client(control)
        for _, each in idle:
            each.close()
        await made.stop()

    asyncio.run(story())


def test_hostile_clients_of_a_tractor_keep_no_order_out() -> None:
    async def story() -> None:
        bus = can.Bus("hostile clients of a tractor", interface="virtual")
        body = WheeledBody(Dimensions(drive="ackermann"), 0.0, 0.0, 0.0)
        made = IsobusMachine(body, ORIGIN, bus)
        control = await made.start_on_bus("127.0.0.1", 0)
        idle = [await _opened(control) for _ in range(4 * CLIENTS_MAX)]
        await _long_line_ends_one_client(control)
        for _, each in idle:
            each.close()
        await made.stop()

    asyncio.run(story())
