"""The body of a robot process: the port that an engineer implements for a vehicle.

    class Tractor(RobotBody):
        def sense(self, now_us): ...      # the newest reading, with the time at which it was sensed
        def drive(self, command, now_us): ...

A robot file names what makes it: `factory = "my_tractor:Tractor"`. It is called with the slot and with
the options of the file, `Tractor(slot, port="/dev/ttyUSB0")`. Ours are named as in a checkout,
`agent.runtime.robot_body:StandingBody`, also where Headland was installed as a wheel.

The contract:

* Times are microseconds on the clock of `now_us`, `time.monotonic()`. An observation has the time at
  which the place was true, not the time at which it arrived.
* Places are metres east and north of the origin of the field, of the middle of the body. Headings are
  radians, counter-clockwise from east. Accuracies are standard deviations.
* A drive command is a velocity in the field frame, metres a second. A mecanum body drives it at once, in
  any direction. A differential and an Ackermann body turn to its course first. A command with a turn rate
  and no velocity turns a mecanum or a differential body on the spot, as out of a corner. `WheelDrive` of
  `agent/motion/wheel_kinematics.py` makes wheel speeds of it for all three.
* A command lives for `ACTUATOR_TTL_US`, 100 ms. Then the wheels stand. The controller of the wheels
  counts this time, because nobody else can when this process dies.
* `tool_on` lowers the implement. It is raised when the command expires. A body that senses its implement
  says so in `Observation.implement_down`. One that is down for 1 s against the command stops the robot.
* `sense` and `drive` are called every 50 ms in the thread of the bus, and must not wait.
* An OSError of `sense` or `drive` says that a device is gone for good. It ends the process with code 75,
  so that a supervisor starts it again. What comes back by itself is no error: `sense` returns None.
* Any other exception is a fault of the driver: it ends the process with code 1 and one line.
* `close` stands. A body can be opened again after it.

`headland body-check` tries all of it on a body.
"""

from collections.abc import Mapping
from difflib import get_close_matches
from importlib import import_module
from importlib.util import find_spec
from inspect import Parameter, signature
from pathlib import Path
from sysconfig import get_path
from traceback import extract_tb
from typing import Any, ClassVar, NamedTuple

from agent.interface.effects import HALT, GatedDrive
from agent.interface.observation import Observation
from agent.interface.vehicle import Vehicle
from agent.peer.peer import Peer
from agent.runtime.option_values import number


class DeclaredMachine(NamedTuple):
    """What a robot file declares of the machine of a body, and of its field."""

    vehicle: Vehicle
    origin: tuple[float, float] | None  # latitude and longitude of (0, 0), degrees; None: no field
    folder: Path = Path()  # of the robot file; names of files are relative to it


class RobotBody:
    """Sensors and actuators of one robot, with a beginning and an end."""

    # Whether it has range sensors. Without them a robot does not see what is no member of its fleet.
    has_range_sensors: ClassVar[bool] = False

    def declare(self, machine: DeclaredMachine) -> None:
        """Called once before `open`, with what the robot file declares. Raises ValueError."""

    async def open(self) -> None:
        """Connect, and return when the body can be driven. Raises OSError for a device that is not there,
        and ValueError for what a person has to mend."""

    def sense(self, now_us: int) -> Observation | None:
        """The newest observation, with the time at which it was sensed on the clock of `now_us`.

        None: there is none yet, or none any more."""
        raise NotImplementedError

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """Obey until the next command, for `agent.interface.config.ACTUATOR_TTL_US` at most."""
        raise NotImplementedError

    async def watch(self, peer: Peer) -> None:
        """Runs beside the robot until it is cancelled, and only reads the peer: for displays."""

    def close(self) -> None:
        """Let the body stand, and free what `open` has taken."""


class StandingBody(RobotBody):
    """A body that always stands at one place: to try bus, keys and stops before a vehicle is there."""

    def __init__(
        self, slot: int, x_m: float = 0.0, y_m: float = 0.0, heading_rad: float = 0.0
    ) -> None:
        """Metres east and north in the field; the heading counter-clockwise from east. Raises
        ValueError."""
        self.slot = slot
        self.pose = (number("x_m", x_m), number("y_m", y_m), number("heading_rad", heading_rad))

    def sense(self, now_us: int) -> Observation | None:
        """The place where it stands, sensed now."""
        return Observation(*self.pose, 0.0, 0.0, sensed_at_us=now_us)

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """It has no wheels."""


class DryBody(RobotBody):
    """A body that senses and is never driven: to see what a robot would do."""

    def __init__(self, body: RobotBody) -> None:
        self.body = body
        self.wanted = HALT  # the newest command, which the body was not given

    def declare(self, machine: DeclaredMachine) -> None:
        """Tell the body that is never driven what the file says."""
        self.body.declare(machine)

    async def open(self) -> None:
        """Connect all the same: its sensors are wanted. Raises OSError."""
        await self.body.open()

    def sense(self, now_us: int) -> Observation | None:
        """The newest reading, as the body returns it."""
        return self.body.sense(now_us)

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """Remember the command, and let the body stand."""
        self.wanted = command
        self.body.drive(HALT, now_us)

    async def watch(self, peer: Peer) -> None:
        """Run what the body runs beside the robot."""
        await self.body.watch(peer)

    def close(self) -> None:
        """Free what it has connected to."""
        self.body.close()


PREFIX = __name__.removesuffix("agent.runtime.robot_body")  # in a wheel: `headland.`
LAYERS = ("crdt", "protocol", "agent", "sim")
OTHERS = (get_path("stdlib"), "<frozen")  # files in which no driver is


class FactoryError(ValueError):
    """One line: why a factory that a robot file names cannot be used."""


class OptionError(FactoryError):
    """A factory does not take an option."""

    def __init__(self, text: str, option: str) -> None:
        super().__init__(text)
        self.option = option


def fault_text(problem: BaseException, file: str | None = None) -> str:
    """An exception of a driver, and where it was raised: "KeyError: 'wheels' (rover.py:12)".

    `file`: of the driver. Its last line in the traceback is named, although a library may have raised."""
    frames = extract_tb(problem.__traceback__)
    own = [frame for frame in frames if frame.filename == file]
    own = (
        own or [frame for frame in frames if not frame.filename.startswith(OTHERS)] or list(frames)
    )
    text = f"{type(problem).__name__}: {problem}" if str(problem) else type(problem).__name__
    if isinstance(problem, SyntaxError) or not own:  # it names its file and line itself
        return text
    return f"{text} ({Path(own[-1].filename).name}:{own[-1].lineno})"


def named(factory: str) -> Any:
    """What "package.module:name" names. Raises FactoryError.

    A module that Headland has is Headland's, although the working folder may have one of that name.
    """
    module, _, name = factory.partition(":")
    if not module or not name:
        raise FactoryError(f"{factory!r} is not MODULE:CLASS, or MODULE:FUNCTION")
    try:
        if PREFIX and module.split(".")[0] in LAYERS and _is_there(PREFIX + module):
            module = PREFIX + module
        return getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as problem:
        raise FactoryError(f"{factory!r} cannot be imported: {problem}") from problem
    except Exception as problem:  # a module of a person raises what it likes
        raise FactoryError(f"{factory!r} cannot be imported: {fault_text(problem)}") from problem


def called(factory: str, *given: Any, **options: Any) -> Any:
    """The result of a factory named "package.module:name". Raises FactoryError, and OSError and
    ValueError of the factory: a device that is not there, and a value that is wrong."""
    make = named(factory)
    _check_options(factory, make, options)
    try:
        return make(*given, **options)
    except (OSError, ValueError):
        raise
    except TypeError as problem:
        inside = problem.__traceback__ is not None and problem.__traceback__.tb_next is not None
        said = fault_text(problem) if inside else str(problem)  # else an argument that is missing
        raise FactoryError(f"{factory!r}: {said}") from problem
    except Exception as problem:  # a factory of a person raises what it likes
        raise FactoryError(f"{factory!r} raised {fault_text(problem)}") from problem


def _check_options(factory: str, make: Any, options: Mapping[str, Any]) -> None:
    """Raises OptionError."""
    try:
        takes = signature(make).parameters
    except (TypeError, ValueError):  # of what is written in C, or is no function
        return
    if any(each.kind is Parameter.VAR_KEYWORD for each in takes.values()):
        return
    for option in options:
        if option not in takes:
            near = get_close_matches(option, takes, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise OptionError(f"{factory!r} takes no option {option!r}{hint}", option)


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # of a package above it
        return False
