"""The linear assignment problem: the assignment with the least total cost.

Shortest augmenting paths, as D. F. Crouse gives them ("On implementing 2D rectangular assignment
algorithms", IEEE TAES 2016). The project has its own solver because every peer must break ties in
the same way, whichever version of scipy is installed beside it. Ties are broken as scipy 1.17 does
(tests/agent/mapf/test_linear_assignment.py compares). Importing scipy.optimize would also take
longer than the rest of a robot's start.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit

NOBODY = -1


def assigned(cost: NDArray[Any]) -> NDArray[np.int64]:
    """The column of each row, (rows,); NOBODY for rows without one where there are too few columns.

    `cost`: (rows, columns), finite numbers of one unit. Of two assignments with equal cost, every
    peer finds the same one.
    """
    rows, columns = cost.shape
    if rows <= columns:
        return assigned_rows(np.ascontiguousarray(cost, dtype=np.float64))
    row_of = assigned_rows(np.ascontiguousarray(cost.T, dtype=np.float64))
    result = np.full(rows, NOBODY, dtype=np.int64)
    result[row_of] = np.arange(columns)
    return result


@njit(cache=True)
def assigned_rows(cost: NDArray[np.float64]) -> NDArray[np.int64]:
    """As `assigned`, for `cost` with at most as many rows as columns, and for other kernels."""
    rows, columns = cost.shape
    row_price, column_price = np.zeros(rows), np.zeros(columns)
    column_of, row_of = np.empty(rows, np.int64), np.empty(columns, np.int64)
    column_of[:], row_of[:] = NOBODY, NOBODY
    came_from, open_ones = np.empty(columns, np.int64), np.empty(columns, np.int64)
    far = np.empty(columns)
    for first in range(rows):
        far[:] = np.inf
        for k in range(columns):
            open_ones[k] = columns - 1 - k  # backwards, so that equal costs give the identity
        row, length, left, sink = first, 0.0, columns, NOBODY
        while sink == NOBODY:
            lowest, chosen = np.inf, -1
            for k in range(left):
                column = open_ones[k]
                way = length + cost[row, column] - row_price[row] - column_price[column]
                if way < far[column]:
                    came_from[column], far[column] = row, way
                # Among equals prefer a free one, because the path ends there.
                if far[column] < lowest or (far[column] == lowest and row_of[column] == NOBODY):
                    lowest, chosen = far[column], k
            length, column = lowest, open_ones[chosen]
            if row_of[column] == NOBODY:
                sink = column
            else:
                row = row_of[column]
            left -= 1  # chosen columns are kept behind index `left`
            open_ones[chosen], open_ones[left] = open_ones[left], column
        row_price[first] += length
        for k in range(left, columns):
            column = open_ones[k]
            if row_of[column] != NOBODY:
                row_price[row_of[column]] += length - far[column]
            column_price[column] -= length - far[column]
        column = sink
        while column != NOBODY:
            row = came_from[column]
            row_of[column] = row
            column, column_of[row] = column_of[row], column
    return column_of
