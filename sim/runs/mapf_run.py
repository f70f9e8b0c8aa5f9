"""Whole peers go to their goals on a MAPF map, over the simulated wire; judged from true positions.

    outcome = MapfRun(MapfSetup.of(instance)).run()

Costs are told in units of time, which is what a body takes for one cell at full speed. They count
from the moment at which the first body set out. What the fleet took to find each other and to agree
before that is told beside it, because solvers do not count their planning as a cost, either.
"""

from collections import deque
from collections.abc import Iterable, Mapping
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.coverage.cell_map import NONE
from agent.interface.config import S
from sim.files.mapf_paths import PathError, timed, tracks, without_broken_moves
from sim.fleet.scheduler import Host
from sim.fleet.simulated_fleet import Record
from sim.runs.coverage_run import QUIET_US
from sim.runs.grid_fleet import MapfFleet
from sim.runs.run import MissionRun, RunProgress, states_of
from sim.scenarios.coverage_setup import STEP_S
from sim.scenarios.mapf_setup import MapfSetup
from sim.world.joint_arrivals import most_arrived
from sim.world.plan_judge import steps_from

STEP_US = round(STEP_S * S)
BESIDE = 0.8  # of a cell: a body nearer to a cell's middle, along both axes, may block the cell


class MapfOutcome(NamedTuple):
    """What came of one run, from the truth."""

    map: str
    robots: int
    seed: int
    finished: bool  # all running robots report it
    crashed: int
    unsolvable: int  # running robots that wrecks, or robots behind a wreck, keep from their goals
    arrived: int  # running robots that stand on their goal, of all that can
    sum_of_costs: float  # of those, units of time
    shortest: int  # the sum of their shortest paths on the empty map: no plan costs less
    makespan: float  # units of time
    before_for_s: float  # from power-up until the first body set out
    collisions: int  # contacts of bodies, and centres in walls
    conflict: str  # why the visits are no plan; empty: they are one
    closest_m: float
    rounds: int  # of agreement
    frames: Mapping[str, int]
    malformed: int
    bus_load: float
    trace_hash: str
    simulated_s: float
    cpu_s: float

    @property
    def solvable(self) -> int:
        """Robots that did not crash and that could be at their goals."""
        return self.robots - self.crashed - self.unsolvable

    @property
    def success(self) -> bool:
        """All that could arrive did, and nothing touched."""
        clean = not (self.collisions or self.conflict)
        return self.finished and clean and self.arrived == self.solvable

    @property
    def ratio(self) -> float:
        """The sum of costs as a factor of that of the shortest paths."""
        return self.sum_of_costs / max(self.shortest, 1)

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values for JSON."""
        plain = {**self._asdict(), "frames": dict(self.frames)}
        more = {"solvable": self.solvable, "ratio": round(self.ratio, 4), "success": self.success}
        return {**plain, **more}


class MapfRun(MissionRun[MapfSetup, MapfFleet, MapfOutcome]):
    """Switches whole peers on, waits until all plans are at their end, and judges the bodies."""

    kind = MapfOutcome
    quiet_for_us = QUIET_US
    steps: list[list[int]]  # after the run: the cells of all robots at each unit of time
    excused: set[int]  # after the run: robots that crashed, or that wrecks keep from their goals

    def make_fleet(self, channel: str, record: Record, host: Host) -> MapfFleet:
        return MapfFleet(self.setting, channel, record, host)

    def progress(self, cluster: MapfFleet) -> RunProgress:
        """Robots at their goals, of all."""
        at, goals = cluster.grid_world.truth.at, self.setting.goals
        done = sum(at.get(slot) == goal for slot, goal in enumerate(goals))
        now_s = cluster.host.now_us() / S
        return RunProgress(now_s, done, len(goals), done / len(goals), states_of(cluster))

    def measure(self, cluster: MapfFleet) -> dict[str, Any]:
        setting, truth = self.setting, cluster.grid_world.truth
        up = {robot.slot for robot in cluster.running}
        moved = [at_us for at_us, slot, cell in truth.visits if cell != setting.cells[slot]]
        first_at_us = min(moved, default=STEP_US) - STEP_US
        came_at_us = {slot: at_us for at_us, slot, cell in truth.visits}  # the last visit of each
        closed = self._closed_off(cluster, up)
        self.excused = closed | set(range(len(setting.goals))) - up
        there = [slot for slot in sorted(up - closed) if truth.at.get(slot) == setting.goals[slot]]
        left = {slot for _, slot, cell in truth.visits if cell != setting.cells[slot]}
        moves = {
            slot: (came_at_us[slot] - first_at_us) / STEP_US if slot in left else 0
            for slot in there
        }
        conflict = self._follow(cluster, up, first_at_us)
        return {
            "map": setting.instance.name,
            "crashed": len(setting.goals) - len(up),
            "unsolvable": len(closed),
            "arrived": len(there),
            "sum_of_costs": float(sum(moves.values())),
            "shortest": sum(self._shortest(there)),
            "makespan": float(max(moves.values(), default=0.0)),
            "before_for_s": first_at_us / S,
            "collisions": len(truth.contacts) + truth.through_walls,
            "conflict": conflict,
            "closest_m": truth.closest_m,
            "rounds": max(cluster.mission(r).agreement.rounds for r in cluster.robots.values()),
        }

    def _follow(self, cluster: MapfFleet, up: set[int], first_at_us: int) -> str:
        """Set `steps` to the cells in which the bodies were. Returns why they are no plan, if so.

        A body is in the cell that holds its centre. A wreck across the border of two cells is in one
        of them, and no other body may have been there since; which of both it is does not matter.
        """
        self.steps, why = [], ""
        crossings, world = cluster.grid_world.truth.crossings, cluster.grid_world
        crashed_at_us = {
            f.robot: round(f.at_s * S) for f in self.setting.scenario.fault if f.kind == "crash"
        }
        across = [
            [None, *[(crashed_at_us.get(slot, crossings[-1][0]), slot, cell) for cell in
                     self._beside(world.body(slot).position)]]
            for slot in sorted(set(world.robots) - up)
        ]  # fmt: skip
        for chosen in product(*across):
            found = sorted([*crossings, *[each for each in chosen if each is not None]])
            # It comes to the middle of a cell half a unit after the border.
            visits = [
                ((at_us - first_at_us) / STEP_US + 0.5, slot, cell) for at_us, slot, cell in found
            ]
            try:
                tracked = tracks(timed(without_broken_moves(visits), len(self.setting.goals)))
            except PathError as error:
                why = why or str(error)
                continue
            self.steps = [list(cells) for cells in zip(*tracked, strict=True)]
            return ""
        return why

    def _beside(self, place: tuple[float, float]) -> list[int]:
        """The free cells that a body at a place blocks, besides the one that it is in."""
        ground, (x_m, y_m) = self.setting.ground, place
        row, column = ground.cell_at(x_m, y_m)
        found = []
        for cell in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
            cx_m, cy_m = ground.centre_of(cell)
            near = max(abs(cx_m - x_m), abs(cy_m - y_m)) < BESIDE * ground.cell_m
            if near and ground.number(cell) != NONE:
                found.append(ground.number(cell))
        return found

    def _shortest(self, slots: Iterable[int]) -> list[int]:
        """The shortest path of each robot on the map without others, in moves."""
        walls, starts = self.setting.ground.walls.tolist(), self.setting.instance.starts
        return [
            steps_from(walls, [starts[slot]])[self.setting.ground.cell(self.setting.goals[slot])]
            for slot in slots
        ]

    def _closed_off(self, cluster: MapfFleet, up: set[int]) -> set[int]:
        """Running robots whose goal is in a wreck, or is cut off by wrecks from where they are, or that
        would have to pass each other where wrecks leave no room."""
        ground, world = self.setting.ground, cluster.grid_world
        walls: NDArray[np.bool_] = ground.walls.copy()
        for slot in set(world.robots) - up:
            x_m, y_m = world.body(slot).position
            row, column = ground.cell_at(x_m, y_m)
            for cell in ((row + i, column + j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
                cx_m, cy_m = ground.centre_of(cell)
                beside = max(abs(cx_m - x_m), abs(cy_m - y_m)) < BESIDE * ground.cell_m
                if beside and ground.number(cell) != NONE:
                    walls[cell] = True
        part: dict[tuple[int, int], int] = {}
        for number in range(len(ground)):
            cell = ground.cell(number)
            if cell in part or walls[cell]:
                continue
            part[cell], queue = number, deque([cell])
            while queue:
                row, column = queue.popleft()
                for near in (
                    (row + 1, column),
                    (row - 1, column),
                    (row, column + 1),
                    (row, column - 1),
                ):
                    if ground.number(near) != NONE and not walls[near] and near not in part:
                        part[near] = number
                        queue.append(near)
        closed = set()
        for slot in up:
            here = ground.cell_at(*world.body(slot).position)
            goal = ground.cell(self.setting.goals[slot])
            if part.get(goal) is None or part.get(here) != part.get(goal):
                closed.add(slot)
        for number in set(part.values()):
            closed |= self._kept_apart(cluster, up, closed, {c for c in part if part[c] == number})
        return closed

    def _kept_apart(
        self, cluster: MapfFleet, up: set[int], closed: set[int], cells: set[tuple[int, int]]
    ) -> set[int]:
        """Robots in these connected cells that are not at their goals, if no more can be at once."""
        ground, world, goals = self.setting.ground, cluster.grid_world, self.setting.goals
        at = {slot: ground.cell_at(*world.body(slot).position) for slot in sorted(up)}
        inside = [slot for slot, cell in at.items() if cell in cells]
        bound = [slot for slot in inside if slot not in closed]
        late = {slot for slot in bound if world.truth.at.get(slot) != goals[slot]}
        if not late:
            return late
        ends = [ground.cell(goals[slot]) if slot in bound else None for slot in inside]
        most = most_arrived(cells, [at[slot] for slot in inside], ends)
        return late if most == len(bound) - len(late) else set()
