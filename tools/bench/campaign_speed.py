"""How fast a campaign goes. A process of its own: what is imported compiled stays so.

Example: python -m tools.bench.campaign_speed all --seed 1 --runs 20
"""

import argparse
import time
from typing import TYPE_CHECKING, NamedTuple

from sim.files.strict_json import dumps
from tools.bench.fresh_process import in_fresh_process
from tools.build.compiled_core import use

if TYPE_CHECKING:
    from sim.scenarios.scenario import Scenario

FIELD = "field"  # instead of a profile: the yard, worked by six robots without trouble
FIELD_ROBOTS = 6


class Campaign(NamedTuple):
    """How much was simulated in a campaign, and for how much computing."""

    robot_s: float  # simulated: seconds of a run times its robots
    cpu_s: float
    runs: int
    broken: int  # runs that broke a rule
    faults: int
    compiled: bool


def measured(profile: str, runs: int, seed: int, interpreted: bool = False) -> Campaign:
    """In a fresh process."""
    words = (profile, "--seed", f"{seed}", "--runs", f"{runs}")
    return Campaign(**in_fresh_process(__spec__.name, *words, interpreted=interpreted))


def campaign(profile: str, runs: int, seed: int) -> Campaign:
    """Here and now: every rule is judged, as `headland chaos` does it."""
    compiled = use()
    from agent.runtime.gc_tuning import freeze_gc
    from sim.chaos.verdict import judge
    from tools.chaos.planted_bug_hunt import warm_up

    warm_up()  # before any clock starts
    freeze_gc()
    begun_s = time.process_time()
    verdicts = [judge(_drawn(profile, s)) for s in range(seed, seed + runs)]
    return Campaign(
        sum(v.robots * v.simulated_s for v in verdicts), time.process_time() - begun_s, runs,
        sum(not v.ok for v in verdicts), sum(v.faults.total() for v in verdicts), compiled,
    )  # fmt: skip


def _drawn(profile: str, seed: int) -> "Scenario":
    from sim.chaos.fault_profiles import draw, with_faults
    from sim.scenarios.scenario import load

    if profile != FIELD:
        return draw(seed, profile)
    return with_faults(load("yard").changed(FIELD_ROBOTS, seed), [])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("profile")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=20)
    given = parser.parse_args()
    print(dumps(campaign(given.profile, given.runs, given.seed)._asdict()))
