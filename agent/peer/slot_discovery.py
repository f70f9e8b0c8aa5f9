"""Asks robots for their slot, the MEMBER frame, and answers with ours when others ask."""

from collections.abc import Mapping
from typing import Any

from agent.interface.effects import Send
from agent.interface.instants import FOREVER_US
from agent.peer import notices
from agent.peer.frame_origin import Origins
from agent.peer.member_discovery import CLAIM_PGN, MEMBER_PGN, MEMBER_REQUEST, MemberDiscovery
from agent.peer.network_join import NetworkJoin
from agent.peer.part import NOTHING, Listener, Outputs, Part, StepContext


class SlotDiscovery(Part):
    """The part that finds out which member sends from which address."""

    def __init__(self, slot: int, joining: NetworkJoin, origins: Origins) -> None:
        self.asks, self.joining, self.origins = MemberDiscovery(slot, MEMBER_PGN), joining, origins

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {
            notices.AddressGained: lambda ctx, n: self.asks.joined(),
            notices.StrangerHeard: self._stranger,
            notices.RobotNamed: self._stranger,
            notices.MemberAnnounced: self._announced,
            notices.RequestOverheard: self._overheard,
            notices.GroupRequested: self._requested,
            notices.Rejoining: self._power_up,
            notices.BeatDue: self._answer,
        }

    @property
    def due_at_us(self) -> int:
        due_at_us = self.asks.due_at_us if self.joining.joined else None
        return FOREVER_US if due_at_us is None else due_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        return self.asks.tick(ctx.now_us) if ctx.joined else NOTHING

    def _stranger(
        self, ctx: StepContext, notice: notices.StrangerHeard | notices.RobotNamed
    ) -> Outputs:
        if ctx.joined and self.origins.is_robot(notice.address):
            self.asks.stranger(notice.address, ctx.now_us)
        return NOTHING

    def _announced(self, ctx: StepContext, notice: notices.MemberAnnounced) -> Outputs:
        self.asks.known(notice.address)
        return NOTHING

    def _overheard(self, ctx: StepContext, notice: notices.RequestOverheard) -> Outputs:
        if notice.data == MEMBER_REQUEST:
            self.asks.overheard(notice.destination, ctx.now_us)
        return NOTHING

    def _requested(self, ctx: StepContext, notice: notices.GroupRequested) -> Outputs:
        if notice.pgn == MEMBER_PGN:
            self.asks.asked(notice.everybody)
        elif notice.pgn == CLAIM_PGN:
            self.asks.answer_due |= not notice.everybody  # the slot is requested next anyway
        return NOTHING

    def _power_up(self, ctx: StepContext, notice: notices.Rejoining) -> Outputs:
        self.asks.power_up()
        return NOTHING

    def _answer(self, ctx: StepContext, notice: notices.BeatDue) -> Outputs:
        if not self.asks.answer_due:
            return NOTHING
        self.asks.answer_due = False
        return [Send(self.joining.announcement)]
