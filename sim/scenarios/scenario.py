"""Scenario files: validated TOML; an invalid file gives one line with the key and the reason."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar
from unicodedata import category

from pydantic import Field, ValidationError

from agent.interface.config import PEERS_MAX
from agent.runtime.declared_values import FieldTable, Table, first_error, line_of
from agent.runtime.declared_values import FleetTable as RobotFleet
from agent.runtime.files.field_error import NOT_READ
from agent.runtime.files.given_file import (
    SCENARIO_BYTES_MAX,
    GivenFileError,
    parse_toml,
    read_text,
)
from agent.runtime.files.printable_text import one_line
from sim.world.step_engine import Engine

SHIPPED = Path(__file__).parent
ARENAS, WAREHOUSES = SHIPPED.parent / "arenas", SHIPPED.parent / "warehouses"
SEED_MAX = 2**63 - 1  # the largest value that every format with a seed can hold
AT_MAX_S = 1e6  # of a fault: longer than any run
LINE_MAX = 1000  # characters of a message
DRAWN_FIELD = "drawn:"  # and a seed, in place of a field's file
# A field file alone is a scenario of defaults. Those that are not read are told so.
FIELD_FILES = (".geojson", ".json", ".xml", ".zip", *NOT_READ)


class ScenarioError(Exception):
    """One line for the author of the file; no content of the file can break the line."""

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text, LINE_MAX))


class FleetTable(RobotFleet):
    """How many robots there are, what bodies they have, and what they do about silence."""

    slip: float = Field(default=0.02, ge=0.0, le=0.3)
    # Of each robot's range sensors; a gap of 0.35 m at 4 m.
    rays: int = Field(default=72, ge=8, le=720)


class BusTable(Table):
    """Bit rate and faults of the bus from the start."""

    bitrate: Literal[125_000, 250_000, 500_000, 1_000_000] = 250_000
    loss: float = Field(default=0.0, ge=0.0, le=0.9)
    error_rate: float = Field(default=0.0, ge=0.0, le=0.5)
    omission: float = Field(default=0.0, ge=0.0, le=0.9)
    duplicate: float = Field(default=0.0, ge=0.0, le=0.9)


class RunTable(Table):
    """Seed, limit and engine of the run."""

    seed: int = Field(default=1, ge=0, le=SEED_MAX)
    time_limit_s: float = Field(default=3600.0, gt=0.0, le=86_400.0)
    engine: Engine = "pymunk"


class _Fault(Table):
    at_s: float = Field(ge=0.0, le=AT_MAX_S)


ReasonName = Literal[
    "OBSTACLE_DETECTED", "OPERATOR_INTERVENTION", "SYSTEM_FAULT", "COLLISION_DETECTED",
    "PERSON_IN_FIELD", "EQUIPMENT_MALFUNCTION", "MAINTENANCE_REQUIRED",
]  # fmt: skip
Slot = Annotated[int, Field(ge=0, lt=PEERS_MAX)]


class Partition(_Fault):
    """The bus is cut into islands of robots; robots that no island names stay in the first."""

    kind: Literal["partition"]
    islands: list[list[Slot]]


class Heal(_Fault):
    """All links work again."""

    kind: Literal["heal"]


class OneWay(_Fault):
    """The receiver gets no frame from the sender, until a heal."""

    kind: Literal["one_way"]
    sender: Slot
    receiver: Slot


# The contents of a robot's disk when it is switched on again. torn: the power failed, unsynced data
# is damaged; rolled_back: an earlier state was restored; lost: empty.
DiskState = Literal["kept", "lost", "torn", "rolled_back"]


class Crash(_Fault):
    """The power of a robot fails."""

    kind: Literal["crash"]
    robot: Slot


class Restart(_Fault):
    """A robot is switched on again, with its disk in this state."""

    kind: Literal["restart"]
    robot: Slot
    disk: DiskState = "kept"


class Freeze(_Fault):
    """The process of a robot does nothing, and then gets everything that waited."""

    kind: Literal["freeze"]
    robot: Slot
    for_s: float = Field(gt=0.0)


class _Rated(_Fault):
    rate: float = Field(ge=0.0, le=1.0)


class Loss(_Rated):
    """From now on each receiver misses frames with this probability, and no node detects it."""

    kind: Literal["loss"]


class Omission(_Rated):
    """From now on receivers miss frames that others get, with this probability (inconsistent
    omission)."""

    kind: Literal["omission"]


class Duplicate(_Rated):
    """From now on frames arrive twice, with this probability."""

    kind: Literal["duplicate"]


class Errors(_Fault):
    """From now on frames are destroyed by error frames and sent again, with this probability."""

    kind: Literal["errors"]
    rate: float = Field(ge=0.0, le=0.5)


class BusOff(_Fault):
    """The controller of a robot leaves the bus for a while."""

    kind: Literal["bus_off"]
    robot: Slot
    for_s: float = Field(gt=0.0)


class Estop(_Fault):
    """A person presses the stop at a robot."""

    kind: Literal["estop"]
    robot: Slot
    reason: ReasonName = "OPERATOR_INTERVENTION"


class Reset(_Fault):
    """An operator clears every stop, resets every machine, and starts again."""

    kind: Literal["reset"]


class Order(_Fault):
    """An operator sends a command to one robot."""

    kind: Literal["order"]
    robot: Slot
    order: Literal["wait", "continue", "replan", "stop", "go_home", "set_goal", "start", "hold",
                   "manual_reset"]  # fmt: skip
    x_m: float = 0.0  # for set_goal
    y_m: float = 0.0


class Box(_Fault):
    """Something stands in the field for a while."""

    kind: Literal["box"]
    x_m: float
    y_m: float
    size_m: float = Field(default=1.0, gt=0.0, le=20.0)
    for_s: float = Field(gt=0.0)


class _Moving(_Fault):
    route: list[tuple[float, float]] = Field(min_length=2, max_length=64)
    yields: bool = True


class Person(_Moving):
    """A person walks along a route. No frame tells the robots; they see it."""

    kind: Literal["person"]
    speed_m_s: float = Field(default=1.3, gt=0.0, le=4.0)


class PassingVehicle(_Moving):
    """A vehicle of somebody else drives along a route. No frame tells the robots; they see it."""

    kind: Literal["vehicle"]
    speed_m_s: float = Field(default=3.0, gt=0.0, le=15.0)
    length_m: float = Field(default=4.5, gt=0.0, le=20.0)
    width_m: float = Field(default=2.0, gt=0.0, le=6.0)


class Pushed(_Fault):
    """Somebody moves a machine, as far as there is room."""

    kind: Literal["pushed"]
    robot: Slot
    dx_m: float
    dy_m: float


class Join(_Fault):
    """A robot is switched on only now."""

    kind: Literal["join"]
    robot: Slot


class Babble(_Fault):
    """A device sends frames without pause."""

    kind: Literal["babble"]
    priority: int = Field(default=7, ge=0, le=7)  # of a group that no robot knows
    # instead: all 29 bits of the identifier; below 0x00FF0000 it outranks a stop, and
    # 0 outranks every frame
    identifier: int | None = Field(default=None, ge=0, lt=1 << 29)
    for_s: float = Field(gt=0.0)


class Buttons(_Fault):
    """Shortcut buttons of other makers permit, and one of them is pressed."""

    kind: Literal["buttons"]
    buttons: int = Field(default=2, ge=2, le=8)
    for_s: float = Field(gt=0.0)
    lost: int = Field(default=0, ge=0, le=1)  # of its stop frames, after each one that is received
    unheard: bool = False  # none of its stop frames is received; its permit then reveals the stop


class UsedStop(_Fault):
    """A panel is pressed after an operator has cleared its next names."""

    kind: Literal["used_stop"]
    names: int = Field(default=4, ge=1, le=64)
    for_s: float = Field(gt=0.0)
    every_s: float = Field(default=0.005, ge=0.001, le=1.0)


class Foreign(_Fault):
    """A device of another maker uses our proprietary groups for its own data."""

    kind: Literal["foreign"]
    claims: bool = True  # an address with its NAME; else its maker is unknown
    for_s: float = Field(gt=0.0)


class Twin(_Fault):
    """A second machine has the slot and the NAME of a robot."""

    kind: Literal["twin"]
    robot: Slot
    same_address: bool = False  # as the robot; else it has a separate one
    for_s: float = Field(gt=0.0)


class Nonsense(_Fault):
    """A device sends what no fleet has: another field, impossible work, or claims of every address."""

    kind: Literal["nonsense"]
    what: Literal["field", "work", "claims"]
    # The address from which the work is sent; the slot of the robot of another field.
    robot: Slot = 0
    same_slot: bool = False  # the robot of another field has it; else its slot is not of this fleet
    for_s: float = Field(default=1.0, gt=0.0)


class Forger(_Fault):
    """An attacker on the bus of a fleet with keys: without a key, replaying, or with a stolen one."""

    kind: Literal["forger"]
    position: Literal["outside", "replaying", "inside"]
    robot: Slot  # the attacker sends in its name; `inside`: the attacker has its keys
    for_s: float = Field(gt=0.0)


class Clone(_Fault):
    """A device claims the address of a robot, with the better NAME or the worse."""

    kind: Literal["clone"]
    robot: Slot
    wins: bool = True


class Blind(_Fault):
    """No observation reaches a robot, as with a muted antenna or a dead driver."""

    kind: Literal["blind"]
    robot: Slot
    for_s: float = Field(gt=0.0)


class Frozen(_Fault):
    """The old position of a robot arrives with new times, as from a filter that hangs."""

    kind: Literal["frozen"]
    robot: Slot
    for_s: float = Field(gt=0.0)


class HungFixes(_Fault):
    """The receiver of a robot repeats its old fix, and the driver adds the way of the wheels to it."""

    kind: Literal["hung_fixes"]
    robot: Slot
    every_s: float = Field(gt=0.0)  # between two fixes
    share: float = Field(gt=0.0, le=1.0)  # of the difference to the fix that the driver takes over
    for_s: float = Field(gt=0.0)


class Jumped(_Fault):
    """The place of a robot arrives wrong by this much: a wrong fix, reflections, swapped antennas."""

    kind: Literal["jumped"]
    robot: Slot
    dx_m: float = Field(ge=-1e4, le=1e4)
    dy_m: float = Field(ge=-1e4, le=1e4)
    turn_rad: float = Field(default=0.0, ge=-3.2, le=3.2)
    for_s: float = Field(gt=0.0)


class Drifting(_Fault):
    """The place of a robot drifts away, and its receiver says how far it may be wrong."""

    kind: Literal["drifting"]
    robot: Slot
    vx_m_s: float = Field(ge=-10.0, le=10.0)
    vy_m_s: float = Field(ge=-10.0, le=10.0)
    for_s: float = Field(gt=0.0)


class DeafWheels(_Fault):
    """No command reaches the wheels of a robot, so that they stand."""

    kind: Literal["deaf_wheels"]
    robot: Slot
    for_s: float = Field(gt=0.0)


class Slipping(_Fault):
    """The wheels of a robot slip: mud, ice, wet grass."""

    kind: Literal["slipping"]
    robot: Slot
    slip: float = Field(gt=0.0, le=0.5)  # standard deviation of the grip of each wheel
    for_s: float = Field(gt=0.0)


class StuckImplement(_Fault):
    """The implement of a robot does not rise: one that is down, or is lowered meanwhile, stays down."""

    kind: Literal["stuck_implement"]
    robot: Slot
    for_s: float = Field(gt=0.0)


class Late(_Fault):
    """The observations of a robot arrive this much later."""

    kind: Literal["late"]
    robot: Slot
    by_s: float = Field(gt=0.0, le=60.0)
    for_s: float = Field(gt=0.0)


class NoRays(_Fault):
    """No scan of its range sensors reaches a robot."""

    kind: Literal["no_rays"]
    robot: Slot
    for_s: float = Field(gt=0.0)


class StuckRays(_Fault):
    """The same old scan reaches a robot again and again, as from a driver that hangs."""

    kind: Literal["stuck_rays"]
    robot: Slot
    for_s: float = Field(gt=0.0)


class NoisyRays(_Fault):
    """The scans of a robot are wrong by chance, and some echoes are missing: dust, rain, sun."""

    kind: Literal["noisy_rays"]
    robot: Slot
    spread_m: float = Field(gt=0.0, le=1.0)  # standard deviation of each range
    missing: float = Field(default=0.0, ge=0.0, le=1.0)  # share of the echoes
    for_s: float = Field(gt=0.0)


class DiskFull(_Fault):
    """The disk of a robot accepts no write; then it is switched on with another one."""

    kind: Literal["disk_full"]
    robot: Slot
    for_s: float = Field(gt=0.0)


class Drift(_Fault):
    """The clock of a robot runs fast or slow from now on."""

    kind: Literal["drift"]
    robot: Slot
    ppm: float = Field(ge=-100_000.0, le=100_000.0)


class ClockJump(_Fault):
    """The clock of a robot leaps, forwards or backwards."""

    kind: Literal["clock_jump"]
    robot: Slot
    by_s: float = Field(ge=-60.0, le=86_400.0)


class CrashWorking(_Fault):
    """A robot dies in the middle of a section, at the next opportunity, and is switched on again
    later."""

    kind: Literal["crash_working"]
    robot: Slot
    for_s: float = Field(gt=0.0)  # then it is switched on again
    disk: DiskState = "kept"


Fault = Annotated[
    Partition | Heal | OneWay | Crash | Restart | Freeze | Loss | Omission | Duplicate | Errors
    | BusOff | Estop | Reset | Order | Box | Person | PassingVehicle | Pushed | Join | Babble
    | Clone | Drift
    | ClockJump | CrashWorking
    | Blind | Frozen | HungFixes | Jumped | Drifting | DeafWheels | Slipping | Late
    | NoRays | StuckRays | NoisyRays | StuckImplement
    | DiskFull
    | Buttons | UsedStop | Foreign | Twin | Nonsense | Forger,
    Field(discriminator="kind"),
]  # fmt: skip


MISSIONS = ("field", "errands", "delivery", "exploration", "drill", "sprint")
DRILLS = ("drill", "sprint")  # no world, only work by the clock; a sprint is short and contended


class Scenario(Table):
    """A whole scenario file: what is worked by which robots, and which faults happen when."""

    name: str = Field(min_length=1, max_length=64)
    # Or a mission without a world: see DRILLS.
    mission: Literal["field", "drill", "sprint"] = "field"
    field: FieldTable
    fleet: FleetTable = FleetTable()
    bus: BusTable = BusTable()
    run: RunTable = RunTable()
    fault: list[Fault] = Field(default=[])
    # Names for operators; metres east and north.
    places: dict[str, tuple[float, float]] = Field(default={})
    folder: Path = Field(Path(), exclude=True)  # file names are relative to this folder

    def path_of(self, name: str) -> Path:
        """The path of a file named in the scenario: beside it, or else a shipped one."""
        beside = self.folder / name
        ships = SHIPPED / name
        return ships if not beside.exists() and ships.is_file() else beside

    def with_engine(self, engine: Engine) -> Self:
        """The same, with its bodies moved by another engine."""
        return self.model_copy(update={"run": self.run.model_copy(update={"engine": engine})})

    def changed(
        self, robots: int | None = None, seed: int | None = None, keys: Path | None = None,
        feature: str | None = None, drive: str | None = None,
        faults: Sequence[Mapping[str, Any]] | None = None, time_limit_s: float | None = None,
    ) -> Self:  # fmt: skip
        """A copy with some values replaced. ScenarioError if a value is out of range."""
        document = self.model_dump(exclude_unset=True)
        if faults is not None:
            document["fault"] = list(faults)
        if time_limit_s is not None:
            document.setdefault("run", {})["time_limit_s"] = time_limit_s
        if robots is not None:
            document.setdefault("fleet", {})["robots"] = robots
        if keys is not None:
            document.setdefault("fleet", {})["keys"] = str(keys.absolute())
        if drive is not None:
            document.setdefault("fleet", {})["drive"] = drive
        if seed is not None:
            document.setdefault("run", {})["seed"] = seed
        if feature is not None:
            document.setdefault("field", {})["feature"] = feature
        return _validate(document, self.name, self.folder, type(self))


Kind = TypeVar("Kind", bound=Scenario)


def shipped(folder: Path = SHIPPED) -> list[str]:
    """Names of the scenarios in a folder, in alphabetical order."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def is_drawn(file: str) -> bool:
    """Whether this is the name of a drawn field (`sim/scenarios/drawn_field.py`) and not of a file."""
    return file.startswith(DRAWN_FIELD)


def is_field_source(name: str) -> bool:
    """Whether a name is that of a field file, of a folder of task data, or of a drawn field.

    A folder without task data does not hide a scenario of its name that ships: the page `small.html` of
    a report has its pictures in a folder `small`.
    """
    path = Path(name)
    if is_drawn(name):
        return True
    if path.suffix.lower() in FIELD_FILES or not path.is_dir():
        return path.suffix.lower() in FIELD_FILES
    if not any(name in shipped(folder) for folder in (SHIPPED, ARENAS, WAREHOUSES)):
        return True
    return any(each.name.upper().startswith("TASKDATA") for each in path.iterdir())


def load(name: str) -> Scenario:
    """A scenario by file, by the name of a shipped one, or a field file with defaults for the
    rest."""
    path = Path(name)
    if is_field_source(name):
        title = path.resolve().stem[:64] or "field"
        document = {"name": title, "field": {"file": path.name}}
        return _validate(document, name, path.parent, Scenario)
    return load_kind(name, Scenario, SHIPPED)


def load_kind(name: str, kind: type[Kind], folder: Path) -> Kind:
    """The same for another kind of scenario, shipped in another folder."""
    document, beside, text = _read(name, folder)
    return _validate(document, name, beside, kind, text)


def read_document(name: str, folder: Path) -> tuple[dict[str, Any], Path]:
    """The parsed scenario file, and the folder that its file names are relative to. Raises
    ScenarioError if there is no such file, or if it is no TOML."""
    return _read(name, folder)[:2]


def _read(name: str, folder: Path) -> tuple[dict[str, Any], Path, str]:
    """The same, and the text of the file."""
    path = Path(name)
    if not path.suffix and not path.is_file() and (folder / f"{name}.toml").exists():
        path = folder / f"{name}.toml"
    if not path.exists():
        raise ScenarioError(
            f"{name}: no such file, and no scenario of that name ships{_meant(name)}"
        )
    try:
        text = read_text(path, SCENARIO_BYTES_MAX)
        return parse_toml(text), path.parent, text
    except GivenFileError as problem:
        raise ScenarioError(f"{name}: {problem}") from None


def _meant(name: str) -> str:
    """The shipped name that was probably meant, of any kind, or all of them."""
    folders = (SHIPPED, SHIPPED.parent / "warehouses", SHIPPED.parent / "arenas")
    known = sorted({each for folder in folders for each in shipped(folder)})
    if name in known:
        return " of the kind that is needed here; see: headland list"
    near = get_close_matches(name, known, n=1)
    return f"; did you mean {near[0]!r}?" if near else f" ({', '.join(known)})"


def _validate(
    document: dict[str, Any], name: str, folder: Path, kind: type[Kind], text: str = ""
) -> Kind:
    mission = document.get("mission", "field")
    if mission not in MISSIONS:
        meant = get_close_matches(str(mission), MISSIONS, n=1)
        hint = f"did you mean {meant[0]!r}?" if meant else f"it is one of {', '.join(MISSIONS)}"
        line = line_of(text, ("mission",))
        where = "" if line is None else f"line {line}: "
        raise ScenarioError(f"{name}: {where}mission: not {str(mission)!r:.60}; {hint}")
    try:
        scenario = kind(**{**document, "folder": folder})
    except ValidationError as problem:
        raise ScenarioError(f"{name}: {first_error(problem, kind, text)}") from None
    except TypeError as problem:
        raise ScenarioError(f"{name}: {problem}") from None
    if any(category(letter) == "Cc" for letter in scenario.name):  # a terminal would obey it
        raise ScenarioError(f"{name}: name: a control character in it; letters and spaces are fine")
    for number, fault in enumerate(scenario.fault):
        for key in ("robot", "sender", "receiver"):
            robot = getattr(fault, key, 0)
            if robot >= scenario.fleet.robots:
                raise ScenarioError(
                    f"{name}: {_line(text, number, key)}fault.{number}.{key}: robot {robot} is not one "
                    f"of {scenario.fleet.robots} (0 to {scenario.fleet.robots - 1})"
                )
        if isinstance(fault, Partition):
            _check_islands(
                fault.islands,
                scenario.fleet.robots,
                f"{name}: {_line(text, number, 'islands')}fault.{number}.islands",
            )
    return scenario


def _line(text: str, number: int, key: str) -> str:
    """Where a key of a fault stands in the file, as the beginning of a message."""
    line = line_of(text, ("fault", number, key))
    return "" if line is None else f"line {line}: "


def _check_islands(islands: list[list[int]], robots: int, where: str) -> None:
    """ScenarioError if a named robot does not exist or is on two islands."""
    known: set[int] = set()
    for robot in (slot for island in islands for slot in set(island)):
        if robot >= robots:
            raise ScenarioError(
                f"{where}: robot {robot} is not one of {robots} (0 to {robots - 1})"
            )
        if robot in known:
            raise ScenarioError(f"{where}: robot {robot} is on two islands")
        known.add(robot)
