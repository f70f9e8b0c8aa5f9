"""Items 3 and 16: only its owner's processes move a body, and what a robot senses has an age (L2, L3)."""

import asyncio
import os
import socket
import stat
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from agent.interface.effects import Drive
from agent.peer.place_jumps import AGE_MAX_US
from sim.record.local_link import LENGTH, MESSAGE_MAX
from sim.record.remote_body import (
    DRIVE,
    MAGIC_DRIVE,
    MAGIC_HELLO,
    BodyServer,
    RemoteBody,
    sense_bytes,
)
from sim.world.drive_trains import Chassis
from sim.world.world import World

NOBODY = 65534  # a user id that no owner has
WAIT_S, LOOK_S = 5.0, 0.01
EAST = Drive(2.0, 0.0)


@asynccontextmanager
async def bodies() -> AsyncIterator[tuple[BodyServer, Path]]:
    world = World([], 1)
    for slot in range(2):
        world.add_robot(slot, (10.0 * slot, 0.0), 0.5, Chassis())
    server = BodyServer(world, round(asyncio.get_running_loop().time() * 1e6))
    path = await server.start()
    stepping = asyncio.create_task(server.run())
    try:
        yield server, path
    finally:
        stepping.cancel()
        server.close()


async def until(holds: Callable[[], object]) -> None:
    """Asked a hundred times a second."""
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(WAIT_S):
        while not holds():
            due = loop.create_future()
            loop.call_later(LOOK_S, due.set_result, None)
            await due


def east(body: RemoteBody) -> bool:
    body.drive(EAST, 0)
    return True


def at(server: BodyServer, slot: int) -> float:
    return server.world.body(slot).position[0]


def test_item_16_a_robot_drives_its_body_and_knows_when_it_was_sensed() -> None:
    async def story() -> None:
        async with bodies() as (server, path):
            body = await RemoteBody(1).connect(path)
            await body.ready()
            loop = asyncio.get_running_loop()
            await until(lambda: east(body) and at(server, 1) > 11.0)
            seen, now_us = body.sense(0), round(loop.time() * 1e6)
            assert seen is not None and 0 <= now_us - seen.sensed_at_us < 1_000_000
            assert at(server, 0) == 0.0

    asyncio.run(story())


def test_item_3_what_a_world_that_hangs_has_told_grows_old() -> None:
    """L3: the last observation was given for ever, without a time."""

    async def story() -> None:
        async with bodies() as (server, path):
            body = await RemoteBody(0).connect(path)
            await body.ready()
            server.close()
            seen, loop = body.sense(0), asyncio.get_running_loop()
            assert seen is not None
            await until(lambda: round(loop.time() * 1e6) - seen.sensed_at_us > AGE_MAX_US)
            later = body.sense(0)
            assert later is not None
            await until(lambda: round(loop.time() * 1e6) - later.sensed_at_us > AGE_MAX_US)

    asyncio.run(story())


def test_item_3_what_was_long_on_its_way_is_old_when_it_comes() -> None:
    async def story() -> None:
        world = World([], 1)
        port = world.add_robot(0, (0.0, 0.0), 0.5, Chassis())
        body, loop = RemoteBody(0), asyncio.get_running_loop()
        first = port.sense(0)._replace(sensed_at_us=1_000_000)
        body.take(sense_bytes(0, first))
        at_us = round(loop.time() * 1e6)
        body.take(sense_bytes(0, first._replace(sensed_at_us=700_000)))  # sent 0.3 s before
        seen = body.sense(0)
        assert seen is not None and at_us - seen.sensed_at_us >= 290_000
        body.take(sense_bytes(0, first))  # the same once more is no younger
        seen = body.sense(0)
        assert seen is not None and seen.sensed_at_us <= at_us

    asyncio.run(story())


def test_what_the_world_tells_of_the_implement_arrives() -> None:
    """A launch of `small` on a loaded machine ended with "robots say 100 %, the ground says 99.99 %".
    A command came late, the world raised the implement, and no robot of a launch knew of it."""

    async def story() -> None:
        world = World([], 1)
        seen = world.add_robot(0, (0.0, 0.0), 0.5, Chassis()).sense(0)
        for down in (True, False, None):
            body = RemoteBody(0)
            body.take(sense_bytes(0, seen._replace(implement_down=down)))
            told = body.sense(0)
            assert told is not None and told.implement_down is down

    asyncio.run(story())


def test_an_implement_that_was_up_in_one_of_several_messages_is_said_to_be_up_once() -> None:
    """The world tells what is sensed every 20 ms, and a robot looks every 50 ms."""

    async def story() -> None:
        world = World([], 1)
        seen = world.add_robot(0, (0.0, 0.0), 0.5, Chassis()).sense(0)
        body = RemoteBody(0)
        for down in (True, False, True):
            body.take(sense_bytes(0, seen._replace(implement_down=down)))
        first, second = body.sense(0), body.sense(0)
        assert first is not None and first.implement_down is False
        assert second is not None and second.implement_down is True

    asyncio.run(story())


def test_item_16_a_second_process_for_a_slot_moves_nothing_and_is_told_nothing() -> None:
    async def story() -> None:
        async with bodies() as (server, path):
            body = await RemoteBody(0).connect(path)
            await body.ready()
            other = await RemoteBody(0).connect(path)
            hello = asyncio.create_task(other.ready())
            await until(lambda: east(other) and server.refused >= 20)
            assert at(server, 0) == 0.0 and other.seen is None
            heard_at_us = body.seen.sensed_at_us if body.seen else 0
            await until(lambda: body.seen and body.seen.sensed_at_us > heard_at_us)
            body.end()  # it dies, and is started again
            await asyncio.wait_for(hello, WAIT_S)

    asyncio.run(story())


def test_item_16_the_socket_is_its_owners_alone() -> None:
    async def story() -> None:
        async with bodies() as (server, path):
            folder = path.parent
            assert stat.S_IMODE(folder.stat().st_mode) == 0o700
            assert folder.stat().st_uid == os.getuid()
            server.close()
            assert not folder.exists()

    asyncio.run(story())


def as_nobody(path: Path) -> int:
    """In a process of another user: 0 where it could say something, else 1."""
    child = os.fork()
    if child == 0:
        try:
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
            end = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            end.connect(str(path))
            drive = DRIVE.pack(MAGIC_DRIVE, 0, 2.0, 0.0, 0.0, 0, -1)
            hello = DRIVE.pack(MAGIC_HELLO, 0, 0.0, 0.0, 0.0, 0, -1)
            for message in (hello, *[drive] * 50):
                end.sendall(LENGTH.pack(len(message)) + message)
            os._exit(0 if end.recv(1) else 1)
        except OSError:
            os._exit(1)
    return child


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
@pytest.mark.parametrize("folder_open", [False, True])
def test_item_16_another_user_neither_drives_nor_diverts(folder_open: bool) -> None:
    """L2 and L3. `folder_open`: by a mistake of somebody; then the kernel's word counts."""

    async def story() -> None:
        async with bodies() as (server, path):
            if folder_open:
                path.parent.chmod(0o755)
                path.chmod(0o777)
            child = as_nobody(path)
            status = await asyncio.to_thread(os.waitpid, child, 0)
            assert os.waitstatus_to_exitcode(status[1]) == 1
            assert at(server, 0) == 0.0 and server.body(0).sense(server.now_us()).vx_m_s == 0.0  # type: ignore[union-attr]
            assert server.server.foreign == int(folder_open)
            body = await RemoteBody(0).connect(path)
            await body.ready()

    asyncio.run(story())


@pytest.mark.parametrize(
    "sent",
    [b"\xff\xff", LENGTH.pack(MESSAGE_MAX + 1), LENGTH.pack(3) + b"HLx", LENGTH.pack(0),
     LENGTH.pack(DRIVE.size) + DRIVE.pack(MAGIC_DRIVE, 99, 1.0, 0.0, 0.0, 0, -1),
     LENGTH.pack(DRIVE.size) + DRIVE.pack(MAGIC_DRIVE, 0, float("nan"), 0.0, 0.0, 0, -1)],
)  # fmt: skip
def test_item_16_what_cannot_be_read_is_counted(sent: bytes) -> None:
    async def story() -> None:
        async with bodies() as (server, path):
            _, writer = await asyncio.open_unix_connection(str(path))
            writer.write(sent)
            links = server.server.links
            await until(lambda: server.malformed or not links or any(k.malformed for k in links))
            body = await RemoteBody(0).connect(path)
            await body.ready()
            writer.close()

    asyncio.run(story())
