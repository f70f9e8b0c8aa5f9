"""Whether a run kept the rules. docs/how/chaos.md explains their names; `headland chaos` prints them.

Some rules are checked elsewhere: S5 by `tests/chaos/test_amnesia.py` and the Spin models, S10 by
`tests/crdt`, S12 by `headland bench forgery`.
"""

from collections import Counter
from typing import NamedTuple

from sim.chaos.protocol_rules import RuleViolation
from sim.chaos.scenario_judge import ScenarioJudge
from sim.scenarios.scenario import Scenario

RULES = {
    "S1": "after a stop no robot moves",
    "S2": "no robot is released without a person's reset",
    "S3": "a reset clears what it names, and nothing else",
    "S4": "reset is not start",
    "S6": "where a member falls silent, all robots stand",
    "S7": "one robot at a time in a section; under policies other than stop, where all hear all",
    "S8": "no two stops with one name",
    "S9": "what was sent is not taken back; a released claim does not return (S11)",
    "S13": "what a robot has sent it still knows after a restart",
    "S14": "only listed transitions of the lifecycle",
    "S15": "no exception, whatever arrives",
    "S16": "one vote and one leader a term",
    "S17": "no two bodies touch",
    "S18": "a robot that has lost its address sends nothing from it",
    "S19": "a robot that has lost its senses stands",
    "S20": "while a stop holds a robot, the standard stop is sent to implements",
    "S21": "a stop that is sent is of this fleet, of a panel of ours, or of a device without a NAME",
    "S22": "a robot whose implement stays down against its command stands",
    "S23": "no lowered implement is drawn over what stands",
    "S24": "no robot works again what it must know as worked",
    "L1": "replicas are equal at the end, and no robot goes on asking",
    "L2": "after the resets no robot remains stopped",
    "L5": "the work is finished in time, all of it",
    "L7": "there is a leader at the end",
}


class Verdict(NamedTuple):
    """What came of one run: broken rules, faults that were injected by kind, and the hash of the
    trace."""

    seed: int
    broken: tuple[RuleViolation, ...]
    faults: Counter[str]
    robots: int
    simulated_s: float
    trace_hash: str

    @property
    def ok(self) -> bool:
        """Whether every rule was kept."""
        return not self.broken


def judge(scenario: Scenario, first_only: bool = False) -> Verdict:
    """Play one scenario under all checkers. With `first_only` the run ends soon after the first
    violation."""
    return verdict_of(ScenarioJudge(scenario, first_only).run())


def verdict_of(play: ScenarioJudge) -> Verdict:
    """What came of a run that is over."""
    assert all(broken.rule in RULES for broken in play.broken)
    scenario = play.scenario
    return Verdict(
        scenario.run.seed, tuple(play.broken), play.faults, scenario.fleet.robots,
        play.outcome.simulated_s if play.outcome else 0.0, play.witness.digest,
    )  # fmt: skip
