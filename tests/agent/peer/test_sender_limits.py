"""A member that says more than it can have done is named."""

import pytest

from agent.interface.config import S
from agent.interface.effects import Send
from agent.peer.sender_limits import (
    EPOCH_JUMP_MAX,
    LEARNING_US,
    STOPS_BURST,
    UNITS_A_S,
    UNITS_BURST,
    SenderLimits,
)
from crdt import Phase
from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Member
from protocol.frames.safety_frames import EmergencyStop
from protocol.frames.work_frames import TaskClaim, WorkProgress
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
