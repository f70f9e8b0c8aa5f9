"""Warehouse scenarios: a map, bays, batteries, and tasks from the file, from CSV or JSON lines."""

import csv
from collections.abc import Iterable
from pathlib import Path
from random import Random
from typing import Any, Literal, NamedTuple

from pydantic import Field

from agent.interface.geometry import Point
from agent.runtime.declared_values import BatteryTable, FieldTable, Table
from agent.runtime.declared_values import WarehouseTable as RobotWarehouse
from agent.runtime.files.given_file import (
    SCENARIO_BYTES_MAX,
    TASKS_BYTES_MAX,
    GivenFileError,
    parse_json,
    read_text,
    read_toml,
)
from protocol.frames.delivery_frames import TASK_NUMBERS
from sim.scenarios.scenario import (
    WAREHOUSES,
    FleetTable,
    RunTable,
    Scenario,
    ScenarioError,
    load_kind,
)

TASK_KEYS = ("pickup_x_m", "pickup_y_m", "dropoff_x_m", "dropoff_y_m", "at_s")


class TaskRow(NamedTuple):
    """One task of a file: metres from the south-west corner of the map, seconds from the start."""

    pickup: Point
    dropoff: Point
    at_s: float = 0.0


class Outage(Table):
    """From this time a bay gives no charge."""

    bay: int = Field(ge=0)
    at_s: float = Field(ge=0.0)


class WarehouseTable(RobotWarehouse):
    """The building, its bays, and where the transports come from."""

    outage: list[Outage] = Field(default=[])
    tasks: str | None = None  # CSV or JSON lines
    random_tasks: int = Field(default=0, ge=0, lt=TASK_NUMBERS)  # drawn with the seed of the run
    random_over_s: float = Field(default=0.0, ge=0.0)  # the seconds in which they arrive
    boxes_a_minute: float = Field(default=0.0, ge=0.0, le=60.0)  # dropped at random, for box_s
    box_s: float = Field(default=20.0, gt=0.0)
    boxes_until_s: float = Field(default=120.0, ge=0.0)


class WarehouseFleet(FleetTable):
    """The robots of a warehouse, smaller and slower than those of a field."""

    robots: int = Field(default=6, ge=1, le=108)
    radius_m: float = Field(default=0.3, gt=0.05, le=5.0)
    speed_m_s: float = Field(default=1.0, gt=0.05, le=12.7)
    acceleration_m_s2: float = Field(default=2.0, gt=0.05, le=10.0)
    silence: Literal["stop", "slow", "continue"] = "continue"


class DeliveryScenario(Scenario):
    """A scenario file with `mission = "delivery"`."""

    mission: Literal["delivery"] = "delivery"  # type: ignore[assignment]
    field: FieldTable = FieldTable(file="")  # there is no field
    fleet: FleetTable = WarehouseFleet()
    run: RunTable = RunTable()
    warehouse: WarehouseTable
    battery: BatteryTable = BatteryTable()


class DeliveryFile(DeliveryScenario):
    """A scenario file with `mission = "delivery"`, with the smaller robots of a warehouse as defaults."""

    fleet: WarehouseFleet = WarehouseFleet()


def is_warehouse(name: str) -> bool:
    """Whether a name is that of a warehouse; errors in the file are reported when it is loaded."""
    path = Path(name)
    if not path.suffix and not path.is_file():
        path = WAREHOUSES / f"{name}.toml"
    if path.suffix != ".toml" or not path.is_file():
        return False
    try:
        return read_toml(path, SCENARIO_BYTES_MAX).get("mission") == "delivery"
    except GivenFileError:
        return False


def load_warehouse(name: str) -> DeliveryScenario:
    """Load by file, or by the name of a shipped one."""
    return load_kind(name, DeliveryFile, WAREHOUSES)


def read_tasks(path: Path) -> list[TaskRow]:
    """Read CSV with a header, or JSON lines, with the keys `TASK_KEYS`; `at_s` may be left out.
    Raises ScenarioError, which names the file and the line."""
    try:
        text = read_text(path, TASKS_BYTES_MAX)
    except GivenFileError as problem:
        raise ScenarioError(f"{path}: {problem}") from None
    rows = _json_lines(path, text) if path.suffix.lower() in (".jsonl", ".json") else _csv(text)
    return [_row(path, number, row) for number, row in rows]


def _csv(text: str) -> Iterable[tuple[int, Any]]:
    return enumerate(csv.DictReader(text.splitlines()), start=2)


def _json_lines(path: Path, text: str) -> Iterable[tuple[int, Any]]:
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip():
            try:
                yield number, parse_json(line)
            except GivenFileError as problem:
                raise ScenarioError(f"{path}: line {number}: {problem}") from None


def _row(path: Path, number: int, row: Any) -> TaskRow:
    if not isinstance(row, dict):
        raise ScenarioError(f"{path}: line {number}: not an object with {', '.join(TASK_KEYS)}")
    found = []
    for key in TASK_KEYS:
        value: Any = row.get(key)
        if key == "at_s" and value in (None, ""):
            value = 0.0
        try:
            found.append(float(value))
        except (TypeError, ValueError):
            raise ScenarioError(
                f"{path}: line {number}: {key}: a number is needed, not {value!r}"
            ) from None
    return TaskRow((found[0], found[1]), (found[2], found[3]), found[4])


def random_tasks(cells: list[Point], count: int, within_for_s: float, rng: Random) -> list[TaskRow]:
    """Transports between random cells, in the order in which they appear within `within_for_s`."""
    rows = []
    for _ in range(count):
        pickup, dropoff = rng.sample(cells, 2)
        rows.append(
            TaskRow(pickup, dropoff, rng.uniform(0.0, within_for_s) if within_for_s else 0.0)
        )
    return sorted(rows, key=lambda row: row.at_s)
