"""`headland run`: a fleet explores an arena in virtual time, with a report and pictures of it."""

from math import isfinite
from pathlib import Path

from sim.files.whole_file import write_whole
from sim.runs.exploration_run import ExplorationOutcome, ExplorationRun
from sim.scenarios.exploration_scenario import load_arena
from tools.common.result_table import Fact
from tools.run.map_picture import draw_maps, film
from tools.run.run_mission import MissionCommand, run_mission


def explore(
    scenario: str,
    robots: int | None,
    seed: int | None,
    to: Path | None,
    as_json: bool,
    animate: bool,
) -> int:
    """The exit code of `headland run`: 0 for a run without a flaw, 1 for any other, 2 for a
    wrong argument."""

    def make() -> ExplorationCommand:
        return ExplorationCommand(
            ExplorationRun(load_arena(scenario).changed(robots, seed)), animate
        )

    return run_mission(make, to, as_json)


class ExplorationCommand(MissionCommand[ExplorationRun]):
    """An exploration in virtual time, with maps, a film if wanted, and what the fleet reports."""

    unit = "cells"

    def __init__(self, run: ExplorationRun, animate: bool) -> None:
        super().__init__(run)
        self.animate = animate

    def draw(self, outcome: ExplorationOutcome, folder: Path, log_hash: str) -> list[str]:
        reports = [f"at {now_s:.1f} s\n\n{text}" for now_s, text in self.run.reports]
        write_whole(folder / "fleet.md", "\n".join(reports))
        draw_maps(self.run, outcome, folder / "maps.png")
        films = self.animate and bool(self.run.films)  # none if no robot was ever on
        if films:
            film(self.run, folder / "maps.gif")
        return ["fleet.md", "maps.png", *(["maps.gif"] if films else [])]

    def facts(self, outcome: ExplorationOutcome) -> list[Fact]:
        equal = "equal, bit for bit" if outcome.maps_equal else "[red]differ[/red]"
        reached = isfinite(outcome.time_95_s)
        most = f"{outcome.time_95_s:.1f} s to 95 %" if reached else "95 % were not seen"
        overlap, until = (outcome.overlap, "95 %") if reached else (outcome.overlap_end, "the end")
        tasks = ", ".join(f"{count} {status}" for status, count in sorted(outcome.tasks.items()))
        return [
            (
                "explored",
                f"{outcome.explored:.1%} of what can be seen; {outcome.right:.1%} of it right",
            ),
            ("time", f"{most}, {outcome.time_s:.1f} s to the end"),
            ("overlap", f"{overlap:.0%} of the area seen again by another, at {until}"),
            ("maps", equal),
            ("contacts", f"{outcome.contacts} (closest {outcome.closest_m:.2f} m)"),
            ("tasks", f"{tasks}; {outcome.switched} left for a better one"),
            ("driven", f"{outcome.travel_m:.0f} m"),
            ("map on the bus", f"{outcome.map_load:.1%}, {outcome.map_bytes_per_m2:.0f} bytes/m2"),
            ("bus load", f"{outcome.bus_load:.1%} at worst-case stuffing"),
            ("malformed frames", str(outcome.malformed)),
        ]
