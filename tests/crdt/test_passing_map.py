"""A map of obstacles that pass: latest update for as long as a fleet runs, with 17 bits of time."""

from random import Random

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from crdt.occupancy import Geometry, OccupancyMap, patch_of
from crdt.passing_map import LAP_S, LAPS, LAST_TIME, PassingMap, code_of, lap_of
from crdt.sighting import OBSTACLE, RECORD_BITS, MergeOrder

SMALL = Geometry(4, 8, (0.0, 0.0), 0.1)
LEVEL = 13
Look = tuple[int, int, int, int]  # column, value, full time, observer
looks = st.lists(
    st.tuples(
        st.integers(0, 7), st.integers(1, 2), st.integers(1, 5 * LAP_S - 1), st.integers(0, 3)
    ),
    max_size=20,
)


def see(chart: OccupancyMap, look: Look) -> None:
    column, value, time, observer = look
    values = np.zeros(16, dtype=np.int64)
    values[column % 4] = value
    chart.apply(patch_of(0, column), values, LEVEL, time, observer)


def made(found: list[Look]) -> PassingMap:
    chart = PassingMap(SMALL)
    for look in found:
        see(chart, look)
    return chart


@given(looks, st.randoms(use_true_random=False))
def test_the_order_in_which_records_arrive_does_not_matter(found: list[Look], rng: Random) -> None:
    again = [*found, *found[::2]]
    rng.shuffle(again)
    one, other = made(found), made(again)
    assert one == other and one.digest == other.digest
    times = [time for _, _, time, _ in found]
    floor = max(max(times, default=0) // LAP_S - 1, 0) * LAP_S
    latest: dict[int, int] = {}
    for column, _, time, _ in found:
        if time >= floor:
            latest[column] = max(time, latest.get(column, 0))
    keys = one.keys()[0]
    assert {c: int(key) >> RECORD_BITS for c, key in enumerate(keys) if key} == latest


@given(looks)
def test_in_the_first_lap_it_is_the_latest_update_bit_for_bit(found: list[Look]) -> None:
    first = [(c, value, time % LAP_S, slot) for c, value, time, slot in found]
    chart, plain = made(first), OccupancyMap(SMALL, MergeOrder.LATEST_UPDATE)
    for look in first:
        see(plain, look)
    assert np.array_equal(chart.keys(), plain.keys())
    assert chart.digest == plain.digest and chart.serialize() == plain.serialize()


@given(
    st.integers(0, 60), st.integers(0, LAP_S - 1), st.integers(-3, 11), st.integers(0, LAP_S - 1)
)
def test_a_time_comes_back_from_the_wire(lap: int, stamp: int, ahead: int, second: int) -> None:
    chart = PassingMap(SMALL)
    own = lap - ahead
    told = chart.stamp(LEVEL, lap * LAP_S + stamp)
    assert 0 <= told[0] < 16 and told[1] == stamp
    if own >= 1 and (lap >= 1 or ahead < 0):
        assert chart.time_of(*told, own * LAP_S + second) == lap * LAP_S + stamp
    assert chart.time_of(*told, second) == code_of(lap) * LAP_S + stamp, "a robot that has booted"


def test_of_two_clocks_at_least_one_follows_the_other() -> None:
    """Otherwise each would take the other's records for old, and they would be repeated for ever."""
    for one in range(1, 40):
        for other in range(1, 40):
            heard = lap_of(code_of(other), one), lap_of(code_of(one), other)
            assert code_of(one) == code_of(other) or heard[0] > one or heard[1] > other


def test_robots_that_count_other_laps_have_equal_digests() -> None:
    found = [(0, OBSTACLE, 3 * LAP_S + 5, 1), (5, OBSTACLE, 2 * LAP_S + 9, 2)]
    late = [(column, value, time + LAPS * LAP_S, slot) for column, value, time, slot in found]
    assert made(found).digest == made(late).digest
    assert made(found).serialize() == made(late).serialize()


def test_records_of_later_laps_are_not_recalled() -> None:
    """Their age is not known: they may be of hours or of weeks before."""
    for lap, recalled in ((0, 1), (1, 0), (7, 0)):
        chart, again = made([(0, OBSTACLE, lap * LAP_S + 5, 1)]), PassingMap(SMALL)
        assert again.join_bytes(0, chart.patch_bytes(0)) == recalled


def test_at_the_end_of_the_clock_every_record_that_a_frame_can_carry_is_taken_or_old() -> None:
    chart = made([(0, OBSTACLE, LAST_TIME, 1)])
    values = np.ones(16, dtype=np.int64)
    for level in range(16):
        for stamp in (0, LAP_S - 1):
            time = chart.time_of(level, stamp, LAST_TIME)
            assert 0 <= time <= LAST_TIME
            chart.apply(patch_of(0, 0), values, level, time, 2)
    assert int(chart.keys().max()) >> RECORD_BITS == LAST_TIME
