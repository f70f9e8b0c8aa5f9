"""The setup of a launch, and the robot file of each of its robots."""

from pathlib import Path
from typing import Any

from agent.interface.geometry import Point
from agent.runtime.declared_values import FieldTable, FleetTable, WarehouseTable
from sim.scenarios.delivery_scenario import is_warehouse, load_warehouse
from sim.scenarios.delivery_setup import DeliverySetup
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import ScenarioError, is_drawn, load
from sim.scenarios.scenario_kind import Kind, named
from tools.language.places import Places, PlacesError

UNLAUNCHED = {
    Kind.ERRANDS: "a scenario of errands", Kind.EXPLORATION: "an arena", Kind.GRID: "a grid map",
}  # fmt: skip
BODY = "sim.record.remote_body:WorldBody"

AnySetting = FieldSetup | DeliverySetup


def setting_of(
    scenario: str, robots: int | None, seed: int | None, keys: Path | None
) -> AnySetting:
    """A field's, or a warehouse's. Raises ScenarioError, also for a scenario of another kind."""
    kind, found = named(scenario)
    if kind in UNLAUNCHED:
        raise ScenarioError(
            f"{scenario}: this is {UNLAUNCHED[kind]}, and a launch has fields and warehouses; "
            f"it is played by: headland run {found}"
        )
    setting: AnySetting
    if is_warehouse(scenario):
        setting = DeliverySetup(load_warehouse(scenario).changed(robots, seed, keys))
    else:
        declared = load(scenario).changed(robots, seed, keys)
        if is_drawn(declared.field.file):
            raise ScenarioError(
                f"{scenario}: a drawn field has no file, which each robot of a launch reads; "
                f"it is played by: headland run {found}"
            )
        setting = FieldSetup(declared)
    places_of(setting)  # said before robots start
    return setting


def places_of(setting: AnySetting) -> str:
    """The text of `places.toml`: what people can name when they speak to this fleet.

    Raises ScenarioError where a place has a name that cannot be said, or is too far away.
    """
    sections: dict[str, Point] = {}
    if isinstance(setting, DeliverySetup):
        own = {f"charger {k}": bay for k, bay in enumerate(setting.house.bays)}
    else:
        own = {"gate": setting.field.gate}
        sections = {section.name: section.ends[0] for section in setting.field.sections}
    text = Places.write({**own, **setting.scenario.places}, sections)
    try:
        Places.parse(text)
    except PlacesError as problem:
        raise ScenarioError(f"{setting.scenario.name}: {problem}") from None
    return text


def robot_document(
    setting: AnySetting,
    slot: int,
    bus: dict[str, Any],
    bodies: Path,
    journal: Path,
    segment: int = 0,
) -> dict[str, Any]:
    """The values of `agent.runtime.robot_file.RobotFile` for one robot, plain as JSON has them.

    `bus`: its table of the same name. `bodies`: the socket of the world. `journal`: the folder of
    the robots' memories. Files are named by their absolute paths.
    """
    scenario = setting.scenario
    fleet = scenario.fleet.model_dump(mode="json", include=set(FleetTable.model_fields))
    if fleet["keys"] is not None:
        fleet["keys"] = str((scenario.folder / fleet["keys"]).absolute())
    document: dict[str, Any] = {
        "name": scenario.name,
        "robot": {"slot": slot, "journal": str(journal.absolute()), "segment": segment},
        "fleet": fleet,
        "bus": bus,
        "body": {"factory": BODY, "options": {"socket": str(bodies)}},
    }
    if isinstance(setting, DeliverySetup):
        return {**document, "warehouse": _warehouse(setting, slot)}
    field = scenario.field.model_dump(mode="json", include=set(FieldTable.model_fields))
    field["file"] = str(scenario.path_of(field["file"]).absolute())
    return {**document, "field": field}


def _warehouse(setting: DeliverySetup, slot: int) -> dict[str, Any]:
    """The warehouse as one robot has it, with the tasks that are known before the start."""
    scenario, known = setting.scenario, setting.house.tasks
    table = scenario.warehouse.model_dump(mode="json", include=set(WarehouseTable.model_fields))
    if "\n" not in table["map"]:
        table["map"] = str((scenario.folder / table["map"]).absolute())
    rows = enumerate(setting.rows)
    return {
        **table,
        "home": setting.starts[slot],
        "seed": setting.search_seed(slot),
        "battery": scenario.battery.model_dump(mode="json"),
        "task": [
            {"number": number, "pickup": row.pickup, "dropoff": row.dropoff}
            for number, row in rows
            if number in known
        ],
    }
