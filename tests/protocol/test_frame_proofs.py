"""Proofs of frames: what they cover, and that each is believed once, in time, and of its sender alone."""

from random import Random

import pytest

from protocol import frame_proofs
from protocol.authentication import KEY_SIZE, Keys
from protocol.frame_proofs import (
    AHEAD,
    BACK,
    HELD_FOR_US,
    HELD_MAX,
    TICK_US,
    FleetTime,
    ProofBatch,
    ProofChecker,
    ProofKeys,
    Replay,
)
from protocol.frames.trust_frames import Proof
from protocol.frames.work_frames import WorkProgress
from protocol.units import S

SENDER, ADDRESS, OTHER = 3, 131, 132
START, NOW_US = 1 << 40, 5 * S
KEYS = Keys(Random("fleet").randbytes(KEY_SIZE), None)


def known_time() -> FleetTime:
    time = FleetTime(START, 0)
    time.known = True
    return time


def checker() -> ProofChecker:
    return ProofChecker(ProofKeys(KEYS), known_time())


def news(section: int) -> WorkProgress:
    return WorkProgress(section, 0, 1)


def sealed(*messages: WorkProgress, at_us: int = NOW_US, keys: Keys = KEYS) -> Proof:
    batch = ProofBatch(SENDER, ProofKeys(keys), known_time())
    for message in messages:
        batch.add(message, at_us)
    proof = batch.seal(ADDRESS, at_us)
    assert proof is not None
    return proof


@pytest.mark.parametrize("order", [(1, 2, 3), (3, 1, 2)])
def test_a_proof_covers_its_frames_in_any_order_before_and_after_it(order: tuple[int, ...]) -> None:
    proof, receiver = sealed(news(1), news(2), news(3)), checker()
    for section in order[:2]:
        assert receiver.hold(ADDRESS, news(section), NOW_US) == []
    assert receiver.verify(ADDRESS, proof, NOW_US) is None, "one frame is still in a queue"
    (proven,) = receiver.hold(ADDRESS, news(order[2]), NOW_US)
    assert proven.sender == SENDER and set(proven.messages) == {news(k) for k in (1, 2, 3)}
    assert receiver.holding == 0


def test_frames_and_proof_that_are_sent_again_are_not_believed_again() -> None:
    proof, receiver = sealed(news(1)), checker()
    receiver.hold(ADDRESS, news(1), NOW_US)
    assert receiver.verify(ADDRESS, proof, NOW_US) is not None
    for later_us in (1, BACK * TICK_US // 2, BACK * TICK_US):
        receiver.hold(ADDRESS, news(1), NOW_US + later_us)
        assert receiver.verify(ADDRESS, proof, NOW_US + later_us) is None
    assert receiver.accepted == 1 and receiver.stale >= 3


@pytest.mark.parametrize("ticks", [BACK + 1, -(AHEAD + 1)])
def test_a_proof_out_of_its_time_is_stale(ticks: int) -> None:
    receiver, at_us = checker(), NOW_US + ticks * TICK_US
    receiver.hold(ADDRESS, news(1), at_us)
    assert receiver.verify(ADDRESS, sealed(news(1)), at_us) is None and receiver.stale == 1


def test_a_proof_is_of_one_sender_address_key_and_content() -> None:
    proof, stranger = sealed(news(1)), Keys(Random("other").randbytes(KEY_SIZE), None)
    wrong = [
        (OTHER, proof, news(1)),
        (ADDRESS, proof._replace(sender=SENDER + 1), news(1)),
        (ADDRESS, proof._replace(tag=proof.tag ^ 1), news(1)),
        (ADDRESS, sealed(news(1), keys=stranger), news(1)),
        (ADDRESS, proof, news(2)),
    ]
    for address, told, message in wrong:
        receiver = checker()
        receiver.hold(address, message, NOW_US)
        assert receiver.verify(address, told, NOW_US) is None, (address, told, message)
        assert receiver.accepted == 0 and receiver.holding == 1


def test_what_is_held_is_bounded_in_number_and_time() -> None:
    receiver = checker()
    for section in range(HELD_MAX + 5):
        receiver.hold(ADDRESS, news(section), NOW_US)
    assert receiver.holding == HELD_MAX and receiver.dropped == 5
    receiver.hold(ADDRESS, news(0), NOW_US + HELD_FOR_US + 1)
    assert receiver.holding == 1


def test_each_tick_is_used_once_and_agrees_with_a_set() -> None:
    rng, window, used = Random(7), Replay(), set[int]()
    newest = -1
    for _ in range(2_000):
        ticks = max(0, newest + rng.randrange(-2 * BACK, 6))
        slow = ticks not in used and ticks >= newest - BACK
        assert window.fresh(ticks) is slow, ticks
        if slow:
            window.use(ticks)
            used.add(ticks)
            newest = max(newest, ticks)


def test_a_robot_keeps_few_tags() -> None:
    """Each is asked for once, or in one process within milliseconds; 4,096 of them took 1.6 MB."""
    for k in range(2 * frame_proofs.SUMS_MAX):
        frame_proofs._sum(bytes(16), k.to_bytes(4, "little"))
    assert frame_proofs._sum.cache_info().currsize <= 128
