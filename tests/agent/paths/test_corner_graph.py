"""The default planner against brute force: as short as can be, through nothing, after any change."""

from itertools import pairwise
from math import inf

import numpy as np
import pytest
from hypothesis import given, note, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import label

from agent.interface.geometry import Point
from agent.paths.any_angle_planner import Change, Planner, Waypoints, length, plan
from tests.agent.visibility_graph import MARGIN, entered, shortest
from tests.examples import examples

seeds = st.integers(0, 1 << 30)


def make(seed: int, side_max: int) -> NDArray[np.bool_]:
    """Anything from an empty grid to a dense one; single cells, boxes or walls with gaps."""
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(1, side_max + 1, 2)
    blocked: NDArray[np.bool_] = rng.random((rows, columns)) < rng.choice(
        [0.0, 0.1, 0.25, 0.4, 0.5]
    )
    if rng.random() < 0.3:
        blocked = np.repeat(np.repeat(blocked, 2, axis=0), 2, axis=1)[:rows, :columns]
    if rng.random() < 0.3:
        blocked[rng.integers(0, rows)] = rng.random(columns) < 0.9
    return blocked


def somewhere(rng: np.random.Generator, blocked: NDArray[np.bool_], centre: bool) -> Point:
    """A point of a free cell, exact in the units of the planner and of the checker."""
    free = np.argwhere(~blocked)
    row, column = free[rng.integers(len(free))].tolist()
    if centre:
        return row, column
    dy, dx = rng.integers(-32_764, 32_765, 2).tolist()  # half a cell less the margin
    if rng.random() < 0.3:
        dy = int(rng.choice([-32_764, 32_764]))
    if rng.random() < 0.3:
        dx = int(rng.choice([-32_764, 32_764]))
    return row + dy / 65536, column + dx / 65536


def check(blocked: NDArray[np.bool_], path: Waypoints | None, a: Point, b: Point) -> None:
    optimum = shortest(blocked, a, b)
    assert (path is not None) == (optimum < inf)
    if path is not None:
        assert path[0] == a and path[-1] == b
        assert not any(entered(blocked, p, q, MARGIN // 2) for p, q in pairwise(path))
        assert length(path) == pytest.approx(optimum, abs=1e-9)


@given(seeds, st.booleans())
@settings(deadline=None, max_examples=examples(150))
def test_paths_are_shortest_ones(seed: int, centre: bool) -> None:
    note(f"seed {seed}")
    blocked = make(seed, 10)
    if blocked.all():
        return
    rng = np.random.default_rng(seed + 1)
    planner = Planner(blocked)
    for _ in range(3):
        a, b = somewhere(rng, blocked, centre), somewhere(rng, blocked, centre)
        check(blocked, planner.plan(a, b), a, b)


@given(seeds)
@settings(deadline=None, max_examples=examples(100))
def test_changes_are_seen(seed: int) -> None:
    """Boxes move and single cells flip between queries: each path is as a new planner finds it."""
    note(f"seed {seed}")
    rng = np.random.default_rng(seed)
    blocked = make(seed, 24)
    planner = Planner(blocked)
    rows, columns = blocked.shape
    for _ in range(12):
        cells: list[Change] = []
        if rng.random() < 0.5:
            top, left, state = rng.integers(rows), rng.integers(columns), bool(rng.integers(2))
            box = [(r, c) for r in range(top, top + 3) for c in range(left, left + 3)]
            cells = [(r, c, state) for r, c in box if r < rows and c < columns]
        else:
            for _ in range(rng.integers(1, 5)):
                r, c = int(rng.integers(rows)), int(rng.integers(columns))
                cells.append((r, c, bool(rng.integers(2))))
        for r, c, state in cells:
            blocked[r, c] = state
        planner.update(cells)
        assert np.array_equal(planner.blocked, blocked)
        if blocked.all():
            continue
        for _ in range(4):
            a, b = somewhere(rng, blocked, False), somewhere(rng, blocked, False)
            ours, fresh = planner.plan(a, b), plan(blocked, a, b)
            assert (ours is None) == (fresh is None)
            if ours is not None and fresh is not None:
                assert length(ours) == pytest.approx(length(fresh), abs=1e-9)
                assert not any(entered(blocked, p, q, MARGIN // 2) for p, q in pairwise(ours))


def test_many_changes_of_a_larger_grid() -> None:
    """More changes than the log holds, more corners than there were rows for."""
    rng = np.random.default_rng(6)
    blocked = np.zeros((60, 70), dtype=np.bool_)
    planner = Planner(blocked)
    for turn in range(1500):
        count = 300 if turn % 500 == 499 else 3
        rows, columns = rng.integers(0, 60, count), rng.integers(0, 70, count)
        state = rng.random(count) < 0.45
        changes = [(int(r), int(c), bool(s)) for r, c, s in zip(rows, columns, state, strict=True)]
        for r, c, s in changes:
            blocked[r, c] = s
        planner.update(changes)
        if turn % 10 == 0:
            a, b = somewhere(rng, blocked, True), somewhere(rng, blocked, True)
            ours, fresh = planner.plan(a, b), plan(blocked, a, b)
            assert (ours is None) == (fresh is None)
            if ours is not None and fresh is not None:
                assert length(ours) == pytest.approx(length(fresh), abs=1e-9)


@given(seeds)
@settings(deadline=None, max_examples=examples(100))
def test_plain_theta_star_is_never_shorter(seed: int) -> None:
    note(f"seed {seed}")
    rng = np.random.default_rng(seed)
    blocked = make(seed, 40)
    if blocked.all():
        return
    planner = Planner(blocked)
    a, b = somewhere(rng, blocked, True), somewhere(rng, blocked, True)
    ours, plain = planner.plan(a, b), planner.plan_plain(a, b)
    assert (ours is None) == (plain is None)
    if ours is not None and plain is not None:
        assert length(ours) <= length(plain) + 1e-3  # the margin at each bend


@given(seeds)
@settings(deadline=None, max_examples=examples(60))
def test_points_on_the_border_of_cells(seed: int) -> None:
    """Nearly nothing is beside such a point, everything is in view: this once took for ever."""
    note(f"seed {seed}")
    rng = np.random.default_rng(seed)
    blocked = rng.random((150, 150)) < rng.choice([0.01, 0.03, 0.1, 0.3])
    planner = Planner(blocked)
    regions, _ = label(~blocked)
    for _ in range(5):
        free = np.argwhere(~blocked)
        (r, c), (i, j) = free[rng.integers(len(free), size=2)].tolist()
        a, b = (
            (r - rng.integers(2) / 2, c - rng.integers(2) / 2),
            (i - 0.5, j - rng.integers(2) / 2),
        )
        path = planner.plan(a, b)
        assert (path is not None) == (regions[r, c] == regions[i, j])
        if path is not None:
            assert not any(entered(blocked, p, q, 0) for p, q in pairwise(path))
            plain = planner.plan_plain(a, b)
            assert plain is not None and length(path) <= length(plain) + 3.0


def test_a_corridor_of_one_cell_is_open() -> None:
    blocked = np.ones((3, 9), dtype=np.bool_)
    blocked[1] = False
    assert plan(blocked, (1, 0), (1, 8)) == [(1, 0), (1, 8)]


def test_a_corner_gap_is_shut_also_between_large_blocks() -> None:
    blocked = np.zeros((8, 8), dtype=np.bool_)
    blocked[:4, :4] = blocked[4:, 4:] = True
    assert plan(blocked, (7, 0), (0, 7)) is None
    blocked[3, 3] = False
    assert plan(blocked, (7, 0), (0, 7)) is not None
