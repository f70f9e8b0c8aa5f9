"""The run of any scenario, by its name: which mission it is, the scenario or its file says."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sim.files.grid_map import GridFileError
from sim.runs.coverage_run import CoverageRun
from sim.runs.delivery_run import DeliveryRun
from sim.runs.exploration_run import ExplorationRun
from sim.runs.field_run import FieldRun
from sim.runs.navigation_run import NavigationRun
from sim.runs.own_mission_run import OwnMissionRun
from sim.runs.run import MissionRun
from sim.scenarios.coverage_setup import CoverageSetup
from sim.scenarios.delivery_scenario import load_warehouse
from sim.scenarios.delivery_setup import DeliverySetup
from sim.scenarios.exploration_scenario import load_arena
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.navigation_scenario import NavigationScenario, load_mission, setting_of
from sim.scenarios.own_mission_setup import MissionMaker, OwnMissionSetup
from sim.scenarios.scenario import ScenarioError
from sim.scenarios.scenario_kind import Kind, named
from tools.run import coverage
from tools.run.coverage_drive import setting_of as grid_setting

AnyRun = MissionRun[Any, Any, Any]
Faults = Sequence[Mapping[str, Any]]
UNITS = {  # what a run counts
    Kind.FIELD: "sections", Kind.ERRANDS: "goals", Kind.DELIVERY: "parcels",
    Kind.EXPLORATION: "cells", Kind.GRID: "cells", Kind.PROTOCOL: "sections",
}  # fmt: skip


def run_of(
    scenario: str, robots: int | None = None, seed: int | None = None, faults: Faults | None = None,
    time_limit_s: float | None = None, drive: str | None = None, mission: MissionMaker | None = None,
) -> AnyRun:  # fmt: skip
    """A run that has not begun. None: as the scenario says. Raises ScenarioError.

    `faults`: tables as in a scenario file, instead of its own. `mission`: what the robots of a
    field do, instead of its swaths.
    """
    kind, name = named(scenario)
    if mission is not None and kind is not Kind.FIELD:
        raise ScenarioError(f"{scenario}: mission: one of your own needs a field, as small")
    if drive is not None and kind not in (Kind.FIELD, Kind.ERRANDS):
        raise ScenarioError(f"{scenario}: drive: of the robots of a field; leave it out")
    changes: dict[str, Any] = {"faults": faults, "time_limit_s": time_limit_s}
    if kind is Kind.GRID:
        return _grid(Path(name), robots, seed or 0, changes)
    if kind is Kind.DELIVERY:
        return DeliveryRun(DeliverySetup(load_warehouse(name).changed(robots, seed, **changes)))
    if kind is Kind.EXPLORATION:
        return ExplorationRun(load_arena(name).changed(robots, seed, **changes))
    changed = load_mission(name).changed(robots, seed, drive=drive, **changes)
    if isinstance(changed, NavigationScenario):
        return NavigationRun(setting_of(changed))
    if mission is not None:
        return OwnMissionRun(OwnMissionSetup(changed, mission))
    return FieldRun(FieldSetup(changed))


def _grid(path: Path, robots: int | None, seed: int, changes: dict[str, Any]) -> CoverageRun:
    try:
        instance = coverage.instance_of(path, robots, seed)
        setting = grid_setting(instance, seed, (), 0.0, "continue", 0.0)
    except (GridFileError, OSError) as problem:
        raise ScenarioError(str(problem)) from None
    if all(change is None for change in changes.values()):
        return CoverageRun(setting)
    return CoverageRun(CoverageSetup(setting.scenario.changed(**changes), instance))
