"""Shares the rest of a coverage walk: runs, goals, and taking over work from robots with more left.

A robot has one run [low, high) of the walk and works it from one end (`side` +1: from low). A robot
with an empty run takes the far end of another's run, as much as lets both finish earliest. No cell
is owned by two robots, and covered cells are skipped. All of it is arithmetic on replicated values,
so all peers that know the same agree without asking.

`grid`, `walked` and `robots` are those of `agent/coverage/team_state.py`: arrays (cells,), (n,) and
(robots,). `reach` (cells,) holds steps from some cell, -1 where not known.
"""

import numpy as np
from numpy.typing import NDArray

from agent.coverage.team_state import NONE, Number, Robots, TeamGrid, Walked
from agent.coverage.team_step import FAR, fill_field, wipe_field
from agent.kernels.kernel import njit

Mask = NDArray[np.uint8]
Ints = NDArray[np.int32]

WON_MIN = 2  # least gain in steps; below it, the way there and back costs more
ASK_AGAIN = 4  # steps until an idle robot asks again, because others have made progress


@njit(cache=True)
def _trim(walked: Walked, covered: Mask, robots: Robots, robot: int) -> None:
    """Drop what is covered from both ends of a run."""
    order, low, high = walked.order, robots.low, robots.high
    while low[robot] < high[robot] and covered[order[low[robot]]]:
        low[robot] += 1
    while low[robot] < high[robot] and covered[order[high[robot] - 1]]:
        high[robot] -= 1


@njit(cache=True)
def _rest(walked: Walked, robots: Robots, robot: int) -> Number:
    """The cost of what a robot has still to do."""
    low, high = robots.low[robot], robots.high[robot]
    if low >= high:
        return 0
    return robots.way[robot] * walked.unit + walked.along[high - 1] - walked.along[low]


@njit(cache=True)
def _nearer(reach: Ints, a: int, b: int) -> int:
    """Steps to the nearer of two cells; if one is not known, those to the other; FAR if neither is."""
    if reach[a] == NONE and reach[b] == NONE:
        return FAR
    if reach[a] == NONE or reach[b] == NONE:
        return max(reach[a], reach[b])
    return min(reach[a], reach[b])


@njit(cache=True)
def _split(walked: Walked, reach: Ints, robots: Robots, owner: int) -> tuple[Number, int]:
    """Where to part a run: (both parts' later end, index), the owner keeping its near part.

    The owner's cost rises with its part and the taker's falls: the crossing is found by halving.
    """
    order, along, unit = walked.order, walked.along, walked.unit
    low, high = robots.low[owner], robots.high[owner]
    own = robots.way[owner] * unit
    near, far = 1, high - low  # cells the owner keeps
    best, best_at = np.int64(1) << 40, high
    while near <= far:
        keep = (near + far) // 2
        if robots.side[owner] > 0:
            a, b = low + keep, high
            mine = own + along[a - 1] - along[low]
        else:
            a, b = low, high - keep
            mine = own + along[high - 1] - along[b]
        theirs = np.int64(0)
        if a < b:
            theirs = _nearer(reach, order[a], order[b - 1]) * unit + along[b - 1] - along[a]
        if max(mine, theirs) < best:
            best, best_at = max(mine, theirs), a if robots.side[owner] > 0 else b
        if mine < theirs:
            near = keep + 1
        else:
            far = keep - 1
    return best, best_at


@njit(cache=True)
def _worth_asking(grid: TeamGrid, walked: Walked, robots: Robots, robot: int) -> Number:
    """How far to look for a run worth taking from; 0 where no end is so near, walls not counted."""
    most = np.int64(0)
    order, place = walked.order, robots.place[robot]
    for other in range(robots.place.size):
        low, high = robots.low[other], robots.high[other]
        if low >= high - 1:
            continue
        far = order[high - 1] if robots.side[other] > 0 else order[low]
        apart = abs(far // grid.width - place // grid.width)
        apart += abs(far % grid.width - place % grid.width)
        if _rest(walked, robots, other) >= (apart + WON_MIN) * walked.unit:
            most = max(most, _rest(walked, robots, other) // walked.unit)
    return most


@njit(cache=True)
def _take_over(grid: TeamGrid, walked: Walked, robots: Robots, robot: int) -> None:
    """An idle robot takes the far part of the run where most is won."""
    order, low, high, reach = walked.order, robots.low, robots.high, grid.reach
    far = _worth_asking(grid, walked, robots, robot)
    if far == 0:
        return
    reach[:] = NONE
    fill_field(grid.free, grid.width, reach, robots.place[robot], np.int64(NONE), far, grid.queue)
    won, owner, at = WON_MIN * walked.unit - 1, NONE, 0
    for other in range(robots.place.size):
        if low[other] >= high[other] - 1:
            continue
        after, index = _split(walked, reach, robots, other)
        gain = _rest(walked, robots, other) - after
        if gain > won:
            won, owner, at = gain, other, index
    if owner == NONE:
        return
    if robots.side[owner] > 0:
        low[robot], high[robot], high[owner] = at, high[owner], at
    else:
        low[robot], high[robot], low[owner] = low[owner], at, at
    a, b = order[low[robot]], order[high[robot] - 1]
    from_low = _nearer(reach, a, b) == reach[a]
    robots.side[robot] = 1 if from_low else -1


@njit(cache=True)
def _find_way(grid: TeamGrid, robots: Robots, robot: int) -> None:
    """Steps to the goal; the field of steps around the robot where the goal is not next door."""
    place, goal = robots.place[robot], robots.goal[robot]
    if abs(goal - place) == 1 or abs(goal - place) == grid.width:
        robots.way[robot] = 1
        return
    field = robots.field[robot]
    known = robots.fielded[robot] == goal
    for step in (0, -grid.width, grid.width, -1, 1):
        known = known and (not grid.free[place + step] or field[place + step] != NONE)
    if not known:
        if robots.fielded[robot] != NONE:
            wipe_field(grid.width, field, robots.fielded[robot], grid.queue)
        fill_field(grid.free, grid.width, field, goal, place, np.int64(FAR), grid.queue)
        robots.fielded[robot] = goal
    robots.way[robot] = field[place]


@njit(cache=True)
def choose_goals(grid: TeamGrid, walked: Walked, robots: Robots, now: int) -> None:
    """Set each robot's next cell to cover, at the step `now`; idle robots take over from others.

    Changes `robots`, and scratch in `grid`.
    """
    for robot in range(robots.place.size):
        _trim(walked, grid.covered, robots, robot)
        robots.way[robot] = 0
        if robots.goal[robot] != NONE and grid.covered[robots.goal[robot]]:
            robots.goal[robot] = NONE
        if robots.place[robot] == NONE or robots.low[robot] == robots.high[robot]:
            continue
        if robots.goal[robot] == NONE:
            _set_goal(walked, robots, robot, now)
        _find_way(grid, robots, robot)
    for robot in range(robots.place.size):
        if robots.place[robot] == NONE or robots.low[robot] < robots.high[robot]:
            continue
        if robots.waits[robot] <= now:
            robots.waits[robot] = now + ASK_AGAIN
            _take_over(grid, walked, robots, robot)
            if robots.low[robot] < robots.high[robot]:
                _set_goal(walked, robots, robot, now)
                _find_way(grid, robots, robot)
    for robot in range(robots.place.size):
        if robots.place[robot] != NONE and robots.goal[robot] != NONE:
            _uncross(grid, robots, robot)


@njit(cache=True)
def _is_corridor(grid: TeamGrid, cell: int) -> bool:
    """Whether a free cell has no room for a robot beside the way through it."""
    free, width = grid.free, grid.width
    return free[cell - width] + free[cell + width] + free[cell - 1] + free[cell + 1] <= 2


@njit(cache=True)
def _goes_through(robots: Robots, robot: int, cell: int) -> bool:
    """Whether a robot is nearer to its goal in that cell beside it."""
    if robots.goal[robot] == NONE or robots.fielded[robot] != robots.goal[robot]:
        return False  # idle, or its goal is next door and not that cell, which is covered
    field = robots.field[robot]
    return field[cell] != NONE and field[cell] < field[robots.place[robot]]


@njit(cache=True)
def _uncross(grid: TeamGrid, robots: Robots, robot: int) -> None:
    """Exchange the runs of two robots in a corridor where each has to go through the other.

    They cannot pass each other. The robot with the older goal would push the other one, which covers
    that goal; then the other one has the older goal, and so on, one cell more each time.
    """
    place = robots.place[robot]
    for step in (-grid.width, grid.width, -1, 1):
        other = grid.here[place + step]
        if other == NONE or not _goes_through(robots, robot, place + step):
            continue
        if not (_is_corridor(grid, place) and _is_corridor(grid, place + step)):
            continue
        if not _goes_through(robots, other, place):
            continue
        for each in (robots.low, robots.high, robots.side, robots.goal, robots.since):
            each[robot], each[other] = each[other], each[robot]
        _find_way(grid, robots, robot)
        _find_way(grid, robots, other)
        return


@njit(cache=True)
def _set_goal(walked: Walked, robots: Robots, robot: int, now: int) -> None:
    """Make the end of its run that a robot works from its goal."""
    end = robots.low[robot] if robots.side[robot] > 0 else robots.high[robot] - 1
    robots.goal[robot], robots.since[robot] = walked.order[end], now
