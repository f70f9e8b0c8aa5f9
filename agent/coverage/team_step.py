"""One synchronous step of all robots on a grid: towards their goals, never into each other.

Priority inheritance with backtracking (PIBT; Okumura et al., Artificial Intelligence 2022): robots
choose in order of priority. A robot that wants an occupied cell makes its occupant choose first; if
that fails, all robots concerned stay. A cell is never promised twice, and robots never swap places.

Coverage never locks, on any connected grid with any number of robots. Priority is the age of a
goal, and a goal is a cell not yet covered, kept until it is. Let h stand on cell c with the oldest
goal g, and v be its neighbour nearer to g. If h cannot go to v, the chain of pushes from v has
failed: every cell that can be reached from v without c is occupied. One of them is g; but an
occupied cell is covered. So the oldest goal is approached in every step, and every reached goal is
a cell less to do. (Renewing priority with every step instead of with every goal loses this: some
maps never end.)

`grid` and `robots` are those of `agent/coverage/team_state.py`, arrays (cells,) and (robots,).
`free` (cells,) is 1 or 0. `field` (cells,) holds steps to some cell, -1 where not known. `queue`
(cells,) is scratch.
"""

import numpy as np
from numpy.typing import NDArray

from agent.coverage.team_state import NONE, Number, Numbers, Robots, TeamGrid
from agent.kernels.kernel import njit

Mask = NDArray[np.uint8]
Ints = NDArray[np.int32]

FAR = 1 << 30  # no limit
WALL = -2  # in a field to be flooded
UNKNOWN = 1 << 20  # steps, where the field ends: more than a padded grid of 2048 x 2048 has corners


@njit(cache=True)
def fill_field(
    free: Mask, width: int, field: Ints, goal: int, place: Number, limit: Number, queue: Ints
) -> None:
    """Fill `field` with steps to `goal`, as far as `limit` or as far as `place` and its neighbours.

    All of `field` must be -1 before, and cells further away stay so. `place` -1: no cell ends the
    search.
    """
    field[goal], queue[0], head, tail = 0, goal, 0, 1
    while head < tail:
        cell = queue[head]
        head += 1
        if cell == place:
            limit = min(limit, field[cell] + 2)
        if field[cell] >= limit:
            break
        for step in (-width, width, -1, 1):
            near = cell + step
            if free[near] and field[near] == NONE:
                field[near] = field[cell] + 1
                queue[tail] = near
                tail += 1


@njit(cache=True)
def flood(width: int, field: Ints, source: int, queue: Ints) -> None:
    """Fill `field` with steps from `source`; before, walls are `WALL` and all other cells -1.

    As `fill_field` without its limits, and with one look at each neighbour: half the time.
    """
    field[source], queue[0], head, tail = 0, source, 0, 1
    while head < tail:
        cell = queue[head]
        head += 1
        ahead = field[cell] + 1
        for step in (-width, width, -1, 1):
            near = cell + step
            if field[near] == NONE:
                field[near] = ahead
                queue[tail] = near
                tail += 1


@njit(cache=True)
def wipe_field(width: int, field: Ints, goal: int, queue: Ints) -> None:
    """Undo `fill_field` for this `goal`: all that it filled is -1 again. Costs as much as it
    filled."""
    queue[0], head, tail = goal, 0, 1
    field[goal] = NONE
    while head < tail:
        cell = queue[head]
        head += 1
        for step in (-width, width, -1, 1):
            near = cell + step
            if field[near] != NONE:
                field[near], queue[tail] = NONE, near
                tail += 1


@njit(cache=True)
def _options(grid: TeamGrid, place: int, goal: int, field: Ints, options: Numbers) -> int:
    """Fill `options`, (5,), with the cells to go to, best first, the own one included; returns how
    many."""
    width = grid.width
    keys = np.empty(5, np.int64)
    count = 0
    beside = goal != NONE and (abs(goal - place) == 1 or abs(goal - place) == width)
    for step in (0, -width, width, -1, 1):
        cell = place + step
        if not grid.free[cell]:
            continue
        if goal == NONE:
            key = 0 if step == 0 else 1
        elif beside:  # no field is kept for a goal next door
            key = abs(cell // width - goal // width) + abs(cell % width - goal % width)
        else:
            key = field[cell] if field[cell] >= 0 else UNKNOWN
        # Ties: an empty cell rather than pushing someone, then one that is still to be covered.
        key = key * 4 + (2 if grid.here[cell] != NONE and step != 0 else 0) + grid.covered[cell]
        at = count
        while at > 0 and keys[at - 1] > key:
            keys[at], options[at] = keys[at - 1], options[at - 1]
            at -= 1
        keys[at], options[at] = key, cell
        count += 1
    return count


@njit(cache=True)
def _choose(
    grid: TeamGrid, robots: Robots, first: Number, memory: tuple[Numbers, Numbers, Numbers, Numbers]
) -> None:
    """Choose the next cells of robot `first` and of all robots that it pushes; `memory` is scratch."""
    stack, options, tried, many = memory
    place, then = robots.place, robots.then
    stack[0], depth, moved = first, 1, False
    many[first] = NONE
    while depth > 0:
        robot = stack[depth - 1]
        if many[robot] == NONE:
            goal = robots.goal[robot]
            many[robot] = _options(grid, place[robot], goal, robots.field[robot], options[robot])
            tried[robot] = 0
        elif moved:  # back from the one it pushed, which has made room
            depth -= 1
            continue
        else:
            tried[robot] += 1
        settled = pushed = False
        while tried[robot] < many[robot] and not settled and not pushed:
            cell = options[robot, tried[robot]]
            other = grid.here[cell]
            stranger = other != NONE and other != robot
            if grid.ahead[cell] != NONE or (stranger and then[other] == place[robot]):
                tried[robot] += 1
                continue
            then[robot], grid.ahead[cell] = cell, robot
            if stranger and then[other] == NONE:
                many[other], stack[depth], pushed = NONE, other, True
                depth += 1
            else:
                settled = True
        if pushed:
            continue
        if not settled:
            then[robot], grid.ahead[place[robot]] = place[robot], robot
        moved = settled
        depth -= 1


@njit(cache=True)
def step(grid: TeamGrid, robots: Robots) -> int:
    """Move every robot by one cell or none; returns how many cells were covered for the first time."""
    place, count = robots.place, robots.place.size
    memory = (
        np.empty(count + 1, np.int64), np.empty((count, 5), np.int64),
        np.empty(count, np.int64), np.full(count, NONE, np.int64),
    )  # fmt: skip
    key = np.empty(count, np.int64)
    for robot in range(count):
        robots.then[robot] = NONE
        idle = robots.goal[robot] == NONE
        key[robot] = (1 << 60) + robot if idle else robots.since[robot] * count + robot
    for robot in np.argsort(key):
        if place[robot] != NONE and robots.then[robot] == NONE:
            _choose(grid, robots, robot, memory)
    for robot in range(count):
        if place[robot] != NONE:
            grid.here[place[robot]] = NONE
    new = 0
    for robot in range(count):
        if place[robot] != NONE:
            cell = robots.then[robot]
            grid.ahead[cell] = NONE
            new += 1 - grid.covered[cell]
            place[robot], grid.here[cell], grid.covered[cell] = cell, robot, 1
    return new
