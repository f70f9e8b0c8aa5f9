"""Work that cannot be true is counted and not joined (findings T7, T8, item 12)."""

import pytest

from agent.interface.config import S
from agent.interface.lifecycle import State
from agent.peer.inputs import Heard
from agent.peer.peer import Peer
from agent.peer.work_admission import EPOCH_BURST, EPOCH_EXPLAINED_MAX, PERSISTS_US
from crdt import Phase
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from tests.agent.lone_peer import introduce, peer_in

MEMBER = 140


def robot() -> Peer:
    peer = peer_in(State.IDLE, None)  # its field has section 0, its fleet slots 0 to 2
    introduce(peer, MEMBER, 1)
    return peer


@pytest.mark.parametrize("kind", [TaskClaim, StateSyncResponse])
def test_t8_a_done_of_a_section_that_the_field_does_not_have(
    kind: type[TaskClaim] | type[StateSyncResponse],
) -> None:
    peer = robot()
    peer.step(Heard(MEMBER, kind(60000, 0, Phase.DONE, 0, 9, 1)), 0)
    peer.step(Heard(MEMBER, WorkProgress(60000, 0, 0xFF)), 0)
    assert peer.allocation.done_count() == 0 and not peer.allocation.entries()
    assert not len(peer.progress) and peer.named.admission.refused == {"section": 2}


def test_t7_a_claim_for_an_owner_that_is_no_member() -> None:
    peer = robot()
    for section in range(14):
        peer.step(Heard(MEMBER, TaskClaim(section, 255, Phase.STARTED, 0, 300, 99)), 0)
    assert not peer.allocation.entries()
    assert peer.named.admission.refused == {"section": 13, "owner": 1}


@pytest.mark.parametrize(("epoch", "lamport"), [(255, 254), (255, 300), (EPOCH_BURST + 1, 300)])
def test_t7_an_epoch_that_no_hand_overs_explain(epoch: int, lamport: int) -> None:
    """For an owner that exists: the same frame again and again in a second, and each epoch in turn."""
    peer = robot()
    for step in range(50):
        peer.step(Heard(MEMBER, TaskClaim(0, epoch, Phase.STARTED, 0, lamport, 1)), step * S // 50)
    for climbing in range(EPOCH_BURST + 1, epoch):
        peer.step(Heard(MEMBER, TaskClaim(0, climbing, Phase.STARTED, 0, 300, 1)), S)
    assert not peer.allocation.entries()
    assert peer.named.admission.refused["epoch"] == 50 + epoch - min(epoch, EPOCH_BURST + 1)


def test_t7_a_robot_that_was_away_believes_a_high_epoch_that_is_told_on() -> None:
    """Replicas become equal: what others hold is told again until it is believed."""
    peer, told = robot(), StateSyncResponse(0, 40, Phase.CLAIMED, 0, 90, 1)
    for told_at_us in (0, S):
        peer.step(Heard(MEMBER, told), told_at_us)
        assert not peer.allocation.entries()
    peer.step(Heard(MEMBER, told), PERSISTS_US + 1)
    assert peer.allocation.owner_of(0) == 1 and peer.allocation.entry(0).epoch == 40


def test_t7_hand_overs_of_a_long_day_are_believed_at_once() -> None:
    peer = robot()
    peer.step(
        Heard(MEMBER, TaskClaim(0, EPOCH_EXPLAINED_MAX, Phase.CLAIMED, 0, 900, 1)), 8 * 3600 * S
    )
    assert peer.allocation.owner_of(0) == 1


def test_t7_a_clock_that_leaps_or_a_long_day_does_not_explain_every_epoch() -> None:
    """Else an hour, or a clock that is set by one, would let every forged register in."""
    peer, now_us = robot(), 8 * 3600 * S
    told = TaskClaim(0, EPOCH_EXPLAINED_MAX + 1, Phase.DONE, 0, 900, 1)
    for told_at_us in (now_us, now_us + S):
        peer.step(Heard(MEMBER, told), told_at_us)
        assert not peer.allocation.entries()
    peer.step(Heard(MEMBER, told), now_us + PERSISTS_US)
    assert peer.allocation.owner_of(0) == 1, "told on: it is put off, not refused"


def test_t7_an_epoch_that_is_told_twice_is_no_epoch_that_is_told_on() -> None:
    """Found by `headland chaos`, profile strangers, seed 61200596: a broken device said one epoch
    twice by chance, nine seconds apart. A section that nobody had worked was done."""
    peer, told = robot(), TaskClaim(0, 184, Phase.DONE, 3, 14_695, 1)
    for told_at_us in (S, 10 * S):
        peer.step(Heard(MEMBER, told), told_at_us)
        assert not peer.allocation.entries()


@pytest.mark.parametrize("epoch", [EPOCH_BURST + 1, EPOCH_EXPLAINED_MAX + 6])
def test_a_live_claim_that_follows_a_known_epoch_is_believed_at_once(epoch: int) -> None:
    """It was put off for 3 s. Meanwhile a second robot claimed the section, and both worked it."""
    peer, free = robot(), StateSyncResponse(0, epoch, Phase.FREE, 0, 900, 1)
    for told_at_us in (0, 2 * S, 4 * S):  # since its restart, or in the course of a long day
        peer.step(Heard(MEMBER, free), told_at_us)
    peer.step(Heard(MEMBER, TaskClaim(0, epoch + 1, Phase.CLAIMED, 0, 901, 1)), 5 * S)
    assert peer.allocation.owner_of(0) == 1 and peer.allocation.entry(0).epoch == epoch + 1
