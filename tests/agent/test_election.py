"""Elections: one vote a term, the newest term counts, and who was away for a moment is told of it."""

from agent.election import Election
from protocol.fleet_frames import LeaderElectionVote

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
