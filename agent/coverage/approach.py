"""Ways from where robots stand to where their runs begin, laid so that they cover cells themselves.

Robots that start together lose their ways to far runs. A way is worked like a run: its cells are
taken out of the walk, and its robot begins the walk at the way's end. Of all shortest ways the one
with the most cells still to do is taken, and among these one along walls or other ways, which cuts
up the rest least.

Cells are numbers into the padded grid (see `agent/coverage/cell_links.py`). `free` and `todo`
(cells,) are 1 or 0: where a robot may be, and what is to be covered. `queue` (cells,) is scratch.
"""

import numpy as np
from numpy.typing import NDArray

from agent.coverage.team_state import NONE
from agent.kernels.kernel import njit

Mask = NDArray[np.uint8]
Ints = NDArray[np.int32]

NEW, BESIDE = 8, 1  # value of a cell to do, and of each neighbour with nothing to do


@njit(cache=True)
def lay(free: Mask, todo: Mask, width: int, start: int, end: int, queue: Ints) -> Ints:
    """The cells after `start` on the best shortest way to `end`, (steps,); both free and in one
    room."""
    steps = np.full(free.size, NONE, np.int32)
    worth = np.zeros(free.size, np.int64)
    by = np.full(free.size, NONE, np.int32)
    steps[start], queue[0], head, tail = 0, start, 0, 1
    while head < tail:
        cell = queue[head]
        head += 1
        own = NEW * todo[cell]
        for step in (-width, width, -1, 1):  # by now every cell before this one has its worth
            near = cell + step
            own += BESIDE * (1 - todo[near])
            before = free[near] and steps[near] == steps[cell] - 1
            if before and (by[cell] == NONE or worth[near] > worth[by[cell]]):
                by[cell] = near
        worth[cell] = own + (worth[by[cell]] if by[cell] != NONE else 0)
        if cell == end:
            break
        for step in (-width, width, -1, 1):
            near = cell + step
            if free[near] and steps[near] == NONE:
                steps[near] = steps[cell] + 1
                queue[tail] = near
                tail += 1
    way = np.empty(max(0, steps[end]), np.int32)
    cell = end
    for i in range(way.size - 1, -1, -1):
        way[i] = cell
        cell = by[cell]
    return way
