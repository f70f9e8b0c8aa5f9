"""Rounds among robots that hear each other with loss: all go by one plan, or nobody does."""

from random import Random

import numpy as np
import pytest

from agent.coverage.cell_map import CellMap
from agent.coverage.plan_agreement import (
    AGAIN_MAX,
    ANYBODY,
    COVERAGE_PLAN_TABLE,
    CoverageAgreement,
    CoveragePlanEvent,
    FleetSnapshot,
)
from agent.interface.config import MS, S
from agent.mapf.agreement_phase import AgreementPhase
from crdt import Progress
from protocol.frames.agreement_frames import ACCORD, AgreementKind, AgreementMessage, AgreementReply
from tests.state_tables import check_table


class Table:
    """Robots that stand at fixed cells and talk; who is in which island hears whom."""

    def __init__(self, robots: int, seed: int = 0, loss: float = 0.0) -> None:
        self.ground = CellMap(np.zeros((6, 6), dtype=np.bool_), 4.0)
        self.rounds = {s: CoverageAgreement(s, self.ground) for s in range(robots)}
        self.progress = {s: Progress(self.ground.section_units) for s in range(robots)}
        self.answers = dict.fromkeys(range(robots), AgreementReply.GRANT)
        self.live = {s: frozenset(range(robots)) for s in range(robots)}
        self.silent: dict[int, dict[int, int]] = {s: {} for s in range(robots)}
        self.placeless: frozenset[int] = frozenset()
        self.rng, self.loss, self.now_us = Random(seed), loss, 0

    def run(self, for_us: int) -> None:
        end_us = self.now_us + for_us
        while self.now_us < end_us:
            self.now_us += 50 * MS
            for slot, rounds in self.rounds.items():
                crew = FleetSnapshot(
                    self.live[slot], self.silent[slot], self.progress[slot], self.placeless - {slot}
                )
                rounds.on_tick(slot, self.answers[slot], True, crew, self.now_us)
                for word in rounds.outgoing(self.now_us):
                    for other in self.live[slot] - {slot}:
                        if other in self.rounds and self.rng.random() >= self.loss:
                            self.rounds[other].on_message(
                                slot, ACCORD.unpack(ACCORD.pack(word)), self.now_us
                            )

    def cut(self, *islands: set[int]) -> None:
        for island in islands:
            for slot in island & self.rounds.keys():
                gone = {other for other in self.live[slot] if other not in island}
                self.silent[slot] |= dict.fromkeys(gone, self.now_us)
                self.live[slot] = frozenset(island)
                for other in island:
                    self.silent[slot].pop(other, None)

    def plans(self, *slots: int) -> set[int]:
        return {id(self.rounds[s].course) for s in slots}


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_all_go_by_one_plan(loss: float) -> None:
    table = Table(5, 3, loss)
    table.run(8 * S)
    assert all(r.phase is AgreementPhase.GO for r in table.rounds.values())
    assert len(table.plans(*range(5))) == 1


def test_nobody_goes_while_replicas_differ() -> None:
    table = Table(3)
    table.progress[1].cover(0, 30)
    table.run(4 * S)
    assert not any(r.going for r in table.rounds.values())
    for slot in (0, 2):
        table.progress[slot].cover(0, 30)
    table.run(8 * S)
    assert all(r.going for r in table.rounds.values())
    assert 30 not in table.rounds[0].course.todo  # type: ignore[union-attr]


def test_one_that_cannot_move_is_gone_round_until_it_can() -> None:
    table = Table(3)
    table.run(2 * S)
    table.answers[1] = AgreementReply.STOPPED
    table.run(3 * S)
    course = table.rounds[0].course
    assert course is not None and course.slots == (0, 2) and 1 not in course.todo
    assert all(course.place(r, s) != 1 for r in range(2) for s in range(course.finish() + 1))
    table.answers[1] = AgreementReply.GRANT
    table.run(3 * S)
    assert all(r.going for r in table.rounds.values())


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_a_robot_that_knows_no_place_has_no_part_in_the_plan_until_it_announces_one(
    loss: float,
) -> None:
    table = Table(3, 2, loss)
    blind = table.rounds.pop(2)
    table.run(8 * S)
    assert not any(r.going for r in table.rounds.values()), "it may announce its cell at any time"
    table.placeless = frozenset({2})
    table.run(8 * S)
    rounds = table.rounds[0].rounds
    assert all(r.going and r.course and r.course.slots == (0, 1) for r in table.rounds.values())
    table.run(8 * S)
    assert table.rounds[0].rounds == rounds, "the plan of the others holds"
    table.rounds[2] = blind
    table.run(8 * S)
    assert all(r.going and r.course and r.course.slots == (0, 1, 2) for r in table.rounds.values())
    rounds = table.rounds[0].rounds
    table.placeless = frozenset()
    table.run(8 * S)
    assert table.rounds[0].rounds == rounds and len(table.plans(0, 1, 2)) == 1


def test_one_silent_is_dead_and_its_work_is_cut_again() -> None:
    table = Table(4)
    table.run(2 * S)
    del table.rounds[3]
    table.cut({0, 1, 2})
    table.run(2 * S)
    rounds = table.rounds[0]
    assert rounds.going and not rounds.kept and rounds.course is not None
    assert set(rounds.course.todo.tolist()) == set(range(36)) - {0, 1, 2}


def test_both_sides_of_a_split_keep_to_their_own_part() -> None:
    table = Table(4)
    table.run(2 * S)
    table.cut({0, 1}, {2, 3})
    table.run(3 * S)
    one, other = table.rounds[0], table.rounds[2]
    assert one.going and other.going and one.kept and other.kept
    assert one.course is not None and other.course is not None
    assert not set(one.course.todo.tolist()) & set(other.course.todo.tolist())
    assert len(table.plans(0, 1)) == len(table.plans(2, 3)) == 1
    table.cut({0, 1, 2, 3})
    table.run(3 * S)
    assert len(table.plans(*range(4))) == 1 and not table.rounds[0].kept


def test_what_one_has_met_all_go_round() -> None:
    table = Table(3)
    table.run(2 * S)
    table.rounds[2].meet(20, ANYBODY, table.now_us)
    table.rounds[2].call(table.now_us)
    table.run(4 * S)
    assert all(r.going and 20 in r.bodies for r in table.rounds.values())
    assert 20 not in table.rounds[0].course.todo  # type: ignore[union-attr]


def test_a_cell_blocked_three_times_is_tried_again_with_other_members() -> None:
    table = Table(4)
    table.run(2 * S)
    for _ in range(AGAIN_MAX + 1):
        table.rounds[2].meet(20, ANYBODY, table.now_us)
    table.rounds[2].call(table.now_us)
    table.run(60 * S)
    assert all(r.going and not r.later and 20 in r.bodies for r in table.rounds.values())
    del table.rounds[3]
    table.cut({0, 1, 2})
    table.run(4 * S)
    assert len(table.plans(0, 1, 2)) == 1
    assert all(r.going and 20 not in r.bodies for r in table.rounds.values())
    assert 20 in table.rounds[0].course.todo  # type: ignore[union-attr]
    table.rounds[2].meet(20, ANYBODY, table.now_us)  # still there: for a while at first
    table.rounds[2].call(table.now_us)
    table.run(4 * S)
    assert all(r.going and r.later and 20 in r.bodies for r in table.rounds.values())


def test_a_wreck_stays_when_the_members_change() -> None:
    table = Table(5)
    table.run(2 * S)
    del table.rounds[4]
    table.rounds[2].meet(20, 4, table.now_us)
    table.cut({0, 1, 2, 3})
    table.run(3 * S)
    del table.rounds[3]
    table.cut({0, 1, 2})
    table.run(3 * S)
    assert all(r.going and 20 in r.bodies for r in table.rounds.values())


@pytest.mark.parametrize("seed", range(5))
def test_a_body_that_one_robot_keeps_is_known_to_all_in_the_end(seed: int) -> None:
    """A robot that was away for a moment drops what is to stay; the others have seen no change."""
    table = Table(3, seed, 0.3)
    table.run(4 * S)
    for _ in range(AGAIN_MAX + 1):
        table.rounds[0].meet(20, ANYBODY, table.now_us)
    table.rounds[0].call(table.now_us)
    table.run(4 * S)
    table.rounds[1] = CoverageAgreement(1, table.ground)
    table.rounds[0].call(table.now_us)
    table.run(8 * S)
    assert all(r.going and 20 in r.bodies for r in table.rounds.values())
    assert len(table.plans(0, 1, 2)) == 1


def test_a_robot_far_ahead_in_rounds_is_followed() -> None:
    table = Table(2)
    table.rounds[1].round = 40_000
    table.run(1 * S)
    table.rounds[1].call(table.now_us)
    table.run(3 * S)
    assert {r.round for r in table.rounds.values()} == {table.rounds[1].round}
    assert all(r.going for r in table.rounds.values())


@pytest.mark.parametrize("say", list(AgreementKind))
def test_words_out_of_range_do_nothing(say: AgreementKind) -> None:
    """What comes from the wire never raises; a cell that does not exist is not believed."""
    rounds, rng = Table(2).rounds[0], Random(7)
    for _ in range(300):
        word = AgreementMessage(
            rng.randrange(3), say, 0, rng.randrange(1 << 16), rng.randrange(1 << 16), 0
        )
        rounds.on_message(rng.randrange(4), word, 0)
    assert all(number < 36 for number in rounds.bodies)


def far_ahead(phase: AgreementPhase, step: int) -> CoverageAgreement:
    """Robot 0 in that phase of a first round, with robot 1 at that step of the plan."""
    ground = CellMap(np.zeros((6, 9), dtype=np.bool_), 4.0)
    rounds, progress, now_us = CoverageAgreement(0, ground), Progress(ground.section_units), 0
    crew = FleetSnapshot(frozenset({0, 1}), {}, progress)
    digest = progress.digest
    place = AgreementMessage(1, AgreementKind.PLACE, 0, 30, digest & 0xFFFF, digest >> 16)
    while rounds.phase is not phase:
        rounds.on_tick(0, AgreementReply.GRANT, True, crew, now_us)
        for word in rounds.outgoing(now_us):
            if word.say == AgreementKind.PLACE:
                rounds.on_message(1, place, now_us)
            elif word.say == AgreementKind.PLAN and phase is AgreementPhase.GO:
                rounds.on_message(1, word, now_us)
        now_us += 50 * MS
    (plan,) = [w.first for w in rounds.outgoing(now_us + 9 * S) if w.say == AgreementKind.PLAN]
    rounds.on_message(1, AgreementMessage(1, AgreementKind.AT, 0, step, plan, 0), now_us)
    return rounds


def test_one_that_went_on_before_we_did_is_known_by_its_step() -> None:
    """Its plan was lost on the way to us, so we have computed no step of it."""
    rounds = far_ahead(AgreementPhase.AGREE, 2)
    passed, (at, before) = rounds.passed(1), rounds.bound_for(1)
    assert len(passed) == 2 and passed[0] == 30
    assert before == passed[1] and at not in passed


@pytest.mark.parametrize("phase", [AgreementPhase.AGREE, AgreementPhase.GO])
def test_a_step_that_is_in_no_plan_is_not_believed(phase: AgreementPhase) -> None:
    rounds = far_ahead(phase, 60_000)
    assert rounds.passed(1) == [] and rounds.bound_for(1) == (30, 30)


def test_every_phase_and_event() -> None:
    free, gather, agree, go = AgreementPhase
    begun, gathered, changed, agreed = CoveragePlanEvent
    check_table(COVERAGE_PLAN_TABLE, free, {
        (free, begun, gather), (agree, begun, gather), (go, begun, gather),
        (gather, gathered, agree), (agree, changed, gather), (agree, agreed, go),
    })  # fmt: skip


@pytest.mark.parametrize("number", [100, 40_000, 65_500])
def test_a_robot_that_restarts_takes_part_in_whatever_round_its_fleet_is_in(number: int) -> None:
    """It began at number 0, for which half of all numbers are over."""
    table = Table(3)
    for slot in (0, 1):
        table.rounds[slot].round = number
    table.run(30 * S)
    assert all(r.phase is AgreementPhase.GO for r in table.rounds.values())
    assert len(table.plans(0, 1, 2)) == 1
    assert all(r.round >= number for r in table.rounds.values())
