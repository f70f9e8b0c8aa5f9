"""Vector clocks against the definition."""

from hypothesis import given
from hypothesis import strategies as st

from crdt import Dot, VectorClock

clocks = st.dictionaries(st.integers(0, 5), st.integers(0, 9)).map(VectorClock)


@given(clocks, clocks, clocks)
def test_merge_is_a_join(a: VectorClock, b: VectorClock, c: VectorClock) -> None:
    assert a.merged(b) == b.merged(a)
    assert a.merged(b).merged(c) == a.merged(b.merged(c))
    assert a.merged(a) == a
    assert a <= a.merged(b) and b <= a.merged(b)


@given(clocks, clocks)
def test_order_is_the_componentwise_order(a: VectorClock, b: VectorClock) -> None:
    slots = range(6)
    below = all(a[s] <= b[s] for s in slots)
    same = all(a[s] == b[s] for s in slots)
    assert (a <= b) == below
    assert a.happens_before(b) == (below and not same)
    assert a.concurrent_with(b) == (not below and not all(b[s] <= a[s] for s in slots))


def test_equal_clocks_are_not_concurrent() -> None:
    assert not VectorClock({1: 2}).concurrent_with(VectorClock({1: 2}))


def test_a_clock_does_not_alias_its_counts() -> None:
    counts = {1: 1}
    clock = VectorClock(counts)
    counts[1] = 99
    assert clock[1] == 1


def test_increment_names_a_new_event() -> None:
    clock = VectorClock()
    assert clock.increment(3) == Dot(3, 1)
    assert clock.increment(3) == Dot(3, 2) and clock.covers(Dot(3, 1))


@given(st.integers(0, 1 << 20), st.integers(0, 20_000))
def test_witness_unwraps_the_low_bits(known: int, missed: int) -> None:
    clock = VectorClock({1: known})
    clock.witness(1, (known + missed) & 0xFFFF)
    assert clock[1] == known + missed


@given(st.integers(1, 1 << 20), st.integers(1, 20_000))
def test_a_stale_witness_changes_nothing(known: int, behind: int) -> None:
    clock = VectorClock({1: known})
    clock.witness(1, (known - min(behind, known)) & 0xFFFF)
    assert clock[1] == known


def test_a_replica_itself_corrects_what_an_old_slice_moved_too_far() -> None:
    clock = VectorClock({1: 1000})
    clock.witness(1, 870 & 0xFF, bits=8)
    assert clock[1] == 1126
    clock.settle(1, 1001)
    assert clock[1] == 1001


@given(st.integers(0, 1 << 20), st.integers(-20_000, 20_000))
def test_settle_takes_the_nearest_value(known: int, moved: int) -> None:
    count = max(known + moved, 0)
    clock = VectorClock({1: known})
    clock.settle(1, count & 0xFFFF)
    assert clock[1] == count and (1 in list(clock)) == (count > 0)
