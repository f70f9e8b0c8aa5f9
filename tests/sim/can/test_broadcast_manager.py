"""The broadcast manager, by the rules of socketcand's protocol page and of Linux."""

import pytest

from protocol.frames.frame import Frame
from protocol.units import MS, S
from sim.can.broadcast_manager import (
    FILTERS_MAX,
    JOBS_MAX,
    NEVER_US,
    BroadcastError,
    BroadcastManager,
)
from sim.can.other_frame import OtherFrame

KEY = (False, 0x123)


def frame(*data: int) -> OtherFrame:
    return OtherFrame.of(0x123, bytes(data))


def sent(manager: BroadcastManager, until_us: int) -> list[tuple[int, bytes]]:
    found = []
    while (now_us := manager.due_at_us) <= until_us:
        found += [(now_us, due.frame.data) for due in manager.on_timer(now_us)]
    return found


def test_a_job_is_sent_now_and_cyclically_until_it_is_deleted() -> None:
    manager = BroadcastManager()
    assert manager.add(KEY, frame(0x42), 20 * MS, 0).data == b"\x42"
    assert [t for t, _ in sent(manager, 65 * MS)] == [20 * MS, 40 * MS, 60 * MS]
    manager.update(KEY, frame(1, 2))  # the time stays
    assert sent(manager, 100 * MS) == [(80 * MS, b"\x01\x02"), (100 * MS, b"\x01\x02")]
    manager.delete(KEY)
    assert manager.due_at_us == NEVER_US
    with pytest.raises(BroadcastError):
        manager.delete(KEY)
    with pytest.raises(BroadcastError):
        manager.update(KEY, frame(1))


def test_a_job_without_interval_is_sent_once_and_a_short_one_does_not_fill_the_bus() -> None:
    manager = BroadcastManager()
    manager.add(KEY, frame(1), 0, 0)
    assert sent(manager, 10 * S) == []
    manager.add(KEY, frame(1), 10, 0)  # 10 microseconds, as the protocol page's example
    assert len(sent(manager, 100 * MS)) == 100


def test_a_late_timer_skips_what_it_missed() -> None:
    manager = BroadcastManager()
    manager.add(KEY, frame(1), 10 * MS, 0)
    assert len(list(manager.on_timer(995 * MS))) == 1
    assert manager.due_at_us == 1000 * MS


def test_a_filter_tells_changes_under_its_mask() -> None:
    manager = BroadcastManager()
    manager.subscribe(KEY, 0, (bytes((0xFF, 0x00, 0xF8)),))
    told = [
        manager.hear(KEY, frame(*data), 0) is not None
        for data in ((1, 2, 8), (1, 3, 8), (1, 3, 9), (1, 3, 16), (2, 3, 16), (2,))
    ]
    assert told == [True, False, False, True, True, True]
    assert manager.hear((True, 0x123), Frame(0x123, b""), 0) is None


def test_a_multiplex_filter_compares_each_number_with_itself() -> None:
    """The example of the protocol page: number in byte 0, number 33 is followed."""
    manager = BroadcastManager()
    masks = bytes.fromhex("FF00000000000000"), bytes.fromhex("33FFFFFFFFFFFFFF")
    manager.subscribe(KEY, 0, masks)
    told = [
        manager.hear(KEY, frame(*data), 0) is not None
        for data in ((0x33, 1), (0x33, 1), (0x44, 1), (0x33, 2), (0x44, 2), (0x33, 2))
    ]
    assert told == [True, False, False, True, False, False]


def test_a_subscription_is_throttled_and_tells_the_newest() -> None:
    manager = BroadcastManager()
    manager.subscribe(KEY, 100 * MS)
    assert manager.hear(KEY, frame(1), 0) is not None
    assert manager.hear(KEY, frame(2), 10 * MS) is None
    assert manager.hear(KEY, frame(3), 20 * MS) is None
    assert sent(manager, S) == [(100 * MS, b"\x03")]
    assert manager.hear(KEY, frame(4), 2 * S) is not None  # after a rest at once
    manager.unsubscribe(KEY)
    assert manager.hear(KEY, frame(5), 9 * S) is None and manager.due_at_us == NEVER_US
    with pytest.raises(BroadcastError):
        manager.unsubscribe(KEY)


def test_what_a_client_may_have_is_bounded() -> None:
    manager = BroadcastManager()
    for number in range(JOBS_MAX):
        manager.add((False, number), frame(1), S, 0)
    with pytest.raises(BroadcastError):
        manager.add((True, 1), frame(1), S, 0)
    for number in range(FILTERS_MAX):
        manager.subscribe((True, number), 0)
    with pytest.raises(BroadcastError):
        manager.subscribe((False, 1), 0)
