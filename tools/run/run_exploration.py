"""`headland explore`: a fleet explores an arena in virtual time, with a report and pictures of it."""

import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from agent.exploration.exploration_task import FleetFullError
from sim.files.strict_json import dumps
from sim.runs.exploration_run import ExplorationRun, Sharing, SurveyOutcome
from sim.scenarios.exploration_scenario import load_arena
from sim.scenarios.scenario import ScenarioError
from tools.common.result_table import run_table
from tools.common.run_folder import FolderError, folder_for
from tools.common.run_recorder import RunRecorder
from tools.run.map_picture import draw_maps, film

UNFINISHED, WRONG = 1, 2  # exit codes; 0 only for a run without a flaw


def explore(
    scenario: str,
    robots: int | None,
    seed: int | None,
    to: Path | None,
    as_json: bool,
    animate: bool,
) -> int:
    console = Console(stderr=as_json)
    try:
        arena = load_arena(scenario).changed(robots, seed)
        out = folder_for(to, arena.name)
        survey = ExplorationRun(arena, Sharing.FLEET, out)
        survey.attach = keeping = RunRecorder(survey.setting, out)
        with console.status(f"{survey.setting.scenario.name}: exploring"):
            try:
                outcome = survey.run()
            finally:
                keeping.close()
    except (ScenarioError, FleetFullError, FolderError) as problem:
        print(f"headland: {problem}", file=sys.stderr)
        return WRONG
    except OSError as problem:
        print(f"headland: --out: {problem}", file=sys.stderr)
        return WRONG
    report = {**outcome.to_dict(), "log_hash": keeping.log_hash}
    (out / "report.json").write_text(dumps(report, indent=1) + "\n")
    told = "\n".join(f"at {now_s:.1f} s\n\n{text}" for now_s, text in survey.reports)
    (out / "fleet.md").write_text(told, encoding="utf-8")
    draw_maps(survey, outcome, out / "maps.png")
    if animate:
        film(survey, out / "maps.gif")
    if as_json:
        print(dumps(report))
    else:
        console.print(outcome_table(outcome))
        names = f"report.json, fleet.md, maps.png, trace.jsonl, {keeping.logs}"
        console.print(f"{names}{', maps.gif' if animate else ''} are in {out}")
    return 0 if outcome.success else UNFINISHED


def outcome_table(outcome: SurveyOutcome) -> Table:
    equal = "equal, bit for bit" if outcome.maps_equal else "[red]differ[/red]"
    tasks = ", ".join(f"{count} {status}" for status, count in sorted(outcome.tasks.items()))
    facts = [
        (
            "explored",
            f"{outcome.explored:.1%} of what can be seen; {outcome.right:.1%} of it right",
        ),
        ("time", f"{outcome.time_95_s:.1f} s to 95 %, {outcome.time_s:.1f} s to the end"),
        ("overlap", f"{outcome.overlap:.0%} of the area seen again by another, at 95 %"),
        ("maps", equal),
        ("contacts", f"{outcome.contacts} (closest {outcome.closest_m:.2f} m)"),
        ("tasks", f"{tasks}; {outcome.switched} left for a better one"),
        ("driven", f"{outcome.travel_m:.0f} m"),
        ("map on the bus", f"{outcome.map_load:.1%}, {outcome.map_bytes_per_m2:.0f} bytes/m2"),
        ("bus load", f"{outcome.bus_load:.1%} at worst-case stuffing"),
        ("malformed frames", str(outcome.malformed)),
    ]
    return run_table(outcome, facts)
