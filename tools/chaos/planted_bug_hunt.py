"""`headland chaos --mutants`: how soon each planted bug is found; a search may be done in parts.

Each is hunted in the profile that `sim/chaos/planted_bugs.py` names, seed after seed from a first
one. What was found is kept in `mutants.json`, or `mutants-FIRST.json` where the first seed is
another than 0; another call goes on with the rest, each hunt at the seed at which it stopped, so
that a budget of CPU time can be spent a few minutes at a time. A broken rule counts only where the
same seed keeps it without the bug; what that costs is part of the time.
"""

import json
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.console import Console

from sim.chaos.fault_profiles import draw
from sim.chaos.planted_bugs import MUTANTS, planted
from sim.chaos.verdict import judge
from sim.files.strict_json import dumps
from sim.files.whole_file import write_whole
from tools.chaos.campaign import workers
from tools.common.fingerprint import fingerprint

MUTANT_CPU_S = 600.0  # the budget within which every planted bug must be found
RESULTS = "mutants.json"
TURN_CPU_S = 20.0  # length of a turn, so that bugs that are found soon do not wait for others
WARM_S = 6.0  # simulated time after which robots drive
Row = dict[str, Any]


def warm_up() -> None:
    """Compiled kernels are loaded: a few seconds of a run with bodies, and its raster."""
    judge(draw(0, "all").changed(time_limit_s=WARM_S))


def hunt(row: Row, end_s: float) -> Row:
    """Go on looking for a planted bug, for a turn, or until it is found or the time is over."""
    before_s, begun_s = row["cpu_s"], time.process_time()
    most_s = min(MUTANT_CPU_S, before_s + TURN_CPU_S)
    mutant = MUTANTS[row["mutant"]]
    while not row["found"] and row["cpu_s"] <= most_s and time.monotonic() < end_s:
        scenario = draw(row["first"] + row["runs"], mutant.profile)
        with planted(row["mutant"]):
            broken = judge(scenario, first_only=True).broken
        row["runs"] += 1
        if broken:
            rule = broken[0].rule
            if all(other.rule != rule for other in judge(scenario).broken):
                row["found"], row["rule"] = True, rule
        row["cpu_s"] = round(before_s + time.process_time() - begun_s, 1)
    return row


def hunt_all(
    console: Console,
    only: Iterable[str],
    jobs: int,
    seconds: float | None,
    out: Path,
    as_json: bool,
    first: int = 0,
) -> list[Row]:
    """All planted bugs, or those named; rows of those that are not hunted to the end come along."""
    rows = {name: _fresh(name, first) for name in only or MUTANTS}
    path = out / (f"mutants-{first}.json" if first else RESULTS)
    if path.exists():
        then = json.loads(path.read_text())
        if then["code"] == fingerprint():  # results of other code do not count
            kept = {row["mutant"]: row for row in then["mutants"]}
            rows = kept | {name: kept.get(name, row) for name, row in rows.items()}
    warm_up()  # so that no hunt pays for it
    end_s = time.monotonic() + (seconds if seconds is not None else float("inf"))
    with workers(jobs) as pool:
        while time.monotonic() < end_s:
            waiting = [rows[name] for name in (only or MUTANTS) if _is_open(rows[name])]
            waiting.sort(key=lambda row: float(row["cpu_s"]))
            if not waiting:
                break
            for future in [pool.submit(hunt, row, end_s) for row in waiting[:jobs]]:
                row = future.result()
                rows[row["mutant"]] = row
                _tell(console, row, as_json)
            results = {"code": fingerprint(), "budget_s": MUTANT_CPU_S, "mutants": [*rows.values()]}
            write_whole(path, dumps(results, indent=1) + "\n")
    return list(rows.values())


def _fresh(name: str, first: int) -> Row:
    return {"mutant": name, "about": MUTANTS[name].about, "first": first,
            "profile": MUTANTS[name].profile, "found": False, "runs": 0,
            "cpu_s": 0.0, "rule": ""}  # fmt: skip


def _is_open(row: Row) -> bool:
    return not row["found"] and row["cpu_s"] <= MUTANT_CPU_S


def _tell(console: Console, row: Row, as_json: bool) -> None:
    if as_json:
        print(dumps(row), flush=True)
        return
    unfound = "[yellow]not yet  [/]" if _is_open(row) else "[red]NOT FOUND[/]"
    found = f"[green]{row['rule']:4}[/]" if row["found"] else unfound
    console.print(f"{found} {row['runs']:3} runs {row['cpu_s']:6.1f} s  "
                  f"{row['mutant']}: {row['about']}")  # fmt: skip
