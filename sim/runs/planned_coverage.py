"""Cover a grid with a coverage team, step by step, recorded as a plan.

Every robot would compute the same team from the same map and positions; here it is computed once.
"""

from collections.abc import Sequence
from typing import NamedTuple

from agent.coverage.team import Team
from agent.interface.geometry import Cell
from sim.files.coverage_plan_file import STEPS, Plan
from sim.files.grid_map import Instance

# Upper limit of a run. Each goal is at most all cells away, and each goal reached is a covered
# cell. The limit is far above real runs; a run that reaches it has a broken invariant and is not
# merely slow.
STEPS_PER_CELL_MAX = 50


class Death(NamedTuple):
    """A robot that stops for good at the beginning of a step."""

    step: int
    robot: int


class Arrival(NamedTuple):
    """A robot that joins at a cell (row, column) at the beginning of a step."""

    step: int
    cell: Cell


def work(
    instance: Instance,
    turn_cost: float = 0.0,
    deaths: Sequence[Death] = (),
    arrivals: Sequence[Arrival] = (),
) -> Plan:
    """The team's plan to its end. An arrival in an occupied cell waits until the cell is free."""
    team = Team(instance.walls, instance.starts, turn_cost)
    recorder = _Recorder(team, instance)
    ends, waiting = sorted(deaths), sorted(arrivals)
    while team.remaining() or ends or waiting:
        while ends and ends[0].step <= team.now:
            recorder.die(ends.pop(0).robot)
        for arrival in [a for a in waiting if a.step <= team.now]:
            number = team.number(arrival.cell)
            if team.grid.here[number] < 0:
                waiting.remove(arrival)
                if team.grid.free[number]:  # no robot can start from a wreck
                    recorder.join(arrival.cell)
        if not team.remaining() and not any(a.step > team.now for a in waiting) and not ends:
            break  # no work is left for a robot that would arrive
        recorder.advance()
        assert team.now < STEPS_PER_CELL_MAX * instance.walls.size + 1000, "locked"
    return recorder.plan


class _Recorder:
    def __init__(self, team: Team, instance: Instance) -> None:
        self.team = team
        width = team.grid.width
        self.codes = {row * width + column: code for code, (row, column) in enumerate(STEPS)}
        self.places: list[int] = team.robots.place.tolist()
        actions: list[list[int]] = [[] for _ in instance.starts]
        self.plan = Plan(instance.walls, list(instance.starts), actions, ~instance.walls)

    def advance(self) -> None:
        after = self.team.advance()
        for robot, (a, b) in enumerate(zip(self.places, after, strict=True)):
            self.plan.actions[robot].append(self.codes[b - a])
        self.places = after

    def die(self, robot: int) -> None:
        if self.places[robot] >= 0:
            self.team.die(robot)
            self.places[robot] = -1
            self.plan.died[robot] = self.team.now

    def join(self, cell: Cell) -> None:
        robot = self.team.join(cell)
        assert robot == len(self.plan.starts)
        self.places.append(self.team.number(cell))
        self.plan.starts.append(cell)
        self.plan.actions.append([0] * self.team.now)
        self.plan.joined.append(self.team.now)
        self.plan.died.append(-1)
