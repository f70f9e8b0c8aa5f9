"""A fleet that explores an arena from power-up to the end; the outcome is from the truth."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.exploration.exploration_mission import ExplorationMission
from agent.exploration.exploration_report import fleet_status, serialize_for_llm
from agent.exploration.exploration_task import ExplorationOrder
from agent.interface.config import MS, S
from crdt.occupancy import OccupancyMap
from protocol.frames.codec import decode_once
from protocol.frames.frame import Frame
from protocol.frames.map_frames import MapDigests, MapPatch
from protocol.sync.map_sync import Values
from sim.can.frame_timing import worst_bits
from sim.fleet.scheduler import Handle, Host
from sim.fleet.simulated_fleet import Record
from sim.runs.exploration_fleet import ExplorationFleet, Sharing
from sim.runs.run import MissionRun, RunProgress, of_bodies, points_of, states_of
from sim.scenarios.exploration_scenario import ExplorationScenario, ExplorationSetup
from sim.world.ground_truth import TrackPoint

QUIET_US = 2 * S  # after the last news of the map, all replicas must be equal within this time
MOST = 0.95
REPORT_S = 2.0


class ExplorationOutcome(NamedTuple):
    """What came of one exploration, from the truth about visible cells."""

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
    first_contact: str = ""  # its time, robots and place; empty: none

    @property
    def success(self) -> bool:
        """Whether the fleet ended by itself with 98 % seen, without a contact, and with equal maps."""
        return self.finished and self.contacts == 0 and self.maps_equal and self.explored >= 0.98

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values for JSON."""
        plain = {**self._asdict(), "frames": dict(self.frames), "tasks": dict(self.tasks)}
        return {**plain, "success": self.success}


class SeenCells:
    """Which robot saw each cell first, and which saw it again, from the robots' own evidence."""

    def __init__(self, setting: ExplorationSetup) -> None:
        self.truth = setting.reachable
        shape = self.truth.shape
        self.first: NDArray[np.int64] = np.full(shape, -1, dtype=np.int64)
        self.by: dict[int, NDArray[np.bool_]] = {}
        self.again = 0
        self.cells = int(np.count_nonzero(self.truth))  # cells that can be seen

    def look(self, missions: Mapping[int, ExplorationMission]) -> None:
        """Take the new evidence of each robot."""
        for slot, mission in sorted(missions.items()):
            own = (mission.chart.own() != 0) & self.truth
            known = self.by.setdefault(slot, np.zeros_like(own))
            new = own & ~known
            known |= own
            self.again += int(np.count_nonzero(new & (self.first >= 0) & (self.first != slot)))
            self.first[new & (self.first < 0)] = slot

    @property
    def share(self) -> float:
        """Share of the visible cells that any robot has seen."""
        return float(
            np.count_nonzero((self.first >= 0) & self.truth) / np.count_nonzero(self.truth)
        )

    @property
    def overlap(self) -> float:
        """Cells that were seen again by another robot, as a factor of the visible ones."""
        return self.again / self.cells


class FilmFrame(NamedTuple):
    """What one picture of the film shows: a map, its robot, and where all robots were."""

    now_s: float
    slot: int  # the robot whose map it is
    values: Values
    first: NDArray[np.int64]  # the robot that saw each cell first; -1: none yet
    places: Mapping[int, tuple[float, float]]


class ExplorationRun(MissionRun[ExplorationSetup, ExplorationFleet, ExplorationOutcome]):
    """Explores an arena until no robot sees a frontier that it could reach, or until a share is
    seen."""

    kind = ExplorationOutcome
    look_period_us, compare_period_us = 250 * MS, 50 * MS
    quiet_for_us = 2 * QUIET_US
    tracks: dict[int, list[TrackPoint]]  # after the run

    def __init__(
        self, scenario: ExplorationScenario, sharing: Sharing = Sharing.FLEET, out: Path | None = None,
        orders: Sequence[ExplorationOrder] = (), until: float = 2.0,
        told: Callable[[RunProgress], None] | None = None,
    ) -> None:  # fmt: skip
        """`until`: end when this share has been seen; above 1: end when the fleet reports the end."""
        super().__init__(ExplorationSetup(scenario), out, told)
        self.sharing, self.until = sharing, until
        self.orders = [*(table.order for table in scenario.order), *orders]
        self.seen = SeenCells(self.setting)
        self.map_bits = self.map_bytes = 0
        self.charts: dict[int, Values] = {}
        self.joined: OccupancyMap | None = None
        self.films: list[FilmFrame] = []
        # seconds, the report that the first robot would give.
        self.reports: list[tuple[float, str]] = []
        self._most_at_s = self._overlap = np.inf  # when 95 % were seen, and the overlap then
        self._done_at_us = self._over_at_us = 0  # when the fleet was done; when the run was over
        self._told_at_us = 0  # when the last script had ended

    def make_fleet(self, channel: str, record: Record, host: Host) -> ExplorationFleet:
        """Also counts the frames of maps on the wire."""
        cluster = ExplorationFleet(self.setting, channel, record, host, self.sharing, self.orders)
        cluster.segment.taps.append(self._tap)
        return cluster

    def _tap(self, t_us: int, frame: Frame) -> None:
        if isinstance(decode_once(frame)[1], MapPatch | MapDigests):
            self.map_bits += worst_bits(len(frame.data))
            self.map_bytes += 8

    def look(self, cluster: ExplorationFleet) -> None:
        now_us = self._over_at_us = cluster.host.now_us()
        for sync in cluster.at_once:
            sync.now_us = now_us
        self.seen.look(cluster.missions)
        self._note(cluster, now_us / S)
        if self.seen.share >= MOST and self._most_at_s == np.inf:
            self._most_at_s, self._overlap = now_us / S, self.seen.overlap
        if not (cluster.finished and self._done_at_us):
            self._done_at_us = now_us

    def is_over(self, cluster: ExplorationFleet, scripts: Sequence[Handle]) -> bool:
        now_us = cluster.host.now_us()
        if not (self._told_at_us and all(script.done() for script in scripts)):
            self._told_at_us = now_us
        # A script that joins parts of the fleet brings news of the map to a fleet that was done.
        quiet = now_us >= max(self._done_at_us, self._told_at_us) + QUIET_US
        return (super().is_over(cluster, scripts) and quiet) or self.seen.share >= self.until

    def is_settled(self, cluster: ExplorationFleet) -> bool:
        return cluster.maps_equal

    def progress(self, cluster: ExplorationFleet) -> RunProgress:
        """Cells seen of all visible ones."""
        share, cells = self.seen.share, self.seen.cells
        now_s = cluster.host.now_us() / S
        return RunProgress(now_s, round(share * cells), cells, share, states_of(cluster))

    def _note(self, cluster: ExplorationFleet, now_s: float) -> None:
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

    def measure(self, cluster: ExplorationFleet) -> dict[str, Any]:
        setting, now_s = self.setting, cluster.host.now_us() / S
        end_at_s, equal_s = self._done_at_us / S, now_s - self._over_at_us / S
        self.tracks = points_of(cluster)
        # If none runs any more, what the first one knew.
        known = [robot.slot for robot in cluster.running] or sorted(cluster.missions)
        chart = cluster.missions[known[0]].chart if known else None
        self.joined = (
            OccupancyMap(setting.geometry, setting.order) if chart is None else chart.fleet
        )
        self.charts = {slot: mission.chart.own() for slot, mission in cluster.missions.items()}
        values = self.joined.values() if chart is None else chart.values()
        truth = setting.reachable
        known = values != 0
        right = np.where(setting.solid, values == 2, values == 1)
        tasks: Counter[str] = Counter()
        for mission in cluster.missions.values():
            tasks.update({status.value: count for status, count in mission.ended.items()})
        wire = cluster.segment.wire
        return {
            **of_bodies(cluster),
            "explored": int(np.count_nonzero(known & truth)) / self.seen.cells,
            "right": int(np.count_nonzero(right & known)) / max(int(np.count_nonzero(known)), 1),
            "time_95_s": self._most_at_s,
            "time_s": end_at_s,
            "overlap": self._overlap,
            "overlap_end": self.seen.overlap,
            "equal_s": equal_s,
            "maps_equal": cluster.maps_equal and equal_s <= QUIET_US / S,
            "map_load": self.map_bits * wire.bit_us / (end_at_s * 1e6),
            "map_bytes_per_m2": self.map_bytes / (self.seen.cells * setting.geometry.cell_m**2),
            "bus_load": wire.worst_for_us / (now_s * 1e6),
            "tasks": dict(tasks),
            "switched": sum(mission.switched for mission in cluster.missions.values()),
        }
