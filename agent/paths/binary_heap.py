"""A binary heap over two arrays, for kernels that search: keys, and the nodes that they belong to.

`keys` and `nodes` are (room,); the least key is at index 0. The heap does not know its size: the
caller counts, and makes the arrays long enough.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit

Number = Any  # an integer: int and np.int64 are one type to numba, but not to mypy


@njit(cache=True, error_model="numpy")
def push(
    keys: NDArray[np.float64], nodes: NDArray[Any], size: Number, key: float, node: Number
) -> None:
    """Insert a node; `size` is the number of items without it."""
    while size > 0:
        up = (size - 1) // 2
        if keys[up] <= key:
            break
        keys[size], nodes[size] = keys[up], nodes[up]
        size = up
    keys[size], nodes[size] = key, node


@njit(cache=True, error_model="numpy")
def close_gap(keys: NDArray[np.float64], nodes: NDArray[Any], size: Number) -> None:
    """Fill index 0, whose item was taken, with the last item; `size` is the number of items without
    it."""
    key, node = keys[size], nodes[size]
    k = 0
    while True:
        child = 2 * k + 1
        if child >= size:
            break
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[k], nodes[k] = keys[child], nodes[child]
        k = child
    keys[k], nodes[k] = key, node
