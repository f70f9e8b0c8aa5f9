"""Chaos: how fast trouble is simulated, what campaigns and planted bugs showed, what decoders took.

Everything is measured in the run, but for the hours of the long campaign: that has its own command
(`headland chaos`), and a short one here shows the rate at which it goes.
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from sim.chaos.fault_profiles import draw
from sim.chaos.fuzz_targets import TARGETS
from sim.chaos.planted_bugs import MUTANTS, planted
from sim.chaos.verdict import judge
from tools.bench.campaign_speed import FIELD
from tools.bench.campaign_speed import measured as measured_campaign
from tools.bench.drill_speed import measured
from tools.bench.figure import Figure
from tools.chaos.chaos_report import (
    BUGS_WANTED,
    HOURS_WANTED,
    RUNS_WANTED,
    ReportError,
    judged_hours,
)
from tools.chaos.fuzz import every
from tools.chaos.planted_bug_hunt import warm_up
from tools.common.fingerprint import ROOT, robots_fingerprint

SIZES = ((5, 1000.0), (20, 100.0), (50, 20.0), (100, 5.0))  # robots, simulated s per CPU s wanted
SHARE_S = 1.5  # CPU time given to each size, --quick
QUICK_MUTANTS = ("hold-forgotten", "latch-forgotten", "claims-uncontested")
BUDGET_S = 600.0
RESULTS = ROOT / "docs" / "measured" / "chaos_runs"
RUNS_CI = 100_000  # of decoders
NOTHING = "nothing: our own figure"
RUNS = (("protocol", 1, 200), ("all", 1, 100), (FIELD, 2, 10))  # --quick, and in full
CAMPAIGN_WANTED = {"all": 300.0, FIELD: 300.0}  # six robots at 50 s a CPU second
COMPILED, INTERPRETED = "compiled core", "interpreted: see `headland compile`"


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Speeds of drills and campaigns, and what the committed results say of today's robots."""
    for robots, wanted in SIZES:
        speed = measured(robots, seed, SHARE_S if quick else 10 * SHARE_S)
        how = COMPILED if speed.compiled else INTERPRETED
        yield Figure(
            f"simulated seconds per CPU second, protocol only, {robots} robots", speed.rate, "s/s",
            f">= {wanted:.0f}", speed.rate >= wanted, NOTHING,
            f"whole core, wire, words and commands judged; 20 beats a second up to 30 robots; {how}",
        )  # fmt: skip
    for profile, few, runs in RUNS:
        yield from _campaign(profile, few if quick else runs, seed)
    yield from _committed()
    warm_up()  # before any clock starts
    yield from _bugs(QUICK_MUTANTS if quick else tuple(MUTANTS), quick)
    yield from _decoders(quick, seed)


def _campaign(profile: str, runs: int, seed: int) -> Iterator[Figure]:
    done = measured_campaign(profile, runs, seed)
    how = COMPILED if done.compiled else INTERPRETED
    mission = "the yard without faults, 6 robots" if profile == FIELD else f"profile {profile}"
    scope = f"{runs} runs of {mission}, {done.faults} faults, every rule judged; {how}"
    rate, wanted = done.robot_s / done.cpu_s, CAMPAIGN_WANTED.get(profile)
    yield Figure(f"robot-seconds per CPU second, {mission}", rate, "s/s",
                 "none" if wanted is None else f">= {wanted:.0f}",
                 None if wanted is None else rate >= wanted, NOTHING, scope)  # fmt: skip
    yield Figure(f"runs that broke a rule, {mission}", done.broken, "runs", "0", done.broken == 0,
                 NOTHING, scope)  # fmt: skip
    yield Figure(f"robot-hours judged in this run, {mission}", done.robot_s / 3600, "h", "none", None,
                 NOTHING, scope)  # fmt: skip


def _committed() -> Iterator[Figure]:
    """What the committed results say of the robots as they are now; of others they say nothing."""
    robots = robots_fingerprint()
    scope = (
        f"read from {RESULTS.relative_to(ROOT)}, not played in this run; today's robots {robots}"
    )
    try:
        hours, broken = judged_hours(RESULTS, robots)
    except ReportError:  # installed without its documents
        return
    yield Figure("robot-hours in the committed results, profile protocol", hours, "h",
                 f">= {HOURS_WANTED:.0f}", hours >= HOURS_WANTED, NOTHING, scope)  # fmt: skip
    yield Figure("rules broken in them", broken, "rules", "0", broken == 0, NOTHING, scope)


def _bugs(names: tuple[str, ...], quick: bool) -> Iterator[Figure]:
    found, slowest_s = 0, 0.0
    for name in names:
        begun_s = time.process_time()
        for number in range(400):
            scenario = draw(number, MUTANTS[name].profile)
            with planted(name):
                hit = not judge(scenario, first_only=True).ok
            hit = hit and judge(scenario).ok  # and the right code keeps the rules
            spent_s = time.process_time() - begun_s
            if hit or spent_s > BUDGET_S or (quick and number == 3):
                break
        found += hit
        slowest_s = max(slowest_s, spent_s)
    wanted = len(names) if quick else BUGS_WANTED
    scope = f"{len(names)} of the {len(MUTANTS)} bugs of sim/chaos/planted_bugs.py"
    yield Figure("planted bugs found", found, "bugs", f">= {wanted}", found >= wanted, NOTHING,
                 scope)  # fmt: skip
    yield Figure("slowest hunt for a planted bug", slowest_s, "CPU s", f"<= {BUDGET_S:.0f}",
                 slowest_s <= BUDGET_S, NOTHING, scope)  # fmt: skip


def _decoders(quick: bool, seed: int) -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as scratch:
        fast = every(["frame"], RUNS_CI if quick else RUNS_WANTED, seed, Path(scratch))
        others = [name for name in TARGETS if name != "frame"]
        slow = every(others, 300 if quick else 100_000, seed, Path(scratch))
        rows = [*fast, *slow]
    done, wanted = sum(row.executions for row in rows), RUNS_CI if quick else RUNS_WANTED
    crashes = sum(not row.ok for row in rows)
    engines = ", ".join(sorted({row.engine for row in rows}))
    scope = f"{len(rows)} targets of sim/chaos/fuzz_targets.py, engine {engines}"
    yield Figure("decoder executions", done, "runs", f">= {wanted}", done >= wanted, NOTHING, scope)
    yield Figure(
        "decoders that broke a promise", crashes, "targets", "0", crashes == 0, NOTHING, scope
    )
