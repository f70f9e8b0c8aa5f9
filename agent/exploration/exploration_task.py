"""What a robot of an exploring fleet is to do, as the mission words it."""

from decimal import ROUND_HALF_UP, Decimal
from enum import Enum
from typing import NamedTuple

XY = tuple[float, float]
ROBOTS_MAX = 10  # the mission's default; a record of the map has room for 32 observers
ORDERS_FIRST = 0xFF00  # sections of orders; patches of the map are below
ORDERS_MAX = 64  # of the 256 sections that are left for them


class FleetFullError(ValueError):
    def __init__(self, limit: int) -> None:
        super().__init__(f"Fleet is full (max {limit} robots)")


class Kind(Enum):
    EXPLORE_FRONTIER = "explore_frontier"
    NAVIGATE_TO = "navigate_to"
    PATROL = "patrol"
    IDLE = "idle"


class Status(Enum):
    PENDING = "pending"  # claimed, still contested
    ACTIVE = "active"
    COMPLETED = "completed"
    FAILED = "failed"


class ExplorationOrder(NamedTuple):
    """An operator's task for any robot of the fleet: go there, or visit these points once."""

    kind: Kind  # NAVIGATE_TO or PATROL
    points: tuple[XY, ...]


class FleetTask(NamedTuple):
    section: int  # the same for all peers: a patch of the map, or an order
    kind: Kind
    target: XY
    assigned_to: int  # slot
    status: Status
    created_us: int  # by the clock of the peer that tells

    @property
    def id(self) -> str:
        return f"task-{self.section}"

    @property
    def description(self) -> str:
        return describe(self.kind, self.target)


def fixed(value: float) -> str:
    """One decimal, ties away from zero, as the mission's `toFixed(1)`.

    >>> fixed(0.25), fixed(-0.04)
    ('0.3', '-0.0')
    """
    return str(Decimal(value).quantize(Decimal("0.1"), ROUND_HALF_UP))


def describe(kind: Kind, target: XY) -> str:
    """What is passed to a language model."""
    place = f"({fixed(target[0])}, {fixed(target[1])})"
    match kind:
        case Kind.EXPLORE_FRONTIER:
            return f"Explore frontier at {place}"
        case Kind.NAVIGATE_TO:
            return f"Navigate to {place}"
        case Kind.PATROL:
            return f"Patrol from {place}"
    return "Idle"
