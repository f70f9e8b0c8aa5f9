"""Becoming a member: claim an address, then announce our slot from it."""

from collections.abc import Sequence
from random import Random
from typing import TYPE_CHECKING

from agent.interface.config import ADDRESS_FIRST
from agent.interface.effects import Effect, Send
from protocol.address import AddressClaim, AddressMessage
from protocol.frames.fleet_frames import Member
from protocol.frames.identifier import NULL_ADDRESS
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import AddressClaimed, Request

if TYPE_CHECKING:
    from agent.interface.identity import Identity

CLAIM_PGN = GROUP_OF[AddressClaimed].pgn


class NetworkJoin:
    def __init__(self, identity: "Identity", incarnation: int, rng: Random, now_us: int) -> None:
        self.identity, self.incarnation = identity, incarnation
        self.machine = AddressClaim(identity.name, ADDRESS_FIRST + identity.slot, rng, now_us)
        self.joined = False
        self.lost_address = False
        self.away = False  # we left on purpose: claim nothing before `rejoin`
        self._spoke_us: dict[int, int] = {}  # address -> when we last claimed it, or lost it
        self._ask_all = True  # request all address claims before we claim one

    @property
    def address(self) -> int | None:
        return self.machine.address

    @property
    def deadline_us(self) -> int | None:
        return None if self.away else self.machine.deadline_us

    def due(self, now_us: int) -> bool:
        """Whether `tick` has something to do."""
        if not self.joined or self.lost_address:
            return True
        due_us = self.deadline_us
        return due_us is not None and now_us >= due_us

    def tick(self, now_us: int) -> Sequence[Effect]:
        if self.away:
            return ()
        effects = self._sends(self.machine.tick(now_us), now_us)
        if self.machine.asks or (effects and self._ask_all):
            self._ask_all = self.machine.asks = False
            effects.insert(0, Send(Request(CLAIM_PGN), source=NULL_ADDRESS))
        if self.machine.address is not None and not self.joined:
            self.joined = True
            effects.append(Send(self.announcement))
        return effects

    def asked(self, everybody: bool, now_us: int) -> Sequence[Effect]:
        """A request for our address claim. After a global request we receive all answers as well."""
        self._ask_all = self._ask_all and not everybody
        return self._sends(self.machine.asked(everybody, now_us), now_us)

    def receive(self, source: int, message: AddressClaimed, now_us: int) -> Sequence[Effect]:
        effects = self._sends(self.machine.receive(source, message, now_us), now_us)
        if self.joined and self.machine.address is None:
            self.joined, self.lost_address = False, True
            self._spoke_us[source] = now_us
        return effects

    def violated(self, now_us: int) -> Sequence[Effect]:
        """Another device sends from our address."""
        return self._sends(self.machine.violated(now_us), now_us)

    def changed_hands(self, source: int, message: AddressClaimed) -> bool:
        """Whether a different NAME than before claims this address."""
        return self.machine.names.get(source, message.name) != message.name

    def hurry(self, now_us: int) -> None:
        """Claim an address quickly, because there is a stop to send."""
        if not self.away:
            self.machine.hurry(now_us)

    def rejoin(self, now_us: int) -> None:
        self.joined = self.lost_address = self.away = False
        self._ask_all = True
        self.machine.restart(now_us)

    def leave(self) -> None:
        self.joined, self.away = False, True

    @property
    def announcement(self) -> Member:
        return Member(self.identity.slot, self.incarnation, self.identity.field_hash)

    def spoke_at(self, address: int, since_us: int) -> bool:
        """Whether we had that address, or claimed it, at that time or later."""
        return self._spoke_us.get(address, since_us - 1) >= since_us

    def _sends(self, claims: list[AddressMessage], now_us: int) -> list[Effect]:
        for claim in claims:
            self._spoke_us[claim.source] = now_us
        return [Send(c.message, c.destination, c.source) for c in claims]
