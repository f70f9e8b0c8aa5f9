"""Whole peers cover a grid map over the simulated wire; the outcome is measured from the truth.

    outcome = CoverageRun(CoverageSetup.made(instance)).run()

Every robot is the peer that runs on a real robot, with address claim, membership, safety, claims,
sync and all frames on a bus of 250 kbit/s. Only bodies and sensors are simpler than in a field
(`grid_world`).
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from agent.coverage.cell_map import NONE
from agent.interface.config import S
from sim.fleet.scheduler import Handle, Host
from sim.fleet.simulated_fleet import Record
from sim.runs.grid_fleet import CoverageFleet
from sim.runs.run import MissionRun, RunProgress, states_of
from sim.scenarios.coverage_setup import STEP_S, CoverageSetup
from sim.world.plan_judge import lower_bound

# A robot that was frozen or off the bus has a part in the next plan again within this time.
BACK_US = 5 * S
QUIET_US = 10 * S  # after the last cell, registers and replicas must be in order within this time
# On a bus that loses frames, until a report that was lost is told again: a robot that has just heard
# the others asks them for what it misses.
TOLD_AGAIN_US = 5 * S


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
    # Cells planned that a robot covered just before it died, and could not report; or just before the
    # plan, where the bus loses frames.
    untold: int
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


class ReplanAuditor:
    """Compares each new plan with the cells that were covered when its round began."""

    def __init__(self, cluster: CoverageFleet) -> None:
        self.cluster = cluster
        self.replanned = self.redone = self.untold = 0
        self._seen: dict[int, int] = {}  # slot -> last round that was checked
        self._whole_at_us = 0  # since when all robots hear each other, as far as was looked
        self._was_cut = False

    def look(self) -> None:
        """Compare the plan of every robot that has begun a new round."""
        cut = len({n.island for n in self.cluster.segment.wire.nodes.values()}) > 1
        if self._was_cut and not cut:
            self._whole_at_us = self.cluster.host.now_us()
        self._was_cut = cut
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
            # A round that began in a part of a cut fleet cannot know what the others covered.
            if not cut and rounds.begun_at_us >= self._whole_at_us:
                told = np.isin(by, sorted(self.cluster.never_died))
                if self.cluster.place.scenario.bus.loss:
                    told &= first_at_us < rounds.begun_at_us - TOLD_AGAIN_US
                self.redone += int(np.count_nonzero(before & told))
                self.untold += int(np.count_nonzero(before & ~told))


class CoverageRun(MissionRun[CoverageSetup, CoverageFleet, CoverageOutcome]):
    """Switches whole peers on over a grid, and judges covered cells, contacts and new plans."""

    kind = CoverageOutcome
    quiet_for_us = QUIET_US
    _undone_at_us = 0  # when the fleet was last not done

    def make_fleet(self, channel: str, record: Record, host: Host) -> CoverageFleet:
        """Also begins to compare plans."""
        cluster = CoverageFleet(self.setting, channel, record, host)
        self.witness = ReplanAuditor(cluster)
        return cluster

    def look(self, cluster: CoverageFleet) -> None:
        self.witness.look()
        if not cluster.finished:
            self._undone_at_us = cluster.host.now_us()

    def is_over(self, cluster: CoverageFleet, scripts: Sequence[Handle]) -> bool:
        waited = cluster.host.now_us() - self._undone_at_us > BACK_US
        return super().is_over(cluster, scripts) and (waited or cluster.waits_for_nobody)

    def progress(self, cluster: CoverageFleet) -> RunProgress:
        """Cells covered of all free ones."""
        covered = cluster.grid_world.truth.first_at_us != NONE
        done, now_s = int(np.count_nonzero(covered)), cluster.host.now_us() / S
        return RunProgress(now_s, done, covered.size, done / covered.size, states_of(cluster))

    def measure(self, cluster: CoverageFleet) -> dict[str, Any]:
        truth, setting, witness = cluster.grid_world.truth, self.setting, self.witness
        reachable = sorted(cluster.reachable())
        late = truth.first_at_us[reachable]
        joined = [0] * len(setting.instance.starts)  # the step before a robot is switched on
        for fault in setting.scenario.fault:
            if fault.kind == "join":
                joined[fault.robot] = int(fault.at_s / STEP_S)
        wanted = {setting.ground.cell(number) for number in reachable}
        bound = lower_bound(setting.instance.walls, setting.instance.starts, joined, wanted)
        return {
            "map": setting.instance.name,
            "uncovered": int(np.count_nonzero(late == NONE)),
            "makespan_s": float(late.max(initial=0)) / S,
            "bound_s": bound * STEP_S,
            "replanned": witness.replanned,
            "redone": witness.redone,
            "untold": witness.untold,
            "contacts": len(truth.contacts),
            "through_walls": truth.through_walls,
            "closest_m": truth.closest_m,
            "steps": truth.steps,
            "rounds": max(cluster.mission(r).agreement.rounds for r in cluster.robots.values()),
            "sections_done": max(
                (r.peer.allocation.done_count() for r in cluster.running), default=0
            ),
            "sections": setting.section_count,
        }
