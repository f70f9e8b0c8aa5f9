"""What is known of the fleet when a person speaks: all that an order is weighed against."""

from collections.abc import Mapping
from math import hypot
from typing import NamedTuple

from agent.interface.geometry import Point

STANDING_M_S = 0.05  # slower than this it stands; POSE tells speed in steps of 0.05 m/s or less


class RobotNow(NamedTuple):
    """What orders are weighed against: state, place, what holds it, and what it does."""

    slot: int
    state: str  # of agent.interface.lifecycle.State
    x_m: float
    y_m: float
    speed_m_s: float = 0.0
    stopped: bool = False  # a stop is latched
    started: bool = True
    silent: bool = False
    asking: int = 0  # number of its open question; 0: none
    goal: Point | None = None  # place to which an operator has sent it, until it is there
    sections: tuple[str, ...] = ()
    heard_s: float = 0.0  # ago
    battery: float | None = None  # share of a full one; None: it has none, or tells of none
    placed: bool = True  # it knows where it is; else its place is the last that it told, or none

    @property
    def idle(self) -> bool:
        """Whether it stands without work, may move, and waits for nobody."""
        return (
            self.state == "IDLE" and self.started and not (self.stopped or self.silent or self.asking)
            and self.goal is None and self.speed_m_s <= STANDING_M_S
        )  # fmt: skip

    def away_m(self, place: Point) -> float:
        """Distance to a place in metres, in a straight line."""
        return hypot(self.x_m - place[0], self.y_m - place[1])


class SectionNow(NamedTuple):
    """Phase and owner of one section."""

    phase: str
    owner: int | None


class FleetNow(NamedTuple):
    """All robots and sections as they are known now, and from whom."""

    robots: Mapping[int, RobotNow]
    sections: Mapping[int, SectionNow]
    told_by: str = "the bus"  # whose view this is

    @property
    def live(self) -> list[RobotNow]:
        """Robots that are not silent, in slot order."""
        return [r for _, r in sorted(self.robots.items()) if not r.silent]

    def nearest(self, place: Point, without: frozenset[int] = frozenset()) -> RobotNow | None:
        """The idle robot nearest to a place (metres), in a straight line; of equals the lower slot.
        None if there is none that knows where it is."""
        idle = [r for r in self.live if r.idle and r.placed and r.slot not in without]
        return min(idle, key=lambda r: (r.away_m(place), r.slot), default=None)

    @property
    def heard(self) -> str:
        """Numbers of the live robots, as text for a message."""
        return ", ".join(str(r.slot) for r in self.live) or "none"
