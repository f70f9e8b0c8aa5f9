"""The reference of scenario files, and their JSON Schema, printed from the models that read them."""

from collections.abc import Set
from inspect import getdoc
from typing import Any

from pydantic import BaseModel

from sim.scenarios.delivery_scenario import DeliveryFile
from sim.scenarios.exploration_scenario import ExplorationFile
from sim.scenarios.navigation_scenario import NavigationScenario
from sim.scenarios.scenario import Scenario

KINDS: tuple[type[Scenario], ...] = (
    Scenario,
    NavigationScenario,
    DeliveryFile,
    ExplorationFile,
)
OWN = "folder"  # set by the reader, in no file
# What a key means: by `table.key` where the same word means two things, else by the key.
MEANING = {
    "name": "in the report and the names of folders",
    "mission": "which kind of scenario it is",
    "field": "what is worked",
    "fleet": "the robots, which are all alike",
    "bus": "bit rate and faults of the wire",
    "run": "seed, limit and engine",
    "fault": "what goes wrong, and when",
    "places": "names for operators, each with metres east and north",
    "floor": "the building",
    "errands": "starts and goals",
    "obstacles": "boxes that nobody announced",
    "warehouse": "the building, its bays and its transports",
    "battery": "of each carrier",
    "arena": "walls, and where robots start",
    "order": "tasks besides exploration",
    "Order.order": "what the operator commands",
    "file": "GeoJSON, or ISOXML task data: beside the scenario, or one that ships",
    "feature": "which field of a file with several",
    "implement_width_m": "width of the implement",
    "overlap_m": "overlap of two lines; half of it is how far a robot may be off its line. At least 0.1, "
    "with `differential` 0.15, with `ackermann` 0.2",
    "section_length_m": "longest section, which one robot claims at a time; shorter for many robots",
    "unit_m": "length of a unit, the smallest piece of work that is recorded",
    "gate": "where robots enter, metres east and north of the field's middle; none: a corner",
    "robots": "how many",
    "radius_m": "radius of a robot's body",
    "speed_m_s": "highest speed",
    "acceleration_m_s2": "highest acceleration",
    "drive": "how it moves; ackermann is a tractor",
    "wheelbase_m": "between the axles; ackermann",
    "track_m": "between the wheels; differential, ackermann",
    "steer_deg": "full lock; ackermann",
    "silence": "what others do about a silent robot: wait for it, go on slowly, or go on after 2 s",
    "asks": "in a building: stop before an unannounced obstacle and ask, else drive round it",
    "keys": "fleet key file or its folder, of `headland keys new`; `drawn`: from the seed",
    "HungFixes.every_s": "between two fixes",
    "HungFixes.share": "of the difference to the fix that the driver takes over",
    "slip": "share by which wheels slip, at random",
    "rays": "rays of each range sensor",
    "bitrate": "bit/s",
    "loss": "share of frames that a receiver misses, undetected",
    "error_rate": "share of frames destroyed by error frames and sent again",
    "omission": "share of frames that one receiver misses and others get",
    "duplicate": "share of frames that arrive twice",
    "seed": "all chance is drawn from it: the same seed gives the same run",
    "time_limit_s": "longest simulated time",
    "engine": "what moves the bodies; the results are judged alike",
    "map": "Moving AI map: a file, or the drawing itself",
    "cell_m": "side of a cell",
    "margin_m": "distance from walls, besides the radius",
    "each": "goals of each robot, drawn by the seed",
    "starts": "where robots start, metres",
    "goals": "a list of places for each robot, metres",
    "every_s": "mean time between two",
    "lasting_s": "shortest and longest stay",
    "size_m": "side",
    "route": "points, metres east and north; it appears at the first and vanishes at the last",
    "yields": "stand while a robot is in the way",
    "PassingVehicle.length_m": "along its way",
    "PassingVehicle.width_m": "across its way",
    "Person.speed_m_s": "its speed",
    "PassingVehicle.speed_m_s": "its speed",
    "ObstacleTable.size_m": "smallest and largest side",
    "until_s": "none appears later",
    "bays": "places of chargers, metres from the south-west corner",
    "handle_s": "time to pick up or put down a parcel",
    "t_max": "up to so many new tasks are inserted one by one; more are planned together",
    "outage": "bays that give no charge from a time on",
    "tasks": "CSV or JSON lines with transports",
    "random_tasks": "transports drawn by the seed",
    "random_over_s": "time within which they appear",
    "boxes_a_minute": "boxes dropped at random",
    "box_s": "how long a box stays",
    "boxes_until_s": "none is dropped later",
    "bay": "number of the bay, from 0",
    "range_m": "driving range of a full battery; 0: no limit",
    "ArenaTable.range_m": "reach of the range sensors",
    "standby_s": "how long a full battery lasts standing; 0: no limit",
    "dock_s": "time to dock",
    "charge_s": "time of a full charge",
    "reserve": "share kept for the way to a bay",
    "width_m": "from west to east",
    "height_m": "from south to north",
    "solid": "rectangles: west, south, east, north",
    "merge_strategy": "which of two observations of a cell holds",
    "robots_max": "robots that the maps have room for",
    "kind": "the kind",
    "points": "places, metres east and north of the middle",
    "at_s": "when, simulated time",
    "robot": "its number, from 0",
    "for_s": "how long",
    "by_s": "by how much",
    "spread_m": "standard deviation of each range",
    "missing": "share of the echoes that are missing",
    "rate": "probability",
    "islands": "lists of robots that hear only each other",
    "sender": "robot that is not heard",
    "receiver": "robot that does not hear it",
    "disk": "its contents at the restart",
    "reason": "what the person says is the reason",
    "x_m": "metres east",
    "y_m": "metres north",
    "dx_m": "metres to the east",
    "vx_m_s": "metres a second to the east",
    "vy_m_s": "metres a second to the north",
    "turn_rad": "radians counter-clockwise",
    "dy_m": "metres to the north",
    "priority": "of a group that no robot knows; 0 wins",
    "identifier": "instead: all 29 bits",
    "buttons": "how many there are",
    "lost": "of its stop frames, after each that is received",
    "unheard": "none of its stop frames is received",
    "names": "how many of its stops were cleared",
    "UsedStop.every_s": "time between two frames",
    "claims": "it claims an address with its NAME",
    "same_address": "it has the robot's address",
    "what": "what it sends",
    "position": "of an attacker: without a key, replaying what it heard, or with the robot's stolen keys",
    "same_slot": "it has a slot of this fleet",
    "wins": "its NAME is the better one",
    "ppm": "parts in a million; positive: fast",
}


def schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of every kind of scenario, with a description of each key."""
    shared: dict[str, Any] = {}
    choices = []
    for model in KINDS:
        found = model.model_json_schema()
        for name, table in found.pop("$defs").items():
            shared[name] = _described(name, table)
        found["properties"].pop(OWN)
        mission = found["properties"]["mission"]
        if "const" in mission and mission["const"] not in found.get("required", []):
            found["required"] = sorted({*found.get("required", []), "mission"})
        choices.append(_described(model.__name__, found))
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Headland scenario", "$defs": shared, "oneOf": choices,
    }  # fmt: skip


def _described(table: str, found: dict[str, Any]) -> dict[str, Any]:
    for key, value in found["properties"].items():
        value["description"] = meaning(table, key)
    return found


def meaning(table: str, key: str) -> str:
    """What a key of a table means. Raises KeyError for one that nobody has described."""
    return MEANING.get(f"{table}.{key}") or MEANING[key]


def scenario_page() -> str:
    """Every table and key of every kind of scenario: type, range, default, meaning."""
    document = schema()
    parts = [
        "# Scenario files", "",
        "A scenario is a TOML file that `headland run` plays. `headland new mine.toml --like rooms` "
        "writes one. `headland check small` says whether one is right, with the line of what is wrong. "
        "Lengths are in metres, times in seconds, x points east and y north. In a field and an arena "
        "they count from the middle, in a building and a warehouse from the south-west corner.", "",
        "`headland check --schema` prints the JSON Schema of this page. An editor that knows TOML "
        "schemas (Even Better TOML, Taplo) completes keys and marks wrong ones, with "
        "`#:schema headland.schema.json` as the first line of the scenario.", "",
    ]  # fmt: skip
    for model, choice in zip(KINDS, document["oneOf"], strict=True):
        mission = choice["properties"]["mission"]
        words = mission.get("enum") or [mission.get("const")]
        parts += [f"## mission = {' or '.join(repr(w) for w in words)}", "", _doc(model), ""]
        parts += [*_table(choice, document), ""]
    parts += ["# Tables", ""]
    for name, table in sorted(document["$defs"].items()):
        if "kind" not in table["properties"] or name == "OrderTable":
            parts += [f"## {name}", "", table["description"].replace("\n", " "), ""]
            parts += [*_table(table, document), ""]
    parts += ["# Faults", "", "Each is a `[[fault]]` table with a `kind` and a time `at_s`.", ""]
    for _, table in sorted(document["$defs"].items()):
        if "at_s" in table["properties"] and "kind" in table["properties"]:
            parts += [f"## {table['properties']['kind']['const']}", ""]
            parts += [table["description"].replace("\n", " "), ""]
            rows = _table(table, document, leave={"kind", "at_s"})
            parts += [*rows, ""] if len(rows) > 2 else []
    return "\n".join(parts).replace("\n\n\n", "\n\n").rstrip() + "\n"


def _doc(model: type[BaseModel]) -> str:
    return (getdoc(model) or "").replace("\n", " ")


def _table(
    table: dict[str, Any], document: dict[str, Any], leave: Set[str] = frozenset()
) -> list[str]:  # fmt: skip
    rows = ["| key | type | range | default | meaning |", "|---|---|---|---|---|"]
    for key, value in table["properties"].items():
        if key not in leave:
            default = "needed" if key in table.get("required", []) else _default(value)
            rows.append(
                f"| `{key}` | {_type(value)} | {_range(value)} | {default} | {value['description']} |"
            )
    return rows


def _type(value: dict[str, Any]) -> str:
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "discriminator" in value:
        return "[a fault](#faults)"
    if "enum" in value or "const" in value:
        return ", ".join(f"`{word}`" for word in value.get("enum") or [value["const"]])
    if "anyOf" in value:
        return " or ".join(_type(each) for each in value["anyOf"] if each.get("type") != "null")
    if value.get("type") == "array":
        if "prefixItems" in value:
            return f"{len(value['prefixItems'])} numbers"
        return f"list of {_type(value['items'])}"
    words = {
        "number": "number",
        "integer": "whole number",
        "string": "text",
        "boolean": "true or false",
    }
    return words.get(value.get("type", ""), "table")


def _range(value: dict[str, Any]) -> str:
    for each in value.get("anyOf", ()):
        if each.get("type") != "null":
            return _range(each)
    low = value.get("minimum", value.get("exclusiveMinimum"))
    high = value.get("maximum", value.get("exclusiveMaximum"))
    if low is None and high is None:
        return ""
    above = "above " if "exclusiveMinimum" in value else ""
    below = "below " if "exclusiveMaximum" in value else ""
    if high is None:
        return f"{above}{low:g}" if above else f"from {low:g}"
    return f"{above}{low:g} to {below}{_short(high)}"


def _short(number: float) -> str:
    return "2^63 - 1" if number == 2**63 - 1 else f"{number:g}"


def _default(value: dict[str, Any]) -> str:
    if "default" not in value or value["default"] in (None, [], {}):
        return "none"
    default = value["default"]
    if isinstance(default, dict):
        return "as its table"
    if isinstance(default, bool):
        return str(default).lower()
    return f"{default:g}" if isinstance(default, float) else f"{default}"
