"""Regions of a grid that 4-connected free cells join.

scipy.ndimage has this as `label`. Importing it costs a robot 20 MB and a third of a second, which a robot
that looks for a way would stand still for.
"""

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit


@njit(cache=True, error_model="numpy")
def regions_of(blocked: NDArray[np.bool_]) -> NDArray[np.int32]:
    """The region of each cell, (rows, columns), as scipy.ndimage.label numbers them: from 1, in the order
    of their first cells row by row; 0 where `blocked`, of the same shape, is True."""
    rows, columns = blocked.shape
    region = np.zeros((rows, columns), dtype=np.int32)
    waiting = np.empty(rows * columns, dtype=np.int64)  # cells whose neighbours are not looked at
    count = 0
    for first in range(rows * columns):
        if blocked[first // columns, first % columns] or region[first // columns, first % columns]:
            continue
        count += 1
        region[first // columns, first % columns] = count
        waiting[0], size = first, 1
        while size > 0:
            size -= 1
            row, column = waiting[size] // columns, waiting[size] % columns
            for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                r, c = row + down, column + right
                if not (0 <= r < rows and 0 <= c < columns) or blocked[r, c] or region[r, c]:
                    continue
                region[r, c] = count
                waiting[size] = r * columns + c
                size += 1
    return region
