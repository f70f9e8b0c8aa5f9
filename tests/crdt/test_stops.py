"""The stop set: what is named is cleared, and nothing else, in whatever order things arrive."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crdt.stops import (
    ACTIVE_MAX,
    DOTS_MAX,
    OWN_MAX,
    RemoteStopDot,
    RemoteStopSet,
    StopDot,
    StopSet,
    next_in_rotation,
)

dots = st.builds(StopDot, st.integers(0, 3), st.integers(0, 1), st.integers(0, 3))
acts = st.lists(st.tuples(st.booleans(), dots), max_size=30)


def make(history: list[tuple[bool, StopDot]]) -> StopSet:
    stops = StopSet()
    for press, dot in history:
        stops.press(dot) if press else stops.clear(dot)
    return stops


@given(acts, st.randoms(use_true_random=False))
def test_order_does_not_matter(history: list[tuple[bool, StopDot]], rng: object) -> None:
    shuffled = list(history)
    rng.shuffle(shuffled)  # type: ignore[attr-defined]
    assert make(history) == make(shuffled)


@given(acts)
def test_latched_while_a_pressed_dot_is_not_cleared(history: list[tuple[bool, StopDot]]) -> None:
    pressed = {dot for press, dot in history if press}
    cleared = {dot for press, dot in history if not press}
    assert make(history).active == pressed - cleared


@given(acts)
def test_bytes_and_back(history: list[tuple[bool, StopDot]]) -> None:
    stops = make(history)
    assert StopSet.deserialize(stops.serialize()) == stops


def test_an_old_reset_does_not_mask_a_new_stop() -> None:
    stops = make([(True, StopDot(1, 0, 1)), (False, StopDot(1, 0, 1)), (True, StopDot(1, 0, 2))])
    assert stops.latched


@given(
    st.sets(
        st.builds(RemoteStopDot, *[st.integers(0, 255)] * 3, st.integers(1, 0x7FFF)), max_size=20
    )
)
def test_dots_of_other_segments(dots: set[RemoteStopDot]) -> None:
    stops = RemoteStopSet()
    for k, dot in enumerate(sorted(dots)):
        stops.press(dot)
        if k % 2:
            stops.clear(dot)
    again = RemoteStopSet.deserialize(stops.serialize())
    assert again == stops and again.active == stops.active


@pytest.mark.slow
def test_a_button_is_never_worn_out() -> None:
    """After 256 presses that were cleared the next one was looked for without end: that robot hung."""
    stops, counter, used = StopSet(), 250, list[StopDot]()

    def press(count: int) -> None:
        nonlocal counter
        for _ in range(count):
            dot, counter = stops.unused(3, 255, counter)
            assert stops.press(dot) and stops.latched
            stops.clear(dot)
            used.append(dot)

    press(600)  # into a third incarnation
    for k in range(600, DOTS_MAX - 300):  # what as many further presses would leave
        used.append(StopDot(3, 255 + k // 256 & 0xFF, 251 + k & 0xFF))
        stops.clear(used[-1])
    press(600)  # until the oldest are forgotten
    assert len(set(used[-DOTS_MAX:])) == DOTS_MAX


@given(st.sets(dots, max_size=20), st.integers(1, 8), st.none() | dots)
def test_all_have_their_turn(held: set[StopDot], count: int, last: StopDot | None) -> None:
    told = list[StopDot]()
    while len(told) < len(held):
        row = next_in_rotation(held, last, count)
        assert len(set(row)) == len(row) == min(count, len(held))
        told, last = [*told, *row], row[-1]
    assert set(told[: len(held)]) == held


def many(count: int) -> list[StopDot]:
    return [StopDot(k >> 16 & 0x7F, k >> 8 & 0xFF, k & 0xFF) for k in range(count)]


def test_t10_seventy_thousand_stops_are_held_written_down_and_released() -> None:
    stops = StopSet()
    for dot in many(70_000):
        stops.press(dot)
    assert stops.latched and len(stops.active) == ACTIVE_MAX and stops.more
    again = StopSet.deserialize(stops.serialize())
    assert again == stops and again.latched
    for dot in many(70_000):
        again.clear(dot)
    assert again.latched, "those without a name are cleared by no name"
    assert len(stops.clear_all()) == ACTIVE_MAX and not stops.latched
    assert len(stops.serialize()) < 3 * (2 * DOTS_MAX + 2 * ACTIVE_MAX)


def test_t10_a_button_is_never_worn_out_by_presses_that_nobody_clears() -> None:
    stops, counter = StopSet(), 0
    for dot in many(70_000):
        stops.press(dot)
    for _ in range(5_000):
        dot, counter = stops.unused(0, 0, counter)
        stops.press_own(dot)
        assert dot in stops.active
    assert len(stops.active) <= ACTIVE_MAX + OWN_MAX
    assert StopSet.deserialize(stops.serialize()).latched


def test_t10_the_digest_is_that_of_what_is_held() -> None:
    first, second = StopSet(), StopSet()
    for dot in many(20):
        first.press(dot)
    for dot in reversed(many(20)):
        second.press(dot)
    assert first.digest() == second.digest() != 0
    for dot in many(300):
        first.press(dot)
    full = first.digest()
    first.press_more()
    assert first.digest() != full, "a press without a name changes it"
    first.clear_all()
    assert first.digest() == 0


def test_replicas_at_the_limit_merge_to_the_same_in_both_directions() -> None:
    full, other = StopSet(), StopSet()
    for dot in many(ACTIVE_MAX):
        full.press(dot)
    other.press(StopDot(0x7F, 1, 1))
    other.clear(StopDot(0x7F, 1, 1))
    for dot in many(4):  # it makes room in the full one
        other.clear(dot)
    for k in range(4):
        other.press(StopDot(0x7F, 2, k))
    one, two = StopSet.deserialize(full.serialize()), StopSet.deserialize(other.serialize())
    one.merge(other)
    two.merge(full)
    assert one == two and one.active == two.active and not one.more and not two.more
