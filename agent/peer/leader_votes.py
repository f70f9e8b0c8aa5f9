"""Casts and counts this peer's votes, made durable before they are sent (`leader_election.py`)."""

from collections.abc import Mapping
from typing import Any

from agent.interface.effects import Persist, Send, Trace
from agent.peer import notices
from agent.peer.durable_records import DurableRecords
from agent.peer.leader_election import Election, Leader
from agent.peer.part import NOTHING, Handler, Header, Listener, Outputs, Part, StepContext
from protocol.frames.fleet_frames import LeaderElectionVote


class LeaderVotes(Part):
    """The part that takes part in the election of the robot that answers for the fleet."""

    def __init__(self, election: Election) -> None:
        self.election = election
        self._led: Leader | None = None

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {LeaderElectionVote: self._vote}

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {notices.MembershipChanged: self._members, notices.BeatDue: self._speak}

    @property
    def leader(self) -> int | None:
        """The slot of the elected leader as this peer knows it; None if there is none."""
        leader = self.election.leader
        return None if leader is None else leader.slot

    def _vote(self, ctx: StepContext, header: Header, m: LeaderElectionVote) -> Outputs:
        if header.slot is not None and m.election == self.election.election:
            self.election.heard(header.slot, m, ctx.live)
        return NOTHING

    def _members(self, ctx: StepContext, notice: notices.MembershipChanged) -> Outputs:
        self.election.see(ctx.now_us)
        return NOTHING

    def _speak(self, ctx: StepContext, notice: notices.BeatDue) -> Outputs:
        """With our beacon: persist our vote, then send it, and trace a new leader."""
        outputs: list[Any] = []
        self.election.tick(ctx.live, ctx.now_us)
        vote = self.election.speak(ctx.now_us)
        if vote is not None:
            outputs += [Persist(*DurableRecords.vote(vote.term, vote.candidate)), Send(vote)]
        leader = self.election.leader
        if leader != self._led and leader is not None:
            outputs.append(Trace("election", "", "LEADER", f"{leader.slot}", f"term {leader.term}"))
        self._led = leader
        return outputs
