"""A robot file: everything one robot is told before it starts, as TOML.

    name = "north farm"                     # of the fleet, equal for all its robots
    [robot]
    slot = 2
    [fleet]                                 # equal for all robots, too
    robots = 3
    keys = "fleet.keys"
    [field]
    file = "north.geojson"
    [bus]
    interface = "socketcan"
    channel = "can0"
    [body]
    factory = "my_tractor:Tractor"

File names are relative to the folder of the robot file. Its work is a `[field]`, a `[warehouse]`, or a
`[mission]` of your own; without one, the robot is a member that does no work.
"""

from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError

from agent.interface.config import PEERS_MAX
from agent.runtime.declared_values import (
    XY,
    BatteryTable,
    FieldTable,
    FleetTable,
    Table,
    WarehouseTable,
    first_error,
)
from agent.runtime.files.given_file import SETTINGS_BYTES_MAX, GivenFileError, read_toml

LINE_MAX = 1000  # characters of a message


class RobotError(Exception):
    """One line for the person; no content of a file can break the line."""

    def __init__(self, text: str) -> None:
        line = "".join(c if c.isprintable() else " " for c in text)
        super().__init__(line if len(line) <= LINE_MAX else f"{line[: LINE_MAX - 4]} ...")


class RobotTable(Table):
    """What differs between the robots of a fleet."""

    slot: int = Field(ge=0, lt=PEERS_MAX)
    journal: str = "."  # folder of its durable memory
    segment: int = Field(default=0, ge=0)  # of a fleet of several segments; 0: there are no others


class RobotBusTable(Table):
    """A python-can interface; `options` are passed to it."""

    interface: str = "socketcan"
    channel: str = "can0"
    bitrate: int = Field(default=250_000, gt=0)
    options: dict[str, Any] = Field(default={})


class FactoryTable(Table):
    """What a module of yours makes: "package.module:name", called with `options`."""

    factory: str
    options: dict[str, Any] = Field(default={})


class TaskTable(Table):
    """A transport that is known before the start; metres from the corner of the map."""

    number: int = Field(ge=0)
    pickup: XY
    dropoff: XY


class CarrierTable(WarehouseTable):
    """A warehouse as one of its robots has it."""

    home: XY  # where the robot waits
    seed: int = 1  # of its search for plans
    battery: BatteryTable = BatteryTable()
    task: list[TaskTable] = Field(default=[])


class RobotFile(Table):
    """All declared values of one robot."""

    name: str = Field(min_length=1, max_length=64)
    robot: RobotTable
    fleet: FleetTable = FleetTable()
    field: FieldTable | None = None
    warehouse: CarrierTable | None = None
    mission: FactoryTable | None = None
    bus: RobotBusTable = RobotBusTable()
    body: FactoryTable = FactoryTable(factory="agent.runtime.robot_body:StandingBody")
    folder: Path = Field(Path(), exclude=True)  # file names are relative to this folder

    @classmethod
    def of(cls, document: dict[str, Any], name: str, folder: Path) -> Self:
        """From plain values. Raises RobotError, which begins with `name`."""
        try:
            found = cls(**{**document, "folder": folder})
        except ValidationError as problem:
            raise RobotError(f"{name}: {first_error(problem, cls)}") from None
        except TypeError as problem:
            raise RobotError(f"{name}: {problem}") from None
        if found.robot.slot >= found.fleet.robots:
            raise RobotError(
                f"{name}: robot.slot: {found.robot.slot} is not one of {found.fleet.robots} robots "
                f"(0 to {found.fleet.robots - 1})"
            )
        if sum(work is not None for work in (found.field, found.warehouse, found.mission)) > 1:
            raise RobotError(f"{name}: field, warehouse, mission: a robot has one work")
        return found

    @classmethod
    def read(cls, path: Path) -> Self:
        """From a file. Raises RobotError."""
        try:
            return cls.of(read_toml(path, SETTINGS_BYTES_MAX), str(path), path.parent)
        except GivenFileError as problem:
            raise RobotError(f"{path}: {problem}") from None
