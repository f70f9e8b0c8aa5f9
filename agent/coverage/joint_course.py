"""A joint plan that every robot of a fleet computes alike, and what each step of it has to wait
for.

The plan is what `agent/coverage/team.py` would do step by step. Robots do not share a clock, so it
is driven in its order instead: a step into a cell waits until the robot that was in it before has
gone on. That order never closes a circle of waiting, because the plan itself is a run in which all
of it happens.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from agent.coverage.cell_map import NONE, CellMap
from agent.coverage.team import Team

Numbers = NDArray[np.int32]
KEPT_MAX = 4  # cached plans: two sides of a network split, and those before them
STEPS_MAX = 0xFFFE  # a step is a u16 on the wire, counted from 1
# Steps computed at a time for one that another robot told: 7 ms on a map of 40,000 cells.
TOLD_STEPS_MAX = 256


class Wait(NamedTuple):
    """A robot's step waits until another has reached a step of its own."""

    robot: int
    step: int
    leaves: int  # its step out of the cell: `step`, or the next one if it leaves as we arrive


FREE = Wait(NONE, 0, 0)


class GridCourse(ABC):
    """A joint plan as it is driven: the cell of each robot after each step, and what a step waits
    for. It is computed step by step as far as it is asked for.

    Robots are indices into `slots`, cells are numbers of the ground.
    """

    def __init__(
        self, ground: CellMap, slots: Sequence[int], places: Sequence[int], todo: Numbers
    ) -> None:
        """`todo`: the cells that have to be entered, in the order in which they were planned."""
        self.ground, self.slots, self.todo = ground, tuple(slots), todo
        # The robot that covers each cell; grows with steps.
        self.owner: Numbers = np.full(len(ground), NONE, np.int32)
        self._wanted = np.zeros(len(ground), dtype=np.bool_)
        self._wanted[todo] = True
        self._steps: list[Numbers] = [np.array(places, np.int32)]
        self._waits: list[dict[int, Wait]] = [{}]
        self._in = np.full(len(ground), NONE, np.int32)  # last robot in each cell, and when it left
        self._left = np.zeros(len(ground), np.int32)
        self.turns: list[list[tuple[int, int]]] = [[] for _ in slots]  # (step, cell it covers)

    @abstractmethod
    def _advance(self) -> Numbers | None:
        """The cells of all robots after one more step, (robots,); None at the end of the plan."""

    def _extend(self) -> bool:
        """One more step of the plan; False at the end."""
        step, before = len(self._steps), self._steps[-1]
        after = self._advance() if step <= STEPS_MAX else None
        if after is None:
            return False
        moved = np.flatnonzero(after != before)
        self._in[before[moved]], self._left[before[moved]] = moved, step
        waits = {}
        for robot, cell in zip(moved.tolist(), after[moved].tolist(), strict=True):
            other = int(self._in[cell])
            if other not in (NONE, robot):
                left = int(self._left[cell])
                waits[robot] = Wait(other, left - 1 if left == step else left, left)
            if self._wanted[cell]:
                self._wanted[cell] = False
                self.owner[cell] = robot
                self.turns[robot].append((step, cell))
        self._steps.append(after)
        self._waits.append(waits)
        return True

    def reaches(self, step: int) -> bool:
        """Whether the plan goes on to that step."""
        while len(self._steps) <= step:
            if not self._extend():
                return False
        return True

    def finish(self) -> int:
        """The number of the last step; computes all of them."""
        while self._extend():
            pass
        return len(self._steps) - 1

    def told_step(self, step: int) -> int:
        """A step that another robot told; 0 if the plan ends before it, or is not computed so far.

        It computes at most `TOLD_STEPS_MAX` steps; a later call goes on from there.
        """
        known = self.reaches(min(step, len(self._steps) - 1 + TOLD_STEPS_MAX))
        return step if known and step < len(self._steps) else 0

    def place(self, robot: int, step: int) -> int:
        """The cell of a robot after a step, which must have been reached (`reaches`)."""
        return int(self._steps[step][robot])

    def wait(self, robot: int, step: int) -> Wait:
        """What must have happened before a robot begins its step.

        A cell that another robot leaves in the same step may be followed into; one that it leaves
        in an earlier step must be free.
        """
        return self._waits[step].get(robot, FREE)


class JointCourse(GridCourse):
    """The steps of a team that covers a grid (`agent/coverage/team.py`)."""

    def __init__(
        self,
        ground: CellMap,
        slots: Sequence[int],
        places: Sequence[int],
        covered: NDArray[np.bool_],
        blocked: Sequence[int],
        turn_cost: float,
    ) -> None:
        """`covered`: by number, cells that need no coverage; `blocked`: cells no robot enters."""
        walls = ground.walls.copy()
        for number in blocked:
            walls[ground.cell(number)] = True
        mask = np.zeros(walls.shape, dtype=np.bool_)
        rows, columns = np.divmod(ground.padded[covered], ground.width)
        mask[rows - 1, columns - 1] = True
        starts = [ground.cell(number) for number in places]
        self._team = Team(walls, starts, turn_cost, mask)
        super().__init__(ground, slots, places, ground.number_of[self._team.walked.order])

    def _advance(self) -> Numbers | None:
        if not self._team.remaining():
            return None
        after: Numbers = self.ground.number_of[np.array(self._team.advance(), np.int64)]
        return after


_KEPT: dict[object, tuple[CellMap, JointCourse]] = {}  # a ground kept keeps its id


class CourseInputs(NamedTuple):
    """Everything that a course depends on: robots that agree on these values compute equal courses."""

    slots: tuple[int, ...]
    places: tuple[int, ...]
    covered: bytes  # packed bits by number; what need not be covered
    blocked: tuple[int, ...]
    turn_cost: float

    def digest(self, ground: CellMap) -> int:
        """32 bits of these inputs and of the map, for comparing them in one frame."""
        return crc32(repr((ground.check, *self)).encode())


def course_of(ground: CellMap, terms: CourseInputs) -> JointCourse:
    """The course of these inputs. The last `KEPT_MAX` are kept, because robots that share a process
    compute the same one after the other."""
    key = (id(ground), terms)
    if key not in _KEPT:
        while len(_KEPT) >= KEPT_MAX:
            del _KEPT[next(iter(_KEPT))]
        bits = np.unpackbits(np.frombuffer(terms.covered, np.uint8), count=len(ground))
        covered: NDArray[np.bool_] = bits.astype(np.bool_)
        course = JointCourse(
            ground, terms.slots, terms.places, covered, terms.blocked, terms.turn_cost
        )  # fmt: skip
        _KEPT[key] = ground, course
    return _KEPT[key][1]
