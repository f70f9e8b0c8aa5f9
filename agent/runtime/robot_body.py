"""The body of a robot process: the port that an engineer implements for a vehicle.

    class Tractor(RobotBody):
        def sense(self, now_us): ...      # the newest reading, with the time at which it was sensed
        def drive(self, command, now_us): ...

A robot file names what makes it: `factory = "my_tractor:Tractor"`. It is called with the slot and with
the options of the file, `Tractor(slot, port="/dev/ttyUSB0")`. Ours are named as in a checkout,
`agent.runtime.robot_body:StandingBody`, also where Headland was installed as a wheel.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from agent.interface.effects import GatedDrive
from agent.interface.observation import Observation
from agent.peer.peer import Peer


class RobotBody:
    """Sensors and actuators of one robot, with a beginning and an end."""

    async def open(self) -> None:
        """Connect, and return when the body can be driven. Raises OSError."""

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
        """Metres east and north in the field; the heading counter-clockwise from east."""
        self.slot, self.pose = slot, (x_m, y_m, heading_rad)

    def sense(self, now_us: int) -> Observation | None:
        """The place where it stands, sensed now."""
        return Observation(*self.pose, 0.0, 0.0, sensed_at_us=now_us)

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """It has no wheels."""


PREFIX = __name__.removesuffix("agent.runtime.robot_body")  # in a wheel: `headland.`
LAYERS = ("crdt", "protocol", "agent", "sim")


class FactoryError(ValueError):
    """One line: why a factory that a robot file names cannot be used."""


def called(factory: str, *given: Any, **options: Any) -> Any:
    """The result of a factory named "package.module:name". Raises FactoryError.

    A module that Headland has is Headland's, although the working folder may have one of that name.
    """
    module, _, name = factory.partition(":")
    try:
        if PREFIX and module.split(".")[0] in LAYERS and _is_there(PREFIX + module):
            module = PREFIX + module
        make = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as problem:
        raise FactoryError(f"{factory!r} cannot be imported: {problem}") from None
    try:
        return make(*given, **options)
    except TypeError as problem:  # an option that it does not take
        raise FactoryError(f"{factory!r}: {problem}") from None


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # of a package above it
        return False
