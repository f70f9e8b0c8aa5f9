"""The nearest few of many, in order: an insertion for kernels that search for neighbours.

`near` (most,) holds the items found so far, and `squares` (most,) the squares of their distances,
nearest first; the caller counts them.

Units: any, as long as all distances have the same.
"""

from typing import Any

from numpy.typing import NDArray

from agent.kernels.kernel import njit

Number = Any  # an integer: int and np.int64 are one type to numba, but not to mypy
Real = Any  # float32 or float64: numba compiles the kernel for each


@njit(cache=True, error_model="numpy")
def insert(
    near: NDArray[Any],
    squares: NDArray[Any],
    count: Number,
    most: Number,
    item: Number,
    square: float,
) -> Number:
    """Insert an item among `count` others, behind those at the same distance; returns its index.

    `square` is the square of its distance. Where there are `most` already, the last one is dropped:
    the caller has seen that the new one is nearer.
    """
    k = count if count < most else most - 1
    while k > 0 and square < squares[k - 1]:
        near[k], squares[k] = near[k - 1], squares[k - 1]
        k -= 1
    near[k], squares[k] = item, square
    return k


@njit(cache=True, error_model="numpy")
def take(
    near: NDArray[Any],
    squares: NDArray[Any],
    count: Number,
    most: Number,
    reach: Real,
    item: Number,
    square: Real,
) -> tuple[Number, Real]:
    """Insert an item within reach; returns the new count and the reach for the next item.

    `reach` and `square` are squares of distances. Once the list is full, the reach is the distance
    of its last item.
    """
    insert(near, squares, count, most, item, square)
    count = min(count + 1, most)
    return count, squares[count - 1] if count == most else reach
