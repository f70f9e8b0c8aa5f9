"""What a robot of an exploring fleet is to do, in the words of the mission's specification."""

from decimal import ROUND_HALF_UP, Decimal
from enum import Enum
from typing import NamedTuple

XY = tuple[float, float]  # metres east and north
ROBOTS_MAX = 10  # default size of a fleet; a record of the map has room for 32 observers
ORDERS_FIRST = 0xFF00  # first section of an order; patches of the map are below
ORDERS_MAX = 64  # of the 256 sections from there on


class FleetFullError(ValueError):
    """More robots than a fleet may have."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"Fleet is full (max {limit} robots)")


class TaskKind(Enum):
    """What a task is about; the values appear in reports."""

    EXPLORE_FRONTIER = "explore_frontier"
    NAVIGATE_TO = "navigate_to"
    PATROL = "patrol"
    IDLE = "idle"


class Status(Enum):
    """How far a task is; the values appear in reports."""

    PENDING = "pending"  # claimed, still contested
    ACTIVE = "active"
    COMPLETED = "completed"
    FAILED = "failed"


class ExplorationOrder(NamedTuple):
    """An operator's task for any robot of the fleet: go there, or visit these points once."""

    kind: TaskKind  # NAVIGATE_TO or PATROL
    points: tuple[XY, ...]


class FleetTask(NamedTuple):
    """A task of one robot, with its target in (x, y) metres."""

    section: int  # the same for all peers: a patch of the map, or an order
    kind: TaskKind
    target: XY
    assigned_to: int  # slot
    status: Status
    created_at_us: int  # on the clock of the peer that reports

    @property
    def id(self) -> str:
        """The task's name in reports."""
        return f"task-{self.section}"

    @property
    def description(self) -> str:
        """The task in words, for reports."""
        return describe(self.kind, self.target)


def fixed(value: float) -> str:
    """A plain number with one decimal, ties away from zero, as `toFixed(1)` of JavaScript; in any
    unit.

    >>> fixed(0.25), fixed(-0.04)
    ('0.3', '-0.0')
    """
    return str(Decimal(value).quantize(Decimal("0.1"), ROUND_HALF_UP))


def describe(kind: TaskKind, target: XY) -> str:
    """A task in words, for people and language models."""
    place = f"({fixed(target[0])}, {fixed(target[1])})"
    match kind:
        case TaskKind.EXPLORE_FRONTIER:
            return f"Explore frontier at {place}"
        case TaskKind.NAVIGATE_TO:
            return f"Navigate to {place}"
        case TaskKind.PATROL:
            return f"Patrol from {place}"
    return "Idle"
