"""Frontiers: borders between known free cells and unseen cells, and the choice of one to go to.

A frontier is a patch of the fleet's map that has frontier cells: its number is its name, and two
robots with nearly the same map name the same thing. It is looked at from a station, the cell nearest
by way from which its middle is seen within `view`. Everything is computed alike by every peer from
the map, the poses and the claims, so no message is needed to agree on the nearest robot.
"""

from collections.abc import Mapping, Sequence
from math import hypot
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from agent.mapping.inflation import Cell, Grid
from agent.paths.theta_star import sees
from crdt.occupancy import SIDE, patch_of
from crdt.sighting import FREE, OBSTACLE, UNKNOWN

Values = NDArray[np.int64]
Steps = NDArray[np.int32]
XY = tuple[float, float]
STRAIGHT, DIAGONAL = 5, 7  # a step of a cell in the wave's units: sqrt(2) to 1 %
NEVER = np.int32(1 << 30)
DEAR = 3  # times: a step among cells that another saw and we would see again
SEPARATION_M = 0.5  # between the targets of two robots
HYSTERESIS = 0.15  # share by which another target must be better than the current one
GAIN_M = 0.01  # distance that one newly seen cell is worth; a full view of a metre about 3 m
UNKNOWN_MIN = 2  # unknown cells round a frontier: a single one is a gap between two rays


class Frontier(NamedTuple):
    patch: int
    middle: Cell  # the frontier cell nearest to the middle of all in the patch
    station: Cell
    unknown: int  # unseen cells within view of the middle


class OtherExplorer(NamedTuple):
    """Another robot that could go somewhere: its slot, its wave, and the target that it has claimed."""

    slot: int
    wave: Steps
    target: Cell | None


@njit(cache=True)
def _spread(passable, dear, times, wave, r0, c0, reach):  # type: ignore[no-untyped-def]
    """Least ways from a cell in steps of 5 and 7, into dear cells `times` that: Dial's buckets (1969)."""
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
    """(rows, columns): way from a cell in fifths of a cell, `NEVER` where there is none; cells that
    are `dear` count as `DEAR`."""
    rows, columns = passable.shape
    assert 0 <= at[0] < rows and 0 <= at[1] < columns
    wave = np.full(passable.shape, NEVER, dtype=np.int32)
    dear = np.zeros_like(passable) if dear is None else dear
    reach = min(int(STRAIGHT * reach_cells), int(NEVER))
    _spread(passable, dear, DEAR, wave, at[0], at[1], reach)
    return wave


def border_cells(values: Values) -> Grid:
    """Free cells with an unknown one beside them."""
    unknown = values == UNKNOWN
    beside = np.zeros(values.shape, dtype=np.bool_)
    beside[1:] |= unknown[:-1]
    beside[:-1] |= unknown[1:]
    beside[:, 1:] |= unknown[:, :-1]
    beside[:, :-1] |= unknown[:, 1:]
    border: Grid = beside & (values == FREE)
    return border


def window_counts(cells: Grid, reach: int) -> NDArray[np.int64]:
    """(rows, columns): how many cells are set in the square of this reach round each."""
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
def _stations(middles, wave, walls, view, found):  # type: ignore[no-untyped-def]
    """The nearest cell by way that sees each middle from within `view`; -1: none."""
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
    """Every frontier that can be looked at, in the order of patches. `view` in cells."""
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
    """How one robot chooses among frontiers; the same for all."""

    def __init__(self, slot: int, cell_m: float, view: int) -> None:
        self.slot, self.cell_m, self.view = slot, cell_m, view

    def utility_m(self, frontier: Frontier, wave: Steps, rivals: Sequence[OtherExplorer]) -> float:
        """Value in metres: cells that would be seen, less the way. Cells others will see do not count."""
        way_m = int(wave[frontier.station]) / STRAIGHT * self.cell_m
        promised = max(
            (self._overlap(frontier.middle, rival.target) for rival in rivals), default=0.0
        )
        return GAIN_M * frontier.unknown * (1.0 - promised) - way_m

    def _overlap(self, a: Cell, b: Cell | None) -> float:
        """Share of one view that lies in another."""
        if b is None:
            return 0.0
        side = 2 * self.view + 1
        dr, dc = abs(a[0] - b[0]), abs(a[1] - b[1])
        return max(side - dr, 0) * max(side - dc, 0) / side**2

    def rank(self, frontier: Frontier, wave: Steps, rivals: Sequence[OtherExplorer]) -> int:
        """How many other robots are nearer to it and not nearer to their own claims."""
        mine = int(wave[frontier.station])
        nearer = 0
        for rival in rivals:
            theirs = int(rival.wave[frontier.station])
            if (theirs, rival.slot) < (mine, self.slot):
                nearer += 1
        return nearer

    def apart(self, a: Cell, b: Cell) -> bool:
        return hypot(a[0] - b[0], a[1] - b[1]) * self.cell_m >= SEPARATION_M

    def best(
        self,
        found: Sequence[Frontier],
        wave: Steps,
        rivals: Sequence[OtherExplorer],
        current: int | None = None,
    ) -> Frontier | None:
        """The one to go to: best rank, then best utility; another than `current` only if by far."""
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
