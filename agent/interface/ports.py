"""What the runner of a peer needs from outside, and the facts that come in.

SI units. Field frame: x east, y north, metres.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple, Protocol, runtime_checkable

from agent.interface.effects import GatedDrive, Persist
from protocol.controller_health import Health
from protocol.frames.fleet_frames import Pose
from protocol.frames.frame import Frame


class Neighbour(NamedTuple):
    """The newest pose of another member, and when it was received, microseconds."""

    pose: Pose
    heard_at_us: int


class VisibleParcel(NamedTuple):
    """A parcel within a carrier's reach, as its scanner sees it."""

    x_m: float
    y_m: float
    on_robot: bool  # it is on a robot that has died


NEVER_US = -(1 << 62)  # an observation without a time counts as infinitely old
NOTHING_SEEN: Mapping[int, VisibleParcel] = {}


class Observation(NamedTuple):
    """The current reading of the robot's own sensors. Field frame: x east, y north, metres."""

    x_m: float
    y_m: float
    heading_rad: float  # counter-clockwise from east
    vx_m_s: float
    vy_m_s: float
    # One per ray, counter-clockwise from the heading; inf: nothing.
    ranges_m: tuple[float, ...] = ()
    battery: float = 1.0  # share of a full charge
    bodies: tuple[tuple[float, float], ...] = ()  # others in sight, metres east and north of us
    load: int = -1  # on a carrier, the number of the parcel aboard; -1: none
    parcels: Mapping[int, VisibleParcel] = NOTHING_SEEN  # parcels within a carrier's reach
    sensed_at_us: int = NEVER_US  # on the clock of the peer that receives it
    health: float = 1.0  # reported by the machine's own controller: 0.0 failed to 1.0 healthy


class Bus(Protocol):
    """A CAN interface. Frames a node sends are not delivered to itself."""

    def send(self, frame: Frame) -> bool:
        """Queue a frame; False if the queue is full or the node is off the bus."""
        ...

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        """Call back for every received frame, in order, on the thread of the event loop."""
        ...

    @property
    def health(self) -> Health:
        """The state of the CAN controller: active, warning, passive or off the bus."""
        ...

    def close(self) -> None:
        """Stop receiving and release the interface."""
        ...


@runtime_checkable
class Confirming(Protocol):
    """A bus that may report how many of our frames were sent."""

    @property
    def sent(self) -> int | None:
        """Count of own frames that were sent completely and acknowledged by another node.

        It starts at any time and never decreases. None: the interface does not report it."""
        ...


class Body(Protocol):
    """Sensors and actuators of one robot."""

    def sense(self, now_us: int) -> Observation | None:
        """The newest observation and when it was sensed; None if there is none (any more)."""
        ...

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """Pass a command to the actuators: one that the gate has let through.

        It expires after `config.ACTUATOR_TTL_US`."""
        ...


class Journal(Protocol):
    """Durable memory of one robot: the newest value of each key."""

    def load(self) -> Mapping[str, bytes]:
        """The newest value of each key. Raises OSError if the memory is lost or damaged."""
        ...

    def write(self, records: Iterable[Persist]) -> None:
        """Return only when the records survive a power cut. Raises OSError if they may not."""
        ...
