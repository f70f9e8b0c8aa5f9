"""How many robots could stand on their goals at once, by trying all configurations. Shares no code with
any planner.

Each step moves one robot into a free cell. That reaches what joint steps reach, but for robots that move
on together in a full ring. A ring of cells has four at least.
"""

from collections import deque
from collections.abc import Sequence
from math import perm

from agent.interface.geometry import Cell

CONFIGURATIONS_MAX = 100_000  # tried in about a second
RING_MIN = 4  # robots that can move on in a full ring


def most_arrived(
    cells: set[Cell], places: Sequence[Cell], goals: Sequence[Cell | None]
) -> int | None:
    """The most robots that can be on their goals at once, from these places in connected cells.

    `goals`: None for a robot that only gives way. None where there are too many configurations, or
    where a full ring could turn.
    """
    near = {
        (row, column): [
            cell
            for cell in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1))
            if cell in cells
        ]
        for row, column in cells
    }
    has_ring = sum(map(len, near.values())) // 2 >= len(cells)
    too_many = perm(len(cells), len(places)) > CONFIGURATIONS_MAX
    if too_many or (has_ring and len(places) >= RING_MIN):
        return None
    first = tuple(places)
    seen, queue, most = {first}, deque([first]), 0
    while queue:
        now = queue.popleft()
        most = max(most, sum(at == goal for at, goal in zip(now, goals, strict=True)))
        for robot, at in enumerate(now):
            for to in near[at]:
                following = (*now[:robot], to, *now[robot + 1 :])
                if to not in now and following not in seen:
                    seen.add(following)
                    queue.append(following)
    return most
