"""Becoming a member: claim an address (ISO 11783-5, J1939-81), then announce our slot from it."""

from collections.abc import Mapping, Sequence
from random import Random
from typing import Any

from agent.interface.config import ADDRESS_FIRST
from agent.interface.effects import HALT, Effect, Send
from agent.interface.identity import Identity
from agent.interface.instants import FOREVER_US
from agent.peer import notices
from agent.peer.part import NOTHING, Listener, Outputs, Part, StepContext
from protocol.address import CANNOT, AddressClaim, AddressMessage
from protocol.frames.fleet_frames import Member
from protocol.frames.identifier import NULL_ADDRESS
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import AddressClaimed, Request

CLAIM_PGN = GROUP_OF[AddressClaimed].pgn


class NetworkJoin(Part):
    """The part that claims our address and announces our slot."""

    def __init__(self, identity: Identity, incarnation: int, rng: Random, now_us: int) -> None:
        self.identity, self.incarnation = identity, incarnation
        self.machine = AddressClaim(identity.name, ADDRESS_FIRST + identity.slot, rng, now_us)
        self.joined = False
        self.lost_address = False
        self.away = False  # claim nothing before we rejoin
        self.left = False  # we are away on purpose, not because the bus is gone
        self._without = False  # it was told that there is no address for us
        self._spoke_at_us: dict[int, int] = {}  # address -> when we last claimed it, or lost it
        self._ask_all = True  # request all address claims before we claim one

    @property
    def address(self) -> int | None:
        """Our source address; None while we have none."""
        return self.machine.address

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {
            notices.GroupRequested: self._requested,
            notices.AddressCommanded: self._commanded,
            notices.Rejoining: self._rejoin,
            notices.BusLost: self._off,
            notices.Left: self._leave,
        }

    @property
    def due_at_us(self) -> int:
        due_at_us = None if self.away else self.machine.due_at_us
        return FOREVER_US if due_at_us is None else due_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        if self.joined and not self.lost_address and ctx.now_us < self.due_at_us:
            return NOTHING
        outputs: list[Any] = []
        if self.lost_address:  # tell this first: we may get a new address in this turn
            outputs += [HALT, notices.AddressLost()]
            self.lost_address = False
        if self.away:
            return outputs
        claims = self._sends(self.machine.on_tick(ctx.now_us), ctx.now_us)
        if self.machine.asks or (claims and self._ask_all):
            self._ask_all = self.machine.asks = False
            outputs.append(Send(Request(CLAIM_PGN), source=NULL_ADDRESS))
        outputs += claims
        if self.machine.state is not CANNOT:
            self._without = False
        elif not self._without:  # else a robot that never had one would not say why it stands
            self._without = True
            outputs += [HALT, notices.AddressLost()]
        address = self.machine.address
        if address is not None and not self.joined:
            self.joined = True
            outputs += [
                Send(self.announcement),
                notices.AddressGained(address),
                notices.FleetJoined(address),
            ]
        return outputs

    def asked(self, everybody: bool, now_us: int) -> Sequence[Effect]:
        """A request for our address claim. After a global request we receive all answers as well."""
        self._ask_all = self._ask_all and not everybody
        return self._sends(self.machine.on_request(everybody, now_us), now_us)

    def receive(self, source: int, message: AddressClaimed, now_us: int) -> Sequence[Effect]:
        """An address claim of another device, from address `source`."""
        effects = self._sends(self.machine.on_message(source, message, now_us), now_us)
        if self.joined and self.machine.address is None:
            self.joined, self.lost_address = False, True
            self._spoke_at_us[source] = now_us
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

    def _requested(self, ctx: StepContext, notice: notices.GroupRequested) -> Outputs:
        return self.asked(notice.everybody, ctx.now_us) if notice.pgn == CLAIM_PGN else NOTHING

    def _commanded(self, ctx: StepContext, notice: notices.AddressCommanded) -> Outputs:
        """Claim another address. Without an address the robot stands, as after losing one."""
        effects = self._sends(self.machine.command(notice.address, ctx.now_us), ctx.now_us)
        if self.joined and self.machine.address is None:
            self.joined, self.lost_address = False, True
        return effects

    def _rejoin(self, ctx: StepContext, notice: notices.Rejoining) -> Outputs:
        self.joined = self.lost_address = self.away = self.left = False
        self._ask_all = True
        self.machine.restart(ctx.now_us)
        return NOTHING

    def _leave(self, ctx: StepContext, notice: notices.Left) -> Outputs:
        self.joined, self.away, self.left = False, True, True
        return NOTHING

    def _off(self, ctx: StepContext, notice: notices.BusLost) -> Outputs:
        """The controller is off the bus."""
        self.joined, self.away = False, True
        return NOTHING

    @property
    def announcement(self) -> Member:
        """The frame that binds our slot and incarnation to our address."""
        return Member(self.identity.slot, self.incarnation, self.identity.config_hash)

    def spoke_from(self, address: int, start_at_us: int) -> bool:
        """Whether we had that address, or claimed it, at that time or later."""
        return self._spoke_at_us.get(address, start_at_us - 1) >= start_at_us

    def _sends(self, claims: list[AddressMessage], now_us: int) -> list[Effect]:
        for claim in claims:
            self._spoke_at_us[claim.source] = now_us
        return [Send(c.message, c.destination, c.source) for c in claims]
