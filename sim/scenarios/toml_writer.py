"""A scenario as the TOML text that `sim/scenarios/scenario.py` reads."""

import json
from collections.abc import Mapping
from typing import Any

from sim.scenarios.scenario import Scenario, is_drawn


def to_toml(scenario: Scenario) -> str:
    """Write only given values; omitted ones have their defaults."""
    document = scenario.model_dump(mode="json", exclude_unset=True)
    file = document["field"]["file"]
    if not is_drawn(file):
        document["field"]["file"] = str(scenario.path_of(file).resolve())
    faults = document.pop("fault", [])
    plain = {key: value for key, value in document.items() if not isinstance(value, Mapping)}
    lines = [f"{key} = {_value(value)}" for key, value in plain.items()]
    for name, table in document.items():
        if isinstance(table, Mapping):
            lines += ["", f"[{name}]", *_pairs(table)]
    for fault in faults:
        lines += ["", "[[fault]]", *_pairs(fault)]
    return "\n".join(lines) + "\n"


def _pairs(table: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {_value(value)}" for key, value in table.items() if value is not None]


def _value(value: Any) -> str:
    """Strings, numbers, booleans and lists of them have the same form in JSON and in TOML."""
    return json.dumps(value)
