"""A robot process and its body in the world's process: datagrams on loopback.

The world tells each body's observation every `TELL_US`; a robot sends its drive commands. A lost or
late datagram is what a lost or late sensor reading or command is: commands expire by themselves.
"""

import asyncio
import struct
from typing import cast

from agent.effects import Drive
from agent.ports import Observation
from sim.intent_link import IntentRelay
from sim.world import World

TELL_US = 20_000  # one world step
HELLO_S = 0.2  # a robot that has heard nothing yet says that it is there
DRIVE = struct.Struct("<4sBdddB")  # magic, slot, vx, vy, turn, implement
SENSE = struct.Struct("<4sBddddd")  # magic, slot, x, y, heading, vx, vy; then a float for each ray
RAY = struct.Struct("<f")
MAGIC_DRIVE, MAGIC_HELLO, MAGIC_SENSE = b"HLDr", b"HLHi", b"HLSe"
Address = tuple[str, int]


class BodyServer(asyncio.DatagramProtocol):
    """In the world's process. `zero_us`: the loop's time at which the world's time is 0."""

    def __init__(self, world: World, zero_us: int) -> None:
        self.world, self.zero_us = world, zero_us
        self.addresses: dict[int, Address] = {}
        self.malformed = 0
        self.relay = IntentRelay()
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def now_us(self) -> int:
        return round(asyncio.get_running_loop().time() * 1e6) - self.zero_us

    def datagram_received(self, data: bytes, address: Address) -> None:
        if self.relay.take(data, address, self._transport):
            return
        if len(data) != DRIVE.size or data[:4] not in (MAGIC_DRIVE, MAGIC_HELLO):
            self.malformed += 1
            return
        magic, slot, vx_m_s, vy_m_s, turn_rad_s, tool_on = DRIVE.unpack(data)
        if slot not in self.world.robots or not all(
            abs(v) < 1e3 for v in (vx_m_s, vy_m_s, turn_rad_s)
        ):
            self.malformed += 1
            return
        self.addresses[slot] = address
        if magic == MAGIC_DRIVE:
            drive = Drive(vx_m_s, vy_m_s, turn_rad_s, tool_on == 1)
            self.world.body(slot).drive(drive, self.now_us())

    async def run(self) -> None:
        """Step the world in real time and tell every robot that has asked."""
        loop, next_s = asyncio.get_running_loop(), asyncio.get_running_loop().time()
        while True:
            now_us = self.now_us()
            self.world.advance(now_us)
            for slot, address in self.addresses.items():
                seen = self.world.body(slot).sense(now_us)
                if self._transport is not None:
                    rays = struct.pack(f"<{len(seen.ranges_m)}f", *seen.ranges_m)
                    head = SENSE.pack(MAGIC_SENSE, slot, *seen[:5])
                    self._transport.sendto(head + rays, address)
            next_s = max(next_s + TELL_US / 1e6, loop.time())
            await asyncio.sleep(next_s - loop.time())


class RemoteBody(asyncio.DatagramProtocol):
    """In a robot's process: the `Body` port over datagrams."""

    def __init__(self, slot: int) -> None:
        self.slot = slot
        self.seen: Observation | None = None
        self.first = asyncio.Event()
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def error_received(self, problem: Exception) -> None:
        """The world is gone; commands expire there, and the launcher ends us."""

    def datagram_received(self, data: bytes, address: Address) -> None:
        rays = (len(data) - SENSE.size) // RAY.size
        if rays < 0 or len(data) != SENSE.size + rays * RAY.size:
            return
        if data[:4] == MAGIC_SENSE and data[4] == self.slot:
            _, _, *fields = SENSE.unpack_from(data)
            ranges_m = struct.unpack_from(f"<{rays}f", data, SENSE.size)
            self.seen = Observation(*fields)._replace(ranges_m=ranges_m)
            self.first.set()

    async def ready(self) -> None:
        """Say hello until the first observation comes."""
        while not self.first.is_set():
            self._send(MAGIC_HELLO, Drive(0.0, 0.0))
            try:
                async with asyncio.timeout(HELLO_S):
                    await self.first.wait()
            except TimeoutError:
                continue

    def sense(self, now_us: int) -> Observation:
        assert self.seen is not None, "wait for ready() first"
        return self.seen

    def drive(self, command: Drive, now_us: int) -> None:
        self._send(MAGIC_DRIVE, command)

    def tell(self, data: bytes) -> None:
        """To whoever watches; see `sim.intent_link`."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.sendto(data)

    def _send(self, magic: bytes, c: Drive) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.sendto(
                DRIVE.pack(magic, self.slot, c.vx_m_s, c.vy_m_s, c.turn_rad_s, c.tool_on)
            )
