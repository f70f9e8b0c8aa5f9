"""One run of a scenario from power-up to the end, and its outcome."""

import itertools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agent.interface.config import S
from sim.can.frame_counter import BusTally
from sim.fleet.event_loop import EventLoop
from sim.fleet.fault_injector import FaultPlan
from sim.fleet.outcome import Outcome
from sim.fleet.scheduler import Handle, Host, LoopHost, Script, follow
from sim.fleet.settling import quiet_us
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.trace_recorder import Recorder
from sim.fleet.virtual_clock import run_virtual
from sim.scenarios.field_setup import Setting
from sim.world.coverage_truth import Coverage, coverage, sample_points
from sim.world.ground_truth import TrackPoint
from sim.world.implement_contacts import implement_contacts

LOOK_US = 1 * S  # how often the end is checked and progress is reported
RASTER_M = 0.25  # of the coverage check

_numbers = itertools.count()
Told = Callable[["RunProgress"], None]


class RunProgress(NamedTuple):
    """The progress of a run, for observers."""

    simulated_s: float
    done: int
    sections: int
    progress: float
    states: tuple[str, ...]


class FieldRun:
    def __init__(
        self,
        setting: Setting,
        out: Path | None = None,
        told: Told | None = None,
        logs: Sequence[Path] = (),
        swarm: bool = True,
        attach: Callable[[Cluster], None] | None = None,
    ) -> None:
        """`swarm`: use our event loop; else asyncio's, as on robots, with the same result. `attach`
        gets the fleet before any robot is switched on."""
        self.attach = attach
        self.swarm = swarm
        self.setting, self.out, self.told = setting, out, told
        self.logs = [*([out / "can.log"] if out else []), *logs]
        self.tally = BusTally()
        self.tracks: dict[int, list[TrackPoint]] = {}
        self.truth: Coverage | None = None
        self.recorder: Recorder | None = None  # None: a new one
        self.faults: list[tuple[float, str]] = []

    @property
    def told_faults(self) -> list[dict[str, Any]]:
        """The faults applied to the fleet, and when, as plain values."""
        planned = sorted(self.setting.scenario.fault, key=lambda fault: fault.at_s)
        return [
            {"t_s": t_s, **fault.model_dump(mode="json", exclude={"at_s"})}
            for (t_s, _), fault in zip(self.faults, planned, strict=False)
        ]

    def run(self) -> Outcome:
        """Run in virtual time, as fast as possible."""
        if not self.swarm:
            return run_virtual(self._on_asyncio())
        swarm = EventLoop()
        return swarm.run(self._play(swarm))

    async def _on_asyncio(self) -> Outcome:
        host = LoopHost()
        try:
            return await follow(self._play(host))
        finally:
            await host.close()

    def _play(self, host: Host) -> Script[Outcome]:
        started_s = time.perf_counter()
        recorder = self.recorder or Recorder(self.out / "trace.jsonl" if self.out else None)
        cluster = Cluster(self.setting, f"run {next(_numbers)}", recorder, host)
        self.tally.open(self.logs)
        cluster.segment.taps.append(self.tally.tap)
        if self.attach is not None:
            self.attach(cluster)
        cluster.boot_all()
        plan = FaultPlan(cluster)
        script = host.spawn(plan.script())
        try:
            yield from self._until_finished(cluster, script)
            outcome = self._measure(cluster, recorder, time.perf_counter() - started_s)
        finally:
            self.faults = plan.done
            cluster.end()
            recorder.close()
            self.tally.close()
        return outcome

    def _until_finished(self, cluster: Cluster, script: Handle) -> Script[None]:
        host, limit_us = cluster.host, round(self.setting.time_limit_s * S)
        while host.now_us() < limit_us:
            yield host.now_us() + LOOK_US
            cluster.check()
            script.check()
            if self.told is not None:
                self.told(self._moment(cluster, host.now_us() / S))
            if script.done() and cluster.finished:
                break
        until_us = host.now_us() + quiet_us(self.setting.scenario.bus)
        while not cluster.replicas_equal and host.now_us() < until_us:
            yield host.now_us() + LOOK_US // 10

    def _moment(self, cluster: Cluster, now_s: float) -> RunProgress:
        running = cluster.running
        best = max(running, key=lambda r: r.peer.allocation.done_count(), default=None)
        done = best.peer.allocation.done_count() if best else 0
        progress = max((r.peer.progress.fraction() for r in running), default=0.0)
        states = tuple(r.peer.state.name for r in running)
        return RunProgress(now_s, done, self.setting.section_count, progress, states)

    def _measure(self, cluster: Cluster, recorder: Recorder, wall_s: float) -> Outcome:
        field, scenario, world = self.setting.field, self.setting.scenario, cluster.world
        now_s = cluster.host.now_us() / S
        world.advance(round(now_s * 1e6))
        self.tracks = {slot: body.track.points for slot, body in world.robots.items()}
        raster = sample_points(field.polygon, field.implement_width_m, field.overlap_m, RASTER_M)
        ground = self.setting.ground(raster)
        truth = self.truth = coverage(raster, self.tracks, field.implement_width_m, ground.cells)
        met = implement_contacts(
            self.tracks, field.implement_width_m, field.overlap_m, scenario.fleet.radius_m
        )
        wire = cluster.segment.wire
        return Outcome(
            scenario=scenario.name,
            robots=scenario.fleet.robots,
            seed=scenario.run.seed,
            silence_policy=scenario.fleet.silence,
            authenticated=self.setting.keys is not None,
            finished=cluster.finished,
            coverage=truth.share,
            reachable=ground.share,
            reached=truth.reached,
            unreached=ground.unreached,
            makespan_s=truth.last_us / 1e6,
            worked_twice=truth.twice,
            units_twice=sum(r.peer.voice.redone for r in cluster.robots.values()),
            contacts=len(world.contacts),
            moved_after_stop=len(cluster.stops.violations),
            closest_m=world.closest_m,
            replicas_equal=cluster.replicas_equal,
            frames=dict(self.tally.kinds.most_common()),
            bus_load=wire.busy_us / (now_s * 1e6),
            bus_load_worst_case=wire.worst_us / (now_s * 1e6),
            claims_lost=recorder.lost,
            malformed=self.tally.malformed,
            refused=sum(r.peer.safety.authority.refused for r in cluster.robots.values()),
            trace_hash=recorder.digest,
            sections=len(field.sections),
            work_m=field.work_m,
            travel_m=sum(body.track.driven_m for body in world.robots.values()),
            simulated_s=now_s,
            wall_s=wall_s,
            pymunk_steps=world.pymunk_steps,
            implement_contacts=len(met),
        )
