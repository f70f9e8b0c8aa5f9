"""Judge a coverage plan by its actions alone. Shares no code with any planner.

In one step all robots move at the same time. Not allowed: leaving the map or entering a wall or a
wreck, two robots in one cell, two robots changing places. A cell is covered by the robot that
stands on it. A robot that died is a wreck from that step on; cells that only it could reach need
not be covered.
"""

from collections import deque
from collections.abc import Collection, Sequence
from typing import NamedTuple

from agent.interface.geometry import Cell
from sim.files.coverage_plan_file import STEPS, Plan
from sim.files.grid_map import Walls


class PlanScore(NamedTuple):
    """How a plan scores, by its actions alone."""

    makespan: int  # the first step after which everything reachable is covered, else the plan's end
    collisions: int  # robots in a cell with another, summed over the steps
    swaps: int  # pairs of robots that changed places
    wall_entries: int  # steps into walls, wrecks, or off the map; the robot stays
    uncovered: int  # cells that a living robot can reach and that no robot was in
    cells: int  # reachable free cells
    moves: int
    turns_90: int  # between two consecutive moves of a robot, waits not counted
    turns_180: int
    repeats: int  # moves into cells that were covered before
    # Of each robot: the step after which it had covered its last new cell.
    last_steps: tuple[int, ...]
    quarter_turns: tuple[int, ...]  # of each robot until that step; a U-turn counts as two

    @property
    def ok(self) -> bool:
        """Whether nothing collided, swapped or hit a wall, and nothing that can be reached was
        left."""
        return not (self.collisions or self.swaps or self.wall_entries or self.uncovered)

    def score(self, turn_cost: float) -> float:
        """The slowest robot's steps to its last new cell, each quarter turn at `turn_cost`
        steps."""
        ends = zip(self.last_steps, self.quarter_turns, strict=True)
        return max((step + turn_cost * turns for step, turns in ends), default=0.0)


def steps_from(walls: list[list[bool]], sources: list[Cell]) -> dict[Cell, int]:
    """Steps from the nearest source to every cell that can be reached."""
    rows, columns = len(walls), len(walls[0])
    steps = dict.fromkeys(sources, 0)
    queue = deque(sources)
    while queue:
        row, column = queue.popleft()
        for dr, dc in STEPS[1:]:
            cell = (row + dr, column + dc)
            if not (0 <= cell[0] < rows and 0 <= cell[1] < columns):
                continue
            if cell not in steps and not walls[cell[0]][cell[1]]:
                steps[cell] = steps[row, column] + 1
                queue.append(cell)
    return steps


def judge(plan: Plan) -> PlanScore:
    """Play a plan to its end and score it."""
    court = PlanJudge(plan)
    while not court.over:
        court.advance()
    court.end()
    return court.verdict()


def lower_bound(
    walls: Walls, starts: Sequence[Cell], joined: Sequence[int] = (),
    wanted: Collection[Cell] | None = None,
) -> int:  # fmt: skip
    """A lower bound for all plans, in steps: cells at distance d or more are not entered in the first
    d - 1 steps, and a robot enters one cell a step.

    `joined`: the step from which on each robot is there; empty: all are from the beginning on.
    `wanted`: the cells that count; None: all that a robot can reach.

    >>> import numpy as np
    >>> lower_bound(np.zeros((1, 9), dtype=bool), [(0, 0), (0, 1)])
    7
    >>> lower_bound(np.zeros((1, 9), dtype=bool), [(0, 0), (0, 8)], [0, 2])
    5
    """
    since = list(joined) or [0] * len(starts)
    first: dict[Cell, int] = {}  # the step after which a robot can be in a cell
    for step in sorted(set(since)):
        there = [cell for cell, begun in zip(starts, since, strict=True) if begun == step]
        for cell, away in steps_from(walls.tolist(), there).items():
            first[cell] = min(first.get(cell, step + away), step + away)
    rings = [0] * (max(first.values(), default=0) + 1)
    for cell, away in first.items():
        if cell not in starts and (wanted is None or cell in wanted):
            rings[away] += 1
    best, beyond = 0, 0
    for away in range(len(rings) - 1, 0, -1):
        beyond += rings[away]
        while beyond > sum(max(0, best - max(away - 1, begun)) for begun in since):
            best += 1
    return best


class PlanJudge:
    """Plays a plan step by step and records faults; `advance` to its end, then call `verdict`."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.walls: list[list[bool]] = plan.walls.tolist()
        self.at: dict[int, Cell] = {}
        self.wrecks: set[int] = set()
        self.covered: dict[Cell, int] = {}  # the step after which it was covered
        self.collisions = self.swaps = self.wall_entries = self.moves = self.repeats = 0
        self.turns = [0, 0]
        self.heading: dict[int, int] = {}
        self.step = 0
        robots = len(plan.starts)
        self.quarters, self.quarters_then, self.last = [0] * robots, [0] * robots, [0] * robots
        self._arrive(0)

    def advance(self) -> None:
        """Play one step: deaths first, then moves, then arrivals."""
        self._die(self.step)
        self._move(self.step)
        self.step += 1
        self._arrive(self.step)

    def end(self) -> None:
        """After the last step: robots that die in the step after it do not cover what is left."""
        self._die(self.step)

    @property
    def over(self) -> bool:
        """Whether all actions have been played."""
        return self.step >= self.plan.makespan

    def wanted(self) -> set[Cell]:
        """The cells that the living robots can reach."""
        live = [cell for robot, cell in self.at.items() if robot not in self.wrecks]
        return {cell for cell in steps_from(self.walls, live) if self.plan.dirt[cell]}

    def verdict(self) -> PlanScore:
        """The score of the steps that were played so far."""
        plan, wanted = self.plan, self.wanted()
        missing = wanted - self.covered.keys()
        last = max((self.covered[cell] for cell in wanted - missing), default=0)
        return PlanScore(
            plan.makespan if missing else last, self.collisions, self.swaps, self.wall_entries,
            len(missing), len(wanted), self.moves, self.turns[0], self.turns[1], self.repeats,
            tuple(self.last), tuple(self.quarters_then),
        )  # fmt: skip

    def _arrive(self, step: int) -> None:
        for robot, joined in enumerate(self.plan.joined):
            if joined == step:
                cell = self.plan.starts[robot]
                self.collisions += cell in self.at.values()
                self.wall_entries += self.walls[cell[0]][cell[1]]
                self.at[robot] = cell
                self.covered.setdefault(cell, step)

    def _die(self, step: int) -> None:
        for robot, died in enumerate(self.plan.died):
            if died == step and robot in self.at:
                self.wrecks.add(robot)
                row, column = self.at[robot]
                self.walls[row][column] = True

    def _move(self, step: int) -> None:
        before = dict(self.at)
        for robot, (row, column) in before.items():
            actions = self.plan.actions[robot]
            action = actions[step] if step < len(actions) else 0
            if robot in self.wrecks or action == 0:
                continue
            cell = (row + STEPS[action][0], column + STEPS[action][1])
            inside = 0 <= cell[0] < len(self.walls) and 0 <= cell[1] < len(self.walls[0])
            if not inside or self.walls[cell[0]][cell[1]]:
                self.wall_entries += 1
                continue
            self.at[robot] = cell
            self._count(robot, action)
        self.collisions += len(self.at) - len(set(self.at.values()))
        movers = {
            (before[robot], self.at[robot]) for robot in before if before[robot] != self.at[robot]
        }
        self.swaps += sum((b, a) in movers for a, b in movers) // 2
        for robot, cell in self.at.items():
            if cell not in self.covered:
                self.covered[cell] = step + 1
                self.last[robot], self.quarters_then[robot] = step + 1, self.quarters[robot]
            elif robot in before and before[robot] != cell:
                self.repeats += 1

    def _count(self, robot: int, action: int) -> None:
        self.moves += 1
        old = self.heading.get(robot, action)
        if old != action:
            back = (old - 1) // 2 == (action - 1) // 2  # up and down, or left and right
            self.turns[back] += 1
            self.quarters[robot] += 2 if back else 1
        self.heading[robot] = action
