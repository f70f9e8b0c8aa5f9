"""What stands in a field for now: bodies of silent members, and things that an operator lets us pass.

The ways lead round them, and the units under them cannot be worked while they stand there.
"""

from typing import Final

from shapely.geometry import LineString
from shapely.geometry import Point as Spot

from agent.coasting import Coasting
from agent.field import Section
from agent.mission import FleetView
from agent.route import Route

Point = tuple[float, float]

BLOCKED_M: Final = 0.4  # margin of ORCA and of tracking, round a body that stands on a swath
THING_M: Final = (
    0.4  # beside the hull on a way past a thing: what the lookout keeps, and half a grain
)


class Blockage:
    def __init__(
        self, route: Route, radius_m: float, deceleration_m_s2: float, beside_m: float = BLOCKED_M
    ) -> None:
        """`beside_m`: kept from a silent body."""
        self.route, self.radius_m = route, radius_m
        self.body_m = 2 * radius_m + beside_m
        self.way = route  # the same with everything that stands in it
        self.things: frozenset[Point] = frozenset()
        self.coasting = Coasting(radius_m, deceleration_m_s2)
        self.bodies: tuple[Point, ...] = ()  # where silent members may stand
        self._silent: tuple[int, ...] = ()
        self._units: dict[tuple[int, bool], frozenset[int]] = {}  # (section, things too)

    def look(self, view: FleetView) -> frozenset[Point] | None:
        """What is new since the last look; None where a silent body came or went."""
        self.coasting.look(view.neighbours, view.here, view.now_us)
        places = {slot: self.coasting.places(slot) for slot in sorted(view.silent_since_us)}
        silent = tuple(slot for slot in places if places[slot] is not None)
        bodies = tuple(place for slot in silent for place in places[slot] or ())
        if silent == self._silent and bodies == self.bodies and view.things == self.things:
            return frozenset()
        # Fewer places than before, seen to be free, are no reason to leave the way we are on.
        new = view.things - self.things if silent == self._silent else None
        self._silent, self.bodies, self.things = silent, bodies, view.things
        self._units.clear()
        self.way = self.route
        if self.bodies:
            self.way = self.way.round(self.bodies, self.body_m)
        if self.things:
            self.way = self.way.round(sorted(self.things), self.radius_m + THING_M)
        return new

    def touches(self, points: list[Point], new: frozenset[Point]) -> bool:
        """Whether a way along these points meets one of the things that are new."""
        if not new or len(points) < 2:
            return bool(new)
        line, near_m = LineString(points), self.radius_m + THING_M
        return any(line.distance(Spot(thing)) < near_m for thing in new)

    def units(self, section: Section, things_too: bool) -> frozenset[int]:
        """Units that cannot be worked for a silent body, or also for a thing."""
        if not self.bodies and not (things_too and self.things):
            return frozenset()
        key = section.id, things_too
        if key not in self._units:
            bodies = [(Spot(at), self.body_m) for at in self.bodies]
            if things_too:
                bodies += [(Spot(at), self.radius_m + THING_M) for at in self.things]
            self._units[key] = frozenset(
                unit
                for unit, line in enumerate(section.unit_lines)
                if any(LineString(line).distance(spot) < reach_m for spot, reach_m in bodies)
            )
        return self._units[key]
