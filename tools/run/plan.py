"""`headland plan`: which robot would work what, from when to when, without a run."""

import sys
from collections.abc import Iterator
from pathlib import Path

import shapely
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from shapely.geometry import Polygon

from agent.runtime.files.field_error import FieldFileError
from agent.runtime.files.field_file import fields_of
from agent.runtime.files.printable_text import printable
from sim.files.strict_json import dumps
from sim.runs.work_geojson import read_work_geojson
from sim.runs.work_plan import WorkPlan, plan_work
from sim.runs.work_plan_files import write_plan_geojson, write_plan_isoxml, write_plan_kml
from sim.runs.work_record import WorkRecord
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Scenario, ScenarioError, is_drawn, load
from sim.scenarios.scenario_kind import Kind, named
from tools.common.counted import counted
from tools.common.exit_codes import WRONG, code_of, wrong

SOME_FAILED = 1
GEOJSON, KML, TASK_DATA = "plan.geojson", "plan.kml", "TASKDATA"


def plan(
    name: str,
    robots: int | None,
    out: Path | None,
    done: Path | None,
    feature: str | None,
    drive: str | None,
    seed: int,
    as_json: bool,
) -> int:
    """The exit code of `headland plan`: 0 if each field is planned, 1 if one is not, 2 if none is.

    `name`: of a scenario, or a field file. `out`: folder of the files; None: only the table. `done`:
    a work record; what it covers is not planned.
    """
    plans: list[WorkPlan] = []
    failed = False
    try:
        if out is not None and out.is_file():
            return wrong(f"--out {out}: is a file; name a folder, or one that is to be made")
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)  # a wrong one is said before the planning
        record = None if done is None else read_work_geojson(done)
        for scenario in _fields(_field_scenario(name).changed(robots, None, None, feature, drive)):
            try:
                plans.append(_planned(scenario, record, seed))
            except ScenarioError as problem:
                print(f"headland: {problem}", file=sys.stderr)
                failed = True
        if not plans:
            return WRONG
        if record is not None and not any(_meets(record, plan) for plan in plans):
            of = printable(record.name)
            return wrong(f"--done {done}: is the work of {of!r}, which is elsewhere than {name}")
        files = [] if out is None else _written(plans, out)
    except (ScenarioError, FieldFileError) as problem:
        return wrong(problem)
    except OSError as problem:
        return wrong(f"{problem.filename}: {problem.strerror}", code_of(problem))
    if as_json:
        print(dumps({"fields": [_told(p) for p in plans], "files": files}))
    else:
        _print(plans, files)
    return SOME_FAILED if failed else 0


def _field_scenario(name: str) -> Scenario:
    """The scenario of a name. Raises ScenarioError, also if it is of another kind."""
    kind, found = named(name)
    if kind is not Kind.FIELD:
        raise ScenarioError(f"{name}: only fields are planned, and this is of kind {kind.value}")
    return load(found)


def _fields(scenario: Scenario) -> Iterator[Scenario]:
    """The scenario once for each field of its file, if it names none."""
    if is_drawn(scenario.field.file):
        yield scenario
        return
    path = scenario.path_of(scenario.field.file)
    try:
        outlines, broken = fields_of(path)
    except FieldFileError as problem:
        raise ScenarioError(f"{scenario.name}: field.file: {problem}") from None
    names = sorted({*outlines, *broken})
    if scenario.field.feature is not None or len(names) < 2:
        yield scenario
        return
    for name in names:
        yield scenario.changed(feature=name)


def _planned(scenario: Scenario, record: WorkRecord | None, seed: int) -> WorkPlan:
    try:
        return plan_work(FieldSetup(scenario), record, seed)
    except ScenarioError as problem:
        feature = scenario.field.feature
        if feature is None or feature in str(problem):
            raise
        raise ScenarioError(f"{feature}: {problem}") from None


def _meets(record: WorkRecord, plan: WorkPlan) -> bool:
    """Whether the work was done where the field lies."""
    worked, planned = (Polygon(rings[0]) for rings in (record.boundary, plan.boundary))
    return bool(shapely.make_valid(worked).intersects(planned))


def _written(plans: list[WorkPlan], out: Path) -> list[str]:
    out.mkdir(parents=True, exist_ok=True)
    write_plan_geojson(plans, out / GEOJSON)
    write_plan_kml(plans, out / KML)
    files = [str(out / GEOJSON), str(out / KML)]
    try:
        write_plan_isoxml(plans, out / TASK_DATA)
        files.append(str(out / TASK_DATA))
    except FieldFileError as problem:  # without the package; the other files are there
        print(f"headland: left out: {problem}", file=sys.stderr)
    return files


def _told(planned: WorkPlan) -> dict[str, object]:
    return {
        "name": planned.name,
        "hectares": round(planned.hectares, 2),
        "method": planned.method,
        "sections": planned.sections,
        "done": planned.done,
        "ends_at_s": round(planned.ends_at_s, 1),
        "robots": [
            {
                "robot": robot.robot,
                "sections": [section.section for section in robot.sections],
                "work_for_s": round(robot.work_for_s, 1),
                "ways_for_s": round(robot.ways_for_s, 1),
                "ends_at_s": round(robot.ends_at_s, 1),
            }
            for robot in planned.robots
        ],
        "unreached": [part._asdict() for part in planned.unreached],
    }


def _print(plans: list[WorkPlan], files: list[str]) -> None:
    console = Console()
    for planned in plans:
        open_sections = planned.sections - planned.done - planned.apart
        table = Table(
            title=f"{escape(printable(planned.name))}: {planned.hectares:.2f} ha, {open_sections} of "
            f"{counted(planned.sections, '{} section{s}')}, {planned.ends_at_s:.0f} s"
        )
        table.add_column("robot", justify="right")
        table.add_column("sections in order")
        for column in ("work, s", "ways, s", "end, s"):
            table.add_column(column, justify="right")
        for robot in planned.robots:
            table.add_row(
                str(robot.robot), " ".join(f"S{s.section}" for s in robot.sections),
                f"{robot.work_for_s:.0f}", f"{robot.ways_for_s:.0f}", f"{robot.ends_at_s:.0f}",
            )  # fmt: skip
        console.print(table)
        left = "; ".join(f"{part.area_m2:.1f} m2 {part.why}" for part in planned.unreached)
        if left:
            console.print(f"never worked: {left}", soft_wrap=True)
    for file in files:
        console.print(escape(file), soft_wrap=True)
