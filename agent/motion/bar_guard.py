"""Keeps the lowered implement off people and things: it goes up before it is drawn over one.

The body stops and asks only before what is in its own way. What stands or walks beside the body, where
the bar passes, stops no robot: the bar is up there, and what it leaves is worked again later.
"""

from collections.abc import Mapping, Sequence
from math import hypot
from typing import Final

from agent.interface.config import MS, S
from agent.interface.effects import Drive
from agent.interface.geometry import Point
from agent.interface.observation import Neighbour, Observation
from agent.motion.obstacle_detector import GroundCell, ObstacleDetector, middle
from agent.motion.swept_ground import SweptGround

STANDING_M_S: Final = 0.02  # slower motion has no direction
STAYS_US: Final = 10 * S  # what keeps the bar up again after so long has not gone
# It is lowered when the ground was free for so long: a turning body's course lags, and what it senses of
# its course is noisy.
FREE_US: Final = 150 * MS
FORGET_US: Final = 60 * S  # a place that kept it up is forgotten after this
# The newest places that kept it up. Noise would make any number of them.
PLACES_MAX: Final = 64


class BarGuard:
    """Where the implement of one robot has to be up because of what its rays see."""

    def __init__(self, half_m: float, steers: bool, lookout: ObstacleDetector) -> None:
        """`half_m`: from the middle of the robot to an end of its bar. `steers`: the course turns as
        the body does. `lookout`: finds and remembers what the rays see.
        """
        self.half_m, self.steers, self.lookout = half_m, steers, lookout
        # When a thing in each ground cell kept the bar up first, and last.
        self.kept_up: dict[GroundCell, tuple[int, int]] = {}
        self._up_at_us = -FREE_US  # when a thing was in the ground last
        self.stay = frozenset[Point]()  # the middles of those that have stayed

    def must_be_up(
        self,
        drive: Drive,
        here: Observation,
        motions: Sequence[Point],
        neighbours: Mapping[int, Neighbour],
        now_us: int,
    ) -> bool:
        """Each control period in which the bar is to be down: whether it would come over something
        before the robot can stand.

        `drive`: what the robot will be told. `motions`: the velocities that it has or may have next,
        (x, y) metres a second. `neighbours`: newest poses by slot.
        """
        if not here.ranges_m:
            return False
        fastest_m_s = max((hypot(*motion) for motion in motions), default=0.0)
        wants_m_s = hypot(drive.vx_m_s, drive.vy_m_s)
        bend_1_m = 0.0
        if self.steers and wants_m_s > STANDING_M_S:
            bend_1_m = drive.turn_rad_s / wants_m_s
        way_m = self.lookout.stopping_m(fastest_m_s)
        ground = SweptGround(self.half_m, motions, way_m, bend_1_m)
        things = self.lookout.under_bar(here, ground, neighbours, now_us)
        if things or self.kept_up:
            self._note(things, now_us)
        if things:
            self._up_at_us = now_us
        return now_us - self._up_at_us < FREE_US

    def _note(self, things: Sequence[GroundCell], now_us: int) -> None:
        """Remember what keeps the bar up, and since when."""
        for cell in things:
            first_at_us, _ = self.kept_up.pop(cell, (now_us, 0))
            self.kept_up[cell] = first_at_us, now_us
        while len(self.kept_up) > PLACES_MAX:
            del self.kept_up[next(iter(self.kept_up))]
        for cell, (_, last_at_us) in list(self.kept_up.items()):
            if now_us - last_at_us <= FORGET_US:
                break
            del self.kept_up[cell]
        self.stay = frozenset(
            middle(cell)
            for cell, (first_at_us, last_at_us) in self.kept_up.items()
            if last_at_us - first_at_us >= STAYS_US
        )
