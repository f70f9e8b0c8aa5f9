"""Where a member may stand that fell silent under way: between its last beat and where it came to rest.

A process that dies says nothing any more, but its body drives on: as long as its last command lives, and
then as far as it brakes; one that was cut off drives until it has noticed. At 2.5 m/s that is three
metres, more than a body is wide: whoever keeps away from the last beat alone drives into the body behind
it. So all of that way is kept clear, until rays pass through a place of it: nobody stands there.
"""

from collections.abc import Mapping
from math import atan2, ceil, cos, floor, hypot, pi, sin
from typing import Final

from agent.interface.config import ACTUATOR_TTL_US, BEATS, CONTROL_PERIOD_US, MS, S
from agent.interface.ports import Neighbour, Observation

Point = tuple[float, float]

GONE_QUIET_US: Final = (
    1 * S
)  # everybody has braked for a younger silence, and moves the last beat on
# Until it brakes: it notices that it hears nobody, and its last command is still in force. In fleets
# of more than 30, where silence is noticed later, a body that was cut off may stand further on: what
# no place here explains is a thing in the way (`agent/motion/obstacle_detector.py`).
DRIVES_ON_US = BEATS[0].silence_us + CONTROL_PERIOD_US + ACTUATOR_TTL_US
SPACING_M: Final = 0.5  # of places: a row of discs of 1.6 m is 2 cm narrower between two of them
SURE_M: Final = 4.0  # nothing is told from rays about places further off
BEYOND_M: Final = 0.4  # a ray that goes so much further than a place has passed it
assert DRIVES_ON_US == 450 * MS


class StoppingZone:
    """One robot's; what it has seen through stays so until the member is heard again."""

    def __init__(self, radius_m: float, deceleration_m_s2: float) -> None:
        self.radius_m, self.deceleration_m_s2 = radius_m, deceleration_m_s2
        self._heard_us: dict[int, int] = {}  # the beat that the places are of
        self._places: dict[int, tuple[Point, ...]] = {}

    def look(self, neighbours: Mapping[int, Neighbour], here: Observation, now_us: int) -> None:
        """Once a control period."""
        for slot, neighbour in neighbours.items():
            _, heard_us = neighbour
            if now_us - heard_us < GONE_QUIET_US:
                if slot in self._places:
                    del self._places[slot], self._heard_us[slot]
                continue
            if self._heard_us.get(slot) != heard_us:
                self._heard_us[slot] = heard_us
                self._places[slot] = self._way(neighbour)
            places = self._places[slot]
            left = tuple(place for place in places if not self._passed(here, place))
            if len(left) < len(places):
                self._places[slot] = left

    def places(self, slot: int) -> tuple[Point, ...] | None:
        """In the order of its way, none where it is seen to be gone; None: it is not long silent."""
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
    """Whether the rays on both sides of a place, two each, pass it: nothing as wide as a body is near."""
    dx_m, dy_m = place[0] - here.x_m, place[1] - here.y_m
    distance_m, count = hypot(dx_m, dy_m), len(here.ranges_m)
    if not count or distance_m > sure_m:
        return False
    turn = floor((atan2(dy_m, dx_m) - here.heading_rad) / (2 * pi / count))
    return all(here.ranges_m[(turn + k) % count] > distance_m + BEYOND_M for k in (-1, 0, 1, 2))
