"""Where a member that fell silent while moving may stand: from its last beat to where it came to
rest.

A member that says that it does not know its place counts as silent from then on: it brakes.

A process that dies sends nothing, but its body drives on while its last command is valid, and then
over its braking distance. A robot that was cut off from the bus drives until it has noticed. At 2.5
m/s that is three metres, more than the width of a body. To keep away from the last beat alone would
lead into the body behind it. All of that way is kept clear. A place on it becomes free when range
sensor rays pass through it.
"""

from collections.abc import Mapping
from math import atan2, ceil, cos, floor, hypot, pi, sin
from typing import Final

from agent.interface.config import (
    ACTUATOR_TTL_US,
    BEATS,
    CONTROL_PERIOD_US,
    GONE_QUIET_US,
    MS,
    S,
)
from agent.interface.geometry import Point
from agent.interface.observation import Neighbour, Observation

# Time until it brakes: it detects the silence, and its last command is still in force. In fleets of
# more than 30, which detect silence later, a robot that was cut off may stand further on. Any echo
# that no place here explains is an obstacle (`agent/motion/obstacle_detector.py`).
DRIVES_ON_US = BEATS[0].silence_for_us + CONTROL_PERIOD_US + ACTUATOR_TTL_US
SPACING_M: Final = 0.5  # of places: a row of discs of 1.6 m is 2 cm narrower between two of them
SURE_M: Final = 4.0  # rays prove nothing about places further away
BEYOND_M: Final = 0.4  # a ray that reaches this much further than a place has passed it
assert DRIVES_ON_US == 450 * MS


class StoppingZone:
    """The zones of all silent members, as one robot knows them.

    A place seen as free stays free until the member is received again.
    """

    def __init__(self, radius_m: float, deceleration_m_s2: float) -> None:
        self.radius_m, self.deceleration_m_s2 = radius_m, deceleration_m_s2
        self._heard_at_us: dict[int, int] = {}  # the beat that the places are of
        self._places: dict[int, tuple[Point, ...]] = {}

    def observe(self, neighbours: Mapping[int, Neighbour], here: Observation, now_us: int) -> None:
        """Once each control period: begin, end and shorten zones.

        `neighbours`: newest poses by slot. `here`: our observation with its rays.
        """
        for slot, neighbour in neighbours.items():
            _, heard_at_us = neighbour
            if now_us - heard_at_us < GONE_QUIET_US:
                if slot in self._places:
                    del self._places[slot], self._heard_at_us[slot]
                continue
            if self._heard_at_us.get(slot) != heard_at_us:
                self._heard_at_us[slot] = heard_at_us
                self._places[slot] = self._way(neighbour)
            places = self._places[slot]
            left = tuple(place for place in places if not self._passed(here, place))
            if len(left) < len(places):
                self._places[slot] = left

    @property
    def is_any(self) -> bool:
        """Whether any member has been silent for long enough to have a zone."""
        return bool(self._places)

    def places(self, slot: int) -> tuple[Point, ...] | None:
        """Possible places of a member, (x, y) metres in driving order, without those seen as free.

        None: the member has not been silent for long enough to have a zone.
        """
        return self._places.get(slot)

    def _way(self, neighbour: Neighbour) -> tuple[Point, ...]:
        pose = neighbour.pose
        speed_m_s = pose.speed_m_s
        way_m = speed_m_s * DRIVES_ON_US / S + speed_m_s * speed_m_s / (2 * self.deceleration_m_s2)
        count = ceil(way_m / SPACING_M)
        step_m = way_m / max(count, 1)
        ux, uy = cos(pose.course_rad), sin(pose.course_rad)
        return tuple(
            (pose.x_m + k * step_m * ux, pose.y_m + k * step_m * uy) for k in range(count + 1)
        )

    def _passed(self, here: Observation, place: Point) -> bool:
        count = len(here.ranges_m)
        # Nearer than this, two neighbouring rays are less than a body's radius apart.
        sure_m = min(SURE_M, self.radius_m * count / (2 * pi))
        return seen_through(here, place, sure_m)


def seen_through(here: Observation, place: Point, sure_m: float) -> bool:
    """Whether two rays on each side of a place all pass it, so that no body is there.

    `place`: (x, y) metres. `sure_m`: rays prove nothing about places further away than this.
    """
    dx_m, dy_m = place[0] - here.x_m, place[1] - here.y_m
    distance_m, count = hypot(dx_m, dy_m), len(here.ranges_m)
    if not count or distance_m > sure_m:
        return False
    turn = floor((atan2(dy_m, dx_m) - here.heading_rad) / (2 * pi / count))
    return all(here.ranges_m[(turn + k) % count] > distance_m + BEYOND_M for k in (-1, 0, 1, 2))
