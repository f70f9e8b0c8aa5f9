"""Cutting one room among the robots in it: a walk, its cut, and ways that are worked, too.

First the walk is cut as if the ways to the runs covered nothing. If these ways cost much, as they
do where robots start together, they are laid as work themselves (`agent/coverage/approach.py`).
What remains is walked and cut again, and so on while the bound falls.

Cells are numbers into the padded grid (see `agent/coverage/cell_links.py`).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.coverage.approach import lay
from agent.coverage.team_state import NONE, Numbers, TeamGrid
from agent.coverage.team_step import FAR, WALL, flood
from agent.coverage.walk import measure, measure_runs, walk
from agent.coverage.walk_cut import cut
from agent.coverage.walk_shortening import polish

Costs = NDArray[np.int32]
Mask = NDArray[np.uint8]
CUT_ROUNDS = 12  # assignment and cut settle within a few
EXCHANGES = 2_000_000  # runs looked up while exchanging robots: a tenth of a second at the worst
APPROACH_ROUNDS = 4  # later rounds save almost nothing
# Least share of the ways in all cost; below it, laying them saves less than 1 %.
APPROACH_SHARE = 0.06

CHOICE_MAX = 20_000  # cells; in larger rooms the robots' places make too little difference


class Costing(NamedTuple):
    """What a step and a quarter turn cost, as whole numbers of one unit."""

    step: int
    turn: int


class Share(NamedTuple):
    """A cut room: the work of mate i is order[cuts[i]:cuts[i + 1]], in this order."""

    bound: int
    order: Costs
    along: Costs
    cuts: list[int]


class _Draft(NamedTuple):
    bound: int
    order: Costs
    along: Costs
    run_of: Numbers
    cuts: Numbers
    ways: Costs  # by mate: cost from where its way ends, the way included
    laid: list[Costs]  # by mate: the cells it works on its way

    def runs(self) -> dict[int, Costs]:
        """The cells of each mate's run, from the end where it begins."""
        found = {}
        for run, mate in enumerate(self.run_of.tolist()):
            cells = self.order[self.cuts[run] : self.cuts[run + 1]]
            if cells.size:
                way = self.ways[mate]
                found[mate] = cells if way[cells[0]] <= way[cells[-1]] else cells[::-1]
        return found


def cut_room(grid: TeamGrid, inside: Mask, places: Numbers, costing: Costing) -> Share | None:
    """Cut a room among its robots; None where all of it is covered.

    `inside`: (cells,), 1 for the cells of the room. `places`: (robots,), the cells where they
    stand.
    """
    todo = inside & (1 - grid.covered)
    if not todo.any():
        return None
    ways = np.tile(_dry(grid), (places.size, 1))
    for row, place in zip(ways, places, strict=True):
        flood(grid.width, row, place, grid.queue)
    ways *= costing.step  # cells outside of this room are never looked up
    nothing = [np.empty(0, np.int32) for _ in places]
    best = draft = _draft(grid, inside, todo, places, ways, nothing, costing)
    lost = draft.bound * places.size - int(draft.along[-1] - draft.along[0])
    if lost > APPROACH_SHARE * draft.bound * places.size:
        for _ in range(APPROACH_ROUNDS):
            draft = _approached(grid, inside, todo, places, draft, ways, costing)
            if draft.bound >= best.bound:
                break
            best = draft
    return _share(grid, inside, places, best, costing)


def _dry(grid: TeamGrid) -> Costs:
    """A field before it is flooded."""
    return np.where(grid.free == 1, np.int32(NONE), np.int32(WALL))


def _orders(
    grid: TeamGrid, inside: Mask, todo: Mask, places: Numbers, turns: bool
) -> Iterator[Costs]:
    """Walks to choose from: straights along rows or columns, with and without the robots' places.

    These are covered, and left out in the end; but as holes of one cell they spoil the straights
    around them. Where turns cost, there are also walks of plain rows and columns.
    """
    whole = todo.copy()
    whole[places] = 1
    whole &= inside
    small = np.count_nonzero(todo) <= CHOICE_MAX
    for axis in (1, grid.width):
        if small:
            yield walk(inside, todo, grid.width, axis, False)
        order = walk(inside, whole, grid.width, axis, False)
        yield order[todo[order] == 1]
        if turns:
            order = walk(inside, whole, grid.width, axis, True)
            yield order[todo[order] == 1]


def _draft(
    grid: TeamGrid,
    inside: Mask,
    todo: Mask,
    places: Numbers,
    ways: Costs,
    laid: list[Costs],
    costing: Costing,
) -> _Draft:
    """The walk with the best quick cut, shortened where it can be, and cut with care."""
    best, bound_least = np.empty(0, np.int32), FAR
    for order in _orders(grid, inside, todo, places, costing.turn > 0):
        along = measure(inside, grid.width, order, costing.step, costing.turn)
        bound, _, _ = cut(order, along, ways, CUT_ROUNDS, 0)
        if bound < bound_least:
            best, bound_least = order, bound
    along = measure(inside, grid.width, best, costing.step, costing.turn)
    shorter = best.copy()
    if polish(inside, grid.width, shorter):
        after = measure(inside, grid.width, shorter, costing.step, costing.turn)
        if after[-1] < along[-1]:  # steps saved may have cost turns
            best, along = shorter, after
    bound, run_of, cuts = cut(best, along, ways, CUT_ROUNDS, EXCHANGES // ways.shape[0])
    return _Draft(int(bound), best, along, run_of, cuts, ways, laid)


def _approached(
    grid: TeamGrid,
    inside: Mask,
    todo: Mask,
    places: Numbers,
    draft: _Draft,
    ways: Costs,
    costing: Costing,
) -> _Draft:
    """Lay the ways to a draft's runs, the longest first, and cut what is left of the walk."""
    left, after, laid, dry = todo.copy(), ways.copy(), list(draft.laid), _dry(grid)
    begins = {mate: cells[0] for mate, cells in draft.runs().items()}
    for mate in range(places.size):
        laid[mate] = np.empty(0, np.int32)
    for mate in sorted(begins, key=lambda mate: (-ways[mate, begins[mate]], mate)):
        way = lay(grid.free, left, grid.width, places[mate], begins[mate], grid.queue)[:-1]
        if way.size == 0:
            continue
        laid[mate] = way[left[way] == 1]
        left[way] = 0
        after[mate] = dry
        flood(grid.width, after[mate], way[-1], grid.queue)
        after[mate] = (after[mate] + way.size) * costing.step
    if not left.any():
        return draft
    return _draft(grid, inside, left, places, after, laid, costing)


def _share(grid: TeamGrid, inside: Mask, places: Numbers, draft: _Draft, costing: Costing) -> Share:
    runs, orders, cuts = draft.runs(), [], [0]
    for mate in range(places.size):
        cells = runs.get(mate, np.empty(0, np.int32))
        order = np.concatenate([draft.laid[mate], cells])
        orders.append(order)
        cuts.append(cuts[-1] + order.size)
    whole = np.concatenate(orders)
    along = measure_runs(inside, grid.width, whole, np.array(cuts), costing.step, costing.turn)
    return Share(draft.bound, whole, along, cuts)
