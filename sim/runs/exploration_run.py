"""A fleet that explores an arena from power-up to the end; the outcome is from the truth."""

import asyncio
import itertools
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.exploration.exploration_mission import ExplorationMission
from agent.exploration.exploration_report import fleet_status, serialize_for_llm
from agent.exploration.exploration_task import ExplorationOrder
from agent.exploration.lone_exploration import LoneExploration
from agent.interface.config import BRAKING_SHARE
from agent.interface.lifecycle import State
from agent.interface.motion_controller import BodyLimits
from agent.mapping.local_and_fleet_map import LocalAndFleetMap
from agent.motion.holonomic_motion import HolonomicMotion
from agent.peer.peer import Peer
from agent.runtime.peer_factory import MissionParts, identity_of, make_peer
from crdt.hybrid_clock import HybridClock
from crdt.occupancy import OccupancyMap
from crdt.sighting import TIME_MAX
from protocol.frames.codec import Malformed, decode_once
from protocol.frames.frame import Frame
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.sync.map_sync import MapSync, Values
from sim.can.frame_timing import worst_bits
from sim.files.can_log import open_log
from sim.fleet.fault_injector import FaultPlan
from sim.fleet.simulated_fleet import Cluster, Record
from sim.fleet.trace_recorder import Recorder
from sim.fleet.virtual_clock import run_virtual
from sim.scenarios.exploration_scenario import ArenaScenario, ArenaSetting
from sim.world.ground_truth import TrackPoint

LOOK_S = 0.25
QUIET_S = 2.0  # after the last news of the map, all replicas must be equal within this time
FENCE_M = 0.04  # distance from walls kept by collision avoidance; planned paths keep 0.1 m
MOST = 0.95
REPORT_S = 2.0
TICK_US = 1_000_000  # of the fleet's clock

_numbers = itertools.count()


class Sharing(Enum):
    FLEET = "the real wire"
    AT_ONCE = "one map for all, without a wire: what an omniscient coordinator would have"
    NONE = "each for itself, to the nearest frontier"


class InstantMapSync(MapSync):
    """News reach all maps immediately and without a frame."""

    fleet: "list[InstantMapSync]"
    hold_us = 0
    now_us = 0

    def see(self, patch: int, values: Values, level: int) -> None:
        time_s = self.clock.read(self.now_us)
        for other in self.fleet:
            other.chart.apply(patch, values, level, time_s, self.slot)

    @property
    def deadline_us(self) -> int:
        return 1 << 62


class SurveyOutcome(NamedTuple):
    scenario: str
    robots: int
    seed: int
    finished: bool  # no live robot sees a frontier that it could reach
    explored: float  # share of the visible area in the joined map of the first running robot
    right: float  # share of its known cells that are correct
    time_95_s: float  # until all robots together have seen 95 % of the visible area; inf: never
    time_s: float  # until the end
    overlap: float  # area that a robot saw after another had, divided by the visible area, at 95 %
    overlap_end: float  # the same at the end of the run
    equal_s: float  # time from the last news until all maps were equal, bit for bit
    maps_equal: bool  # within 2 s
    contacts: int
    closest_m: float
    map_load: float  # share of the bus, worst-case stuffing, over the time to the end
    map_bytes_per_m2: float
    bus_load: float
    tasks: Mapping[str, int]  # by status
    switched: int
    frames: Mapping[str, int]
    malformed: int
    travel_m: float
    pymunk_steps: int  # steps of 10 ms made by pymunk
    trace_hash: str
    wall_s: float

    @property
    def success(self) -> bool:
        return self.finished and self.contacts == 0 and self.maps_equal and self.explored >= 0.98

    def to_dict(self) -> dict[str, Any]:
        plain = {**self._asdict(), "frames": dict(self.frames), "tasks": dict(self.tasks)}
        return {**plain, "success": self.success}


class SurveyCluster(Cluster):
    def __init__(
        self, setting: ArenaSetting, channel: str, record: Record | None = None,
        sharing: Sharing = Sharing.FLEET, orders: Sequence[ExplorationOrder] = (),
    ) -> None:  # fmt: skip
        super().__init__(setting, channel, record)
        self.place, self.sharing, self.orders = setting, sharing, orders
        self.missions: dict[int, ExplorationMission] = {}
        self.at_once: list[InstantMapSync] = []

    def make(
        self, slot: int, now_us: int, recalled: Mapping[str, bytes], first_boot: bool, lot: str
    ) -> Peer:
        place, scenario = self.place, self.place.scenario
        fleet = scenario.fleet
        braking_m_s2 = BRAKING_SHARE * fleet.acceleration_m_s2
        limits = BodyLimits(fleet.radius_m, fleet.speed_m_s, braking_m_s2)
        sync = self._sync(slot, now_us)
        chart = LocalAndFleetMap(sync, place.geometry, fleet.radius_m, scenario.arena.range_m)
        kind = LoneExploration if self.sharing is Sharing.NONE else ExplorationMission
        mission = kind(chart, limits, fleet.robots, scenario.arena.robots_max, self.orders)
        self.missions[slot] = mission
        identity = identity_of(
            scenario.name, slot, fleet.robots, place.config_hash, place.silence,
            first_boot=first_boot,
        )  # fmt: skip
        rng = Random(f"{scenario.run.seed}/peer/{slot}{lot}")
        motion = HolonomicMotion(
            slot, limits._replace(acceleration_m_s2=fleet.acceleration_m_s2), None, fence_m=FENCE_M
        )
        on_wire = sync if self.sharing is Sharing.FLEET else None
        keyring = place.keyring(slot, lot)
        parts = MissionParts(mission, motion, on_wire)
        return make_peer(identity, rng, now_us, recalled, parts, keyring=keyring)

    def _sync(self, slot: int, now_us: int) -> MapSync:
        chart = OccupancyMap(self.place.geometry, self.place.order)
        clock = HybridClock(now_us, TICK_US, TIME_MAX)
        if self.sharing is Sharing.FLEET:
            return MapSync(slot, chart, clock, now_us)
        sync = InstantMapSync(slot, chart, clock, now_us)
        sync.fleet = [sync]
        if self.sharing is Sharing.AT_ONCE:
            self.at_once.append(sync)
            sync.fleet = self.at_once
        return sync

    @property
    def finished(self) -> bool:
        """Whether no running robot has a task, or sees a frontier that it could reach."""
        running = self.running
        return bool(running) and all(
            robot.peer.mission is not None
            and self.missions[robot.slot].over
            and self.missions[robot.slot].task is None
            and robot.peer.state is State.IDLE
            for robot in running
        )

    @property
    def maps_equal(self) -> bool:
        charts = {self.missions[robot.slot].chart.fleet.serialize() for robot in self.running}
        return len(charts) <= 1

    @property
    def told_us(self) -> int:
        """The number of patches that all robots still have to send; 0 if everything is sent."""
        syncs = [self.missions[robot.slot].chart.sync for robot in self.running]
        return sum(sync.pending for sync in syncs if sync is not None)


class SeenCells:
    """Which robot saw each cell first, and which saw it again, from the robots' own evidence."""

    def __init__(self, setting: ArenaSetting) -> None:
        self.truth = setting.reachable
        shape = self.truth.shape
        self.first: NDArray[np.int64] = np.full(shape, -1, dtype=np.int64)
        self.by: dict[int, NDArray[np.bool_]] = {}
        self.again = 0
        self.cells = int(np.count_nonzero(self.truth))  # cells that can be seen

    def look(self, missions: Mapping[int, ExplorationMission]) -> None:
        for slot, mission in sorted(missions.items()):
            own = (mission.chart.own() != 0) & self.truth
            known = self.by.setdefault(slot, np.zeros_like(own))
            new = own & ~known
            known |= own
            self.again += int(np.count_nonzero(new & (self.first >= 0) & (self.first != slot)))
            self.first[new & (self.first < 0)] = slot

    @property
    def share(self) -> float:
        return float(
            np.count_nonzero((self.first >= 0) & self.truth) / np.count_nonzero(self.truth)
        )

    @property
    def overlap(self) -> float:
        return self.again / self.cells


class FilmFrame(NamedTuple):
    """One picture of the film."""

    now_s: float
    slot: int  # the robot whose map it is
    values: Values
    first: NDArray[np.int64]  # the robot that saw each cell first; -1: none yet
    places: Mapping[int, tuple[float, float]]


class ExplorationRun:
    """One run."""

    def __init__(
        self, scenario: ArenaScenario, sharing: Sharing = Sharing.FLEET, out: Path | None = None,
        orders: Sequence[ExplorationOrder] = (), until: float = 2.0,
        attach: Callable[[Cluster], None] | None = None,
    ) -> None:  # fmt: skip
        """`until`: end when this share has been seen; above 1: end when the fleet reports the end.
        `attach` gets the fleet before any robot is switched on."""
        self.attach = attach
        self.setting, self.sharing, self.out = ArenaSetting(scenario), sharing, out
        self.orders = [*(table.order for table in scenario.order), *orders]
        self.until = until
        self.seen = SeenCells(self.setting)
        self.kinds: Counter[str] = Counter()
        self.map_bits = self.map_bytes = self.malformed = 0
        self.news_us = 0  # when the last news of the map was on the bus
        self.charts: dict[int, Values] = {}
        self.joined: OccupancyMap | None = None
        self.films: list[FilmFrame] = []
        self.tracks: dict[int, list[TrackPoint]] = {}
        # seconds, the report that the first robot would give.
        self.reports: list[tuple[float, str]] = []

    def run(self) -> SurveyOutcome:
        return run_virtual(self.go())

    def _tap(self, t_us: int, frame: Frame) -> None:
        _, message = decode_once(frame)
        self.kinds[type(message).__name__] += 1
        self.malformed += isinstance(message, Malformed)
        if isinstance(message, MapPatch | MapDigests):
            self.map_bits += worst_bits(len(frame.data))
            self.map_bytes += 8
            if isinstance(message, MapPatch):
                self.news_us = t_us

    async def go(self) -> SurveyOutcome:
        started_s = time.perf_counter()
        recorder = Recorder(self.out / "trace.jsonl" if self.out else None)
        cluster = SurveyCluster(
            self.setting, f"survey {next(_numbers)}", recorder, self.sharing, self.orders
        )
        log = open_log(self.out / "can.log") if self.out else None
        cluster.segment.taps.append(self._tap)
        if log is not None:
            cluster.segment.taps.append(log.write)
        if self.attach is not None:
            self.attach(cluster)
        cluster.boot_all()
        script = asyncio.create_task(FaultPlan(cluster).run())
        try:
            found = await self._watch(cluster, script)
            outcome = self._measure(cluster, recorder, found, time.perf_counter() - started_s)
        finally:
            script.cancel()
            await cluster.close()
            recorder.close()
            if log is not None:
                log.close()
        return outcome

    async def _watch(
        self, cluster: SurveyCluster, script: "asyncio.Task[None]"
    ) -> tuple[float, float, float, float]:
        """Run until the end; returns seconds to 95 %, overlap then, seconds to the end, seconds to
        equal maps."""
        loop, limit_s = asyncio.get_running_loop(), self.setting.scenario.run.time_limit_s
        most_s = overlap = np.inf
        done_s = 0.0
        while loop.time() < limit_s:
            await asyncio.sleep(LOOK_S)
            cluster.check()
            for sync in cluster.at_once:
                sync.now_us = round(loop.time() * 1e6)
            self.seen.look(cluster.missions)
            self._note(cluster, loop.time())
            if self.seen.share >= MOST and most_s == np.inf:
                most_s, overlap = loop.time(), self.seen.overlap
            done_s = done_s if cluster.finished and done_s else loop.time()
            over = script.done() and cluster.finished and loop.time() >= done_s + QUIET_S
            if over or self.seen.share >= self.until:
                break
        end_s = done_s
        last_s = loop.time()
        while not cluster.maps_equal and loop.time() < last_s + 2 * QUIET_S:
            await asyncio.sleep(0.05)
        return most_s, overlap, end_s, loop.time() - last_s

    def _note(self, cluster: SurveyCluster, now_s: float) -> None:
        """Every two seconds, record the report of a robot, a different one each time, and the
        maps."""
        if not cluster.running or (self.reports and now_s < self.reports[-1][0] + REPORT_S):
            return
        robot = cluster.running[len(self.reports) % len(cluster.running)]
        mission = cluster.missions[robot.slot]
        if robot.peer.here is None:  # its sensors have no observation yet
            return
        status = fleet_status(robot.peer.view(round(now_s * 1e6)), mission)
        self.reports.append((now_s, serialize_for_llm(status, ages=True)))
        places = {slot: body.position for slot, body in cluster.world.robots.items()}
        first = self.seen.first.copy()
        self.films.append(FilmFrame(now_s, robot.slot, mission.chart.values(), first, places))

    def _measure(
        self, cluster: SurveyCluster, recorder: Recorder,
        found: tuple[float, float, float, float], wall_s: float,
    ) -> SurveyOutcome:  # fmt: skip
        most_s, overlap, end_s, equal_s = found
        now_s = asyncio.get_running_loop().time()
        world, setting = cluster.world, self.setting
        world.advance(round(now_s * 1e6))
        self.tracks = {slot: body.track.points for slot, body in world.robots.items()}
        first = cluster.missions[cluster.running[0].slot]
        self.joined = first.chart.fleet
        self.charts = {slot: mission.chart.own() for slot, mission in cluster.missions.items()}
        values, truth = first.chart.values(), setting.reachable
        known = values != 0
        right = np.where(setting.solid, values == 2, values == 1)
        seen_cells, area_m2 = self.seen.cells, self.seen.cells * setting.geometry.cell_m**2
        tasks: Counter[str] = Counter()
        for mission in cluster.missions.values():
            tasks.update({status.value: count for status, count in mission.ended.items()})
        wire = cluster.segment.wire
        return SurveyOutcome(
            scenario=setting.scenario.name,
            robots=setting.scenario.fleet.robots,
            seed=setting.scenario.run.seed,
            finished=cluster.finished,
            explored=int(np.count_nonzero(known & truth)) / seen_cells,
            right=int(np.count_nonzero(right & known)) / max(int(np.count_nonzero(known)), 1),
            time_95_s=most_s,
            time_s=end_s,
            overlap=overlap,
            overlap_end=self.seen.overlap,
            equal_s=equal_s,
            maps_equal=cluster.maps_equal and equal_s <= QUIET_S,
            contacts=len(world.contacts),
            closest_m=world.closest_m,
            map_load=self.map_bits * wire.bit_us / (end_s * 1e6),
            map_bytes_per_m2=self.map_bytes / area_m2,
            bus_load=wire.worst_us / (now_s * 1e6),
            tasks=dict(tasks),
            switched=sum(mission.switched for mission in cluster.missions.values()),
            frames=dict(self.kinds.most_common()),
            malformed=self.malformed,
            travel_m=sum(body.track.driven_m for body in world.robots.values()),
            pymunk_steps=world.pymunk_steps,
            trace_hash=recorder.digest,
            wall_s=wall_s,
        )
