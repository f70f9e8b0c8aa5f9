"""The source address of an operator's tool: asked about, claimed and defended as every device does.

    address = DeviceAddress(bus)     # in an event loop it keeps its own time
    address.send(message)            # waits for the address; an urgent one leaves from 254 at once

The tool asks which device holds which address, waits for the answers, and takes 249 or, if that is held,
the highest free address. Until then it has none: urgent messages (stops, requests) leave from the null
address, others are kept and leave in their order as soon as the claim is sent.

Where every address is held, what is kept is forgotten, because an order of minutes ago would surprise.
The tool tries again every five seconds.
"""

import asyncio
from collections.abc import Callable
from random import Random
from secrets import randbits
from typing import Protocol

from protocol.address import CANNOT, RETRY_US, AddressClaim, AddressMessage
from protocol.frame_proofs import ToolProofs
from protocol.frames.codec import decode, encode
from protocol.frames.delivery_frames import TaskOrder
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS, Identifier
from protocol.frames.messages import GROUP_OF, Message
from protocol.frames.network_frames import AddressClaimed, Request, refusal
from protocol.frames.safety_frames import AllImplementsStop, EmergencyStop, Freshness
from protocol.name import Name, tool_name

PREFERRED = 249  # off-board service tool 1 (J1939 preferred addresses)
LISTEN_US = 200_000  # devices answer a request for claims within 153 ms, and a bus may be full
KEPT_MAX = 64  # messages kept until there is an address; a program that waits sends fewer
IDENTITY_BITS = 21
URGENT = (EmergencyStop, AllImplementsStop, Freshness, Request)
CLAIM_PGN = GROUP_OF[AddressClaimed].pgn
CROWDED_OUT = (
    "other devices have claimed every address that a tool may take, so nothing but a stop can be sent: "
    "look for the device that claims them all"
)


class Sender(Protocol):
    """What a device needs of a bus."""

    def send(self, frame: Frame) -> bool:
        """False when the bus does not take it."""
        ...


class DeviceAddress:
    """Claims an address for a tool and keeps it; messages wait until there is one, except stops and
    requests."""

    def __init__(
        self, bus: Sender, name: Name | None = None, proofs: ToolProofs | None = None
    ) -> None:
        """`name`: of the device; none: a tool's, with an identity number drawn for this process.
        `proofs`: makes the proofs of transport orders, in a fleet with keys."""
        self.bus = bus
        self.name = tool_name(randbits(IDENTITY_BITS)) if name is None else name
        self.claim: AddressClaim | None = None  # begins with the first frame, or with the loop
        self.refused = 0  # messages beyond those that are kept
        self.proofs = proofs
        self._now_us = 0
        self.on_claim: Callable[[], None] | None = None  # called each time an address became ours
        self._kept: list[tuple[Message, int]] = []
        self._told: int | None = None
        self._retry_at_us: int | None = None  # of a claim, while every address is held
        self._held = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._timer: asyncio.TimerHandle | None = None
        try:
            self._loop = asyncio.get_running_loop()
        except RuntimeError:
            return
        self._turn()

    @property
    def address(self) -> int | None:
        """None until it is ours."""
        return None if self.claim is None else self.claim.address

    @property
    def crowded_out(self) -> bool:
        """No address is left for this tool, so its messages wait in vain."""
        return self._retry_at_us is not None

    async def held(self, seconds: float = 2.0) -> bool:
        """Wait for the address, at most for this time."""
        try:
            async with asyncio.timeout(seconds):
                await self._held.wait()
        except TimeoutError:
            return False
        return self.address is not None

    def hear(self, now_s: float, frame: Frame) -> None:
        """Take one frame of the bus: claims and requests for claims matter, and the time goes on."""
        now_us = self._now_us = round(now_s * 1e6)
        self._tick(now_us)
        if self.proofs is not None:
            source, message = decode(frame)
            self.proofs.hear(source, message, now_us)
        group = frame.identifier >> 16 & 0xFF
        if group == CLAIM_PGN >> 8 or group == GROUP_OF[Request].pgn >> 8:
            self._heard(frame, now_us)
            self._tick(now_us)
            self._arm()

    def send(self, message: Message, destination: int = GLOBAL_ADDRESS) -> bool:
        """From our address. False where the bus does not take it, or too much waits already."""
        address = self.address
        if address is None and isinstance(message, URGENT):
            address = NULL_ADDRESS
        if self.crowded_out and address is None:
            self.refused += 1
            return False
        if address is not None:
            sent = self.bus.send(encode(message, address, destination))
            if self.proofs is not None and isinstance(message, TaskOrder):
                for said in self.proofs.after(message, address, self._now_us):
                    self.bus.send(encode(said, address))
            return sent
        if len(self._kept) >= KEPT_MAX:
            self.refused += 1
            return False
        self._kept.append((message, destination))
        return True

    def owns(self, destination: int) -> bool:
        """A frame to this address is for us."""
        return destination in (GLOBAL_ADDRESS, self.address)

    # ---------------------------------------------------------------- the claim

    def _heard(self, frame: Frame, now_us: int) -> None:
        assert self.claim is not None
        source, message = decode(frame)
        if isinstance(message, AddressClaimed):
            self._say(self.claim.on_message(source, message, now_us))
        elif isinstance(message, Request) and message.pgn == CLAIM_PGN:
            destination = Identifier.unpack(frame.identifier).destination
            if destination in (GLOBAL_ADDRESS, self.claim.candidate):
                self._say(self.claim.on_request(destination == GLOBAL_ADDRESS, now_us))
        elif isinstance(message, Request) and source < NULL_ADDRESS:
            self._refuse(source, message.pgn, Identifier.unpack(frame.identifier).destination)

    def _refuse(self, source: int, pgn: int, destination: int) -> None:
        """A tool serves no group. A device that asked it alone is told so (ISO 11783-3)."""
        address = self.address
        if address is not None and destination == address:
            self.bus.send(encode(refusal(source, pgn), address))

    def _tick(self, now_us: int) -> None:
        if self.claim is None:
            rng = Random(self.name.pack())
            self.claim = AddressClaim(self.name, PREFERRED, rng, now_us, LISTEN_US)
            self.bus.send(encode(Request(CLAIM_PGN), NULL_ADDRESS))
        retry_at_us = self._retry_at_us
        if self.claim.state is CANNOT and retry_at_us is not None and now_us >= retry_at_us:
            self._retry_at_us = now_us + RETRY_US
            self.claim.restart(now_us)
        self._say(self.claim.on_tick(now_us))
        if self.claim.asks:
            self.claim.asks = False
            self.bus.send(encode(Request(CLAIM_PGN), NULL_ADDRESS))
        if self.claim.state is CANNOT and self._retry_at_us is None:
            self._retry_at_us = now_us + RETRY_US
            self.refused += len(self._kept)
            self._kept.clear()

    def _say(self, claims: list[AddressMessage]) -> None:
        for message, source, destination in claims:
            self.bus.send(encode(message, source, destination))
        address = self.address
        if address == self._told:
            return
        self._told = address
        if address is None:
            self._held.clear()
            return
        self._held.set()
        self._retry_at_us = None
        kept, self._kept = self._kept, []
        for waited, destination in kept:
            self.bus.send(encode(waited, address, destination))
        if self.on_claim is not None:
            self.on_claim()

    def _turn(self) -> None:
        """Keep our own time, in an event loop."""
        if self._loop is not None and not self._loop.is_closed():
            self._tick(round(self._loop.time() * 1e6))
            self._arm()

    def _arm(self) -> None:
        if self._loop is None or self.claim is None:
            return
        due_at_us = self.claim.due_at_us
        if self.claim.state is CANNOT:
            due_at_us = self._retry_at_us
        if due_at_us is None:
            return
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._loop.call_at(due_at_us / 1e6, self._turn)
