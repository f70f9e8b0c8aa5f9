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
    most that are copied.
    """
    count, most = 0, gaps.size
    for k in range(fences.shape[0]):
        ax, ay = fences[k, 0], fences[k, 1]
        ex, ey = fences[k, 2] - ax, fences[k, 3] - ay
        t = ((x - ax) * ex + (y - ay) * ey) / max(ex * ex + ey * ey, LINE_2_M2)
        t = min(max(t, 0.0), 1.0)
        gap = hypot(ax + t * ex - x, ay + t * ey - y)
        if gap > reach_m or (count == most and gap >= gaps[most - 1]):
            continue
        at = count if count < most else most - 1
        while at > 0 and gaps[at - 1] > gap:
            gaps[at] = gaps[at - 1]
            for n in range(4):
                out[4 * at + n] = out[4 * at - 4 + n]
            at -= 1
        gaps[at] = gap
        for n in range(4):
            out[4 * at + n] = fences[k, n]
        count = min(count + 1, most)
    return count
