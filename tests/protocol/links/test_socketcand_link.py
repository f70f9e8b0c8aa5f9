"""A line to a socketcand server that ends, hangs, talks nonsense and comes back."""

import asyncio
from collections.abc import Awaitable, Callable
from random import Random

from protocol.controller_health import Health
from protocol.frames.frame import Frame
from protocol.links.socketcand_link import DEAD_S, UNSENT_MAX, SocketcandLink
from sim.can.can_wire import QUEUE_MAX
from sim.can.simulated_bus import FieldBus, forget, segment
from sim.can.socketcand_server import Hub

CHANNEL, LIMIT_S = "can0", 20.0
BEAT = Frame(0x18FF1080, bytes(range(8)))


async def until(holds: Callable[[], bool], link: SocketcandLink) -> None:
    """In real time: something is waited for in the kernel."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + LIMIT_S
    while not holds():
        assert loop.time() < end_s, vars(link)
        turn = loop.create_future()
        loop.call_later(0.01, turn.set_result, None)
        await turn


def line(port: int) -> tuple[SocketcandLink, list[Frame]]:
    heard: list[Frame] = []
    link = SocketcandLink("127.0.0.1", port, CHANNEL, Random(1))
    link.subscribe(heard.append)
    return link, heard


async def talk(name: str, hub: Hub, link: SocketcandLink, heard: list[Frame]) -> None:
    other, got, answer = FieldBus(name), list[Frame](), Frame(0x18FF1181, b"")
    other.subscribe(got.append)
    await until(lambda: all(client.bus is not None for client in hub.clients), link)
    assert link.send(BEAT)
    other.submit(answer)
    await until(lambda: got == [BEAT] and heard[-1:] == [answer], link)
    other.shutdown()


def test_frames_go_both_ways_and_again_after_a_restart_of_the_hub() -> None:
    async def main() -> None:
        name = "link restart"
        hub = Hub(segment(name), CHANNEL)
        await hub.start()
        link, heard = line(hub.port)
        assert not link.send(BEAT)
        for life in (1, 2):
            await link.up()
            assert link.health is Health.ACTIVE and link.connections == life
            await talk(name, hub, link, heard)
            port = hub.port
            await hub.stop()
            forget(name)
            await until(lambda: link.health is Health.OFF, link)
            assert not link.send(BEAT)
            hub = Hub(segment(name), CHANNEL)
            await hub.start(port=port)
        link.close()
        await hub.stop()
        forget(name)

    asyncio.run(main())


Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


async def greet(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    writer.write(b"< hi >")
    await reader.readuntil(b">")
    writer.write(b"< ok >")
    await reader.readuntil(b">")
    writer.write(b"< ok >")


def serve(act: Serve, check: Callable[[SocketcandLink, list[Frame]], Awaitable[None]]) -> None:
    async def main() -> None:
        async def client(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            try:
                await greet(reader, writer)
                await act(reader, writer)
            except (ConnectionError, asyncio.IncompleteReadError):
                pass
            finally:
                writer.close()

        server = await asyncio.start_server(client, "127.0.0.1", 0)
        link, heard = line(server.sockets[0].getsockname()[1])
        await check(link, heard)
        link.close()
        server.close()

    asyncio.run(main())


def test_a_server_that_says_nothing_is_left_and_nothing_waits_for_it_without_end() -> None:
    async def mute(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await asyncio.Event().wait()

    async def check(link: SocketcandLink, heard: list[Frame]) -> None:
        await link.up()
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        while link.send(BEAT):
            assert link._transport is not None
            if link._transport.get_write_buffer_size() == 0:
                continue  # the kernel takes some
            assert link._transport.get_write_buffer_size() < 2 * UNSENT_MAX
        await until(lambda: link.health is Health.OFF, link)
        assert loop.time() - begun_s >= DEAD_S / 2
        await until(lambda: link.connections == 2, link)

    serve(mute, check)


def test_a_quiet_bus_is_no_dead_one() -> None:
    async def answers(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while await reader.readuntil(b">"):
            writer.write(b"< echo >")

    async def check(link: SocketcandLink, heard: list[Frame]) -> None:
        await link.up()
        loop = asyncio.get_running_loop()
        end_s = loop.time() + 2 * DEAD_S
        await until(lambda: loop.time() > end_s, link)
        assert link.health is Health.ACTIVE and link.connections == 1

    serve(answers, check)


def test_nonsense_is_counted() -> None:
    async def babbles(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"< frame 18FF1080 1.0 0011 >< frame zz >< frame 123 1.0 00 >< what >")
        writer.write(b"< frame 18FF1080 1.0 001122334455667788 >\xff\xfe>" + b"x" * 1000)
        await asyncio.Event().wait()

    async def check(link: SocketcandLink, heard: list[Frame]) -> None:
        await link.up()
        await until(lambda: link.malformed >= 5, link)
        assert link.other_frames == 1  # of a device with 11-bit identifiers
        assert heard == [Frame(0x18FF1080, b"\x00\x11")]

    serve(babbles, check)


def test_item_2_a_hub_tells_what_has_left_and_what_it_refuses() -> None:
    async def main() -> None:
        name = "link flood"
        hub = Hub(segment(name), CHANNEL)
        await hub.start()
        link, _ = line(hub.port)
        await link.up()
        await until(lambda: link.sent is not None, link)
        assert link.send(BEAT)
        await until(lambda: link.sent == 1, link)
        flooder, wire = FieldBus(name), segment(name).wire
        wire.flood(flooder.node, Frame(0x4D, bytes(8)), segment(name).now_us())
        for _ in range(QUEUE_MAX):
            assert link.send(BEAT)
        refused = Frame(BEAT.identifier, b"")
        link.send(refused)  # in the end it is told; a full queue is no error of the line
        await until(lambda: not link.send(refused), link)
        assert link.sent == 1 and link.malformed == 0
        wire.flood(flooder.node, None, segment(name).now_us())
        segment(name).arm()
        # Refused frames that were still under way to the hub may be accepted now.
        await until(lambda: (link.sent or 0) >= 1 + QUEUE_MAX, link)
        assert link.send(BEAT), "it takes frames again"
        flooder.shutdown()
        await hub.stop()
        link.close()
        forget(name)

    asyncio.run(main())


def test_item_2_a_server_that_cannot_confirm_is_no_error() -> None:
    async def others(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        assert await reader.readuntil(b">") == b"< confirm >"
        writer.write(b"< error unknown command >")
        assert (await reader.readuntil(b">")).startswith(b"< send 18FF1080 8 ")
        writer.write(b"< frame 18FF1181 1.0 00 >")
        await asyncio.Event().wait()

    async def check(link: SocketcandLink, heard: list[Frame]) -> None:
        await link.up()
        link.send(BEAT)
        await until(lambda: len(heard) == 1, link)
        assert link.sent is None and link.malformed == 0 and link.health is Health.ACTIVE

    serve(others, check)
