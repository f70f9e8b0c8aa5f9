"""One run of a fleet that works a field."""

from typing import Any

from agent.interface.config import S
from sim.fleet.outcome import FieldOutcome
from sim.fleet.scheduler import Host
from sim.fleet.simulated_fleet import Cluster, Record
from sim.runs.run import MissionRun, RunProgress, SetupT, of_bodies, points_of, states_of
from sim.scenarios.field_setup import FieldSetup
from sim.world.coverage_truth import Coverage, coverage, sample_points
from sim.world.ground_truth import TrackPoint
from sim.world.implement_contacts import implement_contacts

RASTER_M = 0.25  # of the coverage check


class WorkRun(MissionRun[SetupT, Cluster, FieldOutcome]):
    """A run whose sections are worked, whatever the world is."""

    kind = FieldOutcome
    look_period_us = 1 * S

    def make_fleet(self, channel: str, record: Record, host: Host) -> Cluster:
        """A plain cluster."""
        return Cluster(self.setting, channel, record, host)

    def progress(self, cluster: Cluster) -> RunProgress:
        """Sections that are done by the best replica, and the share of units."""
        peers = [robot.peer for robot in cluster.running]
        done = max((peer.allocation.done_count() for peer in peers), default=0)
        share = max((peer.progress.fraction() for peer in peers), default=0.0)
        now_s, total = cluster.host.now_us() / S, self.setting.section_count
        return RunProgress(now_s, done, total, share, states_of(cluster))

    def measure(self, cluster: Cluster) -> dict[str, Any]:
        peers = [robot.peer for robot in cluster.robots.values()]
        return {
            "units_twice": sum(peer.redone for peer in peers),
            "refused": sum(peer.safety.authority.refused for peer in peers),
            "sections": self.setting.section_count,
        }


class FieldRun(WorkRun[FieldSetup]):
    """Works a field to its end, and measures the swept ground."""

    truth: Coverage | None = None
    tracks: dict[int, list[TrackPoint]]  # after the run

    def measure(self, cluster: Cluster) -> dict[str, Any]:
        field, fleet = self.setting.field, self.setting.scenario.fleet
        self.tracks = points_of(cluster)
        raster = sample_points(field.polygon, field.implement_width_m, field.overlap_m, RASTER_M)
        ground = self.setting.ground(raster)
        truth = self.truth = coverage(raster, self.tracks, field.implement_width_m, ground.cells)
        met = implement_contacts(
            self.tracks, field.implement_width_m, field.overlap_m, fleet.radius_m
        )
        return {
            **super().measure(cluster),
            **of_bodies(cluster),
            "coverage": truth.share,
            "reachable": ground.share,
            "reached": truth.reached,
            "unreached": ground.unreached,
            "makespan_s": truth.last_at_us / 1e6,
            "worked_twice": truth.twice,
            "work_m": field.work_m,
            "implement_contacts": len(met),
        }
