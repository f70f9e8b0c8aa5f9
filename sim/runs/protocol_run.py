"""One protocol run from power-up to the end: a field run without a world to measure."""

from math import inf

from agent.interface.config import S
from sim.fleet.outcome import Outcome
from sim.fleet.simulated_fleet import Cluster
from sim.fleet.trace_recorder import Recorder
from sim.runs.field_run import FieldRun
from sim.scenarios.protocol_setup import DrillSetting


class ProtocolRun(FieldRun):
    setting: DrillSetting

    def _measure(self, cluster: Cluster, recorder: Recorder, wall_s: float) -> Outcome:
        scenario, parade, wire = self.setting.scenario, self.setting.parade, cluster.segment.wire
        now_s = cluster.host.now_us() / S
        return Outcome(
            scenario=scenario.name, robots=scenario.fleet.robots, seed=scenario.run.seed,
            silence_policy=scenario.fleet.silence, authenticated=False,
            finished=cluster.finished, coverage=parade.share, reachable=1.0,
            reached=parade.share, makespan_s=now_s, worked_twice=0.0,
            units_twice=sum(r.peer.voice.redone for r in cluster.robots.values()),
            contacts=0, moved_after_stop=len(cluster.stops.violations), closest_m=inf,
            replicas_equal=cluster.replicas_equal,
            frames=dict(self.tally.kinds.most_common()),
            bus_load=wire.busy_us / (now_s * 1e6), bus_load_worst_case=wire.worst_us / (now_s * 1e6),
            claims_lost=recorder.lost, malformed=self.tally.malformed, refused=0,
            trace_hash=recorder.digest, sections=self.setting.section_count,
            work_m=0.0, travel_m=0.0, simulated_s=now_s, wall_s=wall_s,
        )  # fmt: skip
