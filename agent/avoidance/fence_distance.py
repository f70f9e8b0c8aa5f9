"""How near fences are, as kernels: calling numpy on a dozen numbers costs more than computing with
them.

`fences` (n, 4) are segments: ax, ay, bx, by.

Units: metres; x east, y north.
"""

from math import hypot, inf

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit

Floats = NDArray[np.float64]

LINE_2_M2 = 1e-18  # least squared length of a fence; a single echo is a fence without length
# Where more fences are near than a robot looks at, shorter ones are joined, those below THIN_MIN_M first.
# 64 fences of that length cover the way that a robot drives until it looks again, 2 m. THIN_MAX_M is less
# than the 0.2 m that bodies keep from fences.
THIN_MIN_M, THIN_MAX_M = 0.08, 0.16


@njit(cache=True, error_model="numpy")
def gap_m(x: float, y: float, fences: Floats) -> float:
    """The distance from the point (x, y) to the nearest fence; inf without fences."""
    nearest = inf
    for k in range(fences.shape[0]):
        ax, ay = fences[k, 0], fences[k, 1]
        ex, ey = fences[k, 2] - ax, fences[k, 3] - ay
        t = ((x - ax) * ex + (y - ay) * ey) / max(ex * ex + ey * ey, LINE_2_M2)
        t = min(max(t, 0.0), 1.0)
        nearest = min(nearest, hypot(ax + t * ex - x, ay + t * ey - y))
    return nearest


@njit(cache=True, error_model="numpy")
def way_gap_m(
    x: float, y: float, dx: float, dy: float, step_m: float, count: int, fences: Floats
) -> float:
    """The least distance to a fence along a straight path.

    Looked at are `count` points, `step_m` apart, in the unit direction (dx, dy) from (x, y); the
    first is one step away.
    """
    nearest = inf
    for k in range(1, count + 1):
        nearest = min(nearest, gap_m(x + dx * (k * step_m), y + dy * (k * step_m), fences))
    return nearest


@njit(cache=True, error_model="numpy")
def gather(x: float, y: float, fences: Floats, reach_m: float, out: Floats, gaps: Floats) -> int:
    """Copy the fences within `reach_m` of (x, y) to `out`, nearest first; returns how many.

    `out` (4 * most,) is flat, four numbers a fence. `gaps` (most,) is scratch; its length is the
    most that are copied. More than that are an outline of many short fences, as a receiver records
    it: then fences that follow each other are joined, until they are few enough. A joined fence is at
    most `THIN_MAX_M` from those that it replaces.
    """
    thin_m = 0.0
    while True:
        count, dropped = _nearest_joined(x, y, fences, reach_m, thin_m, out, gaps)
        if not dropped or thin_m >= THIN_MAX_M:
            return count
        thin_m = THIN_MIN_M if thin_m == 0.0 else 2.0 * thin_m


@njit(cache=True, error_model="numpy")
def _nearest_joined(
    x: float, y: float, fences: Floats, reach_m: float, thin_m: float, out: Floats, gaps: Floats
) -> tuple[int, bool]:
    """As `gather`, with fences joined while their ends are within `thin_m` of the first one's
    beginning; 0: none is. Returns how many were copied, and whether others were dropped."""
    count, most, dropped, k = 0, gaps.size, False, 0
    while k < fences.shape[0]:
        ax, ay, bx, by = fences[k, 0], fences[k, 1], fences[k, 2], fences[k, 3]
        k += 1
        while (
            k < fences.shape[0] and fences[k, 0] == bx and fences[k, 1] == by
            and hypot(bx - ax, by - ay) < thin_m
        ):  # fmt: skip
            bx, by = fences[k, 2], fences[k, 3]
            k += 1
        ex, ey = bx - ax, by - ay
        t = ((x - ax) * ex + (y - ay) * ey) / max(ex * ex + ey * ey, LINE_2_M2)
        t = min(max(t, 0.0), 1.0)
        gap = hypot(ax + t * ex - x, ay + t * ey - y)
        if gap > reach_m:
            continue
        dropped = dropped or count == most
        if count == most and gap >= gaps[most - 1]:
            continue
        at = count if count < most else most - 1
        while at > 0 and gaps[at - 1] > gap:
            gaps[at] = gaps[at - 1]
            for n in range(4):
                out[4 * at + n] = out[4 * at - 4 + n]
            at -= 1
        gaps[at] = gap
        out[4 * at], out[4 * at + 1], out[4 * at + 2], out[4 * at + 3] = ax, ay, bx, by
        count = min(count + 1, most)
    return count, dropped
