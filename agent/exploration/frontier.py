"""Frontiers: borders between known free cells and unseen cells, and the choice of one to go to.

Frontiers are those of Yamauchi (1997, 1998); the rank of a robot at a frontier is that of MinPos
(Bautin, Simonin and Charpillet 2012). A frontier is a patch of the fleet's map that has frontier
cells. Its number is its name, so two robots with nearly the same map name the same thing. A robot
looks at it from a station: of the cells from which its middle is seen within `view`, the one with
the shortest way. Every peer computes everything alike from the map, the poses and the claims. So no
message is needed to agree on the nearest robot.
"""

from collections.abc import Mapping, Sequence
from math import hypot
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import Cell
from agent.kernels.kernel import njit
from agent.mapping.inflation import Grid
from agent.paths.theta_star import sees
from crdt.occupancy import SIDE, patch_of
from crdt.sighting import FREE, OBSTACLE, UNKNOWN

Values = NDArray[np.int64]
Steps = NDArray[np.int32]
STRAIGHT, DIAGONAL = 5, 7  # length of a step in fifths of a cell: 7/5 is sqrt(2) to 1 %
NEVER = np.int32(1 << 30)  # length of a way that does not exist
DEAR = 3  # factor for a step among cells that another robot saw and we would see again
SEPARATION_M = 0.5  # between the targets of two robots
HYSTERESIS = 0.15  # share by which another target must be better than the current one
GAIN_M = 0.01  # distance that a newly seen cell is worth: about 3 m for a full view of 1 m
UNKNOWN_MIN = 2  # unknown cells round a frontier: a single one is a gap between two rays


class Frontier(NamedTuple):
    """A patch with frontier cells; cells are (row, column)."""

    patch: int
    middle: Cell  # the frontier cell nearest to the middle of all in the patch
    station: Cell
    unknown: int  # unseen cells within view of the middle


class OtherExplorer(NamedTuple):
    """Another robot that could go to a frontier: its slot, its wave as `wave_from` gives it, and
    the cell that it has claimed.
    """

    slot: int
    wave: Steps
    target: Cell | None


@njit(cache=True)
def _spread(
    passable: Grid, dear: Grid, times: int, wave: Steps, r0: int, c0: int, reach: int
) -> None:
    """Shortest ways from cell (r0, c0) into `wave` (rows, columns), which is `NEVER` at the
    beginning.

    Steps cost `STRAIGHT` or `DIAGONAL`, and `times` that into cells that are `dear`. Ways longer
    than `reach` are not continued. It is Dijkstra's algorithm with the buckets of Dial (1969).
    """
    rows, columns = passable.shape
    cells = rows * columns
    # A cell enters a bucket at most once for each of its neighbours.
    items = np.empty(8 * cells + 1, np.int32)
    follow = np.empty(8 * cells + 1, np.int32)
    buckets = times * DIAGONAL + 1
    heads = np.full(buckets, -1, np.int32)
    wave[r0, c0] = 0
    items[0], follow[0], heads[0] = r0 * columns + c0, -1, 0
    count, waiting, now = 1, 1, 0
    while waiting:
        bucket = now % buckets
        entry = heads[bucket]
        if entry < 0:
            now += 1
            continue
        heads[bucket] = follow[entry]
        waiting -= 1
        r, c = items[entry] // columns, items[entry] % columns
        if wave[r, c] != now or now > reach:
            continue
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                i, j = r + dr, c + dc
                if (dr == 0 and dc == 0) or not (0 <= i < rows and 0 <= j < columns):
                    continue
                if not passable[i, j]:
                    continue
                if dr != 0 and dc != 0 and not (passable[r, j] and passable[i, c]):
                    continue
                step = DIAGONAL if dr != 0 and dc != 0 else STRAIGHT
                way = now + (times * step if dear[i, j] else step)
                if way < wave[i, j]:
                    wave[i, j] = way
                    items[count] = i * columns + j
                    follow[count] = heads[way % buckets]
                    heads[way % buckets] = count
                    count += 1
                    waiting += 1


def wave_from(
    passable: Grid, at: Cell, reach_cells: float = 1e8, dear: Grid | None = None
) -> Steps:
    """Shortest ways from a cell to all cells, (rows, columns) in fifths of a cell; `NEVER` where
    none exists.

    `passable`: (rows, columns). `reach_cells`: ways longer than this are not searched. `dear`:
    steps into these cells count `DEAR` times.
    """
    rows, columns = passable.shape
    assert 0 <= at[0] < rows and 0 <= at[1] < columns
    wave = np.full(passable.shape, NEVER, dtype=np.int32)
    dear = np.zeros_like(passable) if dear is None else dear
    reach = min(int(STRAIGHT * reach_cells), int(NEVER))
    _spread(passable, dear, DEAR, wave, at[0], at[1], reach)
    return wave


def border_cells(values: Values) -> Grid:
    """Free cells with an unknown cell beside them (4-connected), (rows, columns).

    `values`: (rows, columns) of the map, as `LocalAndFleetMap.values` gives them.
    """
    unknown = values == UNKNOWN
    beside = np.zeros(values.shape, dtype=np.bool_)
    beside[1:] |= unknown[:-1]
    beside[:-1] |= unknown[1:]
    beside[:, 1:] |= unknown[:, :-1]
    beside[:, :-1] |= unknown[:, 1:]
    border: Grid = beside & (values == FREE)
    return border


def window_counts(cells: Grid, reach: int) -> NDArray[np.int64]:
    """For each cell, how many cells are set within `reach` rows and columns of it, (rows,
    columns).
    """
    rows, columns = cells.shape
    sums = np.zeros((rows + 1, columns + 1), dtype=np.int64)
    sums[1:, 1:] = cells.cumsum(axis=0).cumsum(axis=1)
    low_r = np.maximum(np.arange(rows) - reach, 0)
    high_r = np.minimum(np.arange(rows) + reach + 1, rows)
    low_c = np.maximum(np.arange(columns) - reach, 0)
    high_c = np.minimum(np.arange(columns) + reach + 1, columns)
    found: NDArray[np.int64] = (
        sums[high_r][:, high_c] - sums[low_r][:, high_c]
        - sums[high_r][:, low_c] + sums[low_r][:, low_c]
    )  # fmt: skip
    return found


@njit(cache=True)
def _stations(middles: Values, wave: Steps, walls: Grid, view: int, found: Values) -> None:
    """For each middle the cell with the shortest way that sees it within `view` cells.

    `middles` (n, 2), `wave` and `walls` (rows, columns). `found` (n, 2): row and column; row -1:
    none.
    """
    rows, columns = wave.shape
    for n in range(middles.shape[0]):
        r, c = middles[n, 0], middles[n, 1]
        best = NEVER
        found[n, 0] = -1
        for i in range(max(r - view, 0), min(r + view + 1, rows)):
            for j in range(max(c - view, 0), min(c + view + 1, columns)):
                near = (i - r) ** 2 + (j - c) ** 2 <= view * view
                if near and wave[i, j] < best and sees(walls, i, j, r, c):
                    best = wave[i, j]
                    found[n, 0], found[n, 1] = i, j


def frontiers(values: Values, wave: Steps, view: int) -> list[Frontier]:
    """Every frontier that can be looked at, in the order of patches.

    `values`: (rows, columns) of the map. `wave`: our ways. `view`: in cells, from how far a middle
    is seen.
    """
    rows, columns = np.nonzero(border_cells(values))
    if not len(rows):
        return []
    names = (rows // SIDE) * 65536 + columns // SIDE
    order = np.argsort(names, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(names[order])) + 1)
    middles = np.empty((len(groups), 2), dtype=np.int64)
    for n, group in enumerate(groups):
        r, c = rows[group], columns[group]
        off = (r - r.mean()) ** 2 + (c - c.mean()) ** 2
        k = int(np.argmin(off))
        middles[n] = r[k], c[k]
    stations = np.zeros_like(middles)
    _stations(middles, wave, values == OBSTACLE, view, stations)
    unknown = window_counts(values == UNKNOWN, view)
    return [
        Frontier(patch_of(r, c), (r, c), (i, j), int(unknown[r, c]))
        for (r, c), (i, j) in zip(middles.tolist(), stations.tolist(), strict=True)
        if i >= 0 and unknown[r, c] >= UNKNOWN_MIN
    ]


class FrontierChooser:
    """How one robot chooses among frontiers; all robots choose by the same rule."""

    def __init__(self, slot: int, cell_m: float, view: int) -> None:
        """`slot`: ours. `cell_m`: side of a cell. `view`: in cells."""
        self.slot, self.cell_m, self.view = slot, cell_m, view

    def utility_m(self, frontier: Frontier, wave: Steps, rivals: Sequence[OtherExplorer]) -> float:
        """The value of a frontier in metres: what would be seen there, less the way to it.

        `wave`: (rows, columns), the way to each cell, as `wave_from` fills it. The share that
        another robot will see at its own target does not count.
        """
        way_m = int(wave[frontier.station]) / STRAIGHT * self.cell_m
        promised = max(
            (self._overlap(frontier.middle, rival.target) for rival in rivals), default=0.0
        )
        return GAIN_M * frontier.unknown * (1.0 - promised) - way_m

    def _overlap(self, a: Cell, b: Cell | None) -> float:
        """Share of the view at one cell that lies in the view at another; 0 for None."""
        if b is None:
            return 0.0
        side = 2 * self.view + 1
        dr, dc = abs(a[0] - b[0]), abs(a[1] - b[1])
        return max(side - dr, 0) * max(side - dc, 0) / side**2

    def rank(self, frontier: Frontier, wave: Steps, rivals: Sequence[OtherExplorer]) -> int:
        """How many other robots have a shorter way to the frontier than we have; of equal ways, the
        one of the lower slot counts as shorter.

        The way of a robot with a target begins at its target.
        """
        mine = int(wave[frontier.station])
        nearer = 0
        for rival in rivals:
            theirs = int(rival.wave[frontier.station])
            if (theirs, rival.slot) < (mine, self.slot):
                nearer += 1
        return nearer

    def apart(self, a: Cell, b: Cell) -> bool:
        """Whether two cells are at least `SEPARATION_M` apart."""
        return hypot(a[0] - b[0], a[1] - b[1]) * self.cell_m >= SEPARATION_M

    def best(
        self,
        found: Sequence[Frontier],
        wave: Steps,
        rivals: Sequence[OtherExplorer],
        current: int | None = None,
    ) -> Frontier | None:
        """The frontier to go to: lowest rank, then highest utility; None if all are too near to
        others' targets.

        `current`: the patch that we are on the way to. It is kept unless another one has a lower
        rank or is better by `HYSTERESIS`.
        """
        targets = [rival.target for rival in rivals if rival.target is not None]
        open_ = [f for f in found if all(self.apart(f.middle, target) for target in targets)]
        scores: Mapping[int, tuple[int, float]] = {
            f.patch: (self.rank(f, wave, rivals), self.utility_m(f, wave, rivals)) for f in open_
        }
        kept = next((f for f in open_ if f.patch == current), None)
        best = min(open_, key=lambda f: (scores[f.patch][0], -scores[f.patch][1]), default=None)
        if kept is None or best is None:
            return best
        rank, utility_m = scores[best.patch]
        kept_rank, kept_m = scores[kept.patch]
        better = rank < kept_rank or utility_m > kept_m + HYSTERESIS * max(abs(kept_m), 1.0)
        return best if better else kept
