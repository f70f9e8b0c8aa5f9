"""Everything a peer can ask of the world. A peer returns effects in order and never performs them.

The order is a guarantee. The runner makes a `Persist` durable before it performs the `Send` that
follows. So nothing is revealed before it is durable. Only the stop deviates, on purpose: brake,
send, then persist.
"""

from typing import NamedTuple, NewType

from protocol.frames.messages import Message


class Send(NamedTuple):
    """Put one message on the bus. `destination` is a bus address; 255 means all."""

    message: Message
    destination: int = 255
    source: int | None = None  # None: the peer's address at the time of sending


class Drive(NamedTuple):
    """The body velocity wanted from now on; the actuator stops after `config.ACTUATOR_TTL_US`
    without another one.

    Field frame: x east, y north, metres a second. The turn rate is counter-clockwise, radians a
    second.
    """

    vx_m_s: float
    vy_m_s: float
    turn_rad_s: float = 0.0
    tool_on: bool = False  # the implement is lowered and working
    # Number of the parcel that a carrier picks up or puts down here; -1: none.
    parcel_action: int = -1


# What a body takes. The gate of `agent/safety/stop_controller.py` is the only one that makes it from a
# wanted drive, so a motion that has not passed the gate is a type error. HALT needs no gate.
GatedDrive = NewType("GatedDrive", Drive)
HALT = GatedDrive(Drive(0.0, 0.0))


class Persist(NamedTuple):
    """Write one record to durable memory; the newest value of a key wins."""

    key: str
    value: bytes


class Trace(NamedTuple):
    """A record for people: which machine changed from which state to which, and why."""

    machine: str  # lifecycle, safety, claim, election, membership, ...
    source: str
    event: str
    target: str
    why: str = ""


Effect = Send | GatedDrive | Persist | Trace
