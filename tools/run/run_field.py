"""`headland run`: a scenario to its end in virtual time, a report of what came of it."""

import sys
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from agent.interface.lifecycle import State
from sim.files.can_log import open_log
from sim.files.strict_json import dumps
from sim.fleet.outcome import Outcome
from sim.record.recording import Recording
from sim.runs.field_run import FieldRun, RunProgress
from sim.runs.work_geojson import write_geojson
from sim.runs.work_record import record_of
from sim.scenarios.field_setup import Setting
from sim.scenarios.navigation_scenario import ErrandScenario, load_mission, setting_of
from sim.scenarios.navigation_setup import ErrandSetting
from sim.scenarios.scenario import Scenario, ScenarioError
from tools.common.result_table import NO_KEYS, run_table
from tools.common.run_folder import FolderError, folder_for
from tools.common.run_recorder import RunRecorder
from tools.livemap.command import MapThread, ServerError
from tools.run.picture import draw_field
from tools.run.run_navigation import run_errands

UNFINISHED, WRONG = 1, 2  # exit codes; 0 only for a run without a flaw


def run(
    scenario: str,
    robots: int | None,
    seed: int | None,
    out: Path | None,
    as_json: bool,
    keys: Path | None = None,
    logs: Sequence[Path] = (),
    feature: str | None = None,
    drive: str | None = None,
    page_port: int | None = None,
    limit_s: float | None = None,
) -> int:
    """`page_port`: of a map that shows the run, and at a terminal stays after its end."""
    console = Console(stderr=as_json)
    try:
        changed = load_mission(scenario).changed(
            robots, seed, keys, feature, drive, time_limit_s=limit_s
        )
        errands = _errands(changed, page_port)
        setting = Setting(changed) if errands is None else errands
        for log in logs:
            open_log(log).close()  # so that what is wrong is known before the run, not after
        folder = folder_for(out, changed.name)
        if isinstance(setting, ErrandSetting):
            return run_errands(console, setting, folder, logs, as_json)
        shown = None if page_port is None else MapThread(Recording(), setting.field.name, page_port)
        keeping = RunRecorder(setting, folder, None if shown is None else shown.server.recording)
    except (ScenarioError, ServerError, FolderError) as problem:
        print(f"headland: {problem}", file=sys.stderr)
        return WRONG
    except (OSError, ValueError) as problem:
        print(f"headland: --out or --log: {problem}", file=sys.stderr)
        return WRONG
    if shown is not None:
        console.print(f"map: {shown.url}")
    try:
        outcome, expedition = _watch(console, setting, folder, logs, keeping)
    finally:
        keeping.close()
    report = {**outcome.to_dict(), "log_hash": keeping.log_hash, "faults": expedition.told_faults}
    (folder / "report.json").write_text(dumps(report, indent=1) + "\n")
    tracks = {s: [(x, y, tool) for _, x, y, tool in t] for s, t in expedition.tracks.items()}
    title = f"{setting.field.name}: {outcome.robots} robots, {outcome.makespan_s:.0f} s"
    draw_field(setting.field, tracks, title, folder / "field.png")
    started = datetime.now(UTC) - timedelta(seconds=outcome.wall_s)
    work = record_of(setting.field, expedition.tracks, outcome.finished, started)
    write_geojson(work, folder / "work.geojson", keeping.log_hash)
    if as_json:
        print(dumps(report), flush=True)
    else:
        console.print(outcome_table(outcome))
        console.print(
            f"report.json, field.png, work.geojson, trace.jsonl, {keeping.logs} are in {folder}"
        )
    if shown is not None and sys.stdout.isatty():  # without a person it would never end
        console.print(f"the map stays at {shown.url} until Ctrl-C")
        shown.join()
    return 0 if outcome.success else UNFINISHED


def _errands(scenario: Scenario, page_port: int | None) -> ErrandSetting | None:
    """None where the scenario is one of a field."""
    if not isinstance(scenario, ErrandScenario):
        return None
    if page_port is not None:
        raise ScenarioError(f"{scenario.name}: the map page shows fields only; leave --map out")
    return setting_of(scenario)


def _watch(
    console: Console, setting: Setting, out: Path, logs: Sequence[Path], keeping: RunRecorder
) -> tuple[Outcome, FieldRun]:
    with Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>5.1f} %"),
        TextColumn("{task.fields[note]}"), TimeElapsedColumn(), console=console, transient=True,
    ) as progress:  # fmt: skip
        bar = progress.add_task(f"{setting.field.name}", total=1.0, note="")

        def told(moment: RunProgress) -> None:
            counts = ", ".join(
                f"{moment.states.count(state.name)} {state.name}"
                for state in State
                if state.name in moment.states
            )
            note = f"{moment.simulated_s:.0f} s, {moment.done}/{moment.sections} sections, {counts}"
            progress.update(bar, completed=moment.progress, note=note)

        expedition = FieldRun(setting, out, told, logs, attach=keeping)
        return expedition.run(), expedition


def told_reach(outcome: Outcome) -> str:
    """What these bodies can work of the field, how much of it they have, and why not the rest."""
    told = f"{outcome.reachable:.2%} of that area, of which {outcome.reached:.2%} is worked"
    left = "; ".join(f"{part.area_m2:.1f} m2 {part.why}" for part in outcome.unreached)
    return f"{told}; never worked: {left}" if left else told


def outcome_table(outcome: Outcome) -> Table:
    sections = f"{outcome.sections} sections" + ("" if outcome.finished else ", not all done")
    overlap = f"{outcome.worked_twice:.1%} of the area overlaps"
    worst = f"{outcome.bus_load_worst_case:.1%}"
    facts = [
        ("coverage", f"{outcome.coverage:.2%} of the area that can be worked ({sections})"),
        ("reachable", told_reach(outcome)),
        ("makespan", f"{outcome.makespan_s:.1f} s of {outcome.simulated_s:.0f} s simulated"),
        ("duplicate work", f"{outcome.units_twice} units announced twice; {overlap}"),
        ("contacts", f"{outcome.contacts} (closest {outcome.closest_m:.2f} m)"),
        ("implements met", f"{outcome.implement_contacts} times, while they were down"),
        ("moved after a stop", str(outcome.moved_after_stop)),
        ("replicas", "equal" if outcome.replicas_equal else "[red]differ[/red]"),
        ("driven", f"{outcome.travel_m:.0f} m for {outcome.work_m:.0f} m of swaths"),
        ("bus load", f"{outcome.bus_load:.1%} ({worst} at worst-case stuffing)"),
        ("malformed frames", str(outcome.malformed)),
        ("refused frames", f"{outcome.refused} without authority, or before their sender's proof"),
        ("claims lost", str(outcome.claims_lost)),
        ("silence policy", outcome.silence_policy),
        ("authentication", "keys" if outcome.authenticated else NO_KEYS),
    ]  # fmt: skip
    return run_table(outcome, facts)
