"""Progress grows and joins; it never shrinks."""

from hypothesis import given
from hypothesis import strategies as st

from crdt import Progress

units = st.lists(st.tuples(st.integers(0, 3), st.integers(0, 199)), max_size=40)
UNITS = {0: 200, 1: 200, 2: 200, 3: 200}


def make(covered: list[tuple[int, int]]) -> Progress:
    progress = Progress(UNITS)
    for section, unit in covered:
        progress.cover(section, unit)
    return progress


@given(units, units)
def test_a_join_is_the_union(a: list[tuple[int, int]], b: list[tuple[int, int]]) -> None:
    one, other = make(a), make(b)
    one.merge(other)
    assert one == make(a + b)
    union = set(a) | set(b)
    assert all(one.has(s, u) == ((s, u) in union) for s in UNITS for u in range(200))
    assert all(one.covered(s) == sum(1 for t, _ in union if t == s) for s in UNITS)
    assert one.digest == make(b + a).digest


@given(units)
def test_bytes_and_back(covered: list[tuple[int, int]]) -> None:
    progress = make(covered)
    assert Progress.deserialize(progress.serialize(), UNITS) == progress


def test_units_that_do_not_exist_are_refused_and_counted() -> None:
    progress = Progress({0: 41})
    assert progress.apply(0, 1, 0b11)
    assert progress.covered(0) == 1 and progress.refused == 1
    assert not progress.apply(0, 200, 1)
