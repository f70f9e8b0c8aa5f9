"""Address claim: how a device comes to a source address and keeps it (ISO 11783-5, J1939-81).

One device's state machine, sans I/O. It outputs `AddressMessage` values: a message and the source
address that it must be sent from, because a claim is sent from the address it claims.

Its states and their total table are `ClaimState` and `CLAIM_TABLE`.
"""

from enum import Enum
from random import Random
from typing import NamedTuple

from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS
from protocol.frames.network_frames import AddressClaimed
from protocol.name import Name
from protocol.state_machine import StateMachine, matrix
from protocol.units import MS, S

FIRST, LAST = 128, 235  # self-configurable addresses of industry group 2
# Preferred addresses that a standard assigns to one kind of device. Such a device sends as soon as
# it has claimed (J1939-81). The standard lists 0 to 127 as well; none of our devices prefers those.
AT_ONCE_FIRST, AT_ONCE_LAST = 248, 253
# Time for such a claim to leave: more urgent frames would overtake it in our transmit queue.
SAID_US = 20 * MS
ADDRESS_CONTENTION_US = 250 * MS  # ISO 11783-5; a lower NAME may object this long
DELAY_STEP_US = 600  # RTxD = rand(0..255) * 0.6 ms
DEFENCES_MAX = 5  # per second; otherwise two devices with one NAME would answer each other forever
# From "cannot claim" to the next try. It doubles, and each device adds a random part of a second.
RETRY_US, RETRY_MAX_US = 5 * S, 20 * S
ANSWERS_US = 200 * MS  # devices answer a request for claims within 153 ms, and the bus may be full
# Minimum time between two claims sent because another device uses our address. A driver that
# returns our own frames must not make us claim after each of them.
VIOLATION_US = 5 * S
COMMAND_US = 5 * S  # between two commanded addresses: a robot stands for 250 ms at each


class ClaimState(Enum):
    """How far this device is with its address."""

    WAITING = "a random delay of 0 to 153 ms, so that devices powered up together do not collide"
    CONTENDING = "our claim is on the bus; for 250 ms a device with a lower NAME may object"
    HELD = "the address is ours; a claim by a higher NAME is answered with ours"
    CANNOT = "no address is left: only 'cannot claim' is sent, from address 254, until the next try"


class ClaimEvent(Enum):
    """What moves this device from one state to another."""

    RESTARTED = "power-up, a return to the bus, or the next try after 'cannot claim' (J1939-81)"
    CLAIMED = "a claim of the candidate address was sent, of the first one or of another"
    UNCONTESTED = "no device objected for the contention time"
    EXHAUSTED = "every address is held by a lower NAME"


WAITING, CONTENDING, HELD, CANNOT = ClaimState
stay = None

# fmt: off
CLAIM_TABLE = matrix(
    ClaimEvent,
    # state       RESTARTED  CLAIMED     UNCONTESTED  EXHAUSTED
    (WAITING,     stay,      CONTENDING, stay,        CANNOT),
    (CONTENDING,  WAITING,   stay,       HELD,        CANNOT),
    (HELD,        WAITING,   CONTENDING, stay,        CANNOT),
    (CANNOT,      WAITING,   stay,       stay,        stay),
)
# fmt: on


class AddressMessage(NamedTuple):
    """A claim, with the address that it must be sent from."""

    message: AddressClaimed
    source: int
    destination: int = GLOBAL_ADDRESS


class AddressClaim:
    """One device's claim of a source address, from power-up on.

    It has no clock and no bus: received claims and the time go in, claims to send come out.
    """

    def __init__(
        self, name: Name, preferred: int, rng: Random, now_us: int,
        modest_for_us: int | None = None, *, assigned: bool = False,
    ) -> None:  # fmt: skip
        """`assigned`: the standard gives the preferred address to this kind of device.
        `modest_for_us`: for a guest. It listens this long before it claims, leaves every address
        to its holder, whatever that NAME is, and searches for a free one from the top."""
        at_once = modest_for_us is not None and AT_ONCE_FIRST <= preferred <= AT_ONCE_LAST
        assert FIRST <= preferred <= LAST or at_once or assigned
        self._modest_for_us = modest_for_us
        self.name, self.number, self._rng = name, name.pack(), rng
        self.preferred = self.candidate = preferred
        self.names: dict[int, int] = {}  # address -> NAME, of other devices
        self._machine = StateMachine("address claim", CLAIM_TABLE, WAITING)
        self.duplicates = 0  # claims with our own NAME by another device: a configuration error
        self.losses = 0
        self.refused = 0  # defences not sent because of the limit
        self.asks = False  # a request for all claims is to be sent now
        self._retry_for_us = RETRY_US
        self._next_at_us: int | None = None
        self._answer_at_us: int | None = None  # all claims were requested: when our answer is due
        self._defences: list[int] = []
        self._violated_at_us = now_us - VIOLATION_US
        self._commanded_at_us = now_us - COMMAND_US
        self.restart(now_us)

    @property
    def state(self) -> ClaimState:
        """How far the claim is, as in `CLAIM_TABLE`."""
        return self._machine.state

    @property
    def address(self) -> int | None:
        """Our address, once no device has objected for the contention time; None before."""
        return self.candidate if self._machine.state is HELD else None

    @property
    def due_at_us(self) -> int | None:
        """When `on_tick` next has something to do, if nothing is received before; None: nothing."""
        next_at_us, answer_at_us = self._next_at_us, self._answer_at_us
        if next_at_us is None or answer_at_us is None:
            return answer_at_us if next_at_us is None else next_at_us
        return min(next_at_us, answer_at_us)

    def restart(self, now_us: int) -> None:
        """Start claiming: after power-up, after a return to the bus, or as a person wishes.

        If no address was left, the claims that we know may be old, so all devices are asked first.
        """
        if self.state is CANNOT:
            self._next_at_us = now_us  # the next try, at once
        else:
            self._restart(now_us)

    def _restart(self, now_us: int) -> None:
        self._machine.fire(ClaimEvent.RESTARTED)
        self._answer_at_us = None
        self._next_at_us = now_us + self._rng.randrange(256) * DELAY_STEP_US
        if self._modest_for_us is not None:
            self._next_at_us = now_us + self._modest_for_us

    def hurry(self, now_us: int) -> None:
        """Claim immediately. A random delay may be zero, so this is allowed. A robot that has a
        stop to send must not wait longer than others take to notice its silence, and a claim delays
        that."""
        if self.state is WAITING:
            self._next_at_us = now_us

    def on_tick(self, now_us: int) -> list[AddressMessage]:
        """The claims to send now: answers that are due, or the next step of our own claim."""
        claims: list[AddressMessage] = []
        if self._answer_at_us is not None and now_us >= self._answer_at_us:
            self._answer_at_us = None
            claims.append(self._answer())
        if self._next_at_us is None or now_us < self._next_at_us:
            return claims
        if self.state is WAITING:
            return claims + self._claim(now_us)
        if self.state is CANNOT:
            self._try_again(now_us)
            return claims
        self._next_at_us = None
        self._machine.fire(ClaimEvent.UNCONTESTED)
        self._retry_for_us = RETRY_US
        return claims

    def _try_again(self, now_us: int) -> None:
        """Request all claims: devices that are present answer, and claims of absent ones are
        dropped."""
        self.names.clear()
        self.candidate, self.asks = self.preferred, True
        self._restart(now_us)
        assert self._next_at_us is not None
        self._next_at_us += ANSWERS_US

    def on_message(self, source: int, message: AddressClaimed, now_us: int) -> list[AddressMessage]:
        """Handle another device's claim from the address `source`; returns the claims to send in
        reply.

        A lower NAME takes our address, a higher one is answered with our claim.
        """
        if source == NULL_ADDRESS:
            return []
        if message.name == self.number and source != self.candidate:
            self.duplicates += 1
            return []
        self.names[source] = message.name
        if source != self.candidate or self.state in (WAITING, CANNOT):
            return []
        if message.name == self.number:
            self.duplicates += 1
            return []
        if message.name > self.number:
            return self._defend(now_us)
        self.losses += 1
        return self._move(now_us)

    def command(self, address: int, now_us: int) -> list[AddressMessage]:
        """Claim that address, because another device commands it (ISO 11783-5, commanded address).

        Ignored without an address of our own, for an address that a robot may not have, for one
        that a lower NAME holds, and within `COMMAND_US` of the last command.
        """
        holder = self.names.get(address, self.number)
        if (
            self.state is not HELD
            or address == self.candidate
            or not FIRST <= address <= LAST
            or holder < self.number
            or now_us - self._commanded_at_us < COMMAND_US
        ):
            return []
        self._commanded_at_us = now_us
        self.candidate = address
        return self._contend(ADDRESS_CONTENTION_US, now_us)

    def violated(self, now_us: int) -> list[AddressMessage]:
        """Another device uses our address: two parts of a bus were joined, and in neither part did
        a device have a reason to object. A claim makes one of us move (ISO 11783-5, address
        violation)."""
        if self.state is not HELD or now_us - self._violated_at_us < VIOLATION_US:
            return []
        self._violated_at_us = now_us
        return [AddressMessage(AddressClaimed(self.number), self.candidate)]

    def on_request(self, everybody: bool, now_us: int) -> list[AddressMessage]:
        """Handle a request for address claimed. If all devices were asked, each answers after its
        own random delay, once for all requests in that time, because a fleet that boots together
        asks often."""
        if self.state is WAITING:
            return []
        if not everybody:
            return [self._answer()]
        if self._answer_at_us is None:
            self._answer_at_us = now_us + self._rng.randrange(256) * DELAY_STEP_US
        return []

    def _answer(self) -> AddressMessage:
        source = NULL_ADDRESS if self.state is CANNOT else self.candidate
        return AddressMessage(AddressClaimed(self.number), source)

    def _claim(self, now_us: int) -> list[AddressMessage]:
        holder = self.names.get(self.candidate, self.number)
        if holder < self.number or (self._modest_for_us is not None and holder != self.number):
            return self._move(now_us)
        at_once = AT_ONCE_FIRST <= self.candidate <= AT_ONCE_LAST
        wait_for_us = SAID_US if at_once else ADDRESS_CONTENTION_US
        return self._contend(wait_for_us, now_us)

    def _contend(self, wait_for_us: int, now_us: int) -> list[AddressMessage]:
        """Claim the candidate address; for `wait_for_us` another device may object."""
        self._machine.fire(ClaimEvent.CLAIMED)
        self._next_at_us = now_us + wait_for_us
        return [AddressMessage(AddressClaimed(self.number), self.candidate)]

    def _defend(self, now_us: int) -> list[AddressMessage]:
        self._defences = [t for t in self._defences if t > now_us - S]
        if len(self._defences) >= DEFENCES_MAX:
            self.refused += 1
            return []
        self._defences.append(now_us)
        return [AddressMessage(AddressClaimed(self.number), self.candidate)]

    def _move(self, now_us: int) -> list[AddressMessage]:
        """Take the next address that is not held by a lower NAME."""
        width = LAST - FIRST + 1
        for step in range(1, width + 1):
            address = FIRST + (self.candidate - FIRST + step) % width
            if self._modest_for_us is not None:
                address = FIRST + (min(self.candidate, LAST + 1) - FIRST - step) % width
            if self.names.get(address) is None:
                self.candidate = address
                return self._contend(ADDRESS_CONTENTION_US, now_us)
        self._machine.fire(ClaimEvent.EXHAUSTED)
        self._next_at_us = None
        if self._modest_for_us is None:
            self._next_at_us = now_us + self._retry_for_us + self._rng.randrange(S)
            self._retry_for_us = min(2 * self._retry_for_us, RETRY_MAX_US)
        return [AddressMessage(AddressClaimed(self.number), NULL_ADDRESS)]
