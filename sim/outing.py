"""One run of a fleet on its errands, and what came of it."""

import asyncio
import itertools
from math import hypot, inf, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.effects import Trace
from agent.errand import GOALS_MAX, Errands, Followed
from sim.clock import run_virtual
from sim.cluster import Cluster
from sim.errand_setting import ErrandSetting
from sim.trace import Recorder

LOOK_S = 0.5

_numbers = itertools.count()
Points = tuple[tuple[float, float], ...]


class Leg(NamedTuple):
    """One errand as it was driven."""

    slot: int
    number: int
    arrived_s: float  # inf: never
    rmse_m: float  # of the true positions to the polyline that was being followed
    replans: int  # paths that were planned for it on the way, not counting those after a plan
    plans: int  # joint plans that it took part in


class OutingOutcome(NamedTuple):
    finished: bool
    contacts: int
    simulated_s: float
    arrived_s: tuple[float, ...]  # each robot's last goal; inf: never
    legs: tuple[Leg, ...]
    rounds: int  # of agreement, the most that one robot saw
    unsolved: int
    closest_m: float
    trace_hash: str


class Outing:
    def __init__(self, setting: ErrandSetting) -> None:
        self.setting = setting
        self.tracks: dict[int, NDArray[np.float64]] = {}  # (n, 4): microseconds, x, y, -
        self.followed: dict[int, list[Followed]] = {}
        self._done_us: dict[int, int] = {}  # section: when its robot said so
        self._recorder = Recorder(None)

    def run(self) -> OutingOutcome:
        return run_virtual(self.go())

    async def go(self) -> OutingOutcome:
        cluster = Cluster(self.setting, f"outing {next(_numbers)}", self._note)
        cluster.boot_all()
        loop, limit_s = asyncio.get_running_loop(), self.setting.scenario.run.time_limit_s
        try:
            while loop.time() < limit_s and len(self._done_us) < self.setting.section_count:
                await asyncio.sleep(LOOK_S)
                cluster.check()
            cluster.world.advance(round(loop.time() * 1e6))
            return self._measure(cluster, loop.time())
        finally:
            await cluster.close()
            self._recorder.close()

    def _note(self, slot: int, now_us: int, effect: object) -> None:
        self._recorder(slot, now_us, effect)  # type: ignore[arg-type]
        if isinstance(effect, Trace) and effect.machine == "claim" and effect.event == "DONE":
            self._done_us.setdefault(int(effect.source[1:]), now_us)

    def _measure(self, cluster: Cluster, now_s: float) -> OutingOutcome:
        world, setting = cluster.world, self.setting
        missions = {slot: robot.peer.mission for slot, robot in cluster.robots.items()}
        errands = {s: m for s, m in missions.items() if isinstance(m, Errands)}
        self.tracks = {slot: body.track.to_array() for slot, body in world.robots.items()}
        self.followed = {slot: errand.followed for slot, errand in errands.items()}
        legs = [leg for slot in errands for leg in self._legs(slot)]
        last_s = tuple(
            max((leg.arrived_s for leg in legs if leg.slot == slot), default=0.0)
            for slot in sorted(errands)
        )
        return OutingOutcome(
            finished=len(self._done_us) == setting.section_count,
            contacts=len(world.contacts),
            simulated_s=now_s,
            arrived_s=last_s,
            legs=tuple(legs),
            rounds=max(e.accords.rounds for e in errands.values()),
            unsolved=max(e.accords.unsolved for e in errands.values()),
            closest_m=world.closest_m,
            trace_hash=self._recorder.digest,
        )

    def _legs(self, slot: int) -> list[Leg]:
        found, since_us = [], 0
        for number in range(len(self.setting.goals[slot])):
            done_us = self._done_us.get(slot * GOALS_MAX + number)
            until_us = done_us if done_us is not None else 1 << 62
            paths = [p for p in self.followed[slot] if since_us <= p.t_us < until_us]
            found.append(
                Leg(
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


def rmse_m(track: NDArray[np.float64], paths: list[Followed], until_us: int) -> float:
    """Root mean square of the distance to the polyline (not to its vertices) followed at the time.

    nan where nothing was driven.
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
