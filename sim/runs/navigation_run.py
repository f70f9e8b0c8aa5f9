"""One run of a fleet with navigation goals, and its outcome."""

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from math import hypot, inf, sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.interface.config import MS, S
from agent.interface.effects import Trace
from agent.navigation.navigation_mission import GOALS_MAX, FollowedPath, NavigationMission
from sim.can.frame_counter import BusTally
from sim.fleet.event_loop import EventLoop
from sim.fleet.fault_injector import FaultPlan
from sim.fleet.scheduler import Host, Script
from sim.fleet.settling import quiet_us
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.trace_recorder import Recorder
from sim.scenarios.navigation_setup import ErrandSetting

LOOK_US = 500 * MS

_numbers = itertools.count()
Points = tuple[tuple[float, float], ...]


class GoalResult(NamedTuple):
    """One goal as it was driven."""

    slot: int
    number: int
    arrived_s: float  # inf: never
    rmse_m: float  # of the true positions, relative to the polyline that was being followed
    replans: int  # paths planned for it on the way, without those that follow a joint plan
    plans: int  # joint plans with this robot


class OutingOutcome(NamedTuple):
    scenario: str
    robots: int
    seed: int
    authenticated: bool
    finished: bool
    contacts: int
    moved_after_stop: int  # steps in which a robot that had to stand moved
    simulated_s: float
    arrived_s: tuple[float, ...]  # when each robot reached its last goal; inf: never
    legs: tuple[GoalResult, ...]
    rounds: int  # of agreement; the largest number that one robot took part in
    unsolved: int
    obstacles: int  # boxes that appeared and vanished
    closest_m: float
    travel_m: float
    replicas_equal: bool
    frames: Mapping[str, int]  # by kind
    malformed: int
    bus_load: float  # share of the bus in use, exact bits
    pymunk_steps: int  # steps of 10 ms made by pymunk
    trace_hash: str
    wall_s: float

    @property
    def success(self) -> bool:
        clean = self.contacts == 0 and self.moved_after_stop == 0
        return self.finished and clean and self.replicas_equal

    def to_dict(self) -> dict[str, Any]:
        """For JSON, which has no infinity; null means never."""
        arrived_s = [None if t_s == inf else t_s for t_s in self.arrived_s]
        legs = [
            {k: v if v == v and v != inf else None for k, v in leg._asdict().items()}
            for leg in self.legs
        ]
        plain = {**self._asdict(), "frames": dict(self.frames)}
        return {**plain, "arrived_s": arrived_s, "legs": legs, "success": self.success}


class RunProgress(NamedTuple):
    """The progress of a run."""

    simulated_s: float
    reached: int
    goals: int
    states: tuple[str, ...]


class NavigationRun:
    def __init__(
        self,
        setting: ErrandSetting,
        out: Path | None = None,
        told: Callable[[RunProgress], None] | None = None,
        logs: Sequence[Path] = (),
        attach: Callable[[Cluster], None] | None = None,
    ) -> None:
        """`out`: folder for trace.jsonl and can.log; `told` is called every half second; `attach`
        gets the fleet before any robot is switched on."""
        self.setting, self.told, self.attach = setting, told, attach
        self.logs = [*([out / "can.log"] if out else []), *logs]
        self.tracks: dict[int, NDArray[np.float64]] = {}  # (n, 4): microseconds, x, y, -
        self.followed: dict[int, list[FollowedPath]] = {}
        self._done_us: dict[int, int] = {}  # section -> when its robot reported it done
        self._recorder = Recorder(out / "trace.jsonl" if out else None)
        self._tally = BusTally()

    def run(self) -> OutingOutcome:
        """Run in virtual time, as fast as possible."""
        swarm = EventLoop()
        return swarm.run(self._play(swarm))

    def _play(self, host: Host) -> Script[OutingOutcome]:
        started_s = time.perf_counter()
        cluster = Cluster(self.setting, f"outing {next(_numbers)}", self._note, host)
        self._tally.open(self.logs)
        cluster.segment.taps.append(self._tally.tap)
        if self.attach is not None:
            self.attach(cluster)
        cluster.boot_all()
        script = host.spawn(FaultPlan(cluster).script())
        limit_us = round(self.setting.scenario.run.time_limit_s * S)
        try:
            while host.now_us() < limit_us and len(self._done_us) < self.setting.section_count:
                yield host.now_us() + LOOK_US
                cluster.check()
                script.check()
                self._tell(cluster)
            yield from self._settle(cluster)
            return self._measure(cluster, time.perf_counter() - started_s)
        finally:
            cluster.end()
            self._recorder.close()
            self._tally.close()

    def _tell(self, cluster: Cluster) -> None:
        if self.told is not None:
            states = tuple(robot.peer.state.name for robot in cluster.running)
            goals, now_s = self.setting.section_count, cluster.host.now_us() / S
            self.told(RunProgress(now_s, len(self._done_us), goals, states))

    def _settle(self, cluster: Cluster) -> Script[None]:
        """Wait until the last news has reached all robots."""
        until_us = cluster.host.now_us() + quiet_us(self.setting.scenario.bus)
        while not cluster.replicas_equal and cluster.host.now_us() < until_us:
            yield cluster.host.now_us() + LOOK_US // 10

    def _note(self, slot: int, now_us: int, effect: object) -> None:
        self._recorder(slot, now_us, effect)  # type: ignore[arg-type]
        if isinstance(effect, Trace) and effect.machine == "claim" and effect.event == "DONE":
            self._done_us.setdefault(int(effect.source[1:]), now_us)

    def _measure(self, cluster: Cluster, wall_s: float) -> OutingOutcome:
        world, setting, now_us = cluster.world, self.setting, cluster.host.now_us()
        world.advance(now_us)
        missions = {slot: robot.peer.mission for slot, robot in cluster.robots.items()}
        errands = {s: m for s, m in missions.items() if isinstance(m, NavigationMission)}
        self.tracks = {slot: body.track.to_array() for slot, body in world.robots.items()}
        self.followed = {slot: list(errand.followed) for slot, errand in errands.items()}
        legs = [leg for slot in errands for leg in self._legs(slot)]
        last_s = tuple(
            max((leg.arrived_s for leg in legs if leg.slot == slot), default=0.0)
            for slot in sorted(errands)
        )
        return OutingOutcome(
            scenario=setting.scenario.name,
            robots=setting.scenario.fleet.robots,
            seed=setting.scenario.run.seed,
            authenticated=setting.keys is not None,
            finished=len(self._done_us) == setting.section_count,
            contacts=len(world.contacts),
            moved_after_stop=len(cluster.stops.violations),
            simulated_s=now_us / S,
            arrived_s=last_s,
            legs=tuple(legs),
            rounds=max(e.accords.rounds for e in errands.values()),
            unsolved=max(e.accords.unsolved for e in errands.values()),
            obstacles=len(setting.appeared),
            closest_m=world.closest_m,
            travel_m=sum(body.track.driven_m for body in world.robots.values()),
            replicas_equal=cluster.replicas_equal,
            frames=dict(self._tally.kinds.most_common()),
            malformed=self._tally.malformed,
            bus_load=cluster.segment.wire.busy_us / now_us,
            pymunk_steps=world.pymunk_steps,
            trace_hash=self._recorder.digest,
            wall_s=wall_s,
        )

    def _legs(self, slot: int) -> list[GoalResult]:
        found, since_us = [], 0
        for number in range(len(self.setting.goals[slot])):
            done_us = self._done_us.get(slot * GOALS_MAX + number)
            until_us = done_us if done_us is not None else 1 << 62
            paths = [p for p in self.followed[slot] if since_us <= p.t_us < until_us]
            found.append(
                GoalResult(
                    slot,
                    number,
                    inf if done_us is None else done_us / 1e6,
                    rmse_m(self.tracks[slot], paths, until_us),
                    sum(p.why in ("lost", "blocked") for p in paths),
                    sum(p.why == "plan" for p in paths),
                )
            )
            since_us = until_us
        return found


def rmse_m(track: NDArray[np.float64], paths: list[FollowedPath], until_us: int) -> float:
    """Root mean square of the distance to the polyline (not to its vertices) followed at the time.

    nan if nothing was driven.
    """
    squares: list[float] = []
    for k, path in enumerate(paths):
        end_us = paths[k + 1].t_us if k + 1 < len(paths) else until_us
        rows = track[(track[:, 0] >= path.t_us) & (track[:, 0] <= end_us)]
        squares += [to_polyline_m((x, y), path.points) ** 2 for _, x, y, _ in rows.tolist()]
    return sqrt(sum(squares) / len(squares)) if squares else float("nan")


def to_polyline_m(at: tuple[float, float], path: Points) -> float:
    nearest = hypot(at[0] - path[0][0], at[1] - path[0][1])
    for (ax, ay), (bx, by) in itertools.pairwise(path):
        ex, ey = bx - ax, by - ay
        square = ex * ex + ey * ey
        t = ((at[0] - ax) * ex + (at[1] - ay) * ey) / square if square > 0 else 0.0
        t = min(max(t, 0.0), 1.0)
        nearest = min(nearest, hypot(ax + t * ex - at[0], ay + t * ey - at[1]))
    return nearest
