"""Whole peers cover a grid map over the simulated wire; the outcome is measured from the truth.

    outcome = GridFleet(GridSetting.made(instance)).run()

Every robot is the peer that runs on a real robot, with address claim, membership, safety, claims,
sync and all frames on a bus of 250 kbit/s. Only bodies and sensors are simpler than in a field
(`grid_world`).
"""

import itertools
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from agent.coverage.cell_map import NONE
from agent.coverage.coverage_mission import GridWork
from agent.interface.config import MS, S
from sim.can.frame_counter import BusTally
from sim.fleet.event_loop import EventLoop
from sim.fleet.fault_injector import FaultPlan
from sim.fleet.scheduler import Handle, Script
from sim.fleet.simulated_fleet import Cluster, Record, Robot
from sim.fleet.trace_recorder import Recorder
from sim.scenarios.coverage_setup import STEP_S, GridSetting
from sim.world.grid_world import GridWorld
from sim.world.plan_judge import lower_bound, steps_from

LOOK_US = 500 * MS
QUIET_US = 10 * S  # after the last cell, registers and replicas must be in order within this time

_numbers = itertools.count()
Told = Callable[[float, float], None]


class GridOutcome(NamedTuple):
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
        return self.makespan_s / max(self.bound_s, STEP_S)

    @property
    def success(self) -> bool:
        clean = not (self.contacts or self.through_walls or self.uncovered or self.malformed)
        again = self.replanned or self.redone
        return self.finished and self.replicas_equal and clean and not again

    def to_dict(self) -> dict[str, Any]:
        plain = {**self._asdict(), "frames": dict(self.frames)}
        return {**plain, "ratio": round(self.ratio, 4), "success": self.success}


class GridCluster(Cluster):
    def __init__(
        self, setting: GridSetting, channel: str, record: Record | None, host: EventLoop
    ) -> None:
        super().__init__(setting, channel, record, host)
        self.place = setting
        self.grid_world = cast(GridWorld, self.world)
        self.never_died = set(range(len(setting.starts)))

    def boot(self, slot: int) -> Robot:
        """Boot a robot; a new one is put into the free cell next to its start."""
        if self.boots[slot]:
            self.never_died.discard(slot)
        if slot not in self.grid_world.robots:
            number = self._room_for(slot)
            self.grid_world.add_robot(slot, number, self.host.now_us())
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
        mission = robot.peer.mission
        assert isinstance(mission, GridWork)
        return mission

    @property
    def finished(self) -> bool:
        """Whether every running robot is at the end of its plan, and covered cells are done."""
        return any(self.mission(robot).accords.going for robot in self.running) and all(
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

    def __init__(self, cluster: GridCluster) -> None:
        self.cluster = cluster
        self.replanned = self.redone = self.untold = 0
        self._seen: dict[int, int] = {}  # slot -> last round that was checked

    def look(self) -> None:
        islands = {n.island for n in self.cluster.segment.wire.nodes.values()}
        for robot in self.cluster.running:
            rounds = self.cluster.mission(robot).accords
            if not rounds.going or self._seen.get(robot.slot) == rounds.round:
                continue
            self._seen[robot.slot] = rounds.round
            assert rounds.course is not None
            units = [rounds.ground.unit(n) for n in rounds.course.todo.tolist()]
            # Cells covered since the round began, by this plan, are not a fault of the plan.
            truth = self.cluster.grid_world.truth
            first_us, by = truth.first_us[rounds.course.todo], truth.by[rounds.course.todo]
            before = (first_us != NONE) & (first_us < rounds.begun_us)
            known = sum(
                robot.peer.progress.has(*unit)
                for unit, was in zip(units, before.tolist(), strict=True) if was
            )  # fmt: skip
            self.replanned += known
            if len(islands) == 1:
                told = np.isin(by, sorted(self.cluster.never_died))
                self.redone += int(np.count_nonzero(before & told))
                self.untold += int(np.count_nonzero(before & ~told))


class CoverageRun:
    """One run."""

    def __init__(
        self, setting: GridSetting, out: Path | None = None, told: Told | None = None
    ) -> None:
        """`told`: called now and then with the simulated seconds and the share covered."""
        self.setting, self.out, self.told = setting, out, told
        self.tally = BusTally()
        self.cluster: GridCluster | None = None
        self.covered_us: Any = None  # by cell number: when each cell was covered; -1: never

    def run(self) -> GridOutcome:
        swarm = EventLoop()
        return swarm.run(self._play(swarm))

    def _play(self, host: EventLoop) -> Script[GridOutcome]:
        began_s = time.process_time()
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
        recorder = Recorder(self.out / "trace.jsonl" if self.out else None)
        cluster = GridCluster(self.setting, f"grid {next(_numbers)}", recorder, host)
        self.cluster = cluster
        self.tally.open([self.out / "can.log"] if self.out else [])
        cluster.segment.taps.append(self.tally.tap)
        cluster.boot_all()
        script = host.spawn(FaultPlan(cluster).script())
        witness = ReplanAuditor(cluster)
        try:
            yield from self._watch(cluster, script, witness)
            cpu_s = time.process_time() - began_s
            outcome = self._measure(cluster, recorder, witness, cpu_s)
        finally:
            cluster.end()
            recorder.close()
            self.tally.close()
        return outcome

    def _watch(self, cluster: GridCluster, script: Handle, witness: ReplanAuditor) -> Script[None]:
        host, limit_us = cluster.host, round(self.setting.scenario.run.time_limit_s * S)
        while host.now_us() < limit_us:
            yield host.now_us() + LOOK_US
            cluster.check()
            witness.look()
            if self.told is not None:
                covered = cluster.grid_world.truth.first_us != NONE
                self.told(host.now_us() / S, float(covered.mean()))
            if script.done() and cluster.finished:
                break
        quiet_us = host.now_us() + QUIET_US
        while not cluster.replicas_equal and host.now_us() < quiet_us:
            yield host.now_us() + LOOK_US // 5

    def _measure(
        self, cluster: GridCluster, recorder: Recorder, witness: ReplanAuditor, cpu_s: float
    ) -> GridOutcome:
        now_us, world = cluster.host.now_us(), cluster.grid_world
        world.advance(now_us)
        truth, setting, wire = world.truth, self.setting, cluster.segment.wire
        self.covered_us = truth.first_us
        wanted = sorted(cluster.reachable())
        late = truth.first_us[wanted]
        starts = [
            cell for slot, cell in enumerate(setting.instance.starts)
            if not any(f.kind == "join" and f.robot == slot for f in setting.scenario.fault)
        ]  # fmt: skip
        return GridOutcome(
            map=setting.instance.name,
            robots=len(setting.starts),
            seed=setting.scenario.run.seed,
            finished=cluster.finished,
            uncovered=int(np.count_nonzero(late == NONE)),
            makespan_s=float(late.max(initial=0)) / S,
            bound_s=lower_bound(setting.instance.walls, starts) * STEP_S,
            replanned=witness.replanned,
            redone=witness.redone,
            untold=witness.untold,
            contacts=len(truth.contacts),
            through_walls=truth.through_walls,
            closest_m=truth.closest_m,
            replicas_equal=cluster.replicas_equal,
            steps=truth.steps,
            rounds=max(cluster.mission(r).accords.rounds for r in cluster.robots.values()),
            sections_done=max(r.peer.allocation.done_count() for r in cluster.running),
            sections=setting.section_count,
            frames=dict(self.tally.kinds.most_common()),
            malformed=self.tally.malformed,
            bus_load=wire.busy_us / now_us,
            bus_load_worst_case=wire.worst_us / now_us,
            trace_hash=recorder.digest,
            simulated_s=now_us / S,
            cpu_s=cpu_s,
        )
