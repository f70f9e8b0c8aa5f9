"""Leader election for conveniences: only the leader answers an operator's global request.

Never use it for stopping, claims or maps. A vote is fixed once cast: one vote for each voter,
election and term, kept durably. A candidate leads when it holds the votes of a majority of the live
view. A later term fences an earlier one. After a network split each side has a leader. When the
sides meet, the one with the higher term remains, then the one with the lower slot. Votes are
repeated every 10 s, because a lost vote would otherwise leave robots without a leader for good.

All members prefer the lowest slot of the live view. Health is not considered: any robot can do the
leader's task, and a preference that changes would cause an election each time.
"""

from typing import NamedTuple

from agent.interface.config import MS, S
from protocol.frames.fleet_frames import LeaderElectionVote

OPERATOR_GATEWAY = 1  # election of the robot that answers operators: `agent/peer/fleet_summary.py`
TERM_MAX = 0xFFFF  # u16 on the wire; at one term a second it lasts 18 hours without a restart
# Terms by which one frame moves ours: a fleet without a leader uses up fewer in two hours, and one forged
# frame must not use up all. A robot that is further behind needs a few frames.
TERMS_AHEAD_MAX = 1000
SETTLE_US = 1 * S  # the live view must be unchanged for this long before a vote
# Between two votes of one peer while terms have no leader.
SPACING_US, SPACING_US_MAX = (500 * MS, 8 * S)
AGAIN_US = 10 * S  # between repetitions of the same vote: 100 robots take 0.6 % of the bus
# Settle times that a robot without memory waits for a term; a running election is heard within one.
PATIENCE = 3


class Leader(NamedTuple):
    """The leader of a term, by its slot."""

    term: int
    slot: int


class Election:
    """One peer's view of one election."""

    def __init__(
        self,
        election: int,
        slot: int,
        name_hash: int,
        term: int = 0,
        forgot: bool = False,
        voted: int | None = None,
    ) -> None:
        """`forgot`: we may have voted before a restart that lost the memory. `voted`: whom we voted for
        in this term before the restart.

        The terms of forgotten votes are unknown, but not later than the terms of the other members."""
        self.election, self.slot, self.name_hash = election, slot, name_hash
        self.term = term  # the highest term seen
        self._patience = PATIENCE if forgot else 0  # above 0: it must not vote yet
        self._lags = False  # it forgot, and its term is not yet later than the one that it was told
        self.votes: dict[int, int] = {}  # voter -> candidate, in this term
        if voted is not None:
            self.votes[slot] = voted
        self.leader: Leader | None = None
        self._live: frozenset[int] = frozenset({slot})
        self._call_at_us: int | None = None
        self._vote_to_say: LeaderElectionVote | None = None
        self._say_at_us = 0  # earliest time of our next vote
        self._again_at_us = 0
        self._spaced_for_us = SPACING_US

    # ---------------------------------------------------------------- when

    @property
    def due_at_us(self) -> int | None:
        """When `tick` has something to do; None: not before the live view changes."""
        return self._call_at_us

    def see(self, now_us: int) -> None:
        """The live view changed. No robot votes before it has settled.

        The view of a fleet that is switched on changes with every robot, and each change would cost
        a vote of every member."""
        self._call_at_us = now_us + SETTLE_US

    def tick(self, live: frozenset[int], now_us: int) -> None:
        """Vote, if the live view has settled. `live`: slots of the live members."""
        if self._call_at_us is None or now_us < self._call_at_us:
            return
        self._call_at_us = None
        if self._patience:
            self._patience -= 1
            if self.term == 0 and self._patience:  # no vote was received
                self.see(now_us)
                return
            self._patience = 0
        self._say(self.call(live))

    def heard(self, voter: int, vote: LeaderElectionVote, live: frozenset[int]) -> None:
        """A vote of member `voter` was received."""
        self._say(self.receive(voter, vote, live))

    def _say(self, vote: LeaderElectionVote | None) -> None:
        if vote is not None:
            self._vote_to_say = vote

    def speak(self, now_us: int) -> LeaderElectionVote | None:
        """The vote to send with this beat. The spacing doubles while terms have no leader."""
        vote = self._vote_to_say
        if vote is None:
            if now_us < self._again_at_us or self.slot not in self.votes:
                return None
            self._again_at_us, self._say_at_us = now_us + AGAIN_US, now_us + SPACING_US
            return self._own
        if now_us < self._say_at_us:
            return None
        self._vote_to_say, self._again_at_us = None, now_us + AGAIN_US
        if self.leader is not None:
            self._spaced_for_us = SPACING_US
        self._say_at_us = now_us + self._spaced_for_us
        self._spaced_for_us = min(2 * self._spaced_for_us, SPACING_US_MAX)
        return vote

    def repeat(self) -> None:
        """Say our vote again with the next beat. Others answer if there is a later term."""
        if self.slot in self.votes:
            self._say(self._own)

    def fence(self, term: int, now_us: int) -> None:
        """That term existed before we joined, so ours must be later."""
        if (term >= self.term and self.leader is None) or term > self.term:
            self._open(self._reached(term + 1))
            self.see(now_us)

    def take_slot(self, slot: int, met_others: bool, now_us: int) -> None:
        """We have another slot, or one for the first time. `met_others`: others have voted, it may be.

        We, or the robot that had the slot before, may have voted otherwise in this term, and others keep
        the first vote that they heard from a slot. So a new term begins."""
        self.slot = slot
        if met_others:
            self._open(self.term + 1)
        self.votes.clear()
        self.see(now_us)

    # ---------------------------------------------------------------- what

    def call(self, live: frozenset[int]) -> LeaderElectionVote | None:
        """The live view changed: vote, repeat the vote for new members, or open a new term.

        A new term is opened if the leader is gone or the votes are split. None: nothing to send."""
        gained, self._live = live - self._live, live
        if self.leader is not None and self.leader.slot not in live:
            self._open(self.term + 1)
        first = self.slot not in self.votes
        vote = self._vote(live) if first or gained else None
        self._count(live)
        if self.leader is not None and self.leader.slot not in live:
            # It fell silent before it had all of these votes, so no view will change for it again.
            self._open(self.term + 1)
            return self._vote(live)
        return (None if first else self._next_term(live)) or vote

    def receive(
        self, voter: int, vote: LeaderElectionVote, live: frozenset[int]
    ) -> LeaderElectionVote | None:
        """Count a vote. Answer with ours if its term is new to us, or our term is new to the voter.

        The answer is needed for a member that restarted before its silence was noticed: no view
        changes, so it would keep its first term for good."""
        if self._patience:
            wanted = max(self.term, vote.term + 1)
            self.term = self._reached(wanted)
            self._lags = self.term < min(wanted, TERM_MAX)
            return None
        if vote.term < self.term:
            return self._vote(live) if self.slot in self.votes else None  # fenced
        answer = None
        if vote.term > self.term:
            wanted = vote.term + self._lags
            self._open(self._reached(wanted))
            self._lags &= self.term < min(wanted, TERM_MAX)
        if vote.term == TERM_MAX == self.term:  # no later term follows, so the newest vote counts
            self.votes[voter] = vote.candidate
        elif vote.term == self.term:
            self.votes.setdefault(voter, vote.candidate)
        if self.slot not in self.votes:
            answer = self._vote(live)
        self._count(live)
        chosen = self.votes.get(self.slot)
        if self.leader is not None and self.leader.slot == chosen and chosen not in live:
            # Votes that come after it fell silent. A member that we never received may live, so only
            # our own vote for it counts here.
            self._open(self.term + 1)
            return self._vote(live)
        return self._next_term(live) or answer

    def _next_term(self, live: frozenset[int]) -> LeaderElectionVote | None:
        """If all have voted and no candidate has a majority, vote again with the current view."""
        if self.leader is not None or not live <= self.votes.keys():
            return None
        self._open(self.term + 1)
        return self._vote(live)

    def _vote(self, live: frozenset[int]) -> LeaderElectionVote:
        # Every member prefers the lowest live slot, so equal views need one round only.
        self.votes.setdefault(self.slot, min(live))
        self._count(live)
        return self._own

    @property
    def _own(self) -> LeaderElectionVote:
        candidate = self.votes[self.slot]
        return LeaderElectionVote(self.election, self.term, candidate, 0, self.name_hash)

    def _reached(self, wanted: int) -> int:
        """The term that we open when a frame tells us of the term `wanted`."""
        return min(wanted, self.term + TERMS_AHEAD_MAX, TERM_MAX)

    def _open(self, term: int) -> None:
        self.term, self.votes, self.leader = min(term, TERM_MAX), {}, None

    def _count(self, live: frozenset[int]) -> None:
        heard = [candidate for voter, candidate in self.votes.items() if voter in live]
        self.leader = None
        for candidate in sorted(set(heard)):
            if 2 * heard.count(candidate) > len(live):
                self.leader = Leader(self.term, candidate)
