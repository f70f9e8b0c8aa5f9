"""What a robot of an exploring fleet is to do, in the words of the mission's specification."""

from decimal import ROUND_HALF_UP, Decimal
from enum import Enum
from typing import NamedTuple

from agent.interface.geometry import Point

ROBOTS_MAX = 10  # default size of a fleet; a record of the map has room for 32 observers
ORDERS_FIRST = 0xFF00  # first section of an order; patches of the map are below
ORDERS_MAX = 64  # of the 256 sections from there on
AT_M = 0.12  # this near to a waypoint, it is reached
VIEW_SHARE = 0.5  # share of the sensor range from which a station sees its frontier
VIEW_MAX_M = 1.0
BEYOND_CELLS = 2.0  # from a frontier's middle to where a ray has passed the cell beyond, slantwise


def view_cells(range_m: float, cell_m: float) -> int:
    """The number of cells between a station and a frontier that it looks at; 0: sensors are too short.

    `range_m`: of the sensors. `cell_m`: side of a cell. A robot may stand `AT_M` from its station, and a
    ray must pass the cell beyond the frontier as a whole.
    """
    view_m = min(VIEW_MAX_M, VIEW_SHARE * range_m, range_m - AT_M - BEYOND_CELLS * cell_m)
    return max(int(view_m / cell_m), 0)


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
    points: tuple[Point, ...]


class FleetTask(NamedTuple):
    """A task of one robot, with its target in (x, y) metres."""

    section: int  # the same for all peers: a patch of the map, or an order
    kind: TaskKind
    target: Point
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


def describe(kind: TaskKind, target: Point) -> str:
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
