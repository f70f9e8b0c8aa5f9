"""One protocol run: sections are worked by the clock, without ground to measure."""

from math import inf
from typing import Any

from agent.interface.config import S
from sim.fleet.simulated_fleet import Cluster
from sim.runs.field_run import WorkRun
from sim.scenarios.protocol_setup import ProtocolSetup


class ProtocolRun(WorkRun[ProtocolSetup]):
    """Works sections by the clock; figures about ground and motion are those of nothing."""

    def measure(self, cluster: Cluster) -> dict[str, Any]:
        share = self.setting.parade.share
        return {
            **super().measure(cluster),
            "coverage": share, "reachable": 1.0, "reached": share, "unreached": (),
            "makespan_s": cluster.host.now_us() / S,
            "contacts": 0, "first_contact": "", "implement_contacts": 0, "closest_m": inf,
            "worked_twice": 0.0, "work_m": 0.0, "travel_m": 0.0, "pymunk_steps": 0,
        }  # fmt: skip
