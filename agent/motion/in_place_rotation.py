"""Turns a body on the spot that is held in front and behind, until it can drive away.

A body with differential drive plans ways of curves, as tractors do, because that is faster. One that
was pushed aslant into a corner has no curve that leads out. One between a fence and another body has
none, either, that keeps its distance to both. It can turn there: its hull is a circle.
"""

from collections.abc import Callable
from math import copysign, pi, remainder
from typing import Final

from agent.interface.config import MS, S
from agent.paths.tractor_route import VehiclePose

HELD_US: Final = 1_500 * MS  # the body has been held for this long before it turns
STEP_RAD: Final = pi / 12  # between headings that are tried
OTHER_GEAR_RAD: Final = pi / 4  # so much further it turns to drive away in the gear that it wants
TURNED_RAD: Final = 0.05  # nearer to the heading than this it has arrived
TURN_RAD_S: Final = 0.6
GAIN_1_S: Final = 2.0  # turn rate for each radian that is left
GIVE_UP_US: Final = 12 * S  # half a turn takes 5.5 s
AWAY_M: Final = 1.0  # length of the straight that has to be free


class InPlaceRotation:
    """The turns on the spot of one robot, in front of fences and bodies."""

    def __init__(self) -> None:
        self._held_from_at_us: int | None = None
        self._to_rad: float | None = None
        self._end_at_us = 0

    def turn_rad_s(
        self,
        here: VehiclePose,
        gear: float,
        is_held: bool,
        away_m: Callable[[float], float],
        now_us: int,
    ) -> float | None:
        """The turn rate of a body that turns on the spot now, radians a second; None: it need not turn.

        Called once each control period. `gear`: 1 to drive ahead, -1 to back up. `is_held`: it wants to
        drive, and fences or bodies do not let it. `away_m`: for a course (radians), by how much a body
        that drives straight on for `AWAY_M` gets away from fences, metres; negative: it would get too
        near to a fence or a body.
        """
        if not is_held:
            self._held_from_at_us = None
        elif self._held_from_at_us is None:
            self._held_from_at_us = now_us
        elif self._to_rad is None and now_us - self._held_from_at_us >= HELD_US:
            self._to_rad = self._way_out(here.heading_rad, gear, away_m)
            self._end_at_us = now_us + GIVE_UP_US
            self._held_from_at_us = now_us
        if self._to_rad is None:
            return None
        left_rad = remainder(self._to_rad - here.heading_rad, 2 * pi)
        if abs(left_rad) < TURNED_RAD or now_us >= self._end_at_us:
            self._to_rad = self._held_from_at_us = None
            return None
        return copysign(min(GAIN_1_S * abs(left_rad), TURN_RAD_S), left_rad)

    @staticmethod
    def _way_out(heading_rad: float, gear: float, away_m: Callable[[float], float]) -> float | None:
        """The nearest heading from which the body can drive away, preferably in this gear."""
        best, best_cost = None, 2 * pi
        for k in range(1, round(pi / STEP_RAD) + 1):
            for turned_rad in (k * STEP_RAD, -k * STEP_RAD):
                for same, back_rad in ((gear > 0.0, 0.0), (gear < 0.0, pi)):
                    cost = abs(turned_rad) + (0.0 if same else OTHER_GEAR_RAD)
                    if cost < best_cost and away_m(heading_rad + turned_rad + back_rad) > 0.0:
                        best, best_cost = heading_rad + turned_rad, cost
        return best
