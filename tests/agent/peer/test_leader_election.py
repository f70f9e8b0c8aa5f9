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
    TERMS_AHEAD_MAX,
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


def test_one_forged_vote_does_not_use_the_terms_up() -> None:
    election = Election(1, 0, 0, term=7)
    election.call(BOTH)
    answer = election.receive(1, _vote(TERM_MAX, 1), BOTH)
    assert election.term == 7 + TERMS_AHEAD_MAX
    assert answer == _vote(7 + TERMS_AHEAD_MAX, 0) and 1 not in election.votes, (
        "it counts in its own term"
    )
    election.fence(TERM_MAX, 0)
    assert election.term == 7 + 2 * TERMS_AHEAD_MAX


def test_a_robot_that_joins_late_gets_to_a_term_that_is_far_ahead() -> None:
    term = 5 * TERMS_AHEAD_MAX + 3
    stayed, late = Election(1, 0, 0, term=term), Election(1, 1, 0)
    stayed.call(BOTH)
    said = late.call(BOTH)
    for _ in range(6):
        assert said is not None
        answer = stayed.receive(1, said, BOTH)
        assert answer is not None
        said = late.receive(0, answer, BOTH)
    assert late.term == stayed.term == term
    assert said is not None
    stayed.receive(1, said, BOTH)
    assert late.leader == stayed.leader == (term, 0)


def test_a_robot_without_memory_does_not_vote_in_a_far_term_of_before() -> None:
    """It reaches that term by steps, and may have voted in it."""
    term = 2 * TERMS_AHEAD_MAX + 3
    back = Election(1, 1, 0, forgot=True)
    back.receive(0, _vote(term, 0), BOTH)
    back._patience = 0
    said = list[LeaderElectionVote | None]()
    for _ in range(4):
        said.append(back.receive(0, _vote(term, 0), BOTH))
    assert [vote.term for vote in said if vote is not None][-1] == back.term == term + 1
    assert all(vote is None or vote.term != term for vote in said)


def test_after_a_restart_in_the_last_term_a_robot_keeps_its_vote() -> None:
    records = DurableRecords(
        dict([DurableRecords.vote(TERM_MAX, 1)]), first_boot=False, rng=Random(1)
    )
    back = Election(1, 2, 0, records.term, voted=records.voted)
    assert back.call(frozenset({0, 1, 2})) == _vote(TERM_MAX, 1), (
        "and not for robot 0, the lowest one"
    )
    before = DurableRecords(
        dict([DurableRecords.vote(TERM_MAX - 1, 1)]), first_boot=False, rng=Random(1)
    )
    assert before.term == TERM_MAX and before.voted is None


def test_votes_for_a_member_that_fell_silent_before_it_led_make_no_leader_for_good() -> None:
    """Robot 2 heard robot 1 and voted for it. Robot 1 fell silent, and did not lead before."""
    election = Election(1, 2, 0)
    both, alone = frozenset({1, 2}), frozenset({2})
    election.see(0)
    election.tick(both, SETTLE_US)
    assert election.leader is None, "the vote of robot 1 is missing"
    election.see(2 * SETTLE_US)
    election.tick(alone, 3 * SETTLE_US)
    assert election.leader == (1, 2)


def test_late_votes_for_a_member_that_fell_silent_make_no_leader_for_good() -> None:
    """The first votes of all were lost. They are said again after the robot that all chose was gone."""
    everybody, left = frozenset({0, 1, 2, 3}), frozenset({1, 2, 3})
    elections = {slot: Election(1, slot, 0) for slot in left}
    now_us = 0
    for live in (everybody, left):
        for election in elections.values():
            election.see(now_us)
        now_us += SETTLE_US
        for election in elections.values():
            election.tick(live, now_us)
            if live is everybody:
                assert election.speak(now_us) == _vote(0, 0)  # nobody hears it
    for _ in range(3):
        now_us += AGAIN_US
        for slot, election in elections.items():
            vote = election.speak(now_us)
            for other in left - {slot}:
                if vote is not None:
                    elections[other].heard(slot, vote, left)
    assert {election.leader for election in elections.values()} == {(1, 1)}


def test_votes_for_a_member_that_we_alone_do_not_receive_open_no_term() -> None:
    deaf = Election(1, 2, 0)
    heard = frozenset({1, 2, 3})
    deaf.call(heard)
    for voter in (1, 3):
        deaf.receive(voter, _vote(0, 0), heard)
    assert deaf.term == 0 and deaf.leader == (0, 0)


def test_in_the_last_term_the_newest_vote_of_a_robot_counts() -> None:
    """Robot 1 did not notice that robot 0 was gone for a while, so it kept the votes of before."""
    stayed = Election(1, 1, 0, term=TERM_MAX)
    live = frozenset({0, 1, 2})
    stayed.call(live)
    stayed.receive(2, _vote(TERM_MAX, 2), live)
    stayed.receive(0, _vote(TERM_MAX, 2), live)
    assert stayed.leader == (TERM_MAX, 2)
    stayed.receive(2, _vote(TERM_MAX, 0), live)
    assert stayed.leader == (TERM_MAX, 0)
