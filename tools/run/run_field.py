"""`headland run` of a field, a building or a protocol: to the end in virtual time, with a report."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from agent.interface.config import S
from sim.fleet.outcome import FieldOutcome
from sim.runs.field_run import FieldRun
from sim.runs.work_geojson import write_geojson
from sim.runs.work_record import record_of
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.navigation_scenario import NavigationScenario, load_mission
from sim.scenarios.scenario import ScenarioError
from sim.world.ground_truth import TrackPoint
from tools.build.warmup import warm_field
from tools.common.counted import counted
from tools.common.result_table import NO_KEYS, Fact
from tools.run.picture import PlaceMark, draw_field
from tools.run.run_mission import MissionCommand, run_mission
from tools.run.run_navigation import NavigationCommand


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
    film: bool = False,
) -> int:
    """The exit code of `headland run`: 0 for a run without a flaw, 1 for any other, 2 for a wrong
    argument.

    `page_port`: of a map that shows the run, and at a terminal stays after its end. `film`: film.gif.
    """

    def make() -> MissionCommand[Any]:
        changed = load_mission(scenario).changed(
            robots, seed, keys, feature, drive, time_limit_s=limit_s
        )
        if not isinstance(changed, NavigationScenario):
            return FieldCommand(FieldRun(FieldSetup(changed)))
        if page_port is not None:
            raise ScenarioError(f"{changed.name}: the map page shows fields only; leave --map out")
        return NavigationCommand.of(changed)

    return run_mission(make, out, as_json, logs, page_port, film)


MARKED = {
    "crash": "crash", "estop": "stop pressed", "box": "box", "person": "person, vehicle",
    "vehicle": "person, vehicle",
}  # fmt: skip


def marks_of(
    faults: Sequence[Mapping[str, Any]], tracks: Mapping[int, Sequence[TrackPoint]]
) -> list[PlaceMark]:
    """Where faults were, of those that have a place: of a robot, where it was then."""
    found = []
    for fault in faults:
        what, at_us = MARKED.get(fault["kind"]), fault["t_s"] * S
        if what is None:
            continue
        if "x_m" in fault:
            found.append(PlaceMark(what, fault["x_m"], fault["y_m"]))
        elif fault.get("route"):
            found.append(PlaceMark(what, *fault["route"][0]))
        else:
            before = [point for point in tracks.get(fault["robot"], ()) if point[0] <= at_us]
            found += [PlaceMark(what, before[-1][1], before[-1][2])] if before else []
    return found


def work_export() -> tuple[str, str]:
    """The command by which farm software gets the work, with what is installed, and why."""
    place = "WORK" if Path("TASKDATA").exists() else "TASKDATA"  # which may be what was worked
    form = "--geojson work.json" if find_spec("isoxml") is None else f"--isoxml {place}"
    return f"export {{}} {form}", "the finished work, for farm software"


class FieldCommand(MissionCommand[FieldRun]):
    """A field in virtual time, with its picture, and work for farm software."""

    unit = "sections"
    warm = staticmethod(warm_field)
    follow_up = (work_export(),)

    def draw(self, outcome: FieldOutcome, folder: Path, log_hash: str) -> list[str]:
        field, tracks = self.run.setting.field, self.run.tracks
        robots = counted(outcome.robots, "{} robot{s}")
        title = f"{outcome.scenario}: {robots}, {outcome.makespan_s:.0f} s"
        rows = {s: [(x, y, tool) for _, x, y, tool in t] for s, t in tracks.items()}
        missed = None if self.run.truth is None else self.run.truth.missed
        marks = marks_of(self.run.told_faults, tracks)
        draw_field(field, rows, title, folder / "field.png", missed, marks)
        # The work ends now: farm software takes no work of the future.
        started = datetime.now(UTC) - timedelta(seconds=outcome.simulated_s)
        work = record_of(field, tracks, outcome.finished, started)
        write_geojson(work, folder / "work.geojson", log_hash)
        return ["field.png", "work.geojson"]

    def facts(self, outcome: FieldOutcome) -> list[Fact]:
        sections = counted(outcome.sections, "{} section{s}") + (
            "" if outcome.finished else ", not all done"
        )
        overlap = f"{outcome.worked_twice:.1%} of the area overlaps"
        twice = counted(outcome.units_twice, "{} unit{s}")
        worst = f"{outcome.bus_load_worst_case:.1%}"
        return [
            ("coverage", f"{outcome.coverage:.2%} of the area that can be worked ({sections})"),
            ("reachable", told_reach(outcome)),
            ("makespan", f"{outcome.makespan_s:.1f} s of {outcome.simulated_s:.0f} s simulated"),
            ("duplicate work", f"{twice} announced twice; {overlap}"),
            ("contacts", f"{outcome.contacts} (closest {outcome.closest_m:.2f} m)"),
            ("implements met", counted(outcome.implement_contacts, "{} time{s}, while they were down")),
            ("implements over things", counted(outcome.things_under_bars, "{} time{s}, while down")),
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


def told_reach(outcome: FieldOutcome) -> str:
    """What these bodies can work of the field, how much of it they have, and why not the rest."""
    told = f"{outcome.reachable:.2%} of that area, of which {outcome.reached:.2%} is worked"
    left = "; ".join(f"{part.area_m2:.1f} m2 {part.why}" for part in outcome.unreached)
    return f"{told}; never worked: {left}" if left else told
