"""The file of paths that MAPF validators read, and how the visits of real bodies become such paths.

    agents=2
    map_file=room.map
    ...
    starts=(0,0),(5,0)
    goals=(5,0),(0,0)
    solution=
    0:(0,0),(5,0),
    1:(1,0),(5,1),

A place is (column, row). The form is that of the public LaCAM and PIBT solvers.

Bodies have no common clock. `timed` gives each visit of a cell a whole unit of time: the one in
which it happened, or a later one where the order of the visits of one cell asks for it. It moves
nothing forward in time, and visits that no such order allows are an error.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

from agent.interface.geometry import Cell

Visit = tuple[float, int, int]  # units of time, robot, cell number
MARGIN = 0.5  # of a unit: a visit is rounded to the nearest one
# A body is in a cell for a unit if it goes to the middle and back; looks at bodies are 0.03 units apart.
TO_THE_MIDDLE = 0.9


class PathError(Exception):
    """The visits of bodies are no plan: two were in one cell, or changed places."""


def without_broken_moves(visits: Sequence[Visit]) -> list[Visit]:
    """The visits, in their order, without those that a robot took back.

    A robot follows another one closely. If that one is stopped between two cells, the follower is in
    a cell that the other has not left for any other, and goes back. The rules of the problem have no
    place for a body between cells. So such a move is left out, as if the follower had waited.

    A body that is back within less than a unit was never in the middle of the cell, which is half a
    unit behind the border. Such a move is left out in any case. A robot that cannot get on
    behind a wreck makes several, and the shortest one is left out first: where it goes to and fro,
    its longer stays say where it waited.
    """
    kept = list(visits)
    while True:
        short = _short_move(kept)
        if short is None:
            break
        del kept[short]
    while True:
        broken = _broken_move(kept)
        if broken is None:
            return kept
        del kept[broken]


def _own_visits(visits: Sequence[Visit]) -> Iterator[list[int]]:
    """For each robot the indices of its visits, in their order, without repeats of the cell that it
    is in."""
    own: dict[int, list[int]] = {}
    for k, (_, robot, cell) in enumerate(visits):
        row = own.setdefault(robot, [])
        if not row or visits[row[-1]][2] != cell:
            row.append(k)
    yield from own.values()


def _short_move(visits: Sequence[Visit]) -> int | None:
    """The index of the shortest visit of less than a unit from which a robot went back to the cell
    that it came from. None: there is none."""
    stays = [
        (visits[later][0] - visits[k][0], k)
        for row in _own_visits(visits)
        for before, k, later in zip(row, row[1:], row[2:], strict=False)
        if visits[before][2] == visits[later][2]
    ]
    return next((k for for_units, k in sorted(stays)[:1] if for_units < TO_THE_MIDDLE), None)


def _broken_move(visits: Sequence[Visit]) -> int | None:
    """The index of the last visit of a cell that its robot left for the one it came from, before the
    robot that was there came to another one. None: there is none."""
    own = list(_own_visits(visits))
    following = {k: later for row in own for k, later in pairwise([*row, len(visits)])}
    back = {
        k
        for row in own
        for before, k, later in zip(row, row[1:], row[2:], strict=False)
        if visits[before][2] == visits[later][2]
    }
    inside: dict[int, list[int]] = {}  # cell -> its visits so far
    for k in sorted(following):
        inside.setdefault(visits[k][2], []).append(k)
    found = [
        other
        for turns in inside.values()
        for one, other in pairwise(turns)
        if other in back and visits[one][1] != visits[other][1]
        and following[one] >= following[other]
    ]  # fmt: skip
    return max(found, default=None)


def timed(visits: Sequence[Visit], robots: int) -> list[list[tuple[int, int]]]:
    """For each robot its (time, cell) in whole units of time, from the visits in their order.

    PathError if two robots were in one cell at a time, however the visits are timed.
    """
    own: list[list[tuple[float, int]]] = [[] for _ in range(robots)]
    of_cell: dict[int, list[tuple[int, int]]] = {}  # cell -> (robot, index) in order
    for at, robot, cell in visits:
        if own[robot] and own[robot][-1][1] == cell:
            continue
        of_cell.setdefault(cell, []).append((robot, len(own[robot])))
        own[robot].append((at, cell))
    times = [[max(0, int(at + MARGIN)) if k else 0 for k, (at, _) in enumerate(row)] for row in own]
    before: dict[tuple[int, int], tuple[int, int]] = {}
    for cell, turns in of_cell.items():
        for (one, k), (other, j) in pairwise(turns):
            if one == other:
                continue
            if k + 1 >= len(own[one]):
                raise PathError(f"robot {other} came to cell {cell}, where robot {one} stayed")
            before[other, j] = (one, k + 1)  # the other one must have gone by then
    limit = sum(map(len, own)) + max((t for row in times for t in row), default=0) + 1
    changed = True
    while changed:
        changed = False
        for robot, row in enumerate(times):
            for k in range(1, len(row)):
                least = max(row[k], row[k - 1] + 1)
                gone = before.get((robot, k))
                if gone is not None:
                    least = max(least, times[gone[0]][gone[1]])
                if least > row[k]:
                    row[k], changed = least, True
                if least > limit:
                    raise PathError(f"robot {robot} was in the way of itself or of others")
    return [
        [(at, cell) for at, (_, cell) in zip(row, visited, strict=True)]
        for row, visited in zip(times, own, strict=True)
    ]


def tracks(timed_visits: Sequence[Sequence[tuple[int, int]]]) -> list[list[int]]:
    """The cell of each robot at each whole time, until the last one has moved."""
    last = max((row[-1][0] for row in timed_visits), default=0)
    found = []
    for row in timed_visits:
        track, k = [], 0
        for t in range(last + 1):
            while k + 1 < len(row) and row[k + 1][0] <= t:
                k += 1
            track.append(row[k][1])
        found.append(track)
    return found


def path_text(
    head: Mapping[str, object], starts: Sequence[Cell], goals: Sequence[Cell],
    steps: Sequence[Sequence[Cell]],
) -> str:  # fmt: skip
    """The text of the file. `head`: remarks on the run. `steps`: the cells of all robots at each time."""
    lines = [f"{name}={value}" for name, value in head.items()]
    lines += [f"starts={_places(starts)}", f"goals={_places(goals)}", "solution="]
    lines += [f"{t}:{_places(cells)}" for t, cells in enumerate(steps)]
    return "\n".join([*lines, ""])


def _places(cells: Sequence[Cell]) -> str:
    return "".join(f"({column},{row})," for row, column in cells)
