"""Paths against a flood fill and an independent look at every cell a path touches."""

import itertools
from math import ceil, floor, hypot

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import label

from agent.paths.any_angle_planner import Planner, length, plan
from tests.examples import examples

grids = st.tuples(
    st.integers(2, 14), st.integers(2, 14), st.integers(0, 1 << 30), st.floats(0, 0.5)
)


def make(rows: int, columns: int, seed: int, density: float) -> NDArray[np.bool_]:
    return np.random.default_rng(seed).random((rows, columns)) < density


def touches_blocked(
    blocked: NDArray[np.bool_], a: tuple[float, float], b: tuple[float, float]
) -> bool:
    """Every cell whose closed square the segment meets, by clipping; not the planner's own walk."""
    rows = range(
        max(0, floor(min(a[0], b[0]) - 0.5)),
        min(blocked.shape[0] - 1, ceil(max(a[0], b[0]) + 0.5)) + 1,
    )
    columns = range(
        max(0, floor(min(a[1], b[1]) - 0.5)),
        min(blocked.shape[1] - 1, ceil(max(a[1], b[1]) + 0.5)) + 1,
    )
    for row in rows:
        for column in columns:
            if not blocked[row, column]:
                continue
            low, high = 0.0, 1.0
            for start, end, centre in ((a[0], b[0], row), (a[1], b[1], column)):
                d = end - start
                if abs(d) < 1e-12:
                    if abs(start - centre) > 0.5 - 1e-9:
                        low = 2.0
                    continue
                t = sorted(((centre - 0.5 - start) / d, (centre + 0.5 - start) / d))
                low, high = max(low, t[0]), min(high, t[1])
            if low < high - 1e-9:
                return True
    return False


@given(grids, st.integers(0, 1 << 30))
@settings(deadline=None, max_examples=examples(300))
def test_a_path_exists_where_the_flood_reaches_and_touches_nothing(
    grid: tuple[int, int, int, float], where: int
) -> None:
    blocked = make(*grid)
    cells = [tuple(int(v) for v in cell) for cell in np.argwhere(~blocked)]
    if len(cells) < 2:
        return
    start, goal = cells[where % len(cells)], cells[where // 7 % len(cells)]
    regions, _ = label(~blocked)
    path = plan(blocked, (start[0], start[1]), (goal[0], goal[1]))
    assert (path is not None) == (regions[start] == regions[goal])
    if path is not None:
        assert path[0] == start and path[-1] == goal
        assert not any(touches_blocked(blocked, a, b) for a, b in itertools.pairwise(path))
        assert length(path) >= hypot(goal[0] - start[0], goal[1] - start[1]) - 1e-9


def test_nothing_squeezes_through_a_diagonal_gap() -> None:
    blocked = np.array([[0, 1], [1, 0]], dtype=bool)
    assert plan(blocked, (0, 0), (1, 1)) is None


def test_blocked_or_outside_ends_have_no_path() -> None:
    blocked = np.zeros((3, 3), dtype=bool)
    blocked[1, 1] = True
    assert plan(blocked, (1, 1), (0, 0)) is None
    assert plan(blocked, (0, 0), (3, 0)) is None


@pytest.mark.slow
def test_a_planner_serves_many_queries_and_changed_grids() -> None:
    blocked = make(40, 40, 5, 0.2)
    planner = Planner(blocked)
    free = np.argwhere(~blocked)
    ends = [(tuple(free[k]), tuple(free[-k - 1])) for k in range(0, 200, 11)]
    once = [planner.plan((int(a[0]), int(a[1])), (int(b[0]), int(b[1]))) for a, b in ends]
    assert once == [plan(blocked, (int(a[0]), int(a[1])), (int(b[0]), int(b[1]))) for a, b in ends]
    other = make(40, 40, 6, 0.2)
    planner.update(other)
    assert planner.plan((0, 0), (39, 39)) == plan(other, (0, 0), (39, 39))
