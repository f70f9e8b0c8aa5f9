"""One run of a delivery fleet from power-up to the last parcel; the outcome is from the truth."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from agent.delivery.task_registry import TASKS_MAX
from agent.interface.config import S
from crdt import Phase
from sim.fleet.scheduler import Handle, Host, Script
from sim.fleet.simulated_fleet import Record
from sim.runs.delivery_fleet import DeliveryFleet
from sim.runs.run import MissionRun, RunProgress, first_of, of_bodies, points_of
from sim.scenarios.delivery_setup import DeliverySetup
from sim.world.contacts import TOUCH_M
from sim.world.ground_truth import TrackPoint

# A place that robots cannot reach for this long stays unreachable: no box stands longer.
CUT_OFF_US = 60 * S
QUIET_US = 4 * S  # after the last parcel, replicas must be equal within this time


class DeliveryOutcome(NamedTuple):
    """What came of one delivery run, from the truth about parcels."""

    scenario: str
    robots: int
    seed: int
    tasks: int
    delivered: int
    unreachable: tuple[int, ...]  # tasks that no robot could reach, as the robots report
    beyond_battery: tuple[int, ...]  # tasks that a battery that is full at a bay does not last for
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
    first_contact: str = ""  # its time, robots and place; empty: none

    @property
    def success(self) -> bool:
        """Whether every parcel was delivered and nothing went wrong."""
        return self.finished and not self.flawed

    @property
    def flawed(self) -> bool:
        """Whether a parcel was mishandled, a battery ran empty, or something was touched."""
        return any(self.flaws.values()) or bool(self.empty) or self.contacts > 0

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values for JSON."""
        plain = {**self._asdict(), "flaws": dict(self.flaws), "frames": dict(self.frames)}
        return {**plain, "success": self.success}


class DeliveryRun(MissionRun[DeliverySetup, DeliveryFleet, DeliveryOutcome]):
    """Runs a warehouse until every task is delivered, or cannot be reached."""

    kind = DeliveryOutcome
    quiet_for_us = QUIET_US
    tracks: dict[int, list[TrackPoint]]  # after the run
    watch: Callable[[DeliveryFleet], None] | None = None  # gets the fleet twice a second
    forever = False  # more tasks may come at any time
    ended = False  # a person ended the run
    _hope_at_us = 0  # when a place could last be reached

    def make_fleet(self, channel: str, record: Record, host: Host) -> DeliveryFleet:
        """Robots with arms and batteries, on the floor of the warehouse."""
        return DeliveryFleet(self.setting, channel, record, host)

    def scripts(self, cluster: DeliveryFleet, faults: Script[None]) -> list[Handle]:
        cluster.host.spawn(cluster.floor.calls())  # these never end
        events = cluster.floor.events()
        return super().scripts(cluster, faults) + [cluster.host.spawn(event) for event in events]

    def look(self, cluster: DeliveryFleet) -> None:
        if self.watch is not None:
            self.watch(cluster)
        left = cluster.truth.dropoff.keys() - cluster.truth.delivered_at_us.keys()
        if not left or left != cluster.unreachable:
            self._hope_at_us = cluster.host.now_us()

    def is_over(self, cluster: DeliveryFleet, scripts: Sequence[Handle]) -> bool:
        done = cluster.finished or cluster.host.now_us() - self._hope_at_us > CUT_OFF_US
        over = all(script.done() for script in scripts) and done
        return (over and not self.forever) or self.ended

    def progress(self, cluster: DeliveryFleet) -> RunProgress:
        """Parcels delivered of those ordered, with the next stops of each robot."""
        plans = "  ".join(
            f"{robot.slot} [{', '.join(stops[:3])}{', ...' if len(stops) > 3 else ''}]"
            for robot in cluster.running
            for stops in (cluster.missions[robot.slot].stops,)
        )
        done, total = len(cluster.truth.delivered_at_us), len(cluster.truth.dropoff)
        return RunProgress(cluster.host.now_us() / S, done, total, done / max(total, 1), plans)

    def measure(self, cluster: DeliveryFleet) -> dict[str, Any]:
        truth, missions = cluster.truth, cluster.missions.values()
        self.tracks = points_of(cluster)
        waits_for_s = [
            (t_us - truth.appeared_at_us[task]) / S for task, t_us in truth.delivered_at_us.items()
        ]
        touches = [contact for contact in cluster.world.contacts if contact.depth_m > TOUCH_M]
        return {
            **of_bodies(cluster),
            "contacts": len(touches),
            "first_contact": first_of(touches),
            "tasks": len(truth.dropoff),
            "delivered": len(truth.delivered_at_us),
            "unreachable": tuple(sorted(cluster.unreachable)),
            "beyond_battery": tuple(sorted(cluster.beyond_battery)),
            "makespan_s": max(truth.delivered_at_us.values(), default=0) / S,
            "latency_s": sum(waits_for_s) / max(len(waits_for_s), 1),
            "flaws": truth.flaws,
            "empty": tuple(sorted(truth.empty)),
            "lowest_battery": min(truth.lowest.values(), default=1.0),
            "charges": _charges(cluster),
            "rounds": sum(m.dispatch.round.streamed for m in missions),
            "agreements": max((m.agreement.rounds for m in missions), default=0),
            "ahead": sum(m.paths.used for m in missions),
            "waited_s": sum(m.waited_for_us for m in missions) / S,
        }


def _charges(cluster: DeliveryFleet) -> int:
    """Visits of bays that were completed, by a running replica."""
    for robot in cluster.running:
        allocation = robot.peer.allocation
        return sum(
            section >= TASKS_MAX and allocation.phase_of(section) is Phase.DONE
            for section in allocation.sections()
        )
    return 0
