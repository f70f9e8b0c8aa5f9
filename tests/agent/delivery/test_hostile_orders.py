"""Orders and claims that a building does not have; each of them ended a robot."""

import pytest

from agent.delivery.cost_matrix import Carrier
from agent.delivery.delivery_mission import DeliveryMission
from agent.delivery.task_registry import (
    AGAIN_US,
    TASKS_MAX,
    TaskRegistry,
    TransportTask,
    recalled_orders,
    record,
)
from agent.delivery.warehouse import SECTIONS_END
from agent.interface.config import MS, S
from agent.interface.lifecycle import State
from agent.peer.work_admission import Admission
from crdt import FieldAllocationCRDT, Phase
from protocol.frames.delivery_frames import BUCKET_TASKS, TASK_NUMBERS, TaskBookDigest, TaskOrder
from protocol.frames.messages import GROUP_OF
from protocol.frames.work_frames import TaskClaim
from tests.agent.delivery.test_delivery_mission import house, view

CELLS = 100  # of the building of these tests


def on_floor(order: TransportTask) -> bool:
    return max(order) < CELLS


def test_an_order_with_a_cell_that_is_no_place_is_refused() -> None:
    book = TaskRegistry(0, {7: TransportTask(1, 2)}, 0, on_floor)
    assert not book.on_message(TaskOrder(7, 50_000, 3), 0)
    assert not book.on_message(TaskOrder(8, 1, 50_000), 0)
    assert not book.on_message(TaskOrder(7, 0xFFFF, 50_000), 0), "taken back, to nowhere"
    assert book.tasks == {7: TransportTask(1, 2)} and book.refused == 3
    assert book.on_message(TaskOrder(7, 0xFFFF, 2), 0) and book.tasks[7].withdrawn


def test_an_order_without_a_place_is_not_remembered_over_a_restart() -> None:
    assert TaskRegistry(0, {3: TransportTask(50_000, 1)}, 0, on_floor).tasks == {}


def test_a_robot_that_comes_late_learns_all_orders() -> None:
    """It told only of the numbers up to its own highest one, so nobody repeated those beyond."""
    known, late = (
        TaskRegistry(0, {k: TransportTask(1, 2) for k in range(3 * BUCKET_TASKS)}, 0),
        TaskRegistry(1, {}, 0),
    )
    for now_us in range(0, 60 * S, 50 * MS):
        for book, other in ((known, late), (late, known)):
            for said in list(book.outgoing(now_us)):
                other.on_message(said, now_us)
    assert late.tasks == known.tasks


def test_a_digest_that_shows_more_is_answered_once_in_a_while() -> None:
    book = TaskRegistry(1, {}, 0)
    more = TaskBookDigest(5, 0, 0, 1)
    said = []
    for now_us in range(0, AGAIN_US, 50 * MS):
        book.on_message(more, now_us)
        said += [
            m for m in book.outgoing(now_us) if isinstance(m, TaskBookDigest) and m.bucket == 5
        ]
    assert len(said) == 1 and said[0].bits == 0


def test_a_claim_of_a_bay_that_the_building_does_not_have_is_refused() -> None:
    bay, unknown = TaskClaim(TASKS_MAX, 0, Phase.CLAIMED, 3, 1, 0), FieldAllocationCRDT()
    for sections, admitted in ((range(TASKS_MAX), False), (range(SECTIONS_END), True)):
        admission = Admission(sections, frozenset({0, 1}), 0)
        assert admission.admits(bay, unknown, 0) is admitted
        assert admission.admits(bay._replace(section=5), unknown, 0)


def test_an_order_without_a_place_does_not_hide_the_task_that_was_given() -> None:
    """An older robot stored it. The parcel aboard went nowhere, since its task was not known."""
    given = {7: TransportTask(1, 2)}
    book = TaskRegistry(
        0, given, 0, on_floor, {7: TransportTask(50_000, 3), 8: TransportTask(4, 5)}
    )
    assert book.tasks == {**given, 8: TransportTask(4, 5)} and book.refused == 1


def test_one_high_number_does_not_delay_all_other_orders() -> None:
    """Digests went round all numbers up to the highest, one a second: 512 s with this one."""
    order = TransportTask(1, 2)
    known = TaskRegistry(0, {0: order, TASK_NUMBERS - 1: order}, 0)
    late = TaskRegistry(1, {}, 0)
    for now_us in range(0, 5 * S, 50 * MS):
        for book, other in ((known, late), (late, known)):
            for said in list(book.outgoing(now_us)):
                other.on_message(said, now_us)
    assert late.tasks == known.tasks


def test_an_order_whose_number_has_no_bucket_is_refused_and_not_recalled() -> None:
    """Found: one frame with number 12,288 ended every robot, since bucket 256 cannot be packed. The
    order was durable, so each restart ended them again."""
    order = TransportTask(1, 2)
    stored = recalled_orders(dict([record(TASK_NUMBERS, order), record(TASK_NUMBERS - 1, order)]))
    book = TaskRegistry(0, {}, 0, recalled=stored)
    assert book.tasks == {TASK_NUMBERS - 1: order}
    assert not book.on_message(TaskOrder(TASK_NUMBERS, 1, 2), 0) and book.refused == 2
    said = [m for now_us in range(0, 5 * S, 50 * MS) for m in book.outgoing(now_us)]
    assert said and all(GROUP_OF[type(m)].pack(m) for m in said)


@pytest.mark.parametrize("section", [9, TASKS_MAX])
def test_a_section_without_an_order_or_a_bay_is_given_up(section: int) -> None:
    """A durable claim may outlive an order that is refused. The mission raised an exception."""
    recalled = dict([record(9, TransportTask(50_000, 1))])
    mission = DeliveryMission(
        0, house(Carrier(1.0, 0.0), []), (0.5, 0.5), 1.0, 1.6, 0, 1, recalled=recalled
    )
    allocation = FieldAllocationCRDT()
    allocation.claim(section, 0)
    allocation.start(section, 0)
    seen = view(10 * S)._replace(allocation=allocation)
    mission.on_control_period(seen, State.WORKING)
    assert not mission.approach(section, seen).given_up
    assert mission.work(seen).given_up
    assert mission.stops == []
