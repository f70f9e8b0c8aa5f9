"""A binary heap over two arrays, for kernels that search: keys, and the nodes that they belong to.

The least key is at place 0. The heap does not know its size: the caller counts, and sees to it that
the arrays are long enough.
"""

from numba import njit


@njit(cache=True, error_model="numpy")
def push(keys, nodes, size, key, node):  # type: ignore[no-untyped-def]
    """Take a node in; `size` counts without it."""
    while size > 0:
        up = (size - 1) // 2
        if keys[up] <= key:
            break
        keys[size], nodes[size] = keys[up], nodes[up]
        size = up
    keys[size], nodes[size] = key, node


@njit(cache=True, error_model="numpy")
def close_gap(keys, nodes, size):  # type: ignore[no-untyped-def]
    """Fill place 0, which was read, with the last item; `size` counts without that item."""
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
