"""How candidates of one segment come to different numbers; elections are in test_segments_rig.py."""

from itertools import count

from agent.interface.effects import Send
from agent.segments.gateway_election import (
    BEAT_US,
    CANDIDATE_TABLE,
    LISTEN_US,
    NUMBERS,
    CandidateEvent,
    CandidateState,
    GatewayElection,
)
from protocol.frames.fleet_frames import LeaderElectionVote
from protocol.frames.segment_frames import SEGMENT_GATEWAY, GatewayBeat
from tests.state_tables import check_table


def test_every_state_and_event() -> None:
    listening, crowded, candidate = CandidateState
    number_free, none_free, yielded = CandidateEvent
    check_table(CANDIDATE_TABLE, listening, {
        (listening, number_free, candidate), (crowded, number_free, candidate),
        (listening, none_free, crowded), (candidate, yielded, listening),
    })  # fmt: skip


def turn(candidates: list[GatewayElection], now_us: int) -> None:
    """Each sends what is due, and the others receive its beats."""
    for own in candidates:
        for effect in own.on_tick(0, False, now_us):
            if isinstance(effect, Send) and isinstance(effect.message, GatewayBeat):
                for other in candidates:
                    if other is not own:
                        other.on_message(effect.message.candidate, effect.message, now_us)


def test_of_two_with_one_number_the_higher_lot_takes_another() -> None:
    candidates = [GatewayElection(lot, lot, 0) for lot in (7, 9)]
    for own in candidates:  # neither hears the first beat of the other
        own.on_tick(0, False, LISTEN_US)
    assert [own.number for own in candidates] == [NUMBERS[0]] * 2
    for now_us in range(LISTEN_US + BEAT_US, 10 * LISTEN_US, BEAT_US):
        turn(candidates, now_us)
    assert [own.number for own in candidates] == [NUMBERS[0], NUMBERS[1]]
    assert all(own.machine.state is CandidateState.CANDIDATE for own in candidates)


def test_a_candidate_too_many_stays_without_an_address_until_one_falls_silent() -> None:
    candidates = [GatewayElection(lot, lot, 0) for lot in range(len(NUMBERS) + 1)]
    times = count(LISTEN_US, BEAT_US)
    for _ in range(8):
        turn(candidates, next(times))
    late = next(own for own in candidates if own.number is None)
    assert late.machine.state is CandidateState.CROWDED and late.address is None
    silent = next(own for own in candidates if own.number == NUMBERS[2])
    candidates.remove(silent)
    for _ in range(8):
        turn(candidates, next(times))
    assert late.number == NUMBERS[2]


def test_a_candidate_that_still_listens_hears_the_votes_of_others() -> None:
    """It is switched on while the second gateway elects itself, because the first one died."""
    own = GatewayElection(7, 7, 0)
    for term in (0, 3):
        vote = LeaderElectionVote(SEGMENT_GATEWAY, term, NUMBERS[1], 0, 9)
        own.on_message(NUMBERS[1], vote, BEAT_US)
    other = GatewayElection(9, 9, 0)
    for now_us in range(LISTEN_US, 12 * LISTEN_US, BEAT_US):
        turn([own, other], now_us)
    assert [own.number, other.number] == [NUMBERS[0], NUMBERS[1]]


def test_who_takes_another_number_votes_in_no_term_in_which_that_number_has_voted() -> None:
    """It voted twice in one term. The others kept the vote that each had heard first, and two gateways
    led for good."""
    gateways = [GatewayElection(lot, lot, 0) for lot in (7, 9, 11)]
    times = count(LISTEN_US, BEAT_US)
    for _ in range(20):
        turn(gateways, next(times))
    term = max(own.term for own in gateways)
    restarted = GatewayElection(5, 5, next(times))
    gateways[1:2] = [restarted]
    said = list[LeaderElectionVote]()
    for _ in range(20):
        now_us = next(times)
        for own in gateways:
            for effect in own.on_tick(0, False, now_us):
                if isinstance(effect, Send):
                    assert own.number is not None
                    for other in gateways:
                        if other is not own:
                            other.on_message(own.number, effect.message, now_us)
                    if own is restarted and isinstance(effect.message, LeaderElectionVote):
                        said.append(effect.message)
    assert said and all(vote.term > term for vote in said)
    assert [own.leads for own in gateways] == [True, False, False]
