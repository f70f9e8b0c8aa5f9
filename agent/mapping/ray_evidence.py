"""What rays say about cells: a hit is evidence for an obstacle, passing through is evidence
against.

Evidence is a small integer for each cell. A cell is solid from `SOLID` on and free again below 0:
with two limits a cell at the edge of a wall does not flicker. One hit makes an unknown cell solid.
A cell known to be free needs two, so that one false echo does not close a corridor. A solid cell is
free after at most `MOST + 1` scans through it. At 20 Hz that is 0.35 s, so a box that leaves is
soon forgotten.
"""

from math import floor, pi

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit

Evidence = NDArray[np.int8]  # (rows, columns)
Flags = NDArray[np.bool_]  # (rows, columns)
Stamps = NDArray[np.uint16]  # (rows, columns)
Floats = NDArray[np.float64]
Toggled = NDArray[np.int64]  # (n, 3): row, column, 1 if solid

HIT, MISS = 3, 1  # what one scan adds to a cell that is hit, or takes from one that is passed
MOST, LEAST, SOLID = 6, -3, 2  # limits of evidence, and from where on a cell is solid
BEYOND_CELLS = 0.05  # a hit counts this much further: on the border of two cells it is the far one


def room_for(rays: int, range_cells: float, rows: int, columns: int) -> int:
    """The largest number of cells that one scan can change.

    Its rays pass fewer cells than the grid has, and each ray crosses at most one border a cell and
    axis. `range_cells`: range of the rays in cells.
    """
    return min(rows * columns, rays * (2 * int(min(range_cells, rows + columns)) + 4))


@njit(cache=True, error_model="numpy")
def _ignored(discs: Floats, x: float, y: float) -> bool:
    """Whether (x, y) lies in one of the discs (n, 3) of x, y, radius; all in metres."""
    for k in range(discs.shape[0]):
        dx, dy = x - discs[k, 0], y - discs[k, 1]
        if dx * dx + dy * dy <= discs[k, 2] * discs[k, 2]:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _weigh(
    evidence: Evidence,
    solid: Flags,
    stamps: Stamps,
    scan: int,
    r: int,
    c: int,
    change: int | np.int64,
    toggled: Toggled,
    count: np.int64,
) -> np.int64:
    """Add `change` to the evidence of a cell, at most once a scan; note the cell if it became solid
    or free.

    `stamps` (rows, columns): the scan that last weighed each cell. `toggled`: rows of row, column,
    1 if solid; `count` of them are filled. Returns the new count.
    """
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
def _pass(
    evidence: Evidence,
    solid: Flags,
    stamps: Stamps,
    scan: int,
    x: float,
    y: float,
    dx: float,
    dy: float,
    far: float,
    toggled: Toggled,
    count: np.int64,
) -> np.int64:
    """Weigh the cells that a ray leaves on their far side before `far` (Amanatides and Woo 1987).

    `x`, `y`, `far` in cells; `dx`, `dy`: unit vector of the ray. Returns the new count of
    `toggled`.
    """
    rows, columns = evidence.shape
    r, c = floor(y), floor(x)
    step_r, step_c = (1 if dy > 0.0 else -1), (1 if dx > 0.0 else -1)
    each_r, each_c = abs(1.0 / dy), abs(1.0 / dx)  # infinite along an axis
    next_r = (r + (dy > 0.0) - y) / dy if dy != 0.0 else np.inf
    next_c = (c + (dx > 0.0) - x) / dx if dx != 0.0 else np.inf
    while min(next_r, next_c) < far and 0 <= r < rows and 0 <= c < columns:
        if evidence[r, c] != LEAST:  # most cells of most scans are known to be free
            count = _weigh(evidence, solid, stamps, scan, r, c, -MISS, toggled, count)
        # A processor cannot predict by which side the ray leaves. So both steps are computed, and
        # there is no branch.
        sideways = next_c < next_r
        c += step_c if sideways else 0
        r += 0 if sideways else step_r
        further_c, further_r = next_c + each_c, next_r + each_r
        next_c = further_c if sideways else next_c
        next_r = next_r if sideways else further_r
    return count


@njit(cache=True, error_model="numpy")
def weigh_scan(
    evidence: Evidence,
    solid: Flags,
    stamps: Stamps,
    scan: int,
    corner_x: float,
    corner_y: float,
    cell: float,
    at_x: float,
    at_y: float,
    heading: float,
    ranges: Floats,
    range_max: float,
    discs: Floats,
    toggled: Toggled,
) -> np.int64:
    """Take in one scan; returns how many rows of `toggled` (row, column, 1 if solid) are filled.

    `evidence`, `solid`, `stamps`: (rows, columns). `scan`: number of this scan. `corner_x`,
    `corner_y`: south-western corner of the grid, `cell`: side of a cell, `at_x`, `at_y`, `heading`:
    pose of the sensor, all in metres and radians. `ranges` (rays,) are at equal angles
    counter-clockwise from the heading. A range of `range_max` or more, or NaN, is no hit, nor is
    one inside of `discs` (n, 3: x, y, radius). `toggled` has the room of `room_for`. Hits are
    weighed first, so a ray that grazes a wall does not erase it.
    """
    rows, columns = evidence.shape
    x, y, most = (at_x - corner_x) / cell, (at_y - corner_y) / cell, range_max / cell
    count, rays = np.int64(0), ranges.size  # numba compiles twice for a literal
    ways = np.empty((rays, 2))
    for n in range(rays):
        angle = heading + n * (2 * pi / rays)
        ways[n, 0], ways[n, 1] = np.cos(angle), np.sin(angle)
        if not 0.0 <= ranges[n] < range_max:
            continue
        far = ranges[n] / cell + BEYOND_CELLS
        hx, hy = x + far * ways[n, 0], y + far * ways[n, 1]
        r, c = floor(hy), floor(hx)
        inside = 0 <= r < rows and 0 <= c < columns
        if inside and not _ignored(discs, corner_x + hx * cell, corner_y + hy * cell):
            count = _weigh(evidence, solid, stamps, scan, r, c, np.int64(HIT), toggled, count)
    for n in range(rays):
        if ranges[n] >= 0.0:  # False for NaN
            far = min(ranges[n] / cell, most)
            count = _pass(evidence, solid, stamps, scan, x, y, ways[n, 0], ways[n, 1], far,
                          toggled, count)  # fmt: skip
    return count
