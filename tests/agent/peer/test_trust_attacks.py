"""Attacks of the findings on a fleet with keys, by an attacker that hears all and holds no key."""

from collections.abc import Iterator

import pytest

from agent.interface.config import MS, S, beat_of
from agent.interface.effects import Send
from agent.interface.lifecycle import State
from agent.peer.inputs import Received
from agent.peer.work_admission import HELD_MAX
from crdt import Phase
from protocol.frames.codec import decode, encode
from protocol.frames.fleet_frames import (
    Heartbeat,
    LeaderElectionVote,
    Member,
    Pose,
    VectorSlice,
)
from protocol.frames.frame import Frame
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.trust_frames import FleetTimeTold, Proof, TimeQuestion
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from sim.rigs.keyed_rig import FIELD_HASH, SECTIONS, UNITS, KeyedRig

BEAT = beat_of(3)
ALL_UNITS = (1 << UNITS) - 1
LIMIT_US = BEAT.life_for_us + BEAT.silence_for_us  # until a robot that proves nothing is silent


@pytest.fixture
def rig() -> KeyedRig:
    fleet = KeyedRig(1)
    fleet.work(1, 2)
    assert_at_work(fleet)
    return fleet


def assert_at_work(rig: KeyedRig, *slots: int) -> None:
    for slot in slots or rig.peers:
        assert rig.drives[slot].vx_m_s > 0, (slot, rig.peers[slot].safety.causes)


def proofs(rig: KeyedRig) -> Iterator[Frame]:
    return (frame for frame in rig.recorded if isinstance(decode(frame)[1], Proof))


def test_honest_work_is_believed(rig: KeyedRig) -> None:
    for slot, peer in rig.peers.items():
        assert peer.allocation.owner_of(2) == 1 and peer.progress.covered(2) == UNITS // 2, slot
        assert peer.membership.live == {0, 1, 2}


def test_a_fleet_without_keys_sends_no_frame_of_trust() -> None:
    plain = KeyedRig(1, keyed=False)
    plain.work(1, 2)
    kinds = {type(decode(frame)[1]) for frame in plain.recorded}
    assert TaskClaim in kinds and not kinds & {Proof, TimeQuestion, FleetTimeTold}
    assert all(peer.allocation.owner_of(2) == 1 for peer in plain.peers.values())


@pytest.mark.parametrize("address", [129, 200])
def test_t1_a_member_frame_with_another_field_holds_nobody(rig: KeyedRig, address: int) -> None:
    before = rig.witness_all()
    rig.forge(AddressClaimed(rig.peers[1].identity.name.pack()), 200)
    for _ in range(20):
        rig.forge(Member(1, 0, FIELD_HASH + 1), address)
        rig.run_for(100 * MS)
    assert rig.witness_all() == before
    rig.run_for(8 * S)  # the claim of our NAME holds its owner for a moment
    assert_at_work(rig)


def test_t2_an_address_storm_costs_seconds(rig: KeyedRig) -> None:
    for address in range(128, 236):
        rig.forge(AddressClaimed(0), address)
    rig.run_for(15 * S)
    assert all(peer.address is not None for peer in rig.peers.values())
    assert all(peer.membership.live == {0, 1, 2} for peer in rig.peers.values())
    assert_at_work(rig)


def test_t2_an_address_that_is_stolen_again_and_again_costs_seconds(rig: KeyedRig) -> None:
    for _ in range(10):
        rig.forge(AddressClaimed(0), rig.address_of(1))
        rig.run_for(3 * S)
    rig.run_for(5 * S)
    assert_at_work(rig)
    assert all(peer.membership.live == {0, 1, 2} for peer in rig.peers.values())


@pytest.mark.parametrize("kind", [TaskClaim, StateSyncResponse])
@pytest.mark.parametrize("victim", [0, 1, 2])
def test_t3_t8_done_and_progress_in_a_robots_name(
    rig: KeyedRig, victim: int, kind: type[TaskClaim] | type[StateSyncResponse]
) -> None:
    before, address = rig.witness_all(), rig.address_of(victim)
    for _ in range(8):  # also told on for longer than an odd epoch has to be
        for section in (*range(SECTIONS), 60_000):
            rig.forge(kind(section, 0, Phase.DONE, 0, 900, victim), address)
            rig.forge(WorkProgress(section, 0, ALL_UNITS), address)
        rig.run_for(500 * MS)
    assert rig.witness_all() == before
    rig.run_for(5 * S)
    assert rig.witness_all() == before and all(
        peer.proven.checker is not None and peer.proven.checker.dropped
        for slot, peer in rig.peers.items()
        if slot != victim
    )


def test_t7_a_section_given_to_somebody_with_the_last_epoch(rig: KeyedRig) -> None:
    before = rig.witness_all()
    for _ in range(8):
        for section in range(SECTIONS):
            for owner in (0, 1, 99):
                rig.forge(TaskClaim(section, 255, Phase.STARTED, 0, 300, owner), rig.address_of(1))
        rig.run_for(500 * MS)
    assert rig.witness_all() == before
    assert_at_work(rig)


def test_t6_a_farewell_before_a_kill_disarms_nobody(rig: KeyedRig) -> None:
    address = rig.address_of(1)
    rig.forge(Pose(0.0, 30.0, 0.0, 0.0, State.IDLE, False, 0), address)
    for _ in range(5):
        rig.forge(Heartbeat(255, State.IDLE, False, False, True, True, 1.0, 0, 0), address)
    assert 1 in rig.peers[0].membership.live
    rig.cut.add(1)
    rig.run_for(BEAT.silence_for_us + 200 * MS)
    assert rig.drives[0].vx_m_s == rig.drives[2].vx_m_s == 0


def test_t6_imitated_beats_hide_a_dead_robot_for_less_than_its_life(rig: KeyedRig) -> None:
    address = rig.address_of(1)
    rig.cut.add(1)
    beats = [frame for frame in rig.recorded if frame.identifier & 0xFF == address]
    beats.reverse()  # the newest first: proofs of the last second are not too old
    for step in range((LIMIT_US + 100 * MS) // (20 * MS)):
        rig.forge(Pose(0.1 * step, 30.0, 0.0, 2.0, State.IDLE, False, 0), address)
        rig.inject(beats[step % len(beats)])  # also its heartbeats, MEMBER frames and proofs
        rig.run_for(20 * MS)
    for slot in (0, 2):
        assert rig.peers[slot].membership.silent == {1}
        assert rig.drives[slot].vx_m_s == 0


def test_t6_a_robot_whose_name_is_used_is_heard_all_the_same(rig: KeyedRig) -> None:
    """Frames under its address spoil no more than what they fall between."""
    address = rig.address_of(1)
    for step in range(40):
        rig.forge(WorkProgress(step % SECTIONS, 0, step), address)
        rig.run_for(100 * MS)
    assert rig.peers[0].membership.live == {0, 1, 2}
    rig.run_for(5 * S)
    rig.work(1, 3)
    assert rig.peers[0].allocation.owner_of(3) == 1


def test_a_digest_a_vote_and_a_clock_in_a_robots_name(rig: KeyedRig) -> None:
    address, peer = rig.address_of(1), rig.peers[0]
    before, led, clock = rig.witness_all(), peer.leader, list(peer.clock)
    votes = [m for _, m in map(decode, rig.recorded) if isinstance(m, LeaderElectionVote)]
    vote = votes[-1]
    for term in range(60):
        rig.forge(Heartbeat(9, State.IDLE, False, False, True, False, 1.0, 999, 0xABCDEF), address)
        for voter in rig.peers:  # all of them, for another leader in a later term
            later = vote._replace(term=(vote.term + 1 + term) & 0xFFFF, candidate=2)
            rig.forge(later, rig.address_of(voter))
        rig.forge(VectorSlice(0, (200,) * 7), address)
        rig.run_for(50 * MS)
    assert rig.witness_all() == before and peer.leader == led
    assert list(peer.clock) == clock and peer.state is not State.SYNCHRONIZING


def test_what_was_recorded_proves_nothing_a_second_time(rig: KeyedRig) -> None:
    before = rig.witness_all()
    recorded = list(rig.recorded)[-400:]
    for frame in recorded:
        rig.inject(frame)
    rig.run_for(2 * S)
    after = rig.witness_all()
    assert {s: w[:2] for s, w in after.items()} == {s: w[:2] for s, w in before.items()}


def test_a_recording_of_another_day_proves_nothing_to_robots_that_boot() -> None:
    yesterday = KeyedRig(3)
    for section in range(4):
        yesterday.work(section % 3, section)
    today = KeyedRig(3, day=1)
    assert today.keys == yesterday.keys
    before = today.witness_all()
    for frame in yesterday.recorded:
        today.inject(frame)
    today.run_for(8 * S)
    after = today.witness_all()
    assert {s: w[:2] for s, w in after.items()} == {s: w[:2] for s, w in before.items()}
    assert all(not peer.allocation.entries() for peer in today.peers.values())


def test_a_robot_that_boots_learns_the_time_and_the_work(rig: KeyedRig) -> None:
    rig.boot(0)
    rig.run_for(8 * S)
    assert rig.peers[0].allocation.owner_of(2) == 1 and rig.peers[0].progress.covered(2)
    assert all(peer.membership.live == {0, 1, 2} for peer in rig.peers.values())


def test_halves_that_were_switched_on_apart_find_one_time() -> None:
    rig = KeyedRig(5)
    rig.cut.update((1, 2))
    for slot in (1, 2):
        rig.boot(slot)
    rig.run_for(6 * S)  # each starts its own time, because nobody answers
    rig.cut.clear()
    rig.run_for(10 * S)
    assert all(peer.membership.live == {0, 1, 2} for peer in rig.peers.values())
    rig.work(2, 5)
    assert all(peer.allocation.owner_of(5) == 2 for peer in rig.peers.values())


def test_a_question_and_a_stolen_address_keep_no_computer_busy(rig: KeyedRig) -> None:
    """A robot owed an answer and lost its address; its timer was due at each turn, for ever."""
    rig.forge(TimeQuestion(200, 12345), rig.address_of(2))
    rig.forge(AddressClaimed(0), rig.address_of(0))
    rig.run_for(500 * MS)
    assert all(peer.due_at_us > rig.now_us for peer in rig.peers.values())


def test_guessed_proofs_cost_little_and_prove_nothing(rig: KeyedRig) -> None:
    before, address = rig.witness_all(), rig.address_of(1)
    now = rig.peers[0].named.fleet_clock.time.at(rig.now_us)
    for guess in range(300):
        rig.forge(TaskClaim(5, 0, Phase.DONE, 0, 900, 1), address)
        rig.forge(Proof(1, 1, (now + guess) & 0xFFF, guess * 7919), address)
    rig.run_for(3 * S)
    assert {s: w[:2] for s, w in rig.witness_all().items()} == {s: w[:2] for s, w in before.items()}


def test_a_proof_of_one_address_is_none_for_another(rig: KeyedRig) -> None:
    """A stolen batch under another robot's address, in the moment in which it is fresh."""
    rig.cut.add(0)  # it hears nothing of the honest frames
    rig.work(1, 6)
    batch = list(rig.recorded)[-60:]
    rig.cut.clear()
    for frame in batch:
        message = decode(frame)[1]
        if isinstance(message, TaskClaim | WorkProgress | Proof):
            moved = encode(message, rig.address_of(2))
            rig.peers[0].step(Received(moved), rig.now_us)
    assert rig.peers[0].allocation.owner_of(6) is None


def say(rig: KeyedRig, slot: int, *messages: Message) -> None:
    """A robot that is broken, or whose key is stolen, says this and proves it."""
    peer = rig.peers[slot]
    rig.send(slot, peer.proven.cover([Send(message) for message in messages], rig.now_us))
    rig.run_for(100 * MS)


def test_a_member_claims_only_for_itself(rig: KeyedRig) -> None:
    say(rig, 1, TaskClaim(5, 0, Phase.CLAIMED, 0, 50, 2), TaskClaim(6, 0, Phase.CLAIMED, 0, 51, 1))
    for slot in (0, 2):
        allocation = rig.peers[slot].allocation
        assert allocation.owner_of(5) is None and allocation.owner_of(6) == 1
        assert rig.peers[slot].named.admission.refused == {"claim of another": 1}


def test_a_member_holds_few_sections(rig: KeyedRig) -> None:
    for peer in rig.peers.values():
        peer.named.admission.sections = frozenset()  # a field of many sections
    claims = [TaskClaim(n, 1, Phase.STARTED, 0, 50 + n, 2) for n in range(HELD_MAX + 5)]
    effects = rig.peers[2].proven.cover([Send(claim) for claim in claims], rig.now_us)
    rig.send(2, effects)
    rig.send(2, rig.peers[2].proven.cover([Send(rig.peers[2].joining.announcement)], rig.now_us))
    for slot in (0, 1):
        peer = rig.peers[slot]
        assert len(peer.allocation.assigned_sections(2)) == HELD_MAX
        assert peer.named.admission.refused["too many sections"] == 5
