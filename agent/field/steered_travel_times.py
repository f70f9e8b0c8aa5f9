"""How long a body that steers takes in a field: lines without a stop, joined by Dubins words.

Dubins words know no fences. So a way takes at least as long as that of a point between the same
places (`TravelTimes`).
"""

from collections.abc import Sequence
from itertools import pairwise
from math import hypot

import numpy as np

from agent.field.field_map import Field
from agent.field.travel_times import Floats, TravelTimes, Whole
from agent.interface.geometry import Point, Polyline
from agent.motion.tractor_tracker import SteeringLimits, bend_speed_m_s, heading_of
from agent.paths.dubins import soonest_for_s
from agent.paths.route import Route


class SteeredTravelTimes(TravelTimes):
    """Times of one field and one kind of body that steers, in whole milliseconds."""

    def __init__(
        self,
        field: Field,
        route: Route,
        limits: SteeringLimits,
        acceleration_m_s2: float,
        radius_m: float,
        corners: Sequence[Point] = (),
    ) -> None:
        """`radius_m`: of planned curves. `corners`: see `TravelTimes`."""
        super().__init__(
            field, route, limits.speed_m_s, acceleration_m_s2, limits.deceleration_m_s2, corners
        )
        self.radius_m = radius_m
        self._bend_m_s = bend_speed_m_s(self.speed_m_s, radius_m)
        # From straight to the arc and back, for a body that goes on as fast as in the arc.
        self._bend_for_s = 1.0 / radius_m / limits.steer_1_m_s

    def _links_for_ms(self) -> Whole:
        """From each end, on the way out, to each other one, on the way in."""
        inward = np.array(
            [_pose(line) for section in self.field.sections for line in _both(section.swaths)]
        ).reshape(-1, 3)
        outward = inward + np.array([0.0, 0.0, np.pi])
        links_for_ms: Whole = np.maximum(
            self._turns_for_ms(outward, inward), super()._links_for_ms()
        )
        return links_for_ms

    def driven_for_ms(self, lines: Sequence[Polyline]) -> int:
        """To work these lines in this order, without a stop between a line and a turn."""
        length_m = sum(
            hypot(bx - ax, by - ay) for line in lines for (ax, ay), (bx, by) in pairwise(line)
        )
        turns_for_ms = sum(
            int(self._turns_for_ms(np.array([_end(a)]), np.array([_pose(b)]))[0, 0])
            for a, b in pairwise(lines)
        )
        return round(1000 * length_m / self.speed_m_s) + turns_for_ms

    def _turns_for_ms(self, starts: Floats, goals: Floats) -> Whole:
        for_s = soonest_for_s(
            starts, goals, self.radius_m, self.speed_m_s, self._bend_m_s, self._bend_for_s
        )
        turns_for_ms: Whole = np.rint(1000 * for_s).astype(np.int64)
        return turns_for_ms


def _both(lines: Sequence[Polyline]) -> tuple[Polyline, Polyline]:
    """The first line, and the last one the other way round: a section is entered by either."""
    return lines[0], lines[-1][::-1]


def _pose(line: Polyline) -> tuple[float, float, float]:
    """Where a line begins, and its direction there."""
    return (*line[0], heading_of(line[0], line[1]))


def _end(line: Polyline) -> tuple[float, float, float]:
    """Where a line ends, and its direction there."""
    return (*line[-1], heading_of(line[-2], line[-1]))
