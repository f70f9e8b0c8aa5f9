"""What a coverage team knows, as arrays that the kernels share: by cell and by robot.

Cells are numbers into the padded grid (see `agent/coverage/cell_links.py`); -1 is no cell, no
robot, not known.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

NONE = -1
Numbers = NDArray[np.int64]
Number = Any  # an integer: int and np.int64 are one type to numba, but not to mypy


class TeamGrid(NamedTuple):
    """The state of each cell: arrays (cells,), and the width of the padded grid."""

    free: NDArray[np.uint8]
    width: int
    covered: NDArray[np.uint8]
    here: Numbers  # the robot in it
    ahead: Numbers  # the robot it is promised to in the step being made
    reach: NDArray[np.int32]  # steps from some cell, for one question at a time
    queue: NDArray[np.int32]  # of searches


class Robots(NamedTuple):
    """The state of each robot: arrays (robots,), and its field of steps."""

    place: Numbers  # -1: not there
    goal: Numbers  # the cell it covers next
    since: Numbers  # the step when it got that goal
    low: Numbers  # its run of the walk: [low, high)
    high: Numbers
    side: Numbers  # +1: works its run from low, -1: from high
    way: Numbers  # steps to its goal
    waits: Numbers  # the step before which an idle robot does not ask again
    then: Numbers  # where it goes in the step being made
    field: NDArray[np.int32]  # (robots, cells) steps to the goal of each robot, where known
    fielded: Numbers  # the goal its field belongs to


class Walked(NamedTuple):
    """A walk over all cells that were to be covered when it was cut."""

    order: NDArray[np.int32]
    along: NDArray[np.int32]  # cost before each of them
    unit: int  # cost of one step


def new_grid(free: NDArray[np.uint8], width: int) -> TeamGrid:
    """A grid with no robot and nothing covered. `free`: (cells,), 1 or 0; `width`: cells of a
    padded row."""
    cells = free.size
    return TeamGrid(
        free, width, np.zeros(cells, np.uint8), np.full(cells, NONE, np.int64),
        np.full(cells, NONE, np.int64), np.full(cells, NONE, np.int32), np.empty(cells, np.int32),
    )  # fmt: skip


def new_robots(place: Numbers, cells: int) -> Robots:
    """Robots without runs and goals, on a grid of so many cells. `place`: (robots,), the cell of
    each."""
    none = np.full(place.size, NONE, np.int64)
    zero = np.zeros(place.size, np.int64)
    return Robots(
        place, none.copy(), zero.copy(), zero.copy(), zero.copy(), zero + 1, zero.copy(),
        zero.copy(), none.copy(), np.full((place.size, cells), NONE, np.int32), none.copy(),
    )  # fmt: skip
