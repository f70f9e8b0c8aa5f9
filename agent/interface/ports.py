"""What a peer's shell needs from outside, and the facts that come in. SI units, field frame."""

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple, Protocol, runtime_checkable

from agent.interface.effects import Drive, Persist
from protocol.controller_health import Health
from protocol.frames.fleet_frames import Pose
from protocol.frames.frame import Frame
from protocol.frames.messages import Message


class Neighbour(NamedTuple):
    """The newest pose of another member and when it was heard."""

    pose: Pose
    heard_us: int


class VisibleParcel(NamedTuple):
    """A parcel within reach, as a carrier's scanner sees it."""

    x_m: float
    y_m: float
    on_robot: bool  # on a robot that is dead


NEVER_US = -(1 << 62)  # without a time, what is sensed is as old as can be
NOTHING_SEEN: Mapping[int, VisibleParcel] = {}


class Observation(NamedTuple):
    """What the robot's own sensors say now. Field frame: x east, y north, metres."""

    x_m: float
    y_m: float
    heading_rad: float  # counter-clockwise from east
    vx_m_s: float
    vy_m_s: float
    ranges_m: tuple[
        float, ...
    ] = ()  # one per ray, counter-clockwise from the heading; inf: nothing
    battery: float = 1.0  # share of a full charge
    bodies: tuple[tuple[float, float], ...] = ()  # others in sight, metres east and north of us
    load: int = -1  # of a carrier: the parcel that is aboard; -1: none
    parcels: Mapping[int, VisibleParcel] = NOTHING_SEEN  # and those within its reach
    sensed_at_us: int = NEVER_US  # on the clock of the peer that is told
    health: float = 1.0  # what the machine's own controller says of it: 0.0 failed to 1.0 healthy


class BufferedBeacon(NamedTuple):
    """A calm beat or heartbeat on a shelf: of somebody who neither stands stopped nor leaves."""

    source: int
    message: Message
    t_us: int  # of the bus
    seen: Neighbour | None  # of a pose: what becomes known of its sender


class Bus(Protocol):
    """A CAN interface. Frames a node sends are not delivered to itself."""

    def send(self, frame: Frame) -> bool:
        """Queue a frame; False when the queue is full or the node is off the bus."""
        ...

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        """Call back for every frame received, in order, in the event loop's thread."""
        ...

    @property
    def health(self) -> Health: ...

    def close(self) -> None: ...


@runtime_checkable
class BatchedDelivery(Protocol):
    """A bus that can keep calm beats for later: a simulated one, which hands over thousands a second."""

    def shelve(self, shelf: list[BufferedBeacon] | None) -> None:
        """From now on they are put on the shelf, and not called back for; None: they are again."""
        ...


@runtime_checkable
class Confirming(Protocol):
    """A bus that may tell which of our frames have left it."""

    @property
    def sent(self) -> int | None:
        """Own frames that were sent to their end and acknowledged by another node, since some time; they
        only become more. None: the interface does not tell."""
        ...


class Body(Protocol):
    """Sensors and actuators of one robot."""

    def sense(self, now_us: int) -> Observation | None:
        """The newest that is known, with the time at which it was sensed; None: nothing yet, or nothing
        any more."""
        ...

    def drive(self, command: Drive, now_us: int) -> None: ...


class Journal(Protocol):
    """Durable memory of one robot: the newest value of each key."""

    def load(self) -> Mapping[str, bytes]: ...
    def write(self, records: Iterable[Persist]) -> None:
        """Return only when the records survive a power cut; raise OSError when they may not."""
        ...
