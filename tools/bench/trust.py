"""`headland bench trust`: what keys defend, what a stolen key can do, and what it costs.

The rows are those of the threat model (`docs/how/trust.md`): an outsider, attacks that were once found,
a thief, the bus, the CPU, the delay of a press, and campaigns with attackers on the bus.
"""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from agent.interface.config import MS, S
from agent.interface.effects import HALT, Effect
from sim.chaos.fault_profiles import draw
from sim.chaos.verdict import judge
from sim.fleet.event_loop import EventLoop
from sim.fleet.scheduler import Script
from sim.fleet.simulated_fleet import Cluster
from sim.scenarios.fleet_setup import DRAWN
from sim.scenarios.protocol_setup import ProtocolSetup, drill
from tools.bench import forged_frames, proof_cost, stolen_key
from tools.bench.chaos import RESULTS
from tools.bench.figure import Figure
from tools.chaos.chaos_report import (
    KEYED,
    KEYED_HOURS_WANTED,
    ReportError,
    is_keyed,
    judged_hours,
)
from tools.common.fingerprint import robots_fingerprint

ROOT = Path(__file__).parents[2]
# The attacks of the findings, each a test that names it; the threat model names those that remain.
ATTACKS = (
    "tests/agent/peer/test_trust_attacks.py", "tests/agent/peer/test_member_conflicts.py",
    "tests/agent/peer/test_work_admission.py", "tests/agent/safety/test_spent_stops.py",
    "tests/agent/safety/test_command_authentication.py", "tests/protocol/test_address.py",
    "tests/agent/safety/test_standard_stop.py", "tests/crdt/test_stops.py",
    "tests/tools/operate/test_release_of_stops.py", "tests/tools/operate/test_confirmations.py",
    "tests/chaos/test_keys.py", "tests/chaos/test_floods.py", "tests/sim/runs/test_delivery_run.py",
    "tests/sim/record/test_remote_body.py", "tests/sim/can/test_socketcand_server.py",
    "tests/tools/livemap/test_map_page.py", "tests/tools/cli/test_given_files.py",
    "tests/agent/runtime/test_sqlite_journal.py", "tests/sim/runs/test_full_disk.py",
)  # fmt: skip
PRESS_ROBOTS, PRESS_AT_S = 20, 12.0
PRESSES, QUICK_PRESSES = 20, 2
SAME_MS = 1.0  # a frame more on the wire before a stop takes 0.6 ms
SEEDS, QUICK_SEEDS = 20, 1  # of each profile


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Every row of the table, the quickest first."""
    yield from proof_cost.figures(quick, seed)
    yield from press_delay(quick, seed)
    if not quick:
        yield from attacks()
    yield from stolen_key.figures(quick, seed)
    yield from forged_frames.figures(quick, seed)
    yield from campaigns(quick, seed)


# -------------------------------------------------------------------- the delay of a press


def stopped_after_us(seed: int, keyed: bool) -> int:
    """From a press until the last of the other robots has braked, on the clock of the wire."""
    loop = EventLoop()
    halted: dict[int, int] = {}
    setting = ProtocolSetup(drill(PRESS_ROBOTS, seed, keys=DRAWN if keyed else None))
    pressed_at_us = round((PRESS_AT_S + seed * 0.0137) * S)

    def record(slot: int, now_us: int, effect: Effect) -> None:
        if effect is HALT and now_us >= pressed_at_us:
            halted.setdefault(slot, now_us)

    cluster = Cluster(setting, f"press {seed}/{keyed}", record, loop)

    def main() -> Script[None]:
        cluster.boot_all()
        yield pressed_at_us
        cluster.press(0)
        yield pressed_at_us + S

    setting.parade.checker()
    loop.run(main())
    assert len(halted) == PRESS_ROBOTS, "a robot has not stopped"
    return max(halted.values()) - pressed_at_us


def press_delay(quick: bool, seed: int) -> Iterator[Figure]:
    """The same presses with keys and without."""
    count = QUICK_PRESSES if quick else PRESSES
    worst = {
        keyed: max(stopped_after_us(seed + k, keyed) for k in range(count)) / MS
        for keyed in (False, True)
    }
    more = worst[True] - worst[False]
    yield Figure(
        f"delay of a press, worst of {count}, that keys add", round(more, 3), "ms", f"<= {SAME_MS:.0f}",
        more <= SAME_MS, "the same fleet without keys",
        f"{PRESS_ROBOTS} whole peers on the simulated wire: {worst[False]:.2f} ms without keys, "
        f"{worst[True]:.2f} ms with",
    )  # fmt: skip


# -------------------------------------------------------------------- attacks that were found


def attacks() -> Iterator[Figure]:
    """The tests of the attacks that were found; only where the sources with their tests are."""
    tests = [path for path in ATTACKS if (ROOT / path).is_file()]
    if not tests:
        return
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--no-header", *tests]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    tail = done.stdout.strip().splitlines()[-1:] or ["no output"]
    failed = sum(line.startswith(("FAILED", "ERROR")) for line in done.stdout.splitlines())
    yield Figure(
        "attacks of the findings that are not resisted as the threat model says",
        failed if done.returncode == 0 or failed else 1, "tests", "0", done.returncode == 0,
        "docs/how/trust.md", f"{len(tests)} files of tests: {tail[0]}",
    )  # fmt: skip


# -------------------------------------------------------------------- campaigns


def campaigns(quick: bool, seed: int) -> Iterator[Figure]:
    """Fleets with keys, with attackers on the bus, under all rules of chaos.

    A few are played here. The hours are those of the committed results, by the robots of today.
    """
    count = QUICK_SEEDS if quick else SEEDS
    profiles = KEYED[:1] if quick else KEYED
    hours, broken = 0.0, []
    for profile in profiles:
        for number in range(seed, seed + count):
            verdict = judge(draw(number, profile))
            hours += verdict.robots * verdict.simulated_s / 3600
            broken += [f"{profile} {number}: {each.rule}" for each in verdict.broken]
    yield Figure(
        "chaos with attackers on the bus: broken rules", len(broken), "rules", "0", not broken,
        "docs/how/chaos.md", f"{hours:.1f} robot-hours of {', '.join(profiles)}, {count} seeds each"
        + "".join(f"; {each}" for each in broken[:3]),
    )  # fmt: skip
    try:
        hours, failed = judged_hours(RESULTS, robots_fingerprint(), is_keyed)
    except ReportError:  # installed without its documents
        return
    yield Figure(
        "chaos with attackers on the bus: robot-hours without a broken rule", hours, "h",
        f">= {KEYED_HOURS_WANTED}", hours >= KEYED_HOURS_WANTED and not failed, "",
        f"read from {RESULTS.relative_to(ROOT)}, not played in this run; {failed} rules broken",
    )  # fmt: skip
