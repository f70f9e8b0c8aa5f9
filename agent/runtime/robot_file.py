"""A robot file: everything one robot is told before it starts, as TOML.

    name = "north farm"                     # of the fleet, equal for all its robots
    [robot]
    slot = 2
    [fleet]                                 # equal for all robots, too
    robots = 3
    keys = "fleet.keys"
    [device]                                # of the NAME of each robot (ISO 11783-5), equal for all
    manufacturer = 1407
    device_class = 24
    [field]
    file = "north.geojson"
    [bus]
    interface = "socketcan"
    channel = "can0"
    [body]
    plugin = "nmea"                         # or: factory = "my_tractor:Tractor"
    options = { gnss = "tcp://10.0.0.5:2947", wheels = "serial:/dev/ttyUSB0" }

One file can be that of the whole fleet. `headland robot fleet.toml --slot 2` says which robot this is,
and a table of each machine has what differs:

    [[machine]]
    slot = 2
    body_options = { wheels = "serial:/dev/ttyUSB1" }

File names are relative to the folder of the robot file. Its work is one of `[field]`, `[warehouse]`,
`[navigation]`, `[exploration]`, `[coverage]`, or a `[mission]` of your own; without one, the robot is a
member that does no work.
"""

from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

from pydantic import Field, ValidationError, model_validator

from agent.exploration.exploration_task import ORDERS_MAX
from agent.interface.config import PEERS_MAX
from agent.interface.geometry import Point
from agent.runtime.declared_values import (
    BatteryTable,
    FieldTable,
    FleetTable,
    FloorTable,
    GridTable,
    OrderTable,
    Table,
    UnknownPlaceTable,
    WarehouseTable,
    first_error,
)
from agent.runtime.files.given_file import SETTINGS_BYTES_MAX, GivenFileError, read_toml
from agent.runtime.files.printable_text import one_line
from protocol.frames.segment_frames import SEGMENT_MAX
from protocol.name import (
    FUNCTION,
    MANUFACTURER,
    OWN_FUNCTIONS,
    TOOL_FUNCTION,
    UTILITY_VEHICLE,
    DeviceFields,
)

VALUE_ERROR = ": value error, "  # how pydantic begins what a validator says
LINE_MAX = 1000  # characters of a message
WORKS = ("field", "warehouse", "navigation", "exploration", "coverage", "mission")


class RobotError(Exception):
    """One line for the person; no content of a file can break the line."""

    code: ClassVar[int] = 2  # of the exit: a person has to mend something

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text, LINE_MAX))


class AbsentError(RobotError):
    """A device of the machine is not there or does not answer: a later start may find it."""

    code = 75  # EX_TEMPFAIL of sysexits.h


class DriverError(RobotError):
    """A driver of a body has a fault: it raised what no driver is to raise, or returned no reading."""

    code = 1  # it failed; a supervisor starts it again


class Changes(NamedTuple):
    """What a command line says instead of the file; None: what the file says."""

    slot: int | None = None
    interface: str | None = None
    channel: str | None = None
    plugin: str | None = None


AS_WRITTEN = Changes()


class RobotTable(Table):
    """What differs between the robots of a fleet."""

    slot: int = Field(ge=0, lt=PEERS_MAX)
    journal: str = "."  # folder of its durable memory
    # Of a fleet of several segments; 0: there are no others.
    segment: int = Field(default=0, ge=0, le=SEGMENT_MAX)


class DeviceTable(Table):
    """What the NAMEs of the fleet say beside identity and industry group (ISO 11783-5); the same for
    all its robots."""

    manufacturer: int = Field(
        default=MANUFACTURER, ge=0, lt=2048
    )  # open to non-commercial projects
    device_class: int = Field(default=UTILITY_VEHICLE, ge=0, lt=128)
    device_class_instance: int = Field(default=0, ge=0, lt=16)
    function: int = Field(default=FUNCTION, ge=OWN_FUNCTIONS[0], le=OWN_FUNCTIONS[-1])
    function_instance: int = Field(default=0, ge=0, lt=32)
    ecu_instance: int = Field(default=0, ge=0, lt=8)

    @model_validator(mode="after")
    def _no_tool(self) -> Self:
        if self.function == TOOL_FUNCTION:
            raise ValueError(f"function {TOOL_FUNCTION} is that of operators' tools")
        return self

    @property
    def fields(self) -> DeviceFields:
        """As a NAME has them."""
        return DeviceFields(**self.model_dump())


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


class BodyTable(Table):
    """The body: a plug-in of the group `headland.body`, or a factory "package.module:name"."""

    plugin: str | None = None
    factory: str | None = None
    options: dict[str, Any] = Field(default={})

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.plugin is None) == (self.factory is None):
            raise ValueError("a body has either plugin or factory")
        return self


class MachineTable(Table):
    """What differs between the machines of one file."""

    slot: int = Field(ge=0, lt=PEERS_MAX)
    body: BodyTable | None = None  # instead of the fleet's
    body_options: dict[str, Any] = Field(default={})  # added to those of the body
    bus: RobotBusTable | None = None  # instead of the fleet's


class TaskTable(Table):
    """A transport that is known before the start; metres from the corner of the map."""

    number: int = Field(ge=0)
    pickup: Point
    dropoff: Point


class CarrierTable(WarehouseTable):
    """A warehouse as one of its robots has it."""

    home: Point  # where the robot waits
    seed: int = 1  # of its search for plans
    battery: BatteryTable = BatteryTable()
    task: list[TaskTable] = Field(default=[])


class NavigationTable(FloorTable):
    """A building, and the goals of each robot of the fleet in their order."""

    goals: list[list[Point]]


class ExplorationTable(UnknownPlaceTable):
    """A place to explore, and what the fleet has to do there besides."""

    order: list[OrderTable] = Field(default=[], max_length=ORDERS_MAX)


class RobotFile(Table):
    """All declared values of one robot."""

    name: str = Field(min_length=1, max_length=64)
    robot: RobotTable
    fleet: FleetTable
    device: DeviceTable = DeviceTable()
    field: FieldTable | None = None
    warehouse: CarrierTable | None = None
    navigation: NavigationTable | None = None
    exploration: ExplorationTable | None = None
    coverage: GridTable | None = None
    mission: FactoryTable | None = None
    bus: RobotBusTable = RobotBusTable()
    body: BodyTable = BodyTable(plugin="standing")
    machine: list[MachineTable] = Field(default=[])
    folder: Path = Field(Path(), exclude=True)  # file names are relative to this folder

    @classmethod
    def of(cls, document: dict[str, Any], name: str, folder: Path) -> Self:
        """From plain values. Raises RobotError, which begins with `name`."""
        try:
            found = cls(**{**document, "folder": folder})
        except ValidationError as problem:
            said = first_error(problem, cls).replace(VALUE_ERROR, ": ")
            raise RobotError(f"{name}: {said}") from None
        except TypeError as problem:
            raise RobotError(f"{name}: {problem}") from None
        # A default number would let a machine wait for members that nobody has.
        if "robots" not in found.fleet.model_fields_set:
            raise RobotError(f"{name}: fleet.robots: is missing")
        if found.robot.slot >= found.fleet.robots:
            raise RobotError(
                f"{name}: robot.slot: {found.robot.slot} is not one of {found.fleet.robots} robots "
                f"(0 to {found.fleet.robots - 1})"
            )
        if sum(getattr(found, work) is not None for work in WORKS) > 1:
            raise RobotError(f"{name}: {', '.join(WORKS)}: a robot has one work")
        if found.robot.segment and found.device != DeviceTable():
            raise RobotError(f"{name}: device: gateways of several segments know the default only")
        slots = [machine.slot for machine in found.machine]
        if len(set(slots)) < len(slots):
            raise RobotError(f"{name}: machine: two have one slot")
        if slots and max(slots) >= found.fleet.robots:
            raise RobotError(
                f"{name}: machine: slot {max(slots)} is not one of {found.fleet.robots} robots "
                f"(0 to {found.fleet.robots - 1})"
            )
        mine = next((each for each in found.machine if each.slot == found.robot.slot), None)
        return found if mine is None else found._on(mine)

    def _on(self, machine: MachineTable) -> Self:
        """With what this machine has of its own. What it does not say stays unset."""
        update: dict[str, Any] = {"bus": machine.bus or self.bus}
        if machine.body is not None or machine.body_options:
            body = machine.body or self.body
            options = {**body.options, **machine.body_options}
            update["body"] = body.model_copy(update={"options": options})
        return self.model_copy(update=update)

    def changed(self, changes: Changes) -> Self:
        """With what a command line says instead."""
        bus: dict[str, Any] = {
            key: value for key in ("interface", "channel") if (value := getattr(changes, key))
        }
        if bus.get("interface", self.bus.interface) != self.bus.interface:
            bus["options"] = {}  # a port of socketcand is no port of udp_multicast
        update: dict[str, Any] = {"bus": self.bus.model_copy(update=bus)}
        if changes.plugin is not None and changes.plugin != self.body.plugin:
            update["body"] = BodyTable(plugin=changes.plugin)
        return self.model_copy(update=update)

    @classmethod
    def read(cls, path: Path, changes: Changes = AS_WRITTEN) -> Self:
        """From a file, with what a command line says instead. Raises RobotError."""
        try:
            document = read_toml(path, SETTINGS_BYTES_MAX)
            if changes.slot is not None:
                robot = document.get("robot", {})
                document["robot"] = (
                    {**robot, "slot": changes.slot} if isinstance(robot, dict) else robot
                )
            return cls.of(document, str(path), path.parent).changed(changes)
        except GivenFileError as problem:
            raise RobotError(f"{path}: {problem}") from None
