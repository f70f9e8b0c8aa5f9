"""`headland run` of a scenario with `mission = "errands"`: robots go to places in a building."""

from collections import Counter
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from statistics import fmean, median

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from sim.files.strict_json import dumps
from sim.runs.navigation_run import NavigationRun, OutingOutcome, RunProgress
from sim.scenarios.navigation_setup import ErrandSetting
from tools.common.result_table import NO_KEYS, run_table
from tools.common.run_recorder import RunRecorder
from tools.run.path_picture import draw_paths

UNFINISHED = 1  # exit code; 0 only for a run without a flaw


def run_errands(
    console: Console, setting: ErrandSetting, out: Path, logs: Sequence[Path], as_json: bool
) -> int:
    keeping = RunRecorder(setting, out)
    outing = NavigationRun(setting, out, None, logs, keeping)
    with Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(), console=console, transient=True,
    ) as progress:  # fmt: skip
        bar = progress.add_task(setting.scenario.name, total=setting.section_count, note="")

        def told(moment: RunProgress) -> None:
            states = ", ".join(
                f"{n} {state}" for state, n in sorted(Counter(moment.states).items())
            )
            note = f"{moment.simulated_s:.0f} s, {moment.reached}/{moment.goals} goals, {states}"
            progress.update(bar, completed=moment.reached, note=note)

        outing.told = told
        try:
            outcome = outing.run()
        finally:
            keeping.close()
    report = {**outcome.to_dict(), "log_hash": keeping.log_hash}
    (out / "report.json").write_text(dumps(report, indent=1) + "\n")
    pictures = draw_paths(outing, outcome, out)
    if as_json:
        print(dumps(report))
    else:
        console.print(outcome_table(outcome))
        names = f"report.json, {len(pictures)} pictures of paths, trace.jsonl, {keeping.logs}"
        console.print(f"{names} are in {out}")
    return 0 if outcome.success else UNFINISHED


def outcome_table(outcome: OutingOutcome) -> Table:
    reached = [leg for leg in outcome.legs if isfinite(leg.arrived_s)]
    errors_m = [leg.rmse_m for leg in reached if isfinite(leg.rmse_m)]
    last_s = [t_s for t_s in outcome.arrived_s if isfinite(t_s)]
    ends = (
        f"; last goals after {median(last_s):.0f} s (median), {max(last_s):.0f} s" if last_s else ""
    )
    planned = f"{sum(leg.replans for leg in outcome.legs)} paths planned anew on the way"
    facts = [
        ("goals", f"{len(reached)} of {len(outcome.legs)} reached{ends}"),
        ("contacts", f"{outcome.contacts} (closest {outcome.closest_m:.2f} m)"),
        ("paths", f"RMSE {fmean(errors_m) if errors_m else 0.0:.3f} m; {planned}"),
        ("agreement", f"{outcome.rounds} rounds, {outcome.unsolved} of them without a plan"),
        ("boxes", f"{outcome.obstacles} came and went"),
        ("replicas", "equal" if outcome.replicas_equal else "[red]differ[/red]"),
        ("driven", f"{outcome.travel_m:.0f} m in {outcome.simulated_s:.0f} s simulated"),
        ("bus load", f"{outcome.bus_load:.1%}"),
        ("malformed frames", str(outcome.malformed)),
        ("authentication", "keys" if outcome.authenticated else NO_KEYS),
    ]
    return run_table(outcome, facts)
