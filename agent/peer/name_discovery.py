"""Asks devices for their NAME, the address claim, where we have missed it."""

from collections.abc import Mapping
from typing import Any

from agent.interface.effects import Effect, Send
from agent.interface.instants import FOREVER_US
from agent.peer import notices
from agent.peer.member_discovery import CLAIM_REQUEST, MemberDiscovery
from agent.peer.network_join import CLAIM_PGN, NetworkJoin
from agent.peer.part import NOTHING, Listener, Outputs, Part, StepContext
from protocol.frames.identifier import NULL_ADDRESS


class NameDiscovery(Part):
    """The part that asks addresses for the NAME of their device (J1939-81)."""

    def __init__(self, slot: int, joining: NetworkJoin) -> None:
        self.asks, self.joining = MemberDiscovery(slot, CLAIM_PGN), joining

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {notices.RequestOverheard: self._overheard, notices.Rejoining: self._power_up}

    @property
    def due_at_us(self) -> int:
        due_at_us = None if self.joining.away else self.asks.due_at_us
        return FOREVER_US if due_at_us is None else due_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        if self.joining.away:
            return NOTHING
        asked = self.asks.tick(ctx.now_us)
        return asked if self.joining.address is not None else [*map(_unclaimed, asked)]

    def _overheard(self, ctx: StepContext, notice: notices.RequestOverheard) -> Outputs:
        if notice.data == CLAIM_REQUEST:
            self.asks.overheard(notice.destination, ctx.now_us)
        return NOTHING

    def _power_up(self, ctx: StepContext, notice: notices.Rejoining) -> Outputs:
        self.asks.power_up()
        return NOTHING


def _unclaimed(request: Effect) -> Effect:
    """Send this request from the null address, because we have no address yet (J1939-81)."""
    return request._replace(source=NULL_ADDRESS) if isinstance(request, Send) else request
