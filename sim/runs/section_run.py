"""One run of a fleet whose work is sections, whatever the robots do in them."""

from typing import Any

from agent.interface.config import S
from sim.fleet.scheduler import Host
from sim.fleet.simulated_fleet import Cluster, Record
from sim.runs.run import MissionRun, OutcomeT, RunProgress, SetupT, states_of


class SectionRun(MissionRun[SetupT, Cluster, OutcomeT]):
    """Counts sections and units, of a field and of a mission that its user wrote."""

    def make_fleet(self, channel: str, record: Record, host: Host) -> Cluster:
        """A plain cluster."""
        return Cluster(self.setting, channel, record, host)

    def progress(self, cluster: Cluster) -> RunProgress:
        """Sections that are done by the best replica, and the share of units."""
        peers = [robot.peer for robot in cluster.running]
        done = max((peer.allocation.done_count() for peer in peers), default=0)
        share = max((peer.progress.fraction() for peer in peers), default=0.0)
        now_s, total = cluster.host.now_us() / S, self.setting.reachable_count
        return RunProgress(now_s, done, total, share, states_of(cluster))

    def measure(self, cluster: Cluster) -> dict[str, Any]:
        return {
            "units_twice": sum(robot.peer.redone for robot in cluster.robots.values()),
            "sections": self.setting.section_count,
        }
