"""The walk visits every cell once and knows its length; changes shorten it by what they say."""

from collections import deque
from itertools import pairwise
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.coverage.approach import lay
from agent.coverage.team_step import WALL, fill_field, flood
from agent.coverage.walk import measure, memory, steps_between, walk
from agent.coverage.walk_cut import cut
from agent.coverage.walk_shortening import polish
from tests.examples import examples

Mask = NDArray[np.uint8]


def room(rows: int, columns: int, share: float, seed: int) -> tuple[Mask, int]:
    """One connected room of a random map, padded and flat."""
    rng, width = Random(f"{seed}/room"), columns + 2
    free = np.zeros((rows + 2, width), np.uint8)
    for row in range(1, rows + 1):
        for column in range(1, columns + 1):
            free[row, column] = rng.random() >= share
    flat = free.ravel()
    best: dict[int, int] = {}
    for source in np.flatnonzero(flat).tolist():
        if source not in best:
            best = max(best, steps_from(flat, width, source), key=len)
    only = np.zeros_like(flat)
    only[list(best)] = 1
    return only, width


def steps_from(free: Mask, width: int, source: int) -> dict[int, int]:
    steps, queue = {source: 0}, deque([source])
    while queue:
        cell = queue.popleft()
        for near in (cell - width, cell + width, cell - 1, cell + 1):
            if free[near] and near not in steps:
                steps[near] = steps[cell] + 1
                queue.append(near)
    return steps


def length(free: Mask, width: int, order: list[int]) -> int:
    return sum(steps_from(free, width, a)[b] for a, b in pairwise(order))


@settings(max_examples=examples(200), deadline=None)
@given(st.integers(1, 12), st.integers(1, 12), st.sampled_from([0.0, 0.15, 0.3, 0.45]),
       st.integers(0, 10**6), st.booleans(), st.booleans(), st.sampled_from([0.0, 0.5, 0.9]))  # fmt: skip
def test_a_walk_is_whole_and_measured(
    rows: int, columns: int, share: float, seed: int, across: bool, straight: bool, done: float
) -> None:
    free, width = room(rows, columns, share, seed)
    rng = Random(f"{seed}/done")
    todo = free * np.array([rng.random() >= done for _ in range(free.size)], np.uint8)
    if not todo.any():
        return
    order = walk(free, todo, width, width if across else 1, straight)
    assert sorted(order.tolist()) == np.flatnonzero(todo).tolist()
    before = length(free, width, order.tolist())
    assert measure(free, width, order, 1, 0)[-1] == before
    saved = polish(free, width, order)
    assert sorted(order.tolist()) == np.flatnonzero(todo).tolist()
    assert length(free, width, order.tolist()) == before - saved <= before


@pytest.mark.parametrize("rows, columns", [(2, 2), (8, 8), (40, 26), (2, 60), (6, 5)])
def test_a_hall_with_an_even_side_has_no_hop(rows: int, columns: int) -> None:
    free, width = room(rows, columns, 0.0, 0)
    order = walk(free, free, width, 1, False)
    assert measure(free, width, order, 1, 0)[-1] == rows * columns - 1


@pytest.mark.parametrize("seed", range(5))
def test_halls_of_blocks_have_no_hop(seed: int) -> None:
    """Maps of 2 x 2 blocks, as coverage benchmarks are: no cell is stepped on twice."""
    small, width = room(15, 15, 0.25, seed)
    blocks = small.reshape(-1, width)[1:-1, 1:-1].repeat(2, axis=0).repeat(2, axis=1)
    free = np.pad(blocks, 1).ravel()
    order = walk(free, free, blocks.shape[1] + 2, 1, False)
    assert measure(free, blocks.shape[1] + 2, order, 1, 0)[-1] == order.size - 1


def test_turns_are_counted() -> None:
    free, width = room(2, 3, 0.0, 0)
    ring = np.array([width + 1, width + 2, width + 3, 2 * width + 3, 2 * width + 2], np.int32)
    assert measure(free, width, ring, 4, 2).tolist() == [0, 4, 8, 14, 20]
    back = np.array([width + 1, width + 2, width + 1], np.int32)
    assert measure(free, width, back, 4, 2).tolist() == [0, 4, 12]


@settings(deadline=None)
@given(st.integers(1, 9), st.integers(1, 8), st.integers(0, 10**6))
def test_a_cut_keeps_its_bound(side: int, robots: int, seed: int) -> None:
    free, width = room(side, side, 0.2, seed)
    cells, rng = np.flatnonzero(free).tolist(), Random(f"{seed}/robots")
    if not cells:
        return
    order = walk(free, free, width, 1, False)
    along = measure(free, width, order, 1, 0)
    ways = np.full((robots, free.size), 10**6, np.int32)
    for row in ways:
        for cell, steps in steps_from(free, width, rng.choice(cells)).items():
            row[cell] = steps
    bound, run_of, cuts = cut(order, along, ways, 8, 1000)
    assert sorted(run_of.tolist()) == list(range(robots))
    assert cuts[0] == 0 and cuts[-1] == order.size and (np.diff(cuts) >= 0).all()
    costs = [0]
    for run, (first, last) in enumerate(pairwise(cuts.tolist())):
        if first < last:
            way = ways[run_of[run]]
            enter = min(way[order[first]], way[order[last - 1]])
            costs.append(int(enter + along[last - 1] - along[first]))
    assert max(costs) == bound or bound == 0


@settings(deadline=None)
@given(st.integers(2, 10), st.integers(0, 10**6))
def test_a_laid_way_is_a_shortest_one(side: int, seed: int) -> None:
    free, width = room(side, side, 0.25, seed)
    cells, rng = np.flatnonzero(free).tolist(), Random(f"{seed}/ends")
    if not cells:
        return
    start, end = rng.choice(cells), rng.choice(cells)
    way = lay(free, free, width, start, end, np.empty(free.size, np.int32)).tolist()
    steps = steps_from(free, width, start)
    assert len(way) == steps[end] and [steps[cell] for cell in way] == list(range(1, len(way) + 1))


@given(st.integers(4, 24), st.integers(4, 24), st.floats(0.0, 0.5), st.integers(0, 99))
@settings(deadline=None, max_examples=examples(40))
def test_searches_agree_on_steps(rows: int, columns: int, share: float, seed: int) -> None:
    """The search that ends where it arrives, the flood, and the field with limits."""
    walls = np.random.default_rng(seed).random((rows, columns)) < share
    walls[0, 0] = False
    free = np.ascontiguousarray(np.pad(~walls, 1).astype(np.uint8).ravel())
    width = columns + 2
    source, queue = width + 1, np.empty(free.size, np.int32)
    plain = np.full(free.size, -1, np.int32)
    fill_field(free, width, plain, source, -1, 1 << 30, queue)
    flooded = np.where(free == 1, np.int32(-1), np.int32(WALL))
    flood(width, flooded, source, queue)
    assert (flooded[free == 1] == plain[free == 1]).all()
    near = memory(free.size)
    for cell in np.flatnonzero(free).tolist():
        steps = steps_between(free, width, source, cell, near)
        assert steps == (plain[cell] if plain[cell] >= 0 else 1 << 30)
