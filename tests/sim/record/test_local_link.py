"""Links of robots to their bodies under clients of the same user that are many, or say too much."""

import asyncio
import socket
from pathlib import Path

from sim.record.local_link import LENGTH, LINKS_MAX, MESSAGE_MAX, Link, LinkServer

WAIT_S = 20.0


class _Echo(Link):
    def take(self, message: bytes) -> None:
        self.send(message)


class _Client(Link):
    def __init__(self) -> None:
        super().__init__()
        self.taken = asyncio.Event()

    def take(self, message: bytes) -> None:
        self.taken.set()


async def _answered(path: Path) -> bool:
    client = await _Client().connect(path)
    client.send(b"hello")
    try:
        await asyncio.wait_for(client.taken.wait(), WAIT_S)
    finally:
        client.end()
    return True


def test_many_links_and_long_messages_keep_a_robot_served() -> None:
    async def story() -> None:
        server = LinkServer(_Echo)
        path = await server.start()
        robot = await _Client().connect(path)
        idle: list[socket.socket] = []
        for _ in range(LINKS_MAX + 20):
            idle.append(_connected(path))
            await _turn()
        while server.crowded < 20:
            await _turn()
        assert len(server.links) <= LINKS_MAX
        robot.send(b"still here")
        await asyncio.wait_for(robot.taken.wait(), WAIT_S)
        for each in idle:
            each.close()
        while len(server.links) > 1:
            await _turn()
        long = _connected(path)
        long.sendall(LENGTH.pack(MESSAGE_MAX + 1) + bytes(100))
        while len(server.links) > 1:
            await _turn()
        assert await _answered(path)
        long.close()
        robot.end()
        server.close()

    asyncio.run(asyncio.wait_for(story(), 3 * WAIT_S))


def _connected(path: Path) -> socket.socket:
    end = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    end.settimeout(WAIT_S)
    end.connect(str(path))
    return end


async def _turn() -> None:
    """Let the loop go round once."""
    loop = asyncio.get_running_loop()
    passed = loop.create_future()
    loop.call_soon(passed.set_result, None)
    await passed
