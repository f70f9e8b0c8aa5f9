"""Everything a peer can ask of the world. Effects are returned, in order, and never performed here.

The order is a guarantee: the runner performs a `Persist` (durably) before the `Send` that follows
it. That is all of "durable before revealed". Only the stop deviates, and on purpose: brake, send,
then persist.
"""

from typing import NamedTuple

from protocol.frames.messages import Message


class Send(NamedTuple):
    """Put one message on the bus."""

    message: Message
    destination: int = 255
    source: int | None = None  # None: the peer's address at the time of sending


_tuple = tuple.__new__


def to_all(message: Message) -> Send:
    """`Send(message)` without the cost of the defaults, because every beat is one."""
    return _tuple(Send, (message, 255, None))


class Drive(NamedTuple):
    """Body velocity wanted from now on; it expires in the actuator after `config.ACTUATOR_TTL_US`.

    Field frame: x east, y north, metres per second; turn rate counter-clockwise, radians per second.
    """

    vx_m_s: float
    vy_m_s: float
    turn_rad_s: float = 0.0
    tool_on: bool = False  # the implement is lowered and working
    handle: int = -1  # number of the parcel that a carrier picks up or puts down here; -1: none


HALT = Drive(0.0, 0.0)


class Persist(NamedTuple):
    """Write one record durably; the newest value of a key wins."""

    key: str
    value: bytes


class Trace(NamedTuple):
    """A record for people: which machine changed from which state to which, and why."""

    machine: str  # lifecycle, safety, claim, election, membership, ...
    source: str
    event: str
    target: str
    why: str = ""


Effect = Send | Drive | Persist | Trace
