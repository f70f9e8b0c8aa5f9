"""Whether a run kept the rules: checkers that see the world, the wire and the disks, never a robot's
inside. The names S1, S7, ... are those of docs/stopping.md and `headland chaos`.
"""

from collections import Counter, defaultdict
from typing import NamedTuple

from agent.config import MS, beat_of
from agent.effects import Effect, Send, Trace
from agent.field_work import LEAD_M
from agent.lifecycle import TABLE, State
from protocol.fleet_frames import Pose
from protocol.messages import Message
from sim import scenario as kinds
from sim.checkers import ExclusiveWorkChecker, MotionAfterStopChecker
from sim.cluster import Cluster
from sim.disk import Disk, LogJournal
from sim.expedition import Expedition
from sim.outcome import Outcome
from sim.scenario import Scenario
from sim.setting import Setting
from sim.swarm import Swarm
from sim.tape import STANDS, lost
from sim.trace import Recorder
from sim.trouble import AGAIN_S, CALM_S

SLACK_US = 20 * MS  # a control tick, and a frame in the way
RELEASED_S = 12.0  # after the last reset nobody may still stand stopped
ON_LINE_M = 0.2  # closer than this to a line is on it; who comes to another line passes further off
TOUCH_M = 0.02  # deeper than this is a contact; bodies of robots are measured to a centimetre
RULES = {
    "S1": "after a stop nobody moves",
    "S7": "one robot at a time in a section, under the stop policy",
    "S13": "what was told is still known after a restart",
    "S14": "only listed transitions of the lifecycle",
    "S15": "no exception, whatever arrives",
    "S17": "no two bodies touch",
    "L1": "replicas are equal in the end",
    "L2": "after the resets nobody stands stopped",
    "L5": "the field is finished in time, all of it",
}


class Broken(NamedTuple):
    """A rule that was broken."""

    rule: str
    t_s: float
    what: str


class Verdict(NamedTuple):
    seed: int
    broken: tuple[Broken, ...]
    faults: Counter[str]
    robots: int
    simulated_s: float
    trace_hash: str

    @property
    def ok(self) -> bool:
        return not self.broken


class Witness(Recorder):
    """Sees every effect: what was told, and which transitions were made."""

    def __init__(self) -> None:
        super().__init__()
        self.told: defaultdict[int, list[Message]] = defaultdict(list)
        self.broken: list[Broken] = []
        self.released: set[int] = set()  # reset by a person, and not yet shown in a pose
        self._edges = {
            (source.name, event.name.lower(), target.name)
            for (source, event), target in TABLE.items()
        }

    def __call__(self, slot: int, now_us: int, effect: Effect) -> None:
        super().__call__(slot, now_us, effect)
        if isinstance(effect, Send):
            self.told[slot].append(effect.message)
            if isinstance(effect.message, Pose):
                self.released.discard(slot)
        elif isinstance(effect, Trace) and effect.machine == "lifecycle":
            if effect.event == "MANUAL_RESET":
                self.released.add(slot)
            edge = (effect.source, effect.event.lower(), effect.target)
            if effect.source != effect.target and edge not in self._edges:
                self.broken.append(Broken("S14", now_us / 1e6, f"robot {slot}: {' '.join(edge)}"))


class Play:
    """One scenario under the eyes of every checker."""

    def __init__(self, scenario: Scenario) -> None:
        self.setting, self.scenario = Setting(scenario), scenario
        self.witness = Witness()
        self.broken: list[Broken] = []
        self.cluster: Cluster | None = None

    def run(self) -> Verdict:
        expedition = Expedition(self.setting, attach=self._attach)
        expedition.recorder = self.witness
        outcome: Outcome | None = None
        try:
            outcome = expedition.run()
        except Exception as problem:  # an assertion of a robot, or of the simulation: both count
            assert self.cluster is not None
            now_s = self.cluster.host.now_us() / 1e6
            text = f"{type(problem).__name__}: {problem}"
            self.broken.append(Broken("S15", now_s, text))
        if outcome is not None:
            self._judge(outcome)
        self.broken += self.witness.broken
        faults: Counter[str] = Counter(f.kind for f in self.scenario.fault if f.at_s <= CALM_S)
        return Verdict(
            self.scenario.run.seed, tuple(sorted(self.broken, key=lambda b: b.t_s)), faults,
            self.scenario.fleet.robots, outcome.simulated_s if outcome else 0.0,
            self.witness.digest,
        )  # fmt: skip

    def _attach(self, cluster: Cluster) -> None:
        self.cluster = cluster
        for slot in range(self.scenario.fleet.robots):
            cluster.journals[slot] = LogJournal(Disk())
        self.motion = MotionAfterStopChecker(cluster.world)
        self._presses: list[int] = []
        assert isinstance(cluster.host, Swarm)
        for fault in self.scenario.fault:
            at_us = round(fault.at_s * 1e6)
            if isinstance(fault, kinds.Estop):
                cluster.host.at(at_us, lambda slot=fault.robot: self._pressed(slot))  # type: ignore[misc]
            elif isinstance(fault, kinds.Reset):
                cluster.host.at(at_us, self._released)
            elif isinstance(fault, kinds.Crash):
                cluster.host.at(at_us + 1, lambda slot=fault.robot: self._died(slot))  # type: ignore[misc]
            elif isinstance(fault, kinds.Restart):
                cluster.host.at(at_us + 1, lambda slot=fault.robot: self._back(slot))  # type: ignore[misc]
        end_us = round((AGAIN_S + RELEASED_S) * 1e6)
        if any(isinstance(f, kinds.Reset) and f.at_s == AGAIN_S for f in self.scenario.fault):
            cluster.host.at(end_us, self._all_released)

    # ---------------------------------------------------------------- while it runs

    def _pressed(self, slot: int) -> None:
        assert self.cluster is not None
        cluster = self.cluster
        if self.scenario.fleet.silence != "stop" or not cluster.is_up(slot):
            return
        bound_us = beat_of(self.scenario.fleet.robots).silence_us + SLACK_US
        slots = [robot.slot for robot in cluster.running]
        cluster.world.advance(cluster.host.now_us())
        self._presses.append(self.motion.press(cluster.host.now_us(), bound_us, slots))

    def _released(self) -> None:
        for number in self._presses:
            self.motion.release(number)
        self._presses.clear()

    def _died(self, slot: int) -> None:
        """A dead robot is held by nobody's stop; what it does when it is back is another rule."""

    def _back(self, slot: int) -> None:
        assert self.cluster is not None
        restarts = [f for f in self.scenario.fault if isinstance(f, kinds.Restart)]
        now_s = self.cluster.host.now_us() / 1e6
        newest = max((f for f in restarts if f.robot == slot and f.at_s <= now_s),
                     key=lambda f: f.at_s)  # fmt: skip
        if newest.disk == "lost":
            self.witness.told[slot].clear()
            return
        missing = lost(self.witness.told[slot], self.cluster.journals[slot].load())
        if missing and not (missing == STANDS and slot in self.witness.released):
            self.broken.append(Broken("S13", now_s, f"robot {slot} has forgotten {missing}"))

    def _all_released(self) -> None:
        assert self.cluster is not None
        standing = [r.slot for r in self.cluster.running if r.peer.state is State.EMERGENCY_STOP]
        if standing:
            now_s = self.cluster.host.now_us() / 1e6
            self.broken.append(Broken("L2", now_s, f"robots {standing} still stand stopped"))

    # ---------------------------------------------------------------- in the end

    def _judge(self, outcome: Outcome) -> None:
        assert self.cluster is not None
        world, end_s = self.cluster.world, outcome.simulated_s
        for violation in self.motion.violations[:1]:
            self._add("S1", violation.t_us / 1e6, f"robots {violation.slots}: {violation.what}")
        for contact in world.contacts:
            if contact.depth_m > TOUCH_M:
                what = (
                    f"robot {contact.first} {contact.depth_m * 100:.0f} cm into {contact.against}"
                )
                self._add("S17", contact.t_us / 1e6, what)
                break
        if self.scenario.fleet.silence == "stop":
            self._exclusive()
        if not outcome.replicas_equal:
            self._add("L1", end_s, "replicas differ")
        if not outcome.finished or outcome.coverage < 0.9999:
            what = f"finished: {outcome.finished}, coverage {outcome.coverage:.2%}"
            self._add("L5", end_s, what)

    def _exclusive(self) -> None:
        assert self.cluster is not None
        field, world = self.setting.field, self.cluster.world
        sections = {number: list(section.swaths) for number, section in enumerate(field.sections)}
        tracks = {slot: body.track for slot, body in world.robots.items()}
        checker = ExclusiveWorkChecker(sections, ON_LINE_M, least_m=LEAD_M + 0.5)
        for violation in checker.violations(tracks)[:1]:
            self._add("S7", violation.t_us / 1e6, f"robots {violation.slots}: {violation.what}")

    def _add(self, rule: str, t_s: float, what: str) -> None:
        self.broken.append(Broken(rule, t_s, what))


def judge(scenario: Scenario) -> Verdict:
    return Play(scenario).run()
