"""Kernels about fences say what shapely says, and gather the nearest in order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, Point

from agent.avoidance.fence_distance import THIN_MAX_M, gap_m, gather, way_gap_m
from agent.avoidance.orca import OrcaSolver

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


@pytest.mark.parametrize("piece_m", [0.1, 0.05, 0.02, 0.01])
@pytest.mark.parametrize("wanted", [(2.5, -1.0), (1.0, -2.2)])
def test_a_fence_of_many_short_pieces_is_kept_as_one_piece_is(
    piece_m: float, wanted: tuple[float, float]
) -> None:
    """An outline as a receiver records it has more vertices near than a robot looks at. The nearest 64
    were a metre of fence, and a robot drove through what came after it."""
    ends_m = np.arange(0.0, 60.0, piece_m)
    level = np.zeros(len(ends_m) - 1)
    fences = np.stack([ends_m[:-1], level, ends_m[1:], level], axis=1)
    orca = OrcaSolver(0.8, 2.5, 0.75, 3.0, 0.05, fences)
    at, own, nearest_m = np.array([5.0, 2.0]), np.zeros(2), 2.0
    for k in range(400):
        chosen = np.array(orca.among_known((at[0], at[1]), (own[0], own[1]), wanted, k * 0.05))
        asked = float(np.hypot(*(chosen - own)))
        own = own + (chosen - own) * min(1.0, 1.5 * 0.05 / max(asked, 1e-9))
        at = at + own * 0.05
        nearest_m = min(nearest_m, float(at[1]))
    assert nearest_m > 0.79
    assert at[0] > 10.0, "it goes on along the fence"


def test_a_place_where_the_receiver_stood_hides_no_other_fence() -> None:
    """Hundreds of vertices within centimetres, and a long fence on each side."""
    rng = np.random.default_rng(1)
    knot = np.cumsum(np.abs(rng.normal(0.0, 0.001, (300, 2))), axis=0)
    points = np.vstack([[-50.0, 0.0], knot, [50.0, knot[-1, 1]]])
    fences = np.hstack([points[:-1], points[1:]])
    out = np.zeros(4 * 64)
    count = gather(0.0, 1.0, fences, 6.0, out, np.empty(64))
    kept = out[: 4 * count].reshape(-1, 4)
    assert count < 64 and kept[:, 0].min() == -50.0 and kept[:, 2].max() == 50.0


@settings(deadline=None)  # kernels are loaded
@given(st.integers(0, 2**32 - 1), st.integers(65, 400))
def test_what_is_joined_stays_near_what_it_replaces(seed: int, number: int) -> None:
    rng = np.random.default_rng(seed)
    turns = np.cumsum(rng.normal(0.0, 0.3, number))
    steps_m = rng.uniform(0.001, 0.06, number)
    points = np.cumsum(np.stack([np.cos(turns), np.sin(turns)], 1) * steps_m[:, None], axis=0)
    fences = np.hstack([points[:-1], points[1:]])
    x, y = points[number // 2] + rng.normal(0.0, 1.0, 2)
    out, reach_m = np.zeros(4 * 64), 100.0
    count = gather(x, y, fences, reach_m, out, np.empty(64))
    kept = [LineString([row[:2], row[2:]]) for row in out[: 4 * count].reshape(-1, 4)]
    for point in points if count < 64 else ():
        assert min(line.distance(Point(point)) for line in kept) <= THIN_MAX_M + 1e-9
