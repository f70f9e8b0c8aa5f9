"""Rounds of planning by several peers on a wire that loses, delays nothing, and has deaths."""

from random import Random

import pytest

from agent.delivery.plan_negotiation import (
    NEGOTIATION_TABLE,
    NegotiationEvent,
    NegotiationPhase,
    PlanNegotiation,
    digest_of,
)
from agent.delivery.task_registry import TaskRegistry, TransportTask
from agent.interface.config import MS, S
from protocol.frames.delivery_frames import (
    BUCKET_TASKS,
    ORDER_SALTS,
    PlanOffer,
    PlanRow,
    TaskBookDigest,
)
from tests.agent.planning import frozen, play, short_search
from tests.state_tables import check_table

short_searches = pytest.fixture(autouse=True)(short_search)


@pytest.mark.parametrize("seed", range(4))
def test_all_adopt_the_cheapest_plan(seed: int) -> None:
    peers = play(4, 0.0, seed)
    adopted = [peer.adopted for peer in peers]
    assert adopted[0] is not None and all(plan == adopted[0] for plan in adopted)
    assert sorted(t for row in adopted[0].values() for t in row) == list(range(100, 112))
    assert sum(peer.streamed for peer in peers) == 1


@pytest.mark.parametrize("seed", range(4))
def test_when_the_elected_dies_the_next_is_elected(seed: int) -> None:
    peers = play(4, 0.0, seed, dies_streaming=True)
    assert len(peers) == 3
    adopted = [peer.adopted for peer in peers]
    assert adopted[0] is not None and all(plan == adopted[0] for plan in adopted)
    assert sum(peer.streamed for peer in peers) == 1


@pytest.mark.parametrize("seed", range(4))
def test_no_loss_keeps_anybody_in_a_round(seed: int) -> None:
    for peer in play(4, 0.3, seed):
        assert peer.phase is NegotiationPhase.REST


@pytest.mark.parametrize("number", [1, 126, 127, 128, 200, 254, 255])
def test_a_robot_that_restarts_joins_whatever_round_the_fleet_is_in(number: int) -> None:
    """Found: it began at 0, so half of all numbers were over for it, and it adopted no plan."""
    peers = play(2, 0.0, 1, number=number)
    assert peers[0].adopted is not None and peers[1].adopted == peers[0].adopted
    assert [peer.number for peer in peers] == [(number + 1) & 0xFF] * 2
    assert not peers[1].wanted(PlanOffer(number, 4, 0, 0)), "from now on its own number counts"


def test_rows_of_an_older_round_are_not_believed() -> None:
    peer = PlanNegotiation(0, 1)
    peer.call(frozen(2, 4, 1), 1_000_000, 0)
    peer.on_message(1, PlanRow((peer.number - 1) & 0xFF, 0, 0, 1, 100, 0xFFFF), 0)
    assert not peer._told


def test_a_digest_tells_plans_apart() -> None:
    assert digest_of({0: [1, 2], 1: []}) != digest_of({0: [2, 1], 1: []})


@pytest.mark.parametrize("seed", range(5))
def test_task_books_become_equal_whatever_is_lost(seed: int) -> None:
    print(f"seed {seed}")
    rng = Random(seed)
    books = [TaskRegistry(slot, {}, 0) for slot in range(4)]
    for task in {*range(60)} - {7}:
        order = TransportTask(rng.randrange(900), rng.randrange(900))
        books[rng.randrange(4)].tasks[task] = order
    # one number was given to two tasks, in different halves of a split
    books[0].tasks[7], books[1].tasks[7] = TransportTask(1, 2), TransportTask(3, 4)
    for step in range(1_200):
        for slot, book in enumerate(books):
            for said in list(book.outgoing(step * 50_000)):
                for other, heard in enumerate(books):
                    if other != slot and rng.random() > 0.2:
                        heard.on_message(said, step * 50_000)
    assert all(book.tasks == books[0].tasks for book in books)
    assert len(books[0].tasks) == 60 and books[0].tasks[7] == TransportTask(3, 4)


def test_no_withdrawal_is_hidden_by_a_collision_of_digests() -> None:
    """Found: a check of 8 bits without a salt was equal for one order in 256 and its withdrawal. A robot
    that was off when the order was taken back never heard of it, and carried the parcel."""
    for pickup in range(1_000):
        order = TransportTask(pickup, 5)
        books = [TaskRegistry(0, {0: order.taken_back}, 0), TaskRegistry(1, {0: order}, 0)]
        for now_us in range(0, 10 * S, 250 * MS):
            for book, other in (books, books[::-1]):
                for said in list(book.outgoing(now_us)):
                    other.on_message(said, now_us)
            if books[0].tasks == books[1].tasks:
                break
        assert books[1].tasks[0].withdrawn, order


@pytest.mark.parametrize("buckets", [1, 2, 8, 16])
def test_each_bucket_is_told_with_all_salts(buckets: int) -> None:
    order = TransportTask(1, 2)
    book = TaskRegistry(3, {k * BUCKET_TASKS: order for k in range(buckets)}, 0)
    told = {
        (said.bucket, said.salt)
        for second in range((ORDER_SALTS + 1) * buckets + 2)
        for said in book.outgoing(second * S)
        if isinstance(said, TaskBookDigest)
    }
    assert len(told) == buckets * ORDER_SALTS


def test_every_phase_and_event() -> None:
    rest, search, offer, stream = NegotiationPhase
    begun, searched, elected, silent, no_offer, adopted = NegotiationEvent
    check_table(NEGOTIATION_TABLE, rest, {
        (rest, begun, search), (offer, begun, search), (stream, begun, search),
        (search, searched, offer), (offer, elected, stream), (stream, silent, offer),
        (stream, no_offer, rest),
        (search, adopted, rest), (offer, adopted, rest), (stream, adopted, rest),
    })  # fmt: skip
