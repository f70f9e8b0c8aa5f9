"""Places that a robot cannot reach at present by any path: enclosed by bodies and other obstacles.

Boxes are removed and people step aside, so a place behind them counts only when it is cut off for a
while. Walls of the plan stay, so a place behind them counts at once. A robot does not
begin a task that it knows to be cut off. A fleet with only such tasks left reports that and is done.
"""

from collections.abc import Mapping, Sequence
from math import hypot

from agent.interface.config import S
from agent.interface.geometry import Point
from agent.mapping.dynamic_obstacles import DynamicObstacles

LOOK_US = 1 * S  # period of `observe`
# A section counts as cut off after this long: another robot may be about to fetch the parcel.
CUT_OFF_US = 15 * S
STANDSTILL_US = 30 * S  # without `GOT_ON_M` of progress for this long, others may take our tasks
GOT_ON_M = 1.0


class Reachability:
    """Which sections one robot cannot reach now, and whether it makes no progress."""

    def __init__(self, hazards: DynamicObstacles) -> None:
        self.hazards = hazards
        self.sections: frozenset[int] = frozenset()
        self._cut_off_at_us: dict[int, int] = {}
        self._look_at_us, self._orders = 0, 0
        self._stood: tuple[Point, int] = ((0.0, 0.0), 0)  # where, and since when

    def due(self, now_us: int, orders: int) -> bool:
        """Whether it is time to call `observe`. `orders`: how many have been added or changed; a new
        one is looked at before anybody bids for it.
        """
        fresh, self._orders = orders != self._orders, orders
        return fresh or now_us >= self._look_at_us

    def observe(self, at: Point, goals: Mapping[int, Sequence[Point]], now_us: int) -> None:
        """Update `sections`, the ones that have been out of reach for `CUT_OFF_US`, or that are behind
        walls of the plan.

        `at`: our position. `goals`: for each section the places that must all be reachable; (x, y)
        metres.
        """
        self._look_at_us = now_us + LOOK_US
        places = [(section, place) for section, own in goals.items() for place in own]
        reached = self.hazards.reaches(at, [place for _, place in places])
        cut = {section for (section, _), there in zip(places, reached, strict=True) if not there}
        self._cut_off_at_us = {section: self._cut_off_at_us.get(section, now_us) for section in cut}
        left = [(section, place) for section in sorted(cut) for place in goals[section]]
        planned = self.hazards.reaches(at, [place for _, place in left], on_plan=True)
        walled = {section for (section, _), there in zip(left, planned, strict=True) if not there}
        self.sections = frozenset(
            section
            for section, start_at_us in self._cut_off_at_us.items()
            if section in walled or now_us - start_at_us > CUT_OFF_US
        )

    def forget(self, section: int) -> None:
        """The place of this section is another one now: what is known of it begins anew."""
        self._cut_off_at_us.pop(section, None)
        self.sections -= {section}

    def stands_still(self, at: Point, busy: bool, now_us: int) -> bool:
        """Once each control period: whether a busy robot has stood for `STANDSTILL_US`.

        `at`: our position, (x, y) metres.
        """
        (x_m, y_m), start_at_us = self._stood
        if not busy or hypot(at[0] - x_m, at[1] - y_m) > GOT_ON_M:
            self._stood = (at, now_us)
            return False
        return now_us - start_at_us > STANDSTILL_US
