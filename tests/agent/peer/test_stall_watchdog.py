"""Who wants to drive and gets nowhere plans again, says so, and gives back what it gets nowhere with."""

from agent.claims.claim_headway import Headway
from agent.claims.standing_owners import STANDS_US
from agent.field.section_choice import AGAIN_US, SectionChooser
from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView
from agent.interface.observation import Neighbour, Observation
from agent.peer.stall_watchdog import ALONE_US, CROWDED_US, TOLD_AFTER, Advice, Stall
from crdt import FieldAllocationCRDT, Progress
from protocol.frames.fleet_frames import Pose
from tests.agent.field.test_section_choice import FIELD

PERIODS = 1_000


def advice(stall: Stall, wants_m_s: float, crowded: bool, moves_m_s: float = 0.0) -> list[int]:
    """When something was advised, in microseconds."""
    return [
        now_us
        for now_us in range(0, PERIODS * CONTROL_PERIOD_US, CONTROL_PERIOD_US)
        if stall.look((moves_m_s * now_us / S, 0.0), wants_m_s, lambda: crowded, now_us) is not None
    ]


def test_m16_nobody_stands_alone_with_a_wish_for_ten_seconds_without_a_plan_and_a_word() -> None:
    assert advice(Stall(), 0.2, crowded=False)[0] == ALONE_US <= 10 * S
    stall, words = Stall(), list[tuple[int, Advice]]()
    for now_us in range(0, 20 * S, CONTROL_PERIOD_US):
        word = stall.look((0.0, 0.0), 0.2, lambda: False, now_us)
        words += [] if word is None else [(now_us, word)]
    assert (TOLD_AFTER * ALONE_US, Advice.TELL) in words
    assert TOLD_AFTER * ALONE_US <= 10 * S


def test_who_wants_nothing_or_creeps_on_is_not_held_up() -> None:
    assert advice(Stall(), 0.0, crowded=False) == []
    assert advice(Stall(), 0.1, crowded=False, moves_m_s=0.1) == []


def test_who_waits_for_somebody_near_waits_longer() -> None:
    assert advice(Stall(), 0.5, crowded=True)[0] == CROWDED_US


def test_a11_work_without_headway_is_lost_and_time_without_leave_to_drive_does_not_count() -> None:
    headway, now_us = Headway(), 0
    headway.begin()
    while not headway.lost:
        headway.observe(False, 50.0, now_us := now_us + CONTROL_PERIOD_US)
    assert abs(now_us - Headway.NONE_US) <= 2 * CONTROL_PERIOD_US
    headway.begin()
    for _ in range(PERIODS):  # each time after a stop of a minute
        headway.observe(False, 50.0, now_us := now_us + 60 * S)
    assert not headway.lost


def view(now_us: int, at: tuple[float, float], x_m: float, done: int = 0) -> FleetView:
    """Robot 0 at a place; robot 1 holds the last section and stands at `x_m`."""
    allocation = FieldAllocationCRDT()
    for section in FIELD.sections[:-1]:
        allocation.done(section.id, 0)
    last = FIELD.sections[-1]
    allocation.claim(last.id, 1)
    allocation.start(last.id, 1)
    progress = Progress({section.id: section.units for section in FIELD.sections})
    for unit in range(done):
        progress.cover(last.id, unit)
    pose = Pose(x_m, 0.0, 0.0, 0.0, State.WORKING, False, 0)
    return FleetView(
        0, now_us, Observation(*at, 0.0, 0.0, 0.0), allocation, progress, frozenset((0, 1)), {},
        {1: Neighbour(pose, now_us)},
    )  # fmt: skip


def taken_us(moves_m_s: float, until_us: int = 3 * STANDS_US) -> int | None:
    choosing = SectionChooser(FIELD, 2.5)
    for now_us in range(0, until_us, CONTROL_PERIOD_US):
        choice = choosing.choose(view(now_us, (0.0, 0.0), moves_m_s * now_us / S), (0.0, 0.0))
        if choice is not None:
            assert choice.takeover and choice.section == FIELD.sections[-1].id
            return now_us
    return None


def test_a11_a_live_robot_that_stands_loses_its_claim_and_the_epoch_rises() -> None:
    when_us = taken_us(0.0)
    assert when_us is not None and abs(when_us - STANDS_US) <= 2 * CONTROL_PERIOD_US
    seen = view(0, (0.0, 0.0), 0.0)
    before = seen.allocation.entry(FIELD.sections[-1].id).epoch
    assert seen.allocation.takeover(FIELD.sections[-1].id, 0) is not None
    assert seen.allocation.entry(FIELD.sections[-1].id).epoch == before + 1


def test_a_live_robot_that_moves_on_keeps_its_claim() -> None:
    assert taken_us(0.5) is None


def test_a11_what_we_gave_back_is_left_to_others_until_one_gets_on() -> None:
    choosing, last = SectionChooser(FIELD, 2.5), FIELD.sections[-1].id
    choosing.gave_back(last, 2, 0)
    free = view(AGAIN_US - 1, (0.0, 0.0), 0.0, done=2)
    free.allocation.release(last, 1)
    assert choosing.choose(free, (0.0, 0.0)) is None
    assert choosing._left_to_others(last, free) and not choosing._left_to_others(
        last, free._replace(now_us=AGAIN_US)
    )
    more = view(1, (0.0, 0.0), 0.0, done=3)
    assert not choosing._left_to_others(last, more)
