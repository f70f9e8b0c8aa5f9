"""Kernels about fences say what shapely says, and gather the nearest in order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, Point

from agent.avoidance.fence_distance import gap_m, gather, way_gap_m

PLACE = st.floats(-20.0, 20.0).map(lambda v: round(v, 2))
FENCES = st.lists(st.tuples(PLACE, PLACE, PLACE, PLACE), min_size=1, max_size=12)


def away_m(fence: tuple[float, ...], x: float, y: float) -> float:
    return float(LineString([fence[:2], fence[2:]]).distance(Point(x, y)))


@settings(deadline=None)  # kernels are loaded
@given(FENCES, PLACE, PLACE)
def test_the_nearest_of_all(fences: list[tuple[float, ...]], x: float, y: float) -> None:
    wanted = min(away_m(fence, x, y) for fence in fences)
    assert gap_m(x, y, np.array(fences)) == pytest.approx(wanted, abs=1e-9)


@settings(deadline=None)  # kernels are loaded
@given(FENCES, PLACE, PLACE)
def test_along_a_way_it_is_the_smallest_of_its_points(
    fences: list[tuple[float, ...]], x: float, y: float
) -> None:
    table = np.array(fences)
    wanted = min(gap_m(x + 0.6 * k * 0.5, y + 0.8 * k * 0.5, table) for k in (1, 2, 3))
    assert way_gap_m(x, y, 0.6, 0.8, 0.5, 3, table) == pytest.approx(wanted, abs=1e-9)


@settings(deadline=None)  # kernels are loaded
@given(FENCES, PLACE, PLACE, st.integers(1, 5), st.floats(1.0, 30.0))
def test_the_nearest_are_gathered_in_order(
    fences: list[tuple[float, ...]], x: float, y: float, most: int, reach_m: float
) -> None:
    table = np.array(fences)
    gaps = [gap_m(x, y, table[k : k + 1]) for k in range(len(table))]
    order = [k for k in np.argsort(gaps, kind="stable") if gaps[k] <= reach_m][:most]
    out = np.zeros(4 * most)
    count = gather(x, y, table, reach_m, out, np.empty(most))
    assert count == len(order)
    np.testing.assert_array_equal(out[: 4 * count].reshape(-1, 4), table[order])


def test_without_fences_nothing_is_near() -> None:
    assert gap_m(0.0, 0.0, np.empty((0, 4))) == np.inf
