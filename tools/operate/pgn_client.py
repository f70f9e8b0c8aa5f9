"""A device that asks for texts: the other end of a peer's transport sessions."""

import asyncio
from collections import deque

from agent.interface.ports import Bus
from agent.runtime.files.printable_text import printable
from protocol.frames.codec import decode
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS, Identifier
from protocol.frames.messages import Message
from protocol.frames.network_frames import Request, TransportData, TransportManagement
from protocol.transport import ReceivedMessage, Transport
from tools.operate.tool_address import DeviceAddress

ARRIVED_MAX = 128  # one for each robot; others that nobody asked for are forgotten
LOOK_S = 0.02  # sessions are looked after this often; their shortest limit is 200 ms


class PgnClient:
    """Asks a robot for a group that is longer than a frame, and collects the answer by the
    transport protocol."""

    def __init__(self, bus: Bus, device: DeviceAddress | None = None) -> None:
        """`device`: whose address it speaks from; none: it claims one of its own."""
        self.bus, self.transport = bus, Transport()
        self.device = DeviceAddress(bus) if device is None else device
        self._own_device = device is None
        self.arrived: deque[ReceivedMessage] = deque(maxlen=ARRIVED_MAX)

    def hear(self, now_s: float, frame: Frame) -> None:
        """Take one frame of the bus; what has arrived whole goes to `arrived`."""
        if self._own_device:
            self.device.hear(now_s, frame)
        source, message = decode(frame)
        destination = Identifier.unpack(frame.identifier).destination
        if not self.device.owns(destination):
            return
        if isinstance(message, TransportManagement | TransportData):
            now_us = round(now_s * 1e6)
            out, arrived = self.transport.on_message(source, destination, message, now_us)
            for o in out:
                self._send(o.message, o.destination)
            if arrived is not None:
                self.arrived.append(arrived)

    async def ask(self, pgn: int, address: int, seconds: float) -> str | None:
        """The text of a parameter group, or None where nothing whole came in time.

        `address`: of one device, or GLOBAL_ADDRESS: the first text that comes from any."""
        loop = asyncio.get_running_loop()
        await self.device.held()  # an answer in parts goes to an address
        end_s = loop.time() + seconds
        # Its answer to an earlier question is no answer to this one.
        any_source = address == GLOBAL_ADDRESS
        others = [
            a for a in self.arrived if a.pgn != pgn or not (any_source or a.source == address)
        ]
        self.arrived = deque(others, ARRIVED_MAX)
        self._send(Request(pgn), address)
        while loop.time() < end_s:
            for letter in self.arrived:
                if letter.pgn == pgn and (any_source or letter.source == address):
                    return _shown(letter.data)
            await asyncio.sleep(LOOK_S)
            for o in self.transport.on_tick(round(loop.time() * 1e6)):
                self._send(o.message, o.destination)
        return None

    def _send(self, message: Message, destination: int) -> None:
        self.device.send(message, destination)


def _shown(data: bytes) -> str:
    """A text of lines. Any device can send it in a robot's name."""
    return "\n".join(map(printable, data.decode("latin-1").split("\n"))).rstrip()
