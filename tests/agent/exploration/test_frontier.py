"""Frontiers: robots with the same map find, name and rank them alike."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.sparse import lil_matrix
from scipy.sparse.csgraph import dijkstra

from agent.exploration.frontier import (
    DEAR,
    DIAGONAL,
    NEVER,
    SEPARATION_M,
    STRAIGHT,
    FrontierChooser,
    OtherExplorer,
    border_cells,
    frontiers,
    wave_from,
    window_counts,
)
from agent.mapping.inflation import Grid
from crdt.occupancy import patch_of
from crdt.sighting import FREE, OBSTACLE, UNKNOWN
from tests.examples import examples


def slow_wave(passable: Grid, at: tuple[int, int]) -> dict[tuple[int, int], float]:
    rows, columns = passable.shape
    graph = lil_matrix((rows * columns, rows * columns))
    for r in range(rows):
        for c in range(columns):
            for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
                i, j = r + dr, c + dc
                if not (i < rows and 0 <= j < columns and passable[r, c] and passable[i, j]):
                    continue
                if dr and dc and not (passable[r, j] and passable[i, c]):
                    continue
                graph[r * columns + c, i * columns + j] = DIAGONAL if dr and dc else STRAIGHT
    ways = dijkstra(graph.tocsr(), directed=False, indices=at[0] * columns + at[1])
    return {divmod(k, columns): way for k, way in enumerate(ways) if np.isfinite(way)}


@given(arrays(np.bool_, (9, 11), elements=st.booleans()), st.integers(0, 8), st.integers(0, 10))
@settings(deadline=None, max_examples=examples(40))
def test_a_wave_is_dijkstra(passable: Grid, r: int, c: int) -> None:
    passable[r, c] = True
    wave, slow = wave_from(passable, (r, c)), slow_wave(passable, (r, c))
    found = {(i, j): int(wave[i, j]) for i, j in np.argwhere(wave < NEVER).tolist()}
    assert found == slow


def test_a_way_among_what_others_saw_counts_more() -> None:
    passable, theirs = np.ones((1, 6), dtype=np.bool_), np.zeros((1, 6), dtype=np.bool_)
    theirs[0, 2:4] = True
    wave = wave_from(passable, (0, 0), dear=theirs)
    assert (wave[0] / STRAIGHT).tolist() == [
        0,
        1,
        1 + DEAR,
        1 + 2 * DEAR,
        2 + 2 * DEAR,
        3 + 2 * DEAR,
    ]


@given(arrays(np.bool_, (7, 8), elements=st.booleans()), st.integers(0, 3))
def test_windows_are_counted(cells: Grid, reach: int) -> None:
    counts = window_counts(cells, reach)
    for r in range(7):
        for c in range(8):
            area = cells[max(r - reach, 0) : r + reach + 1, max(c - reach, 0) : c + reach + 1]
            assert counts[r, c] == np.count_nonzero(area)


def half_known() -> np.ndarray:
    """West known, east not, a wall across the lower half of what is known."""
    values = np.full((20, 40), UNKNOWN, dtype=np.int64)
    values[:, :20] = FREE
    values[:12, 10] = OBSTACLE
    return values


def test_a_frontier_is_where_free_meets_unknown() -> None:
    values = half_known()
    assert np.argwhere(border_cells(values))[:, 1].tolist() == [19] * 20
    found = frontiers(values, wave_from(values == FREE, (2, 2)), 6)
    assert [f.patch for f in found] == [patch_of(4 * k, 19) for k in range(5)]
    assert all(f.middle[1] == 19 and f.unknown > 20 for f in found)


def test_what_cannot_be_reached_is_no_frontier() -> None:
    values = half_known()
    values[:, 10] = OBSTACLE
    assert frontiers(values, wave_from(values == FREE, (2, 2)), 6) == []


def choose(slot: int, at: tuple[int, int], others: dict[int, tuple[int, int]],
           claims: dict[int, tuple[int, int]]) -> tuple[int, int] | None:  # fmt: skip
    values = half_known()
    free = values == FREE
    wave = wave_from(free, at)
    rivals = [OtherExplorer(s, wave_from(free, a), claims.get(s)) for s, a in others.items()]
    best = FrontierChooser(slot, 0.1, 6).best(frontiers(values, wave, 6), wave, rivals)
    return None if best is None else best.middle


def test_two_that_see_the_same_go_apart_without_a_word() -> None:
    low, high = (2, 17), (17, 17)
    a, b = choose(0, low, {1: high}, {}), choose(1, high, {0: low}, {})
    assert a is not None and b is not None
    assert a[0] < 10 < b[0]


def test_targets_stay_apart_from_running_claims() -> None:
    free = choose(0, (2, 17), {1: (4, 17)}, {})
    assert free is not None
    other = choose(0, (2, 17), {1: (4, 17)}, {1: free})
    assert other is not None
    assert np.hypot(other[0] - free[0], other[1] - free[1]) * 0.1 >= SEPARATION_M


@pytest.mark.parametrize("gain", [1.0, 1.1])
def test_a_target_is_kept_unless_another_is_better_by_far(gain: float) -> None:
    values = half_known()
    wave = wave_from(values == FREE, (10, 15))
    found = frontiers(values, wave, 6)
    choosing = FrontierChooser(0, 0.1, 6)
    best = choosing.best(found, wave, [])
    assert best is not None
    kept = next(f for f in found if f.patch != best.patch)
    almost = kept._replace(station=best.station, unknown=round(best.unknown / gain))
    assert choosing.best([best, almost], wave, [], almost.patch) == almost
    worse = almost._replace(unknown=2)
    assert choosing.best([best, worse], wave, [], worse.patch) == best
