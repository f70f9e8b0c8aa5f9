"""One run of a delivery fleet from power-up to the last parcel; the outcome is from the truth."""

import itertools
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from agent.delivery.delivery_mission import DeliveryMission
from agent.delivery.task_registry import TASKS_MAX
from agent.interface.config import S
from agent.peer.peer import Peer
from crdt import Phase
from protocol.frames.codec import Malformed, decode_once
from protocol.frames.frame import Frame
from sim.files.can_log import open_log
from sim.fleet.event_loop import EventLoop
from sim.fleet.fault_injector import FaultPlan
from sim.fleet.scheduler import Handle, Host, LoopHost, Script, follow
from sim.fleet.simulated_fleet import Cluster, Record, Robot
from sim.fleet.trace_recorder import Recorder
from sim.fleet.warehouse_floor import WarehouseFloor
from sim.scenarios.delivery_setup import DeliverySetting
from sim.world.contacts import TOUCH_M
from sim.world.ground_truth import TrackPoint
from sim.world.parcel_truth import CarrierBody

LOOK_US = 500_000
# A place that robots cannot reach for this long stays unreachable: no box stands longer.
CUT_OFF_US = 60 * S
QUIET_US = 4 * S  # after the last parcel, replicas must be equal within this time

_numbers = itertools.count()


class RunProgress(NamedTuple):
    simulated_s: float
    delivered: int
    tasks: int
    itineraries: Mapping[int, list[str]]


class HaulOutcome(NamedTuple):
    scenario: str
    robots: int
    seed: int
    tasks: int
    delivered: int
    unreachable: tuple[int, ...]  # tasks that no robot could reach, as the robots report
    finished: bool  # every parcel lies at its dropoff, and every running replica has it
    makespan_s: float  # until the last parcel was put down
    latency_s: float  # the mean time from a task's appearance to its delivery
    flaws: Mapping[str, int]  # twice, lost, by_two, again
    empty: tuple[int, ...]  # robots whose battery was empty at any time
    lowest_battery: float
    charges: int
    contacts: int  # deeper than 2 cm: bodies are measured to a centimetre
    closest_m: float
    travel_m: float
    rounds: int  # of planning, with streamed plans
    agreements: int  # rounds in jams; the largest number that one robot took part in
    ahead: int  # paths that were planned before they were needed, and then used
    waited_s: float  # for new itineraries, total of all robots
    replicas_equal: bool
    bus_load: float
    frames: Mapping[str, int]
    malformed: int
    pymunk_steps: int  # steps of 10 ms made by pymunk
    trace_hash: str
    simulated_s: float
    wall_s: float

    @property
    def success(self) -> bool:
        return self.finished and not self.flawed

    @property
    def flawed(self) -> bool:
        return any(self.flaws.values()) or bool(self.empty) or self.contacts > 0

    def to_dict(self) -> dict[str, Any]:
        plain = {**self._asdict(), "flaws": dict(self.flaws), "frames": dict(self.frames)}
        return {**plain, "success": self.success}


class HaulCluster(Cluster):
    def __init__(
        self, setting: DeliverySetting, channel: str, record: Record | None, host: Host
    ) -> None:
        super().__init__(setting, channel, record, host)
        self.place = setting
        self.depot = WarehouseFloor(setting, self.world, host.now_us, self.is_up, self.inject)
        self.truth, self.desk = self.depot.truth, self.depot.desk
        self.missions: dict[int, DeliveryMission] = {}
        self.segment.taps.append(self.depot.hear)

    def make(
        self, slot: int, now_us: int, recalled: Mapping[str, bytes], first_boot: bool, lot: str
    ) -> Peer:
        peer = super().make(slot, now_us, recalled, first_boot, lot)
        assert isinstance(peer.mission, DeliveryMission)
        self.missions[slot] = peer.mission
        return peer

    def boot(self, slot: int) -> Robot:
        robot = super().boot(slot)
        assert robot.shell.body is not None
        robot.shell.body = CarrierBody(robot.shell.body, slot, self.truth, self.host.now_us)
        return robot

    @property
    def finished(self) -> bool:
        return self.depot.delivered and all(
            robot.peer.allocation.phase_of(task) is Phase.DONE
            for robot in self.running
            for task in self.truth.dropoff
        )

    @property
    def unreachable(self) -> frozenset[int]:
        """Tasks that are not done and cannot be, as the running robots report. Either the robot
        with the parcel aboard cannot reach its dropoff, or no robot can reach both places."""
        cut = {robot.slot: self.missions[robot.slot].cut_off.sections for robot in self.running}
        found = set()
        for task in self.truth.dropoff.keys() - self.truth.delivered_us.keys():
            aboard = [
                cut[slot] for slot, t in self.truth.aboard.items() if t == task and slot in cut
            ]
            asked = aboard or list(cut.values())
            if asked and all(task in own for own in asked):
                found.add(task)
        return frozenset(found)


class DeliveryRun:
    def __init__(
        self, setting: DeliverySetting, out: Path | None = None,
        told: Callable[[RunProgress], None] | None = None,
        watch: Callable[[HaulCluster], None] | None = None, forever: bool = False,
    ) -> None:  # fmt: skip
        """`watch` gets the fleet twice a second. `forever`: more tasks may come at any time."""
        self.forever = forever
        self.setting, self.out, self.told, self.watch = setting, out, told, watch
        self.kinds: Counter[str] = Counter()
        self.malformed = 0
        self.tracks: dict[int, list[TrackPoint]] = {}
        self.cluster: HaulCluster | None = None
        self.ended = False  # a person ended the run
        self.attach: Callable[[HaulCluster], None] | None = None

    def run(self) -> HaulOutcome:
        swarm = EventLoop()
        return swarm.run(self._play(swarm))

    async def live(self, attach: Callable[[HaulCluster], None]) -> HaulOutcome:
        """Run in the running loop's time, which begins at 0. `attach`: connects others to the
        bus."""
        host = LoopHost()
        self.attach = attach
        try:
            return await follow(self._play(host))
        finally:
            await host.close()

    def _play(self, host: Host) -> Script[HaulOutcome]:
        started_s = time.perf_counter()
        recorder = Recorder(self.out / "trace.jsonl" if self.out else None)
        cluster = HaulCluster(self.setting, f"haul {next(_numbers)}", recorder, host)
        self.cluster = cluster
        log = open_log(self.out / "can.log") if self.out else None

        def tap(t_us: int, frame: Frame) -> None:
            _, message = decode_once(frame)
            self.kinds[type(message).__name__] += 1
            self.malformed += isinstance(message, Malformed)
            if log is not None:
                log.write(t_us, frame)

        cluster.segment.taps.append(tap)
        if self.attach is not None:
            self.attach(cluster)
        cluster.boot_all()
        desk = host.spawn(cluster.depot.calls())
        scripts = [host.spawn(FaultPlan(cluster).script())]
        scripts += [host.spawn(script) for script in cluster.depot.events()]
        try:
            yield from self._until_finished(cluster, scripts)
            outcome = self._measure(cluster, recorder, time.perf_counter() - started_s)
        finally:
            desk.cancel()
            cluster.end()
            recorder.close()
            if log is not None:
                log.close()
        return outcome

    def _until_finished(self, cluster: HaulCluster, scripts: list[Handle]) -> Script[None]:
        host, limit_us = cluster.host, round(self.setting.scenario.run.time_limit_s * S)
        hope_us = 0  # when a place could last be reached
        while host.now_us() < limit_us:
            yield host.now_us() + LOOK_US
            cluster.check()
            for script in scripts:
                script.check()
            if self.watch is not None:
                self.watch(cluster)
            if self.told is not None:
                self.told(self._moment(cluster))
            left = cluster.truth.dropoff.keys() - cluster.truth.delivered_us.keys()
            if not left or left != cluster.unreachable:
                hope_us = host.now_us()
            done = cluster.finished or host.now_us() - hope_us > CUT_OFF_US
            over = all(script.done() for script in scripts) and done
            if (over and not self.forever) or self.ended:
                break
        quiet_us = host.now_us() + QUIET_US
        while not cluster.replicas_equal and host.now_us() < quiet_us:
            yield host.now_us() + LOOK_US // 5

    def _moment(self, cluster: HaulCluster) -> RunProgress:
        running = {robot.slot for robot in cluster.running}
        return RunProgress(
            cluster.host.now_us() / S, len(cluster.truth.delivered_us), len(cluster.truth.dropoff),
            {slot: m.stops for slot, m in cluster.missions.items() if slot in running},
        )  # fmt: skip

    def _measure(self, cluster: HaulCluster, recorder: Recorder, wall_s: float) -> HaulOutcome:
        truth, world, scenario = cluster.truth, cluster.world, self.setting.scenario
        now_us = cluster.host.now_us()
        world.advance(now_us)
        self.tracks = {slot: body.track.points for slot, body in world.robots.items()}
        waits_s = [
            (t_us - truth.appeared_us[task]) / S for task, t_us in truth.delivered_us.items()
        ]
        missions = cluster.missions.values()
        wire = cluster.segment.wire
        return HaulOutcome(
            scenario=scenario.name,
            robots=scenario.fleet.robots,
            seed=scenario.run.seed,
            tasks=len(truth.dropoff),
            delivered=len(truth.delivered_us),
            unreachable=tuple(sorted(cluster.unreachable)),
            finished=cluster.finished,
            makespan_s=max(truth.delivered_us.values(), default=0) / S,
            latency_s=sum(waits_s) / max(len(waits_s), 1),
            flaws=truth.flaws,
            empty=tuple(sorted(truth.empty)),
            lowest_battery=min(truth.lowest.values(), default=1.0),
            charges=_charges(cluster),
            contacts=sum(contact.depth_m > TOUCH_M for contact in world.contacts),
            closest_m=world.closest_m,
            travel_m=sum(body.track.driven_m for body in world.robots.values()),
            rounds=sum(m.dispatch.round.streamed for m in missions),
            agreements=max((m.accords.rounds for m in missions), default=0),
            ahead=sum(m.paths.used for m in missions),
            waited_s=sum(m.waited_us for m in missions) / S,
            replicas_equal=cluster.replicas_equal,
            bus_load=wire.busy_us / max(now_us, 1),
            frames=dict(self.kinds.most_common()),
            malformed=self.malformed,
            pymunk_steps=world.pymunk_steps,
            trace_hash=recorder.digest,
            simulated_s=now_us / S,
            wall_s=wall_s,
        )


def _charges(cluster: HaulCluster) -> int:
    """Visits of bays that were completed, by a running replica."""
    for robot in cluster.running:
        allocation = robot.peer.allocation
        return sum(
            section >= TASKS_MAX and allocation.phase_of(section) is Phase.DONE
            for section in allocation.sections()
        )
    return 0
