"""A member that says more than it can have done is named."""

import pytest

from agent.interface.config import S
from agent.interface.effects import Send
from agent.peer.inputs import ClaimSection
from agent.peer.sender_limits import (
    EPOCH_JUMP_MAX,
    FOREIGN_BURST,
    LEARNING_US,
    STOPS_BURST,
    UNITS_A_S,
    UNITS_BURST,
    SenderLimits,
)
from agent.peer.work_admission import HELD_MAX
from crdt import Phase
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Member
from protocol.frames.messages import Message
from protocol.frames.safety_frames import EmergencyStop
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from sim.rigs.keyed_rig import KeyedRig
from tools.inspect.inspector import Inspector

BLOCK = (1 << 40) - 1
LATER_US = LEARNING_US + S


def test_work_at_the_speed_of_a_machine_is_never_too_much() -> None:
    limits = SenderLimits(0)
    for second in range(3600):
        assert limits.progress(1, UNITS_A_S, LATER_US + second * S) is None
    assert not limits.found


def test_work_of_ten_minutes_apart_is_not_too_much() -> None:
    limits = SenderLimits(0)
    limits.progress(1, 1, LATER_US)
    assert limits.progress(1, 600 * UNITS_A_S, LATER_US + 600 * S) is None


def test_a_field_within_a_second_is_named_and_told_once() -> None:
    limits = SenderLimits(0)
    told = [limits.progress(1, 40, LATER_US + k * 1000) for k in range(UNITS_BURST // 40 + 3)]
    assert [text is not None for text in told] == [False] * 4 + [True, False, False]
    assert limits.named == ["robot 1: told more than 8 units a second, 3 times"]
    assert limits.progress(2, 40, LATER_US) is None, "each robot is counted for itself"


def test_what_is_learned_after_a_start_names_nobody() -> None:
    limits = SenderLimits(0)
    assert limits.progress(1, 10_000, LEARNING_US - 1) is None
    assert limits.claim(1, 200, 0, LEARNING_US - 1) is None


def test_an_epoch_that_jumps_is_named() -> None:
    limits = SenderLimits(0)
    assert limits.claim(1, EPOCH_JUMP_MAX, 0, LATER_US) is None
    assert limits.claim(1, 5 + EPOCH_JUMP_MAX + 1, 5, LATER_US)
    assert "epoch" in limits.named[0]


def test_a_hand_that_presses_again_and_again_is_not_named_and_a_flood_is() -> None:
    limits = SenderLimits(0)
    assert not any(limits.stop(1, k * 6 * S) for k in range(100))
    assert any(limits.stop(2, k * 1000) for k in range(STOPS_BURST + 1))


def test_what_others_tell_of_a_robot_that_came_back_names_nobody() -> None:
    limits = SenderLimits(0)
    limits.appeared(2, LATER_US)
    assert limits.progress(1, 10_000, LATER_US + S) is None
    assert limits.foreign(1, True, LATER_US + S) is None
    assert limits.progress(2, 10_000, LATER_US + S), "it may not excuse itself"
    limits.learn(LATER_US + LEARNING_US)
    assert limits.progress(1, 10_000, LATER_US + LEARNING_US + S) is None


def test_a_few_missed_claims_name_nobody_and_many_do() -> None:
    limits = SenderLimits(0)
    told = [limits.foreign(1, False, LATER_US + k * S) for k in range(2 * FOREIGN_BURST)]
    assert not any(told[:FOREIGN_BURST]) and any(told)
    assert limits.foreign(2, True, LATER_US), "the robot in whose name it is knows better"


class Thief:
    """A laptop with the keys of robot 1, on whose address it speaks."""

    def __init__(self, rig: KeyedRig) -> None:
        self.rig, self.address = rig, rig.address_of(1)
        self.peer = rig.peers.pop(1)
        rig._due_at_us.pop(1, None)

    def answer(self, sections: range, phase: Phase, owner: int) -> None:
        """Say of sections what is not true."""
        for section in sections:
            self.say(StateSyncResponse(section, 1, phase, 0, 500 + section, owner))

    def say(self, message: Message) -> None:
        """With a proof, and in a frame that keeps its robot alive."""
        said = [Send(message), Send(self.peer.joining.announcement)]
        for effect in self.peer.proven.cover(said, self.rig.now_us):
            assert isinstance(effect, Send)
            self.rig.forge(effect.message, self.address)
        self.rig.run_for(S // 5)


@pytest.mark.slow
def test_the_end_of_a_section_that_its_live_owner_has_not_said_is_named() -> None:
    rig = KeyedRig(2)
    rig.run_for(LEARNING_US)
    Thief(rig).answer(range(1, 3), Phase.DONE, 0)
    assert rig.peers[0].allocation.done_count() == 2, "believed until the revocation"
    assert "in our name" in rig.peers[0].named.state_sync.limits.named[0]
    assert not rig.peers[2].named.state_sync.limits.named


@pytest.mark.slow
def test_progress_of_other_robots_sections_names_a_member_too() -> None:
    rig = KeyedRig(2)
    for peer in rig.peers.values():
        peer.named.admission.sections = frozenset()
    rig.work(0, 2, 1)  # the section is robot 0's
    rig.run_for(LEARNING_US)
    thief = Thief(rig)
    for block in range(1, 8):
        thief.say(WorkProgress(20, block, BLOCK))
    assert "units" in rig.peers[2].named.state_sync.limits.named[0]


def test_sync_answers_do_not_lift_the_limit_of_sections() -> None:
    """And what others say in a robot's name uses up nothing of what it may claim."""
    rig = KeyedRig(1)
    for peer in rig.peers.values():
        peer.named.admission.sections = frozenset()
    thief, peer = Thief(rig), rig.peers[0]
    thief.answer(range(10, 10 + 3 * HELD_MAX), Phase.STARTED, 1)
    assert len(peer.allocation.assigned_sections(1)) == HELD_MAX
    assert peer.named.admission.refused["too many sections"] == 2 * HELD_MAX
    rig.cut.add(2)  # it does not hear that, and gives nothing back
    thief.answer(range(60, 60 + 2 * HELD_MAX), Phase.STARTED, 2)
    rig.cut.clear()
    rig.tell(2, ClaimSection(3, 3))
    rig.run_for(S // 2)
    assert peer.allocation.owner_of(3) == 2, peer.named.admission.refused


@pytest.mark.slow
def test_a_robot_with_keys_names_a_member_that_ends_a_field_at_once() -> None:
    rig = KeyedRig(2)
    rig.work(1, 2, 1)
    rig.run_for(LEARNING_US)
    thief, victim = rig.peers[1], rig.peers[0]
    claim = TaskClaim(2, 1, Phase.STARTED, 3, 500, 1)
    for block in range(1, 8):
        sent = [Send(claim), Send(WorkProgress(2, block, BLOCK))]
        rig.send(1, thief.proven.cover(sent, rig.now_us))
        rig.run_for(S // 5)
    assert victim.named.state_sync.limits.named, victim.named.state_sync.limits.found


def test_inspect_names_a_robot_without_keys_too() -> None:
    seen = Inspector()

    def hear(t_s: float, message: object) -> None:
        seen.hear(t_s, encode(message, 128))  # type: ignore[arg-type]

    hear(0.0, Member(1, 1, 7))
    hear(70.0, TaskClaim(2, 1, Phase.STARTED, 3, 5, 1))
    for block in range(8):
        hear(70.0 + block / 100, WorkProgress(2, block, BLOCK))
    hear(71.0, TaskClaim(3, 99, Phase.CLAIMED, 3, 500, 1))
    for counter in range(STOPS_BURST + 2):
        hear(72.0 + counter / 100, EmergencyStop(1, 1, counter, 0))
    assert len(seen.to_dict()["suspects"]) == 3, seen.to_dict()["suspects"]
