"""Whole peers cover a grid map over the simulated wire; the outcome is measured from the truth.

    outcome = CoverageRun(CoverageSetup.made(instance)).run()

Every robot is the peer that runs on a real robot, with address claim, membership, safety, claims,
sync and all frames on a bus of 250 kbit/s. Only bodies and sensors are simpler than in a field
(`grid_world`).
"""

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from agent.coverage.cell_map import NONE
from agent.coverage.coverage_mission import GridWork
from agent.interface.config import S
from sim.fleet.scheduler import Host
from sim.fleet.simulated_fleet import Cluster, Record, Robot
from sim.runs.run import MissionRun, RunProgress, states_of
from sim.scenarios.coverage_setup import STEP_S, CoverageSetup
from sim.world.grid_world import GridWorld
from sim.world.plan_judge import lower_bound, steps_from

QUIET_US = 10 * S  # after the last cell, registers and replicas must be in order within this time


class CoverageOutcome(NamedTuple):
    """What came of one run of whole peers on a grid, from the truth."""

    map: str
    robots: int
    seed: int
    finished: bool  # all running robots report it, and all sections are done
    uncovered: int  # cells that a running robot could reach
    makespan_s: float  # from power-up until the last cell was covered
    bound_s: float  # lower bound for any fleet: distance-aware, one cell a step
    replanned: int  # cells planned although the planner's own replica had them as covered
    redone: int  # cells planned although covered by a robot that is present and reachable by all
    untold: int  # cells planned that a robot covered just before it died, and could not report
    contacts: int
    through_walls: int
    closest_m: float
    replicas_equal: bool
    steps: int  # cells entered by all robots
    rounds: int  # of agreement; the largest number that one robot took part in
    sections_done: int
    sections: int
    frames: Mapping[str, int]
    malformed: int
    bus_load: float
    bus_load_worst_case: float
    trace_hash: str
    simulated_s: float
    cpu_s: float  # all robots, the bus and the world together, in one process

    @property
    def ratio(self) -> float:
        """Makespan as a factor of the bound."""
        return self.makespan_s / max(self.bound_s, STEP_S)

    @property
    def success(self) -> bool:
        """Whether all cells are covered without a contact, a wall or a cell planned again, and all
        replicas are equal."""
        clean = not (self.contacts or self.through_walls or self.uncovered or self.malformed)
        again = self.replanned or self.redone
        return self.finished and self.replicas_equal and clean and not again

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values for JSON."""
        plain = {**self._asdict(), "frames": dict(self.frames)}
        return {**plain, "ratio": round(self.ratio, 4), "success": self.success}


class CoverageFleet(Cluster):
    """A cluster in the world of cells. It knows which robots never died, because only these are
    asked for equal replicas."""

    def __init__(self, setting: CoverageSetup, channel: str, record: Record, host: Host) -> None:
        super().__init__(setting, channel, record, host)
        self.place = setting
        assert isinstance(self.world, GridWorld)
        self.grid_world = self.world
        self.never_died = set(range(len(setting.starts)))

    def boot(self, slot: int) -> Robot:
        """Boot a robot; a new one is put into the free cell next to its start."""
        if self.boots[slot]:
            self.never_died.discard(slot)
        if slot not in self.grid_world.robots:
            number = self._room_for(slot)
            self.grid_world.put_robot(slot, number, self.host.now_us())
        return super().boot(slot)

    def kill(self, slot: int) -> None:
        self.never_died.discard(slot)
        super().kill(slot)

    def _room_for(self, slot: int) -> int:
        ground, start = self.place.ground, self.place.cells[slot]
        seen, queue = {start}, deque([start])
        while queue:
            number = queue.popleft()
            if self.grid_world.is_empty(number, self.host.now_us()):
                return number
            row, column = ground.cell(number)
            for cell in (
                (row - 1, column),
                (row + 1, column),
                (row, column - 1),
                (row, column + 1),
            ):
                near = ground.number(cell)
                if near != NONE and near not in seen:
                    seen.add(near)
                    queue.append(near)
        raise AssertionError("more robots than cells")

    def mission(self, robot: Robot) -> GridWork:
        """The coverage mission of a robot."""
        mission = robot.peer.mission
        assert isinstance(mission, GridWork)
        return mission

    @property
    def finished(self) -> bool:
        """Whether every running robot is at the end of its plan, and covered cells are done."""
        return any(self.mission(robot).agreement.going for robot in self.running) and all(
            self.mission(robot).over and self._in_order(robot) for robot in self.running
        )

    def _in_order(self, robot: Robot) -> bool:
        peer = robot.peer
        complete = sum(peer.progress.complete(s) for s in self.place.ground.section_units)
        return peer.allocation.done_count() >= complete

    def reachable(self) -> set[int]:
        """Cells that some running robot can reach; bodies of the others block their cells
        permanently."""
        ground = self.place.ground
        walls = ground.walls.copy()
        for slot, body in self.grid_world.robots.items():
            if not self.is_up(slot):
                for number in np.flatnonzero(self._near(body.position)).tolist():
                    walls[ground.cell(number)] = True
        sources = [ground.cell_at(*self.grid_world.body(r.slot).position) for r in self.running]
        found = steps_from(walls.tolist(), [s for s in sources if not walls[s]])
        return {ground.number(cell) for cell in found}

    def _near(self, at: tuple[float, float]) -> Any:
        """Cells without room beside a body, or possibly without. Others know its position by its
        last beat; how far it moved after that is known to 0.1 of a cell."""
        off = np.abs(self.grid_world._centres - at)
        return (off < 0.8 * self.place.ground.cell_m).all(axis=1)


class ReplanAuditor:
    """Compares each new plan with the cells that were covered when its round began."""

    def __init__(self, cluster: CoverageFleet) -> None:
        self.cluster = cluster
        self.replanned = self.redone = self.untold = 0
        self._seen: dict[int, int] = {}  # slot -> last round that was checked

    def look(self) -> None:
        """Compare the plan of every robot that has begun a new round."""
        islands = {n.island for n in self.cluster.segment.wire.nodes.values()}
        for robot in self.cluster.running:
            rounds = self.cluster.mission(robot).agreement
            if not rounds.going or self._seen.get(robot.slot) == rounds.round:
                continue
            self._seen[robot.slot] = rounds.round
            assert rounds.course is not None
            units = [rounds.ground.unit(n) for n in rounds.course.todo.tolist()]
            # Cells covered since the round began, by this plan, are not a fault of the plan.
            truth = self.cluster.grid_world.truth
            first_at_us, by = truth.first_at_us[rounds.course.todo], truth.by[rounds.course.todo]
            before = (first_at_us != NONE) & (first_at_us < rounds.begun_at_us)
            known = sum(
                robot.peer.progress.has(*unit)
                for unit, was in zip(units, before.tolist(), strict=True) if was
            )  # fmt: skip
            self.replanned += known
            if len(islands) == 1:
                told = np.isin(by, sorted(self.cluster.never_died))
                self.redone += int(np.count_nonzero(before & told))
                self.untold += int(np.count_nonzero(before & ~told))


class CoverageRun(MissionRun[CoverageSetup, CoverageFleet, CoverageOutcome]):
    """Switches whole peers on over a grid, and judges covered cells, contacts and new plans."""

    kind = CoverageOutcome
    quiet_for_us = QUIET_US

    def make_fleet(self, channel: str, record: Record, host: Host) -> CoverageFleet:
        """Also begins to compare plans."""
        cluster = CoverageFleet(self.setting, channel, record, host)
        self.witness = ReplanAuditor(cluster)
        return cluster

    def look(self, cluster: CoverageFleet) -> None:
        self.witness.look()

    def progress(self, cluster: CoverageFleet) -> RunProgress:
        """Cells covered of all free ones."""
        covered = cluster.grid_world.truth.first_at_us != NONE
        done, now_s = int(np.count_nonzero(covered)), cluster.host.now_us() / S
        return RunProgress(now_s, done, covered.size, done / covered.size, states_of(cluster))

    def measure(self, cluster: CoverageFleet) -> dict[str, Any]:
        truth, setting, witness = cluster.grid_world.truth, self.setting, self.witness
        late = truth.first_at_us[sorted(cluster.reachable())]
        starts = [
            cell for slot, cell in enumerate(setting.instance.starts)
            if not any(f.kind == "join" and f.robot == slot for f in setting.scenario.fault)
        ]  # fmt: skip
        return {
            "map": setting.instance.name,
            "uncovered": int(np.count_nonzero(late == NONE)),
            "makespan_s": float(late.max(initial=0)) / S,
            "bound_s": lower_bound(setting.instance.walls, starts) * STEP_S,
            "replanned": witness.replanned,
            "redone": witness.redone,
            "untold": witness.untold,
            "contacts": len(truth.contacts),
            "through_walls": truth.through_walls,
            "closest_m": truth.closest_m,
            "steps": truth.steps,
            "rounds": max(cluster.mission(r).agreement.rounds for r in cluster.robots.values()),
            "sections_done": max(r.peer.allocation.done_count() for r in cluster.running),
            "sections": setting.section_count,
        }
