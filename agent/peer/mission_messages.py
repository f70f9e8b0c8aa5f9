"""Passes the frames of a mission to it, and sends what it wants to say with each beacon."""

from collections.abc import Mapping, Set
from typing import Any

from agent.interface.effects import Persist, Send
from agent.interface.mission import Mission
from agent.peer import notices
from agent.peer.part import NOTHING, Handler, Header, Listener, Outputs, Part, StepContext
from protocol.frames.agreement_frames import AgreementMessage, SilentPosition
from protocol.frames.delivery_frames import (
    Itinerary,
    PlanOffer,
    PlanRow,
    TaskBid,
    TaskBookDigest,
    TaskOrder,
)

OF_MISSIONS = (
    AgreementMessage,
    SilentPosition,
    TaskOrder,
    TaskBookDigest,
    TaskBid,
    Itinerary,
    PlanOffer,
    PlanRow,
)


class MissionMessages(Part):
    """The part between the mission and the bus."""

    def __init__(self, mission: Mission | None, members: Set[int]) -> None:
        """`members`: the slots of the fleet, as configured."""
        self.mission, self.members = mission, members
        self.refused = 0  # frames about robots that the fleet does not have

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return dict.fromkeys(OF_MISSIONS, self._message)

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {notices.BeatDue: self._say}

    def _message(self, ctx: StepContext, header: Header, m: Any) -> Outputs:
        if self.mission is None:
            return NOTHING
        if type(m) is SilentPosition and m.slot not in self.members:
            self.refused += 1  # it would be told on for ever, as a body that nobody can take away
            return NOTHING
        records = self.mission.on_message(header.slot, m, ctx.now_us)
        return [Persist(*record) for record in records]

    def _say(self, ctx: StepContext, notice: notices.BeatDue) -> Outputs:
        if self.mission is None:
            return NOTHING
        return [Send(message) for message in self.mission.outgoing(ctx.now_us)]
