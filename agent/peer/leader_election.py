"""Elections for conveniences: the leader alone answers an operator's device that asks everybody.

Never for stopping, claims or maps. A vote is fixed once cast: one vote per voter, election and
term, remembered durably. A candidate leads when it holds the votes of a majority of the live view;
a later term fences an earlier one. Two sides of a split have a leader each, and the higher term
(then the lower slot) remains when they meet. Votes are said again now and then: one that was lost would
leave its voter, or those that missed it, without a leader for good.

All prefer the lowest slot of the live view. Health has no vote: a leader does nothing that another could
not do at once, and a preference that changes would be an election each time.
"""

from typing import NamedTuple

from agent.interface.config import MS, S
from protocol.frames.fleet_frames import LeaderElectionVote

OPERATOR_GATEWAY = 1  # who speaks for the fleet to an operator: `agent/peer/fleet_summary.py`
TERM_MAX = 0xFFFF  # u16 on the wire; at one term a second it lasts 18 hours without a restart
SETTLE_US = 1 * S  # the live view stands still for so long before it is voted upon
SPACING_US, SPACING_US_MAX = (
    500 * MS,
    8 * S,
)  # between two votes of one peer, terms without a leader
AGAIN_US = (
    10 * S
)  # between two times that the same is said: 100 robots take 0.6 % of the bus for it
PATIENCE = (
    3  # settlings that a robot without memory waits to hear a term: who is there speaks in one
)


class Leader(NamedTuple):
    term: int
    slot: int


class Election:
    """One peer's view of one election."""

    def __init__(
        self, election: int, slot: int, name_hash: int, term: int = 0, forgot: bool = False
    ) -> None:
        """`forgot`: an earlier life may have voted, nobody knows in which terms: not in later ones
        than those that the others are in."""
        self.election, self.slot, self.name_hash = election, slot, name_hash
        self.term = term  # the highest term seen
        self._patience = PATIENCE if forgot else 0  # more than 0: it has no vote yet
        self.votes: dict[int, int] = {}  # voter -> candidate, of this term
        self.leader: Leader | None = None
        self._live: frozenset[int] = frozenset({slot})
        self._call_us: int | None = None
        self._vote_to_say: LeaderElectionVote | None = None
        self._say_us = 0  # not before
        self._again_us = 0
        self._spacing_us = SPACING_US

    # ---------------------------------------------------------------- when

    @property
    def deadline_us(self) -> int | None:
        return self._call_us

    def see(self, now_us: int) -> None:
        """The live view changed. Nobody votes before it has stood still: a fleet that is switched on
        changes its view with every robot, and each would be a vote of everybody."""
        self._call_us = now_us + SETTLE_US

    def tick(self, live: frozenset[int], now_us: int) -> None:
        if self._call_us is None or now_us < self._call_us:
            return
        self._call_us = None
        if self._patience:
            self._patience -= 1
            if self.term == 0 and self._patience:  # nobody has been heard
                self.see(now_us)
                return
            self._patience = 0
        self._say(self.call(live))

    def heard(self, voter: int, vote: LeaderElectionVote, live: frozenset[int]) -> None:
        self._say(self.receive(voter, vote, live))

    def _say(self, vote: LeaderElectionVote | None) -> None:
        if vote is not None:
            self._vote_to_say = vote

    def speak(self, now_us: int) -> LeaderElectionVote | None:
        """The vote that goes with this beat. Terms without a leader are opened ever more slowly."""
        vote = self._vote_to_say
        if vote is None:
            if now_us < self._again_us or self.slot not in self.votes:
                return None
            self._again_us, self._say_us = now_us + AGAIN_US, now_us + SPACING_US
            return self._own
        if now_us < self._say_us:
            return None
        self._vote_to_say, self._again_us = None, now_us + AGAIN_US
        if self.leader is not None:
            self._spacing_us = SPACING_US
        self._say_us = now_us + self._spacing_us
        self._spacing_us = min(2 * self._spacing_us, SPACING_US_MAX)
        return vote

    def fence(self, term: int, now_us: int) -> None:
        """That term was there already, before we came: ours has to be later."""
        if (term >= self.term and self.leader is None) or term > self.term:
            self._open(term + 1)
            self.see(now_us)

    # ---------------------------------------------------------------- what

    def call(self, live: frozenset[int]) -> LeaderElectionVote | None:
        """The live view changed: vote, vote again for those that have just come, or open a new
        term where the leader is gone or the votes are split. None: nothing to say."""
        gained, self._live = live - self._live, live
        if self.leader is not None and self.leader.slot not in live:
            self._open(self.term + 1)
        if self.slot not in self.votes:
            return self._vote(live)
        self._count(live)
        return self._next_term(live) or (self._vote(live) if gained else None)

    def receive(
        self, voter: int, vote: LeaderElectionVote, live: frozenset[int]
    ) -> LeaderElectionVote | None:
        """Count a vote; answer with ours where its term is new to us, or ours new to the voter: who was
        back before anybody missed it changes no view, and would keep to its first term for good."""
        if self._patience:
            self.term = min(max(self.term, vote.term + 1), TERM_MAX)
            return None
        if vote.term < self.term:
            return self._vote(live) if self.slot in self.votes else None  # fenced
        answer = None
        if vote.term > self.term:
            self._open(vote.term)
        self.votes.setdefault(voter, vote.candidate)
        if self.slot not in self.votes:
            answer = self._vote(live)
        self._count(live)
        return self._next_term(live) or answer

    def _next_term(self, live: frozenset[int]) -> LeaderElectionVote | None:
        """Everybody has voted and nobody has a majority: vote again, with the views of now."""
        if self.leader is not None or not live <= self.votes.keys():
            return None
        self._open(self.term + 1)
        return self._vote(live)

    def _vote(self, live: frozenset[int]) -> LeaderElectionVote:
        # Everybody prefers the lowest live slot, so one round settles it where views are equal.
        self.votes.setdefault(self.slot, min(live))
        self._count(live)
        return self._own

    @property
    def _own(self) -> LeaderElectionVote:
        candidate = self.votes[self.slot]
        return LeaderElectionVote(self.election, self.term, candidate, 0, self.name_hash)

    def _open(self, term: int) -> None:
        self.term, self.votes, self.leader = min(term, TERM_MAX), {}, None

    def _count(self, live: frozenset[int]) -> None:
        heard = [candidate for voter, candidate in self.votes.items() if voter in live]
        self.leader = None
        for candidate in sorted(set(heard)):
            if 2 * heard.count(candidate) > len(live):
                self.leader = Leader(self.term, candidate)
