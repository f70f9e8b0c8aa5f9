"""`headland check`: scenario files as a run would load them, and what is wrong with which."""

import sys

from sim.files.strict_json import dumps
from sim.scenarios.delivery_scenario import load_warehouse
from sim.scenarios.delivery_setup import DeliverySetup
from sim.scenarios.exploration_scenario import ExplorationSetup, load_arena
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.fleet_setup import FleetSetup
from sim.scenarios.navigation_scenario import NavigationScenario, load_mission, setting_of
from sim.scenarios.scenario import ScenarioError
from sim.scenarios.scenario_kind import Kind, named
from tools.common.exit_codes import WRONG
from tools.run.launch_setup import AnySetting, places_of


def check(names: list[str], as_json: bool) -> int:
    """The exit code of `headland check`: 0, or 2 if one is wrong."""
    told = []
    for name in names:
        row: dict[str, object] = {"scenario": name, "kind": Kind.FIELD.value}
        try:
            row["kind"] = named(name).kind.value
            setup = setup_of(name)
        except (ScenarioError, OSError) as problem:  # a name may be too long for a file system
            why = f"{name}: {problem.strerror}" if isinstance(problem, OSError) else str(problem)
            row |= {"ok": False, "problem": why}
            if not as_json:
                print(f"headland: {why}", file=sys.stderr)
        else:
            scenario = setup.scenario
            row |= {"ok": True, "robots": scenario.fleet.robots, "faults": len(scenario.fault)}
            if not as_json:
                counts = [_count(scenario.fleet.robots, "robot")]
                if scenario.fault:
                    counts.append(_count(len(scenario.fault), "fault"))
                print(f"{name}: right: {row['kind']}, {', '.join(counts)}")
        told.append(row)
    if as_json:
        print(dumps(told))
    return 0 if all(row["ok"] for row in told) else WRONG


def setup_of(name: str) -> FleetSetup:
    """Everything that a run needs, but for its bodies. Raises ScenarioError."""
    kind, path = named(name)
    if kind is Kind.GRID:
        raise ScenarioError(f"{name}: a map is no scenario: headland run {name} plans and plays it")
    if kind is Kind.DELIVERY:
        return _said(DeliverySetup(load_warehouse(path)))
    if kind is Kind.EXPLORATION:
        return ExplorationSetup(load_arena(path))
    scenario = load_mission(path)
    return (
        setting_of(scenario)
        if isinstance(scenario, NavigationScenario)
        else _said(FieldSetup(scenario))
    )


def _said(setup: AnySetting) -> AnySetting:
    """The same. Raises ScenarioError where `headland say` cannot name its places."""
    places_of(setup)
    return setup


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + "s" * (number != 1)
