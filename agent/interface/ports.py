"""What the runner of a peer needs from outside: a bus, a body and a journal."""

from collections.abc import Callable, Iterable, Mapping
from typing import Protocol, runtime_checkable

from agent.interface.effects import GatedDrive, Persist
from agent.interface.observation import Observation
from protocol.controller_health import Health
from protocol.frames.frame import Frame


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
