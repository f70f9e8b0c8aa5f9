"""One run of a fleet with navigation goals, and its outcome."""

import itertools
from collections.abc import Mapping, Sequence
from math import hypot, inf, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.interface.config import MS, S
from agent.interface.effects import Effect, Trace
from agent.navigation.navigation_mission import GOALS_MAX, FollowedPath, NavigationMission
from sim.fleet.scheduler import Handle, Host
from sim.fleet.simulated_fleet import Cluster, Record
from sim.fleet.trace_recorder import Recorder
from sim.runs.run import MissionRun, RunProgress, of_bodies, states_of
from sim.scenarios.navigation_setup import NavigationSetup

Points = tuple[tuple[float, float], ...]


class GoalResult(NamedTuple):
    """One goal as it was driven."""

    slot: int
    number: int
    arrived_s: float  # inf: never
    rmse_m: float  # of the true tracks, relative to the polyline that was being followed
    replans: int  # paths planned for it on the way, without those that follow a joint plan
    plans: int  # joint plans with this robot


class NavigationOutcome(NamedTuple):
    """What came of one run of errands, from the truth about positions."""

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
    first_contact: str = ""  # its time, robots and place; empty: none

    @property
    def success(self) -> bool:
        """Whether all arrived, touched nothing, obeyed every stop, and have equal replicas."""
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


class NavigationRun(MissionRun[NavigationSetup, Cluster, NavigationOutcome]):
    """Lets robots go to their goals, and records which path each one followed when."""

    kind = NavigationOutcome
    compare_period_us = 50 * MS
    tracks: dict[int, NDArray[np.float64]]  # after the run; (n, 4): microseconds, x, y, -
    followed: dict[int, list[FollowedPath]]

    def make_fleet(self, channel: str, record: Record, host: Host) -> Cluster:
        """A plain cluster; arrivals are noted by section."""
        self._done_at_us: dict[int, int] = {}  # section -> when its robot reported it done
        return Cluster(self.setting, channel, record, host)

    def recorded(self, recorder: Recorder) -> Record:
        def record(slot: int, now_us: int, effect: Effect) -> None:
            recorder(slot, now_us, effect)
            if isinstance(effect, Trace) and effect.machine == "claim" and effect.event == "DONE":
                self._done_at_us.setdefault(int(effect.source[1:]), now_us)

        return record

    def is_over(self, cluster: Cluster, scripts: Sequence[Handle]) -> bool:
        return len(self._done_at_us) == self.setting.section_count

    def progress(self, cluster: Cluster) -> RunProgress:
        """Goals reached of all."""
        done, total = len(self._done_at_us), self.setting.section_count
        now_s = cluster.host.now_us() / S
        return RunProgress(now_s, done, total, done / max(total, 1), states_of(cluster))

    def measure(self, cluster: Cluster) -> dict[str, Any]:
        missions = {slot: robot.peer.mission for slot, robot in cluster.robots.items()}
        errands = {s: m for s, m in missions.items() if isinstance(m, NavigationMission)}
        bodies = cluster.world.robots
        self.tracks = {slot: body.track.to_array() for slot, body in bodies.items()}
        self.followed = {slot: list(errand.followed) for slot, errand in errands.items()}
        legs = [leg for slot in errands for leg in self._legs(slot)]
        last_at_s = tuple(
            max((leg.arrived_s for leg in legs if leg.slot == slot), default=0.0)
            for slot in sorted(errands)
        )
        return {
            **of_bodies(cluster),
            "finished": len(self._done_at_us) == self.setting.section_count,
            "arrived_s": last_at_s,
            "legs": tuple(legs),
            "rounds": max(e.agreement.rounds for e in errands.values()),
            "unsolved": max(e.agreement.unsolved for e in errands.values()),
            "obstacles": len(self.setting.appeared),
        }

    def _legs(self, slot: int) -> list[GoalResult]:
        found, start_at_us = [], 0
        for number in range(len(self.setting.goals[slot])):
            done_at_us = self._done_at_us.get(slot * GOALS_MAX + number)
            end_at_us = done_at_us if done_at_us is not None else 1 << 62
            paths = [p for p in self.followed[slot] if start_at_us <= p.t_us < end_at_us]
            found.append(
                GoalResult(
                    slot,
                    number,
                    inf if done_at_us is None else done_at_us / 1e6,
                    rmse_m(self.tracks[slot], paths, end_at_us),
                    sum(p.why in ("lost", "blocked") for p in paths),
                    sum(p.why == "plan" for p in paths),
                )
            )
            start_at_us = end_at_us
        return found


def rmse_m(track: NDArray[np.float64], paths: list[FollowedPath], end_at_us: int) -> float:
    """Root mean square of the distance to the polyline (not to its vertices) followed at the time.

    `track` (n, 4): microseconds, x, y, and a column that is not used. nan if nothing was driven.
    """
    squares: list[float] = []
    for k, path in enumerate(paths):
        last_at_us = paths[k + 1].t_us if k + 1 < len(paths) else end_at_us
        rows = track[(track[:, 0] >= path.t_us) & (track[:, 0] <= last_at_us)]
        squares += [to_polyline_m((x, y), path.points) ** 2 for _, x, y, _ in rows.tolist()]
    return sqrt(sum(squares) / len(squares)) if squares else float("nan")


def to_polyline_m(at: tuple[float, float], path: Points) -> float:
    """Distance from a point to the nearest point of a polyline; both in metres."""
    nearest = hypot(at[0] - path[0][0], at[1] - path[0][1])
    for (ax, ay), (bx, by) in itertools.pairwise(path):
        ex, ey = bx - ax, by - ay
        square = ex * ex + ey * ey
        t = ((at[0] - ax) * ex + (at[1] - ay) * ey) / square if square > 0 else 0.0
        t = min(max(t, 0.0), 1.0)
        nearest = min(nearest, hypot(ax + t * ex - at[0], ay + t * ey - at[1]))
    return nearest
