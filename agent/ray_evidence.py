"""What rays say about cells: a hit is evidence for an obstacle, passing through is evidence against.

Evidence is a small integer a cell. A cell is solid from `SOLID` on and free again below 0: with two
limits a cell at the edge of a wall does not flicker. One hit makes an unknown cell solid; a cell
known to be free needs two, so that one false echo does not close a corridor. A solid cell is free
after at most `MOST + 1` looks through it: 0.35 s at 20 Hz, a box that leaves is soon forgotten.
"""

from math import floor

import numpy as np
from numba import njit

HIT, MISS = 3, 1
MOST, LEAST, SOLID = 6, -3, 2
BEYOND_CELLS = 0.05  # a hit is this much further: on the border of two cells it is the far one


@njit(cache=True, error_model="numpy")
def _ignored(discs, x, y):  # type: ignore[no-untyped-def]
    for k in range(discs.shape[0]):
        dx, dy = x - discs[k, 0], y - discs[k, 1]
        if dx * dx + dy * dy <= discs[k, 2] * discs[k, 2]:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _weigh(evidence, solid, stamps, scan, r, c, change, toggled, count):  # type: ignore[no-untyped-def]
    """Add to a cell's evidence, once a scan; a cell that becomes solid or free is noted."""
    known = evidence[r, c]
    if (known == LEAST and change < 0) or stamps[r, c] == scan:
        return count  # most cells of most scans: known to be free
    stamps[r, c] = scan
    value = min(max(known + change, LEAST), MOST)
    evidence[r, c] = value
    now = value >= SOLID or (solid[r, c] and value >= 0)
    if now != solid[r, c]:
        solid[r, c] = now
        toggled[count, 0], toggled[count, 1], toggled[count, 2] = r, c, now
        count += 1
    return count


@njit(cache=True, error_model="numpy")
def weigh_scan(evidence, solid, stamps, scan, x, y, angles, ranges, range_max, discs, toggled):  # type: ignore[no-untyped-def]
    """Take in one scan; how many rows of `toggled` (row, column, solid) are filled.

    Position, ranges and `discs` (n, 3: x, y, radius; hits inside are no obstacles) in cells from
    the corner of the grid; `angles` in the frame of the grid. A range of `range_max` or more, or
    none at all, is no hit. Hits are weighed first: a ray that grazes a wall does not erase it.
    """
    rows, columns = evidence.shape
    count = 0
    ways = np.empty((ranges.size, 2))
    for n in range(ranges.size):
        ways[n, 0], ways[n, 1] = np.cos(angles[n]), np.sin(angles[n])
        if not 0.0 <= ranges[n] < range_max:
            continue
        far = ranges[n] + BEYOND_CELLS
        hx, hy = x + far * ways[n, 0], y + far * ways[n, 1]
        r, c = floor(hy), floor(hx)
        if 0 <= r < rows and 0 <= c < columns and not _ignored(discs, hx, hy):
            count = _weigh(evidence, solid, stamps, scan, r, c, HIT, toggled, count)
    for n in range(ranges.size):
        if ranges[n] < 0.0 or ranges[n] != ranges[n]:
            continue
        dx, dy = ways[n, 0], ways[n, 1]
        far = min(ranges[n], range_max)
        r, c = floor(y), floor(x)
        step_r, step_c = (1 if dy > 0.0 else -1), (1 if dx > 0.0 else -1)
        each_r, each_c = abs(1.0 / dy), abs(1.0 / dx)  # infinite along an axis
        next_r = (r + (dy > 0.0) - y) / dy if dy != 0.0 else np.inf
        next_c = (c + (dx > 0.0) - x) / dx if dx != 0.0 else np.inf
        # The last cell counts as passed only where the ray leaves it on the other side.
        while min(next_r, next_c) < far and 0 <= r < rows and 0 <= c < columns:
            count = _weigh(evidence, solid, stamps, scan, r, c, -MISS, toggled, count)
            if next_c < next_r:
                c += step_c
                next_c += each_c
            else:
                r += step_r
                next_r += each_r
    return count
