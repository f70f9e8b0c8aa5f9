"""Elections: one vote a term, the newest term counts, and a robot that was away learns it."""

from random import Random

from agent.interface.config import MS, S
from agent.peer.durable_records import DurableRecords
from agent.peer.leader_election import (
    AGAIN_US,
    PATIENCE,
    SETTLE_US,
    SPACING_US,
    TERM_MAX,
    Election,
)
from protocol.frames.fleet_frames import LeaderElectionVote

BOTH = frozenset({0, 1})


def _vote(term: int, candidate: int) -> LeaderElectionVote:
    return LeaderElectionVote(1, term, candidate, 0, 0)


def test_who_comes_back_without_memory_before_it_is_missed_is_told_of_the_term() -> None:
    stayed, back = Election(1, 0, 0, term=2), Election(1, 1, 0)
    stayed.call(BOTH)
    stayed.receive(1, _vote(2, 0), BOTH)  # of its earlier life
    old = back.call(BOTH)
    assert old is not None and old.term == 0
    answer = stayed.receive(1, old, BOTH)
    assert answer == _vote(2, 0)
    told = back.receive(0, answer, BOTH)
    assert told == _vote(2, 0)
    assert back.leader is not None and back.leader == stayed.leader


def test_an_old_vote_does_not_count() -> None:
    election = Election(1, 0, 0, term=3)
    election.call(BOTH)
    election.receive(1, _vote(2, 1), BOTH)
    assert election.votes == {0: 0} and election.leader is None


def test_a_vote_that_was_lost_is_said_again() -> None:
    """Found by `headland chaos`, profile protocol, seeds 1197 and 1300: who voted behind a cut or in
    noise kept a term of its own for good, and knew of no leader."""
    here, there = Election(1, 0, 0), Election(1, 1, 0, term=3)
    here._say(here.call(BOTH))
    there._say(there.call(BOTH))
    for now_us in (0, 1):
        assert there.speak(now_us) == (None if now_us else _vote(3, 0))  # nobody hears it
    assert here.speak(0) == _vote(0, 0)
    assert here.leader is None and there.leader is None
    again = there.speak(AGAIN_US)
    assert again == _vote(3, 0)
    here.heard(1, again, BOTH)
    answer = here.speak(AGAIN_US)
    assert answer == _vote(3, 0)
    there.heard(0, answer, BOTH)
    assert here.leader == there.leader == (3, 0)


def test_who_has_lost_its_memory_votes_in_no_term_that_was_there_before() -> None:
    """Found by `headland chaos`, profile protocol, seed 1181: it had voted otherwise in that term."""
    back = Election(1, 1, 0, forgot=True)
    back.see(0)
    assert back.receive(0, _vote(4, 0), BOTH) is None
    back.tick(BOTH, SETTLE_US)
    vote = back.speak(SETTLE_US)
    assert vote == _vote(5, 0)


def test_who_has_lost_its_memory_does_not_wait_for_ever_to_be_told_of_a_term() -> None:
    back, said = Election(1, 1, 0, forgot=True), list[LeaderElectionVote]()
    back.see(0)
    for settling in range(1, PATIENCE + 1):
        assert not said
        back.tick(BOTH, settling * SETTLE_US)
        said += [vote for vote in [back.speak(settling * SETTLE_US)] if vote is not None]
    assert said == [_vote(0, 0)]


def test_what_is_said_again_keeps_no_new_vote_waiting() -> None:
    """Found by `headland chaos`, profile protocol, seed 20094: a robot that had repeated its vote for
    long without a leader kept its vote of a new term to itself for half a minute."""
    alone = Election(1, 1, 0, term=2)
    alone._say(alone.call(BOTH))
    now_us = 0
    for _ in range(20):
        while alone.speak(now_us) is None:
            now_us += 100 * MS
    alone.heard(0, _vote(3, 0), BOTH)
    assert alone.speak(now_us + SPACING_US) == _vote(3, 0)


def test_a_forged_vote_with_the_last_term_ends_no_robot_at_its_next_start() -> None:
    """Its term is on the disk, and the next one does not fit into a record."""
    recalled = dict([DurableRecords.vote(TERM_MAX, 0)])
    records = DurableRecords(recalled, first_boot=False, rng=Random(1))
    assert records.term == TERM_MAX
    election = Election(1, 0, 0x1234, records.term)
    election.see(0)
    election.tick(frozenset({0, 1}), 10 * S)
    vote = election.speak(10 * S)
    assert vote is not None and DurableRecords.vote(vote.term, vote.candidate)
