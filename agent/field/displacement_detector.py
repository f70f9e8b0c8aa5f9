"""Detects that the robot was displaced: it did not drive the way by which its place changed.

The units in between were passed without work, even on a straight line. A robot that is pushed along
its row must not count the push as driving.

There are two signs. A leap is further than the wheels could drive since the last control period. A
slower displacement, as by people who push at walking speed, shows by the sensed velocity: the place
changes by more than the velocity explains. Both sums, of the way and of what is explained, are forgotten
with a time constant, so that their errors do not add up. A body whose velocity does not follow its way,
because it senses none or that has failed, shows leaps only.
"""

from math import exp, hypot, pi, remainder
from typing import Final

from agent.interface.config import CONTROL_PERIOD_US, MS, S
from agent.interface.geometry import Point
from agent.interface.instants import NEVER_US
from agent.interface.observation import Observation

LEAP_M: Final = 0.1  # a jump longer than this plus the way at 1.5 times full speed is no driving
LEAP_SHARE: Final = 1.5
FORGET_S: Final = 0.5  # time constant of both sums
GAP_US: Final = 500 * MS  # after a longer time without senses, both sums begin again
# What the velocity need not explain: noise of the place beyond its accuracy, then a velocity that is late
# by `LATE_S` while the body speeds up, then an antenna that is not in the middle of a body that turns.
UNEXPLAINED_M: Final = 0.1
LATE_S: Final = 0.2
ACCURACIES: Final = 2.0  # standard deviations of the place
LEVER_M: Final = 2.0
# With more than this share of it unexplained, a displacement may have begun. In the meantime a push moves
# a robot by 7 cm.
DOUBTFUL_SHARE: Final = 0.25
EXPLAINED_SHARE: Final = 0.5  # of the way: the velocity follows the way
FOLLOWED_FOR_US: Final = 10 * S  # it failed after as long as this without, and longer than any push


class DisplacementDetector:
    """Compares each place of one robot with the ones before, and with its sensed velocity."""

    def __init__(self, speed_m_s: float, acceleration_m_s2: float) -> None:
        """`speed_m_s`: the highest speed of the robot. `acceleration_m_s2`: at which it speeds up."""
        self.speed_m_s = speed_m_s
        self._late_m = UNEXPLAINED_M + acceleration_m_s2 * LATE_S * FORGET_S
        self._before: Observation | None = None
        self._seen_at_us = 0  # when the place before was seen
        self._sensed_at_us = 0  # when it was sensed
        self._way: Point = (0.0, 0.0)
        self._explained: Point = (0.0, 0.0)
        self._turned_rad = 0.0  # forgotten as the sums
        self._follows_for_us = 0  # how long the velocity has followed the way; 0: it does not
        self.doubtful = (
            False  # whether a displacement may have begun that `observe` does not see yet
        )

    def observe(self, here: Observation, now_us: int) -> bool:
        """Whether the robot was displaced since the last call, or not long before. Call it in every
        control period at work."""
        before, self._before = self._before, here
        seen_at_us, self._seen_at_us = self._seen_at_us, now_us
        at_us = now_us if here.sensed_at_us == NEVER_US else here.sensed_at_us
        sensed_at_us, self._sensed_at_us = self._sensed_at_us, at_us
        if before is None:
            return False
        step_m = here.x_m - before.x_m, here.y_m - before.y_m
        passed_for_us = max(now_us - seen_at_us, CONTROL_PERIOD_US)
        reach_m = LEAP_SHARE * self.speed_m_s * passed_for_us / S + LEAP_M
        if not 0 <= at_us - sensed_at_us <= GAP_US:
            self._way = self._explained = (0.0, 0.0)
            self._turned_rad = 0.0
        elif at_us != sensed_at_us:
            self._add(before, here, at_us - sensed_at_us)
        share = self._unexplained_share(here.position_accuracy_m)
        self.doubtful = share > DOUBTFUL_SHARE
        return hypot(*step_m) > reach_m or share > 1.0

    def _add(self, before: Observation, here: Observation, passed_for_us: int) -> None:
        """Add the step from one observation to the next to the sums."""
        passed_for_s = passed_for_us / S
        kept = exp(-passed_for_s / FORGET_S)
        (way_x_m, way_y_m), (x_m, y_m) = self._way, self._explained
        self._way = (
            kept * way_x_m + here.x_m - before.x_m,
            kept * way_y_m + here.y_m - before.y_m,
        )
        self._explained = (
            kept * x_m + (before.vx_m_s + here.vx_m_s) / 2 * passed_for_s,
            kept * y_m + (before.vy_m_s + here.vy_m_s) / 2 * passed_for_s,
        )
        turned_rad = remainder(here.heading_rad - before.heading_rad, 2 * pi)
        self._turned_rad = kept * self._turned_rad + turned_rad
        way_m = hypot(*self._way)
        if way_m > UNEXPLAINED_M + ACCURACIES * here.position_accuracy_m:
            follows = self._along_m(self._explained) > EXPLAINED_SHARE * way_m
            more_for_us = passed_for_us if follows else -passed_for_us
            self._follows_for_us = min(max(self._follows_for_us + more_for_us, 0), FOLLOWED_FOR_US)

    def _along_m(self, vector: Point) -> float:
        """How far a vector goes along the way."""
        way_m = hypot(*self._way)
        return (vector[0] * self._way[0] + vector[1] * self._way[1]) / way_m if way_m else 0.0

    def _unexplained_share(self, accuracy_m: float) -> float:
        """By how much more the place has changed than the velocity explains, as a share of what it need
        not explain."""
        if not self._follows_for_us:
            return 0.0
        rest_m = self._way[0] - self._explained[0], self._way[1] - self._explained[1]
        allowed_m = self._late_m + ACCURACIES * accuracy_m + LEVER_M * abs(self._turned_rad)
        # Where the place lags behind the velocity, as a frozen one does, no ground was passed.
        return hypot(*rest_m) / allowed_m if self._along_m(rest_m) > 0.0 else 0.0
