"""The nearest few of many, in order: an insertion for kernels that search for neighbours."""

from numba import njit


@njit(cache=True, error_model="numpy")
def insert(near, squares, count, most, item, square):  # type: ignore[no-untyped-def]
    """Take an item in among `count` that are sorted by `squares`, after its equals; its place.

    Where there are `most` already the last one falls out: the caller has seen that this is nearer.
    """
    k = count if count < most else most - 1
    while k > 0 and square < squares[k - 1]:
        near[k], squares[k] = near[k - 1], squares[k - 1]
        k -= 1
    near[k], squares[k] = item, square
    return k


@njit(cache=True, error_model="numpy")
def take(near, squares, count, most, reach, item, square):  # type: ignore[no-untyped-def]
    """Insert an item within `reach` (squared); returns the new count and the reach for the next item.

    Once the list is full, the reach is the distance of its last item."""
    insert(near, squares, count, most, item, square)
    count = min(count + 1, most)
    return count, squares[count - 1] if count == most else reach
