"""A polyline that a robot with an implement drives in one go: at work on a section, or on
its way.
"""

from itertools import pairwise
from math import dist, hypot
from typing import Final, NamedTuple

from agent.interface.geometry import Point
from agent.motion.implement_clearance import LEAD_M

STRAIGHT_M: Final = 0.01  # a lead-in that begins closer to the line of its first unit does not turn
# This far behind a corner the bar is round it. The tracker turns 6 cm before the corner.
SWUNG_M: Final = 0.15
assert SWUNG_M < LEAD_M

# The parts of the swath before and behind a stretch.
LeadInOut = tuple[tuple[Point, ...], tuple[Point, ...]]


class WorkLeg(NamedTuple):
    """A polyline to drive, (x, y) metres; `units` are passed in this order, and none means transit.

    A leg with units is longer than they are by `LEAD_M` at both ends.
    """

    points: tuple[Point, ...]
    units: tuple[int, ...] = ()

    @property
    def length_m(self) -> float:
        """Length of the polyline."""
        return sum(dist(a, b) for a, b in pairwise(self.points))


def working_leg(
    points: tuple[Point, ...],
    units: tuple[int, ...],
    leads: LeadInOut = ((), ()),
) -> WorkLeg:
    """A stretch of units with its lead-in and lead-out.

    `leads`: the parts of the swath before and behind it, `LEAD_M` each. The leg follows a lead that
    turns, because the bar has to swing round a corner at a unit's end. Otherwise it goes straight
    on.
    """
    before, after = leads
    first: tuple[Point, ...] = (_beyond(points[1], points[0]),)
    last: tuple[Point, ...] = (_beyond(points[-2], points[-1]),)
    if before and dist(before[0], first[0]) > STRAIGHT_M:
        first = before
    if after and dist(after[-1], last[0]) > STRAIGHT_M:
        last = after
    return WorkLeg((*first, *points[1:-1], *last), units)


def _beyond(a: Point, b: Point) -> Point:
    """The point `LEAD_M` further than b, coming from a."""
    length_m = max(hypot(b[0] - a[0], b[1] - a[1]), 1e-9)
    share = LEAD_M / length_m
    return b[0] + (b[0] - a[0]) * share, b[1] + (b[1] - a[1]) * share
