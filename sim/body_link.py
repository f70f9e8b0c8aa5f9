"""A robot process and its body in the world's process: datagrams on loopback.

The world tells each body's observation every `TELL_US`; a robot sends its drive commands. A lost or
late datagram is what a lost or late sensor reading or command is: commands expire by themselves.
"""

import asyncio
import struct
from collections.abc import Callable
from typing import cast

from agent.effects import Drive
from agent.ports import Body, Lying, Observation
from sim.intent_link import IntentRelay
from sim.world import World

TELL_US = 20_000  # one world step
HELLO_S = 0.2  # a robot that has heard nothing yet says that it is there
DRIVE = struct.Struct("<4sBdddBi")  # magic, slot, vx, vy, turn, implement, parcel to handle
# magic, slot, x, y, heading, vx, vy, battery, load, parcels in reach; then these, and the rays
SENSE = struct.Struct("<4sBddddddiB")
LYING = struct.Struct("<idd?")  # task, x, y, on a robot
PARCELS_MAX = 32  # told at once; within an arm's reach
RAY = struct.Struct("<f")
MAGIC_DRIVE, MAGIC_HELLO, MAGIC_SENSE = b"HLDr", b"HLHi", b"HLSe"
Address = tuple[str, int]


def sense_bytes(slot: int, seen: Observation) -> bytes:
    parcels = sorted(seen.parcels.items())[:PARCELS_MAX]
    head = SENSE.pack(
        MAGIC_SENSE, slot, *seen[:5], seen.battery, seen.load, len(parcels)
    )  # fmt: skip
    lying = b"".join(LYING.pack(task, *where) for task, where in parcels)
    return head + lying + struct.pack(f"<{len(seen.ranges_m)}f", *seen.ranges_m)


def observation_of(data: bytes) -> Observation | None:
    """None where it is not what `sense_bytes` makes."""
    if len(data) < SENSE.size:
        return None
    _, _, *pose, battery, load, count = SENSE.unpack_from(data)
    begin = SENSE.size + count * LYING.size
    rays = (len(data) - begin) // RAY.size
    if rays < 0 or len(data) != begin + rays * RAY.size:
        return None
    lying = (LYING.unpack_from(data, SENSE.size + k * LYING.size) for k in range(count))
    parcels = {task: Lying(x_m, y_m, on_robot) for task, x_m, y_m, on_robot in lying}
    ranges_m = struct.unpack_from(f"<{rays}f", data, begin)
    return Observation(*pose)._replace(
        ranges_m=ranges_m, battery=battery, load=load, parcels=parcels
    )


class BodyServer(asyncio.DatagramProtocol):
    """In the world's process. `zero_us`: the loop's time at which the world's time is 0."""

    def __init__(self, world: World, zero_us: int) -> None:
        self.world, self.zero_us = world, zero_us
        self.body: Callable[[int], Body] = world.body  # or one with an arm and a battery
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
        magic, slot, vx_m_s, vy_m_s, turn_rad_s, tool_on, handle = DRIVE.unpack(data)
        if slot not in self.world.robots or not all(
            abs(v) < 1e3 for v in (vx_m_s, vy_m_s, turn_rad_s)
        ):
            self.malformed += 1
            return
        self.addresses[slot] = address
        if magic == MAGIC_DRIVE:
            drive = Drive(vx_m_s, vy_m_s, turn_rad_s, tool_on == 1, handle)
            self.body(slot).drive(drive, self.now_us())

    async def run(self) -> None:
        """Step the world in real time and tell every robot that has asked."""
        loop, next_s = asyncio.get_running_loop(), asyncio.get_running_loop().time()
        while True:
            now_us = self.now_us()
            self.world.advance(now_us)
            for slot, address in self.addresses.items():
                seen = self.body(slot).sense(now_us)
                if self._transport is not None and seen is not None:
                    self._transport.sendto(sense_bytes(slot, seen), address)
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
        if data[:4] == MAGIC_SENSE and data[4:5] == bytes([self.slot]):
            seen = observation_of(data)
            if seen is not None:
                now_us = round(asyncio.get_running_loop().time() * 1e6)
                self.seen = seen._replace(sensed_at_us=now_us)
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
                DRIVE.pack(magic, self.slot, c.vx_m_s, c.vy_m_s, c.turn_rad_s, c.tool_on, c.handle)
            )
