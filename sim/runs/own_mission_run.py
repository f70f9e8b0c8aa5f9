"""One run of a fleet with a mission that its user wrote."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from sim.fleet.simulated_fleet import Cluster
from sim.runs.run import of_bodies, points_of
from sim.runs.section_run import SectionRun
from sim.scenarios.own_mission_setup import OwnMissionSetup
from sim.world.ground_truth import TrackPoint


class OwnMissionOutcome(NamedTuple):
    """The figures of one run. They say how the robots behaved, not whether the work is good."""

    scenario: str
    robots: int
    seed: int
    silence_policy: str
    authenticated: bool
    finished: bool  # every section DONE on every running replica, and their digests equal
    sections: int
    units_twice: int  # units announced by two robots: duplicate work
    contacts: int
    moved_after_stop: int
    closest_m: float
    travel_m: float
    replicas_equal: bool
    frames: Mapping[str, int]
    bus_load: float
    bus_load_worst_case: float
    claims_lost: int
    malformed: int
    trace_hash: str
    simulated_s: float
    wall_s: float
    pymunk_steps: int
    first_contact: str = ""  # its time, robots and place; empty: none

    @property
    def success(self) -> bool:
        """Whether all is done, no robot touched anything or moved after a stop, and all replicas are
        equal."""
        clean = self.contacts == 0 and self.moved_after_stop == 0
        return self.finished and clean and self.replicas_equal

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values for JSON."""
        return {**self._asdict(), "frames": dict(self.frames), "success": self.success}


class OwnMissionRun(SectionRun[OwnMissionSetup, OwnMissionOutcome]):
    """Runs until every section is done, or until the scenario's time limit."""

    kind = OwnMissionOutcome
    tracks: dict[int, list[TrackPoint]]  # after the run

    def measure(self, cluster: Cluster) -> dict[str, Any]:
        self.tracks = points_of(cluster)
        return {**super().measure(cluster), **of_bodies(cluster)}
