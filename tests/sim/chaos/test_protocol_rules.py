"""What is wrong to say and what is not: memory kept, memory lost, work handed over."""

from unittest.mock import patch

import pytest

from agent.interface.config import MS, STOP_SPACING_US, S
from agent.interface.lifecycle import State
from agent.peer.durable_records import OPERATIONS, REGISTER, U32, U64
from crdt import Phase
from crdt.claim_register import pack
from protocol.frames.fleet_frames import LeaderElectionVote, Pose
from protocol.frames.messages import Message
from protocol.frames.safety_frames import (
    Command,
    EmergencyReset,
    EmergencyStop,
    OperatorCommand,
)
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from sim.chaos.durability_rules import losses, lost
from sim.chaos.fault_profiles import draw
from sim.chaos.protocol_rules import ProtocolRules
from sim.chaos.verdict import judge
from sim.world.protocol_world import BOTH_US, ProtocolWorld, StationaryBody

OWN, OTHER = 1, 2  # sections


def _spoken() -> ProtocolRules:
    """Robot 0 has claimed a section, and told again what it had of another's."""
    rules = ProtocolRules(2)
    rules.said(0, 0, TaskClaim(OWN, 2, Phase.CLAIMED, 3, 8, 0))
    rules.said(0, 1 * S, TaskClaim(OWN, 2, Phase.STARTED, 3, 9, 0))
    rules.said(0, 1 * S, StateSyncResponse(OTHER, 2, Phase.STARTED, 3, 9, 1))
    rules.said(0, 1 * S, WorkProgress(OTHER, 0, 0b111))
    return rules


def test_what_was_told_of_others_may_be_gone_after_a_restart() -> None:
    rules = _spoken()
    rules.restarts(0)
    rules.said(0, 2 * S, StateSyncResponse(OTHER, 0, Phase.CLAIMED, 3, 1, 1))
    rules.said(0, 2 * S, WorkProgress(OTHER, 0, 0b1))
    assert not rules.broken


def test_what_was_told_of_others_stands_without_a_restart() -> None:
    rules = _spoken()
    rules.said(0, 2 * S, StateSyncResponse(OTHER, 0, Phase.CLAIMED, 3, 1, 1))
    assert [broken.rule for broken in rules.broken] == ["S9"]


def test_what_it_wrote_itself_stands_over_restarts() -> None:
    rules = _spoken()
    rules.restarts(0)
    rules.said(0, 2 * S, StateSyncResponse(OWN, 0, Phase.CLAIMED, 3, 1, 0))
    assert [broken.rule for broken in rules.broken] == ["S9"]


def _stop(rules: ProtocolRules, t_us: int, counter: int) -> None:
    rules.said(0, t_us, EmergencyStop(0, 1, counter, 1, False, 0, 0))


def test_a_stop_is_repeated_while_the_same_hand_presses_again() -> None:
    rules = ProtocolRules(1)
    rules.pressed(0, 1 * S)
    _stop(rules, 1 * S, 1)
    # Bounces: the next repetition is due in this very microsecond.
    rules.pressed(0, 1 * S + 40 * MS)
    _stop(rules, 1 * S + 40 * MS, 1)
    _stop(rules, 1 * S + 45 * MS, 1)
    assert not rules.broken


@pytest.mark.parametrize("names", [(1,), (1, 2), (2, 1), (1, 1)])
def test_a_new_press_needs_a_new_name(names: tuple[int, ...]) -> None:
    """Found by `headland chaos`, profile press, seed 8380: the stop of an earlier press was repeated in
    the very microsecond of the next one, before the new one."""
    rules = ProtocolRules(1)
    rules.pressed(0, 1 * S)
    _stop(rules, 1 * S, 1)
    again_us = 1 * S + STOP_SPACING_US
    rules.pressed(0, again_us)
    for name in names:
        _stop(rules, again_us, name)
    _stop(rules, again_us + 5 * MS, 1)
    assert [broken.rule for broken in rules.broken] == ([] if 2 in names else ["S8"])


@pytest.mark.parametrize("reset_us", [1 * S - 1 * MS, 1 * S + 1 * MS])
def test_a_reset_between_a_stop_and_the_next_beat_counts(reset_us: int) -> None:
    """Found by `headland chaos`, profile flood, seed 940062: after a flood the stop, its clearing, the
    reset and the start left within some milliseconds, before the next beat of the robots."""
    rules = ProtocolRules(1)
    beat = Pose(0.0, 0.0, 0.0, 0.0, State.WORKING, False, 255)
    rules.said(0, 1 * S - 10 * MS, beat)
    orders: list[EmergencyReset | OperatorCommand] = [
        EmergencyReset(0, 1, 1, 200),
        OperatorCommand(Command.MANUAL_RESET, 255, 200),
        OperatorCommand(Command.START, 255, 200),
    ]
    if reset_us < 1 * S:
        for order in orders:
            rules.ordered(order, reset_us)
    _stop(rules, 1 * S, 1)
    if reset_us > 1 * S:
        for order in orders:
            rules.ordered(order, reset_us)
    rules.said(0, 1 * S + 40 * MS, beat._replace(stopped=True, state=State.EMERGENCY_STOP))
    rules.said(0, 1 * S + 90 * MS, beat)
    assert [broken.rule for broken in rules.broken] == (["S2", "S4"] if reset_us < 1 * S else [])


@pytest.mark.parametrize("hangs", [True, False])
def test_a_hung_robot_reads_a_stop_and_the_start_after_it_at_once(hangs: bool) -> None:
    """Found by `headland chaos`, profile stop, seed 972170: a robot hung from a stop until after the
    reset and the start, and read all of them in one microsecond."""
    rules = ProtocolRules(2)
    beat = Pose(0.0, 0.0, 0.0, 0.0, State.WORKING, False, 255)
    rules.said(1, 1 * S, beat)
    if hangs:
        rules.hangs(1, 8 * S)
    rules.said(0, 2 * S, EmergencyStop(0, 1, 1, 1, False, 0, 0))
    for command in (Command.MANUAL_RESET, Command.START):
        rules.ordered(EmergencyReset(0, 1, 1, 200), 3 * S)
        rules.ordered(OperatorCommand(command, 255, 200), 4 * S)
    rules.said(1, 8 * S, EmergencyStop(0, 1, 1, 1, True, 0, 0))
    rules.said(1, 8 * S + 50 * MS, beat._replace(stopped=True, state=State.EMERGENCY_STOP))
    rules.said(1, 8 * S + 100 * MS, beat)
    assert [broken.rule for broken in rules.broken] == ([] if hangs else ["S2", "S4"])


def test_a_section_that_is_handed_over_is_not_worked_by_two() -> None:
    parade = ProtocolWorld(2, 2)
    parade.works(0, 0, 1 * S)
    parade.works(1, 0, 1 * S + BOTH_US + 1 * MS)
    assert not parade.together
    parade.works(0, 0, 1 * S + BOTH_US + 50 * MS)
    assert [violation.slots for violation in parade.together] == [(1, 0)]


def test_two_sides_of_a_split_are_asked_only_once_they_are_one() -> None:
    parade = ProtocolWorld(2, 2)
    parade.counts = lambda one, other: False
    parade.works(0, 0, 1 * S)
    parade.works(1, 0, 1 * S)
    assert not parade.together


def test_a_disk_on_which_no_stops_can_be_read_has_lost_them() -> None:
    assert "stop" in lost([], {"stops": b""})


@pytest.mark.parametrize("leaps", [False, True])
def test_a_section_is_not_started_without_a_claim(leaps: bool) -> None:
    """A start without any claim counted as one that had waited. When a robot claimed is unknown only
    after its clock was set."""
    rules = ProtocolRules(2)
    if leaps:
        rules.leaps(0)
    rules.said(0, 1 * S, TaskClaim(OWN, 2, Phase.STARTED, 3, 9, 0))
    assert [broken.rule for broken in rules.broken] == ([] if leaps else ["S7"])


def test_each_loss_is_found_beside_one_that_is_allowed() -> None:
    """On a full disk units may be missing. Then no loss after them was seen."""
    told: list[Message] = [
        TaskClaim(OWN, 2, Phase.STARTED, 3, 9, 0),
        WorkProgress(OWN, 0, 0b1),
        LeaderElectionVote(0, 3, 1),
    ]
    register = pack(2, Phase.STARTED, 3, 9, 0).to_bytes(U64.size, "little")
    kept = {f"{REGISTER}{OWN}": register, OPERATIONS: (1).to_bytes(U32.size, "little")}
    assert list(losses(told, kept)) == [f"units of S{OWN}", "the vote of term 3"]


def test_a_drill_counts_no_unit_while_the_implement_is_up() -> None:
    """Units were counted by the clock, although no implement was ever down."""
    scenario = draw(1, "claims")
    with patch.object(StationaryBody, "tool_on", property(lambda body: False)):
        broken = judge(scenario).broken
    assert "L5" in {each.rule for each in broken}
