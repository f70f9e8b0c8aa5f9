"""One run of a fleet that works a field."""

from typing import Any

from agent.interface.config import S
from agent.safety.stop_cause import Severity
from sim.fleet.outcome import FieldOutcome
from sim.fleet.simulated_fleet import Cluster
from sim.runs.run import SetupT, of_bodies, points_of
from sim.runs.section_run import SectionRun
from sim.scenarios.field_setup import FieldSetup
from sim.world.coverage_truth import Coverage, coverage, sample_points
from sim.world.ground_truth import TrackPoint
from sim.world.implement_contacts import implement_contacts, things_under_bars
from sim.world.missed_ground import told_missed

RASTER_M = 0.25  # of the coverage check


class WorkRun(SectionRun[SetupT, FieldOutcome]):
    """A run whose sections are worked, whatever the world is."""

    kind = FieldOutcome
    look_period_us = 1 * S

    def measure(self, cluster: Cluster) -> dict[str, Any]:
        peers = [robot.peer for robot in cluster.robots.values()]
        refused = sum(peer.safety.authority.refused for peer in peers)
        return {**super().measure(cluster), "refused": refused}


def held(cluster: Cluster) -> dict[int, list[str]]:
    """Of each running robot the causes for which it may not move, by name, worst first."""
    return {
        robot.slot: [
            cause.name
            for cause, _ in robot.peer.safety.causes
            if cause.severity is not Severity.SLOW
        ]
        for robot in cluster.running
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
        under = things_under_bars(self.tracks, cluster.world.things, field.implement_width_m)
        return {
            **super().measure(cluster),
            **of_bodies(cluster),
            "coverage": truth.share,
            "reachable": ground.share,
            "reached": truth.reached,
            "unreached": ground.unreached,
            "missed": told_missed(
                truth.missed, raster.cell_m, field.implement_width_m, self.tracks, held(cluster)
            ),
            "makespan_s": truth.last_at_us / 1e6,
            "worked_twice": truth.twice,
            "work_m": field.work_m,
            "implement_contacts": len(met),
            "things_under_bars": len(under),
        }
