"""Orders are said until two robots know them, or all there are; a number is one task's."""

import time

import pytest

from agent.delivery.task_registry import HIGHEST_ASKED, WITHDRAWN, TaskRegistry, TransportTask
from agent.interface.config import MS, S
from protocol.frames.delivery_frames import TASK_NUMBERS, TaskBookDigest, TaskOrder
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import AddressClaimed
from protocol.name import tool_name
from sim.fleet.transport_orders import NumbersSpentError, TransportClient


def digest(tasks: set[int]) -> TaskBookDigest:
    return TaskBookDigest(0, 0, 0, sum(1 << task for task in tasks))


def test_an_order_is_repeated_until_two_robots_know_it() -> None:
    """Found: the only robot that had heard an order died before it told the others."""
    desk = TransportClient(3)
    desk.order([TransportTask(1, 2)])
    assert desk.numbers == [3]
    for source in (1, 2):
        desk.hear(source, digest({0, 1, 2}))
    assert desk.due() == [TaskOrder(3, 1, 2)]
    desk.hear(1, digest({0, 1, 2, 3}))
    assert desk.due()
    desk.hear(2, digest({0, 1, 2, 3}))
    assert not desk.due() and desk.confirmed(3)


def test_of_two_devices_that_use_one_number_the_lesser_order_moves_on() -> None:
    desk = TransportClient(3)
    desk.order([TransportTask(1, 2)])
    desk.hear(9, TaskOrder(3, 5, 6))
    assert desk.numbers == [4]
    desk.hear(9, TaskOrder(4, 0, 6))  # less than ours: the other one moves on
    assert desk.numbers == [4]


def test_the_book_is_as_the_desk_believes() -> None:
    book = TaskRegistry(0, {}, 0)
    assert book.on_message(TaskOrder(3, 1, 2), 0)  # to be kept
    assert book.on_message(TaskOrder(3, 5, 6), 0)
    assert not book.on_message(TaskOrder(3, 1, 2), 0)
    assert book.tasks[3] == TransportTask(5, 6)


def test_a_tool_that_asks_for_orders_confirms_none() -> None:
    desk = TransportClient()
    desk.order([TransportTask(1, 2)])
    desk.hear(249, AddressClaimed(tool_name(5).pack()))
    desk.hear(249, digest({0}))
    assert not desk.robots and not desk.confirmed(0)
    desk.hear(7, digest({0}))
    assert desk.confirmed(0)


def test_an_order_is_taken_back_until_a_robot_repeats_that() -> None:
    desk = TransportClient()
    (index,) = desk.order([TransportTask(1, 2)])
    for source in (7, 8):
        desk.hear(source, digest({0}))
    assert desk.confirmed(0)
    desk.withdraw(0)
    desk.hear(7, digest({0}))  # that it knows the task says nothing of the withdrawal
    assert desk.due() == [TaskOrder(0, WITHDRAWN, 2)]
    desk.hear(7, TaskOrder(0, WITHDRAWN, 2))
    assert not desk.due() and desk.number_of(index) == 0


def test_a_withdrawal_wins_in_every_order_of_arrival() -> None:
    said = [TaskOrder(3, 1, 2), TaskOrder(3, WITHDRAWN, 2)]
    books = []
    for frames in (said, said[::-1]):
        book = TaskRegistry(0, {}, 0)
        for frame in frames:
            book.on_message(frame, 0)
        books.append(book.tasks)
    assert books[0] == books[1] == {3: TransportTask(1, 2).taken_back}
    assert books[0][3].withdrawn


def test_a_stranger_with_the_last_number_does_not_hold_orders_up() -> None:
    """One frame of anybody on the bus, and every later order had a number that robots refuse; the
    highest one ended the device by a struct.error."""
    for number in (TASK_NUMBERS - 1, TASK_NUMBERS, 0xFFFF):
        desk = TransportClient(3)
        desk.hear(9, TaskOrder(number, 5, 6))
        desk.order([TransportTask(1, 2), TransportTask(1, 3)])
        assert desk.numbers == [3, 4]
        assert [GROUP_OF[TaskOrder].pack(due) for due in desk.due()]


def test_numbers_of_transports_end_with_the_last_bucket_of_a_task_book() -> None:
    """Found: a gateway numbered an order that robots ignore, and the master heard that it was
    accepted."""
    desk = TransportClient(TASK_NUMBERS - 1)
    desk.order([TransportTask(1, 2)])
    with pytest.raises(NumbersSpentError, match="start a fleet with new state folders"):
        desk.order([TransportTask(1, 3)])
    desk.hear(9, TaskOrder(TASK_NUMBERS - 1, 5, 6))  # greater: the number belongs to another device
    assert not desk.due() and not desk.confirmed(desk.number_of(0))


def test_an_order_is_found_among_thousands_at_once() -> None:
    """Found: the gateway of a VDA 5050 master looks twenty times a second for the order of each robot,
    and each look went through all orders that there ever were. With
    20,000 of them, and twenty robots, that was a fifth of a core."""
    desk = TransportClient()
    index = desk.order([TransportTask(1, 2)])[0]
    for number in range(1, 20_000):
        index = desk.recall(number, TransportTask(1, 2))
    begun_at_s = time.process_time()
    for _ in range(2_000):
        assert desk.number_of(index) == 19_999
    assert time.process_time() - begun_at_s < 0.5, "was 0.9 s"


@pytest.mark.parametrize("tasks", [200, 1500])
def test_a_device_that_comes_late_takes_no_number_that_is_used(tasks: int) -> None:
    """Found: robots tell 48 numbers a second, so in 3 s a device heard a part of them. Its order took the
    number of another one: that one was lost, or ours counted as delivered where that one was."""
    given = {number: TransportTask(1, 2) for number in range(tasks)}
    books = [TaskRegistry(slot, given, 0) for slot in range(2)]
    for listens_at_us in range(60 * S, 100 * S, 7 * S):
        desk = TransportClient()
        for now_us in range(listens_at_us, listens_at_us + 3 * S, 50 * MS):
            if now_us == listens_at_us:
                for book in books:
                    book.on_message(HIGHEST_ASKED, now_us)
            for source, book in enumerate(books):
                for message in book.outgoing(now_us):
                    desk.hear(source, message)
        desk.order([TransportTask(5, 6)])
        assert desk.numbers == [tasks]


def test_a_finished_order_keeps_its_number_and_takes_no_other() -> None:
    """A greater order under its number gave it a new number, and a new order could get the old one."""
    desk = TransportClient(7)
    desk.order([TransportTask(1, 2)])
    desk.finish(7)
    desk.hear(128, TaskOrder(7, 3, 4))
    assert not desk.due()
    desk.order([TransportTask(1, 2)])
    assert desk.numbers == [8]
    desk.finish(8)
    desk.order([TransportTask(1, 2)])
    assert desk.numbers == [9], "nobody has told of 8, and it is used"
