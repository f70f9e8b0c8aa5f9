"""What is in sight on a grid of blocked and free cells; numba kernels over tables of runs.

A blocked cell is a square that is `MARGIN` wider on every side than the cell, without its border: a
line may run along it and not through it. So nothing passes where two blocked cells touch at a
corner, any corridor of one cell is open, and every predicate is exact, in integers of `UNIT` to a
cell. The grid is padded by one blocked cell all round: cell (r, c) of the array is (r+1, c+1) here.
Lattice point (i, j) is the corner shared by cells (i-1, j-1) and (i, j).

`runs[START, r, c]` and `runs[END, r, c]`, (2, rows, columns), are the first column of the run of
equal cells that (r, c) is part of and the column after it, END negative where the run is blocked.
`columns`, (2, columns, rows), is the same for the transposed grid. With them a line of sight costs
one look-up a row or a column, whichever is less, and a field of view one step for each run that it
meets.

A view is what is seen through one run. `stack` (n, 3) holds of each view the lattice line that is
seen through, and the run [a, b) of the row beyond it; `slopes` (n, 2) the least and greatest slope,
in columns per row away from the point. `index` (lattice rows, lattice columns) is the number of the
corner at a lattice point, -1 for none. `found` (n,) are corners: their number if they are certainly
in sight, its complement where that must be verified.

The kernels of `agent.paths.corner_graph` contain these: numba's cache of that file does not notice
a change in this one, so touch it (or delete `__pycache__`) after one.
"""

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit
from agent.paths.binary_heap import Number

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Runs = NDArray[np.int16]

UNIT = 1 << 16  # units a cell
MARGIN = 4  # units that a path keeps from a blocked cell; 0.06 thousandths of a cell
HALF = UNIT // 2 + MARGIN
START, END = 0, 1
# Tolerance of slopes: passing a corner nearer than this needs an exact check.
NEAR = 4.0 * MARGIN / UNIT


@njit(cache=True, error_model="numpy")
def rerun(runs: Runs, line: int, first: int, last: int, cells: Flags) -> None:
    """Write the runs of `cells[line, first:last]`, which must begin and end with runs. `cells`:
    (rows, columns)."""
    c = first
    while c < last:
        end = c + 1
        while end < last and cells[line, end] == cells[line, c]:
            end += 1
        for k in range(c, end):
            runs[START, line, k] = c
            runs[END, line, k] = -end if cells[line, c] else end
        c = end


@njit(cache=True, error_model="numpy")
def kind(cells: Flags, i: int, j: int) -> int:
    """1 to 4 where lattice point (i, j) is a convex corner of the one blocked cell there, else 0.

    The number says which of the four cells is blocked, row by row. `cells`: (rows, columns).
    """
    a, b, c, d = cells[i - 1, j - 1], cells[i - 1, j], cells[i, j - 1], cells[i, j]
    if a + b + c + d != 1:
        return 0
    return 1 * a + 2 * b + 3 * c + 4 * d


@njit(cache=True, error_model="numpy")
def _clear(runs: Runs, y0: int, x0: int, y1: int, x1: int) -> bool:
    """Whether no blocked square has a point of the segment inside it; y runs across the rows."""
    if y0 > y1:
        y0, x0, y1, x1 = y1, x1, y0, x0
    dy, dx = y1 - y0, x1 - x0
    first, last = (y0 - HALF) // UNIT + 1, -((-y1 - HALF) // UNIT) - 1
    for r in range(first, last + 1):
        if dy == 0:
            low, high = min(x0, x1), max(x0, x1)
            c0, c1 = (low - HALF) // UNIT + 1, -((-high - HALF) // UNIT) - 1
        else:
            ya, yb = max(y0, UNIT * r - HALF) - y0, min(y1, UNIT * r + HALF) - y0
            if dx < 0:
                ya, yb = yb, ya
            c0 = ((x0 - HALF) * dy + ya * dx) // (UNIT * dy) + 1
            c1 = -((-(x0 + HALF) * dy - yb * dx) // (UNIT * dy)) - 1
        if runs[END, r, c0] <= c1:
            return False
    return True


@njit(cache=True, error_model="numpy")
def sees(runs: Runs, columns: Runs, r0: Number, c0: Number, r1: Number, c1: Number) -> bool:
    """Whether the straight line from (r0, c0) to (r1, c1), rows and columns in units, is free.
    Exact."""
    if abs(r1 - r0) <= abs(c1 - c0):
        return _clear(runs, r0, c0, r1, c1)
    return _clear(columns, c0, r0, c1, r1)


@njit(cache=True, error_model="numpy")
def glance(
    runs: Runs,
    index: Ints,
    uy: float,
    ux: float,
    step: int,
    line: int,
    a: int,
    b: int,
    stack: Ints,
    slopes: Floats,
    found: Ints,
    count: Number,
) -> tuple[int, Number]:
    """Views from (uy, ux), inside the run [a, b) of its own row, through the lattice line beside
    it.

    The point, in lattice coordinates, may be very near to that line. Its slopes are then so inexact
    that views are made wider than they are, and every corner must be verified. Returns the numbers
    of views and of corners, the latter -1 if `stack` or `found` is too small.
    """
    dy = abs(line - uy)
    per_row, near = 1.0 / dy, NEAR / dy
    low, high = (a - ux) * per_row, (b - ux) * per_row
    low, high = low - near * (1.0 + abs(low)), high + near * (1.0 + abs(high))
    c, last = max(int(np.floor(ux + low * dy)), 0), min(ux + high * dy, float(runs.shape[2]))
    row = line if step > 0 else line - 1
    if count + 2 > found.size:
        return 0, -1
    top = 0
    for at in (a, b):
        if index[line, at] >= 0:
            found[count] = ~index[line, at]
            count += 1
    while c < last:
        end = runs[END, row, c]
        if end < 0:
            c = -end
            continue
        if count + 2 > found.size or top >= stack.shape[0] - 1:
            return top, -1
        begin = runs[START, row, c]
        for at in (begin, end):
            if index[line, at] >= 0:
                found[count] = ~index[line, at]
                count += 1
        to_a, to_b = (begin - ux) * per_row, (end - ux) * per_row
        stack[top, 0], stack[top, 1], stack[top, 2] = line, begin, end
        slopes[top, 0] = max(low, to_a - near * (1.0 + abs(to_a)))
        slopes[top, 1] = min(high, to_b + near * (1.0 + abs(to_b)))
        top += 1
        c = end
    return top, count


@njit(cache=True, error_model="numpy")
def _note(
    corner: int,
    slope: float,
    low: float,
    high: float,
    off_low: float,
    off_high: float,
    found: Ints,
    count: Number,
) -> Number:
    """Append a corner to `found` if its slope is in the view; returns the number of corners."""
    if corner < 0 or slope < low - off_low or slope > high + off_high:
        return count
    sure = slope > low + off_low and slope < high - off_high
    found[count] = corner if sure else ~corner
    return count + 1


@njit(cache=True, error_model="numpy")
def look(
    runs: Runs,
    index: Ints,
    uy: float,
    ux: float,
    step: int,
    left: Number,
    right: Number,
    stack: Ints,
    slopes: Floats,
    top: Number,
    found: Ints,
    count: Number,
) -> Number:
    """Collect the corners in sight from (uy, ux), in lattice coordinates, through some views.

    The first `top` rows of `stack` and `slopes` are the views; the next line is at least a row
    away. `step` is 1 where rows count up with distance, else -1. Only columns of cells from `left`
    to `right` are looked at. Returns how many corners are in `found`, -1 if it or `stack` is too
    small. The last row of `stack` is widened to all that was looked at: furthest line, lowest and
    highest column of cells.
    """
    bottom = stack.shape[0] - 1
    far, leftmost, rightmost = stack[bottom, 0], stack[bottom, 1], stack[bottom, 2]
    while top > 0:
        top -= 1
        line, a, b = stack[top, 0] + step, stack[top, 1], stack[top, 2]
        low, high = slopes[top, 0], slopes[top, 1]
        if count + 2 > found.size:
            return -1
        dy = abs(line - uy)
        per_row = 1.0 / dy
        to_a, to_b = (a - ux) * per_row, (b - ux) * per_row
        off_low, off_high = NEAR * (1.0 + abs(low)), NEAR * (1.0 + abs(high))
        if low <= to_a + off_low:
            if a != ux:
                count = _note(index[line, a], to_a, low, high, off_low, off_high, found, count)
            low = max(low, to_a)
            off_low = NEAR * (1.0 + abs(low))
        if high >= to_b - off_high:
            if b != ux:
                count = _note(index[line, b], to_b, low, high, off_low, off_high, found, count)
            high = min(high, to_b)
            off_high = NEAR * (1.0 + abs(high))
        if low > high + off_low:
            continue
        x_low, x_high = ux + (low - off_low) * dy, ux + (high + off_high) * dy
        c = int(np.floor(x_low)) if x_low > left else left
        last = min(x_high, right + 1.0)
        far = max(far, line) if step > 0 else min(far, line)
        leftmost, rightmost = min(leftmost, c), max(rightmost, int(last))
        row = line if step > 0 else line - 1
        while c < last:
            end = runs[END, row, c]
            if end < 0:
                c = -end
                continue
            if count + 2 > found.size or top >= bottom:
                return -1
            begin = max(runs[START, row, c], left)
            to_a, to_b = (begin - ux) * per_row, (end - ux) * per_row
            if begin >= x_low and begin != ux:
                count = _note(index[line, begin], to_a, low, high, off_low, off_high, found, count)
            if end <= last and end != ux:
                count = _note(index[line, end], to_b, low, high, off_low, off_high, found, count)
            stack[top, 0], stack[top, 1], stack[top, 2] = line, begin, min(end, right + 1)
            slopes[top, 0], slopes[top, 1] = max(low, to_a), min(high, to_b)
            top += 1
            c = end
    stack[bottom, 0], stack[bottom, 1], stack[bottom, 2] = far, leftmost, rightmost
    return count
