"""The one run: a fleet is switched on, watched to its end, given time to settle, and measured.

Each mission is a small subclass. It says which fleet runs, when the run is over, how far it is, and
what its outcome adds to the fields that all outcomes have.
"""

import itertools
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from agent.interface.config import MS, S
from sim.can.frame_counter import FrameCounter
from sim.fleet.event_loop import EventLoop
from sim.fleet.fault_injector import FaultPlan
from sim.fleet.scheduler import Handle, Host, LoopHost, Script, follow
from sim.fleet.settling import quiet_for_us
from sim.fleet.simulated_fleet import Cluster, Record
from sim.fleet.trace_recorder import Recorder
from sim.scenarios.fleet_setup import FleetSetup
from sim.scenarios.scenario import Fault
from sim.world.ground_truth import Contact, TrackPoint

DEAD_FOR_US = 5 * S  # by then the bodies of robots that died stand
_numbers = itertools.count()
SetupT = TypeVar("SetupT", bound=FleetSetup)
FleetT = TypeVar("FleetT", bound=Cluster)
OutcomeT = TypeVar("OutcomeT")


class RunProgress(NamedTuple):
    """What a bar shows while a run goes on."""

    simulated_s: float
    done: int  # of `total`: sections, goals, parcels
    total: int
    share: float  # of the whole work, 0 to 1
    note: str  # what the robots do at present


class MissionRun(ABC, Generic[SetupT, FleetT, OutcomeT]):
    """Make it, optionally set `told` and `attach`, and call `run` once."""

    kind: ClassVar[type[Any]]  # the outcome, a NamedTuple
    # how often the end is checked and progress is reported
    look_period_us: ClassVar[int] = 500 * MS
    compare_period_us: ClassVar[int] = 100 * MS  # how often replicas are compared after the end

    def __init__(
        self, setting: SetupT, out: Path | None = None,
        told: Callable[[RunProgress], None] | None = None, logs: Sequence[Path] = (),
        attach: Callable[[FleetT], None] | None = None,
    ) -> None:  # fmt: skip
        """`out`: folder for trace.jsonl and can.log. `logs`: more files for the frames. `told` is
        called every `look_period_us`. `attach` gets the fleet before any robot is switched on."""
        self.setting, self.out, self.told, self.attach = setting, out, told, attach
        self.logs = logs
        self.tally = FrameCounter()
        self.recorder: Recorder | None = None  # None: a new one
        self.faults: list[tuple[float, Fault]] = []  # that were applied, and when; after the run
        self.cluster: FleetT | None = None  # once it has begun
        self._alive_at_us = 0  # when a robot was on last, or could be switched on

    # ---------------------------------------------------------------- what a mission says

    @abstractmethod
    def make_fleet(self, channel: str, record: Record, host: Host) -> FleetT:
        """The cluster of this mission, switched off."""

    @abstractmethod
    def progress(self, cluster: FleetT) -> RunProgress:
        """What is done at present, for the bar."""

    @abstractmethod
    def measure(self, cluster: FleetT) -> dict[str, Any]:
        """The fields that this outcome adds to `_common`, or has instead of them."""

    def is_over(self, cluster: FleetT, scripts: Sequence[Handle]) -> bool:
        """Whether the run has come to its end; asked every `look_period_us`."""
        return all(script.done() for script in scripts) and cluster.finished

    def is_settled(self, cluster: FleetT) -> bool:
        """Whether the last news has reached all robots."""
        return cluster.replicas_equal

    def look(self, cluster: FleetT) -> None:
        """Observe the fleet; called every `look_period_us`, before `is_over`."""

    def scripts(self, cluster: FleetT, faults: Script[None]) -> list[Handle]:
        """Start what happens beside the robots; the run lasts until all of it has happened."""
        return [cluster.host.spawn(faults)]

    def recorded(self, recorder: Recorder) -> Record:
        """What gets every effect of every robot."""
        return recorder

    @property
    def quiet_for_us(self) -> int:
        """The limit for `is_settled` after the end."""
        return quiet_for_us(self.setting.scenario.bus)

    # ---------------------------------------------------------------- the run

    @property
    def told_faults(self) -> list[dict[str, Any]]:
        """The faults applied to the fleet, and when, as plain values."""
        return [
            {"t_s": t_s, **fault.model_dump(mode="json", exclude={"at_s"})}
            for t_s, fault in self.faults
        ]

    def run(self) -> OutcomeT:
        """Run in virtual time, as fast as possible."""
        loop = EventLoop()
        return loop.run(self._play(loop))

    async def live(self) -> OutcomeT:
        """Run in the running loop's time, which begins at 0."""
        host = LoopHost()
        try:
            return await follow(self._play(host))
        finally:
            await host.close()

    def _play(self, host: Host) -> Script[OutcomeT]:
        began_at_s, began_cpu_at_s = time.perf_counter(), time.process_time()
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
        recorder = self.recorder or Recorder(self.out / "trace.jsonl" if self.out else None)
        cluster = self.cluster = self.make_fleet(
            f"run {next(_numbers)}", self.recorded(recorder), host
        )
        self.tally.open([*([self.out / "can.log"] if self.out else []), *self.logs])
        cluster.segment.taps.append(self.tally.tap)
        if self.attach is not None:
            self.attach(cluster)
        cluster.boot_all()
        plan = FaultPlan(cluster)
        scripts = self.scripts(cluster, plan.script())
        try:
            yield from self._until_done(cluster, scripts)
            wall_s, cpu_s = time.perf_counter() - began_at_s, time.process_time() - began_cpu_at_s
            cluster.world.advance(host.now_us())
            found = {
                **self._common(cluster, recorder),
                "wall_s": wall_s,
                "cpu_s": cpu_s,
                **self.measure(cluster),
            }
            # What a kind of run does not measure has the default of its field.
            unmeasured = self.kind._field_defaults.keys() - found.keys()
            outcome: OutcomeT = self.kind(
                **{name: found[name] for name in self.kind._fields if name not in unmeasured}
            )
            return outcome
        finally:
            self.faults = plan.done
            cluster.end()
            recorder.close()
            self.tally.close()

    def _until_done(self, cluster: FleetT, scripts: Sequence[Handle]) -> Script[None]:
        """Until the run is over and has settled. The last news may bring new work, and then the run goes
        on."""
        limit_at_us = round(self.setting.time_limit_s * S)
        while True:
            yield from self._until_over(cluster, scripts)
            yield from self._until_settled(cluster)
            over = self.is_over(cluster, scripts) or self._is_dead(cluster, scripts)
            if cluster.host.now_us() >= limit_at_us or over:
                return

    def _until_over(self, cluster: FleetT, scripts: Sequence[Handle]) -> Script[None]:
        host, limit_at_us = cluster.host, round(self.setting.time_limit_s * S)
        while host.now_us() < limit_at_us:
            yield host.now_us() + self.look_period_us
            cluster.check()
            for script in scripts:
                script.check()
            self.look(cluster)
            if self.told is not None:
                self.told(self.progress(cluster))
            if self.is_over(cluster, scripts) or self._is_dead(cluster, scripts):
                break

    def _is_dead(self, cluster: FleetT, scripts: Sequence[Handle]) -> bool:
        """Whether no robot is on any more, and nothing is left that could switch one on."""
        now_us = cluster.host.now_us()
        if cluster.running or not all(script.done() for script in scripts):
            self._alive_at_us = now_us
        return now_us - self._alive_at_us >= DEAD_FOR_US

    def _until_settled(self, cluster: FleetT) -> Script[None]:
        host = cluster.host
        end_at_us = host.now_us() + self.quiet_for_us
        while not self.is_settled(cluster) and host.now_us() < end_at_us:
            yield host.now_us() + self.compare_period_us

    def _common(self, cluster: FleetT, recorder: Recorder) -> dict[str, Any]:
        """The fields that outcomes have alike, measured from the world's truth and the wire."""
        scenario, now_us, wire = self.setting.scenario, cluster.host.now_us(), cluster.segment.wire
        return {
            "scenario": scenario.name,
            "robots": scenario.fleet.robots,
            "seed": scenario.run.seed,
            "silence_policy": scenario.fleet.silence,
            "authenticated": self.setting.keys is not None,
            "finished": cluster.finished,
            "moved_after_stop": len(cluster.stops.violations),
            "replicas_equal": cluster.replicas_equal,
            "frames": dict(self.tally.kinds.most_common()),
            "malformed": self.tally.malformed,
            "bus_load": wire.busy_for_us / max(now_us, 1),  # share of the bus in use, exact bits
            "bus_load_worst_case": wire.worst_for_us / max(now_us, 1),  # at worst-case stuffing
            "claims_lost": recorder.lost,
            "trace_hash": recorder.digest,
            "simulated_s": now_us / S,
        }


def states_of(cluster: Cluster) -> str:
    """How many running robots are in each state, such as `2 IDLE, 3 WORKING`."""
    names = sorted(robot.peer.state.name for robot in cluster.running)
    return ", ".join(f"{len(list(same))} {name}" for name, same in itertools.groupby(names))


def of_bodies(cluster: Cluster) -> dict[str, Any]:
    """Fields of outcomes about bodies that move."""
    world = cluster.world
    return {
        "contacts": len(world.contacts),
        "first_contact": first_of(world.contacts),
        "closest_m": world.closest_m,
        "travel_m": sum(body.track.driven_m for body in world.robots.values()),
        "pymunk_steps": world.pymunk_steps,  # of 10 ms, made by pymunk
    }


def first_of(contacts: Sequence[Contact]) -> str:
    """Time, robots and place of the first contact; empty if there was none."""
    if not contacts:
        return ""
    first = min(contacts, key=lambda contact: contact.t_us)
    return (
        f"at {first.t_us / S:.1f} s robot {first.first} touched {first.against} "
        f"at {first.x_m:.1f},{first.y_m:.1f}"
    )


def points_of(cluster: Cluster) -> dict[int, list[TrackPoint]]:
    """The true track of each robot."""
    return {slot: body.track.points for slot, body in cluster.world.robots.items()}
