"""A joint plan from cells to goals, made alike by every robot of a fleet on a grid.

A goal may be out of reach: something stands there or in the only way, or another robot has the same
goal. Such a robot gets another end: the nearest cell that is nobody's goal. So it leaves the way of
others. Nor does a robot end beside one that stands between two cells, which needs one of them.

Robots that something keeps apart are planned for apart. Where some of them have no plan, as two that
would have to change places in a corridor, those stay, and all others go.
"""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from agent.coverage.cell_map import NONE, CellMap
from agent.coverage.joint_course import GridCourse, Numbers
from agent.mapf.pibt import NOWHERE, ways
from agent.mapf.sum_of_costs import planned

KEPT_MAX = 4  # cached plans: two sides of a network split, and those before them
DIGEST_MASK = 0xFFFF_FFFF


def neighbours(ground: CellMap, blocked: tuple[int, ...] = ()) -> NDArray[np.int32]:
    """The cells beside each cell, (cells, 4) numbers; -1 for walls and for `blocked` cells."""
    near: NDArray[np.int32] = np.stack(
        [ground.number_of[ground.padded + step] for step in (1, -ground.width, -1, ground.width)],
        axis=1,
    ).astype(np.int32)
    if blocked:
        near[np.isin(near, blocked)] = NONE
        near[list(blocked)] = NONE
    return near


class GoalInputs(NamedTuple):
    """All that a plan depends on: robots that agree on these values compute equal plans."""

    slots: tuple[int, ...]
    places: tuple[int, ...]
    goals: tuple[int, ...]
    blocked: tuple[int, ...]
    salt: int
    cleared: tuple[int, ...] = ()  # cells in which no robot is to end

    def digest(self, ground: CellMap) -> int:
        """32 bits of these inputs and of the map, for comparing them in one frame."""
        return crc32(repr((ground.check, *self)).encode()) & DIGEST_MASK


def _outward(near: NDArray[np.int32], place: int) -> Iterator[int]:
    """The cells that a robot at `place` can come to, the nearest first."""
    queue, seen = deque([place]), {place}
    while queue:
        at = queue.popleft()
        yield at
        for to in near[at].tolist():
            if to != NONE and to not in seen:
                seen.add(to)
                queue.append(to)


def ends_of(near: NDArray[np.int32], inputs: GoalInputs) -> list[int]:
    """Where each robot is to end: at its goal, or near its place if its goal cannot be reached.

    `near`: (cells, 4), as `neighbours` gives it."""
    ends: list[int] = []
    for place, goal in zip(inputs.places, inputs.goals, strict=True):
        possible = goal not in ends and goal not in inputs.cleared
        # Not `goal in _outward(...)`: a compiled generator cannot be asked so.
        possible = possible and any(cell == goal for cell in _outward(near, place))
        ends.append(goal if possible else NONE)
    taken = {*inputs.goals, *inputs.cleared}
    for k, place in enumerate(inputs.places):
        if ends[k] != NONE:
            continue
        ends[k] = next((cell for cell in _outward(near, place) if cell not in taken), NONE)
        if ends[k] == NONE:  # each cell is a robot's goal: one of a robot that does not get there
            ends[k] = next(cell for cell in _outward(near, place) if cell not in ends)
        taken.add(ends[k])
    return ends


def _groups(near: NDArray[np.int32], places: NDArray[np.int32]) -> list[list[int]]:
    """The robots, as indices into `places`, that can come to each other's places."""
    if not len(places):
        return []
    joined = ways(near, places)[:, places] < NOWHERE
    groups: dict[int, list[int]] = {}
    for k, first in enumerate(joined.argmax(axis=1).tolist()):
        groups.setdefault(first, []).append(k)
    return list(groups.values())


class GoalCourse(GridCourse):
    """The plan, from `agent/mapf/sum_of_costs.py`. Robots without one stay where they are."""

    def __init__(self, ground: CellMap, inputs: GoalInputs) -> None:
        near = neighbours(ground, inputs.blocked)
        self.ends = ends_of(near, inputs)
        places = np.array(inputs.places, np.int32)
        tracks = [
            (
                group,
                planned(near, places[group].tolist(), [self.ends[k] for k in group], inputs.salt),
            )
            for group in _groups(near, places)
        ]
        self.solved = all(track is not None for _, track in tracks)
        last = max((track.shape[1] for _, track in tracks if track is not None), default=1)
        self._track = np.repeat(places[:, None], last, axis=1)
        for group, track in tracks:
            if track is not None:
                self._track[group, : track.shape[1]] = track
                self._track[group, track.shape[1] :] = track[:, -1:]
        self.left_out = {
            slot for slot, goal, end in zip(inputs.slots, inputs.goals, self.ends, strict=True)
            if goal != end
        }  # fmt: skip
        super().__init__(ground, inputs.slots, inputs.places, np.empty(0, np.int32))

    def _advance(self) -> Numbers | None:
        step = len(self._steps)
        return self._track[:, step].copy() if step < self._track.shape[1] else None


_KEPT: dict[object, tuple[CellMap, GoalCourse]] = {}  # a ground kept keeps its id


def course_to_goals(ground: CellMap, inputs: GoalInputs) -> GoalCourse:
    """The plan of these inputs. The last `KEPT_MAX` are kept, because robots that share a process
    compute the same one after the other."""
    key = (id(ground), inputs)
    if key not in _KEPT:
        while len(_KEPT) >= KEPT_MAX:
            del _KEPT[next(iter(_KEPT))]
        _KEPT[key] = ground, GoalCourse(ground, inputs)
    return _KEPT[key][1]
