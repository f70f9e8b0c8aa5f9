"""Temporary obstructions in a field: bodies of silent members, and obstacles confirmed by an operator.

Paths lead round them, and the units under them cannot be worked while they are there.
"""

from collections.abc import Iterable, Sequence
from math import dist, inf
from typing import Final

from shapely.geometry import LineString
from shapely.geometry import Point as Spot

from agent.field.field_map import Section
from agent.interface.config import S
from agent.interface.geometry import Point
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView
from agent.motion.stopping_zone import StoppingZone
from agent.paths.route import Route

BLOCKED_M: Final = 0.4  # margin of ORCA and of tracking round a body that stands on a swath
PASS_M: Final = 0.25  # margin on a path past a body: ORCA's margin and the cross-track error
# Margin beside the hull on a path past an obstacle: that of the detector and half a ground cell.
THING_M: Final = 0.4
OUT_OF_REACH_M: Final = 1.5  # from a body that cannot go on to the obstacle, and to the next unit
NEAR_M: Final = 4.0  # a robot with no larger gap than this may be the reason for a stall
STANDS_M_S: Final = 0.05  # a slower robot counts as standing
MOVED_M: Final = 0.5  # a robot that moved further than this no longer stands in the way
BESIDE_M: Final = 0.1  # a path may be this much nearer to a robot than one planned round it
FRESH_US: Final = 1 * S  # an older beat does not prove that a robot stands
FORGET_US: Final = 30 * S  # after this the path past a robot that stood in the way is tried again


class FieldObstructions:
    """What stands in the field for a while, as one robot knows it, and paths round it; (x, y)
    metres.
    """

    def __init__(
        self, route: Route, radius_m: float, deceleration_m_s2: float, beside_m: float = BLOCKED_M,
        bar_m: float = 0.0,
    ) -> None:  # fmt: skip
        """`route`: plans paths in the field without obstructions. `radius_m`: of every body.
        `beside_m`: margin to a silent body. `bar_m`: from a body to the nearest lowered implement.
        """
        self.route, self.radius_m = route, radius_m
        self.body_m, self.pass_m = 2 * radius_m + beside_m, 2 * radius_m + PASS_M
        self.unit_m = max(self.body_m, bar_m)  # from a silent body to a unit that is worked
        self._way: Route | None = route  # the route planner with all obstructions; None: to be made
        self.things: frozenset[Point] = frozenset()
        # Places that kept our implement up: paths planned from now on lead round them.
        self.under_bar: frozenset[Point] = frozenset()
        self.coasting = StoppingZone(radius_m, deceleration_m_s2)
        self.bodies: tuple[Point, ...] = ()  # where silent members may stand
        # Robots in our way -> where they may stand, and when that was seen.
        self.standing: dict[int, tuple[tuple[Point, ...], int]] = {}
        self._silent: tuple[int, ...] = ()
        self._units: dict[tuple[int, bool], frozenset[int]] = {}  # (section, things too)
        self._out_of_reach: dict[int, set[int]] = {}  # section -> units beside an obstacle

    def observe(self, view: FleetView) -> frozenset[Point] | None:
        """Once each control period: the obstacles that are new since the last call.

        None means that a silent body or a robot in our way came or went, so that all paths may be
        others.
        """
        self.coasting.observe(view.neighbours, view.here, view.now_us)
        self.under_bar = view.under_bar
        places = {slot: self.coasting.places(slot) for slot in sorted(view.fell_silent_at_us)}
        silent = tuple(slot for slot in places if places[slot] is not None)
        bodies = tuple(place for slot in silent for place in places[slot] or ())
        left = self._leave(view)
        same = silent == self._silent and bodies == self.bodies and view.things == self.things
        if same and not left:
            return frozenset()
        if self.things - view.things:
            self._out_of_reach.clear()  # of an obstacle that has left, perhaps
        # If places were seen to be free, the current path still does.
        new = view.things - self.things if silent == self._silent and not left else None
        self._silent, self.bodies, self.things = silent, bodies, view.things
        self._plan()
        return new

    def stand_before(self, view: FleetView) -> None:
        """We make no progress: paths go round robots that stand near by, until those move.

        A live robot that does not know its place stands, and does not move before it knows it again.
        """
        here = view.here.x_m, view.here.y_m
        for slot, (pose, heard_at_us) in view.neighbours.items():
            places = self._without_place(slot, view)
            if view.now_us - heard_at_us < FRESH_US and pose.speed_m_s < STANDS_M_S:
                places = ((pose.x_m, pose.y_m),)
            if any(dist(here, place) < self.body_m + NEAR_M for place in places):
                self.standing[slot] = places, view.now_us
        self._plan()

    def _without_place(self, slot: int, view: FleetView) -> tuple[Point, ...]:
        """Where a live robot may stand that says that it does not know its place; else empty."""
        if slot not in view.live or view.now_us - view.neighbours[slot].heard_at_us < FRESH_US:
            return ()
        return self.coasting.places(slot) or ()

    def _leave(self, view: FleetView) -> bool:
        """Drop robots that no longer stand in our way, or that may have moved."""
        for slot, (places, seen_at_us) in list(self.standing.items()):
            neighbour = view.neighbours.get(slot)
            lost = () if neighbour is None else self._without_place(slot, view)
            if lost == places:
                continue
            if lost:
                self.standing[slot] = lost, view.now_us
                return True
            here = (inf, inf) if neighbour is None else neighbour.pose[:2]
            if view.now_us - seen_at_us < FORGET_US and dist(here, places[0]) < MOVED_M:
                continue
            del self.standing[slot]
            return True
        return False

    @property
    def _stand(self) -> list[Point]:
        return [place for places, _ in self.standing.values() for place in places]

    def _plan(self) -> None:
        self._units.clear()
        self._way = None

    @property
    def way(self) -> Route:
        """The route planner with all obstructions, made when it is needed: in a large field that takes
        longer than a control period."""
        way = self._way
        if way is None:
            way = self.route
            if self.bodies:
                way = way.round(self.bodies, self.pass_m)
            if self.things:
                way = way.round(sorted(self.things), self.radius_m + THING_M)
            if self.standing:
                way = way.round(self._stand, self.pass_m)
            self._way = way
        return way

    def path(self, start: Point, goal: Point, view: FleetView) -> tuple[Point, ...]:
        """A path from start to goal round all obstructions, and round idle robots that stand on it.

        Idle robots may have nowhere to go. It also leads round places that have kept our implement up,
        if it would meet them.
        """
        free = self.way
        way = free.path(start, goal)
        if self.under_bar and self._meets(way, self.under_bar):
            free = free.round(sorted(self.under_bar), self.radius_m + THING_M)
            way = free.path(start, goal)
        stand = [
            (pose.x_m, pose.y_m)
            for slot, (pose, heard_at_us) in sorted(view.neighbours.items())
            if pose.state != State.WORKING and pose.speed_m_s < STANDS_M_S
            if slot not in self.standing and view.now_us - heard_at_us < FRESH_US
        ]
        if not stand:
            return way
        line = LineString(way)
        if all(line.distance(Spot(at)) >= self.pass_m - BESIDE_M for at in stand):
            return way
        near = [at for at in stand if dist(at, goal) > self.body_m and dist(at, start) > NEAR_M / 2]
        return free.round(near, self.pass_m).path(start, goal) if near else way

    def _meets(self, points: Sequence[Point], places: Iterable[Point]) -> bool:
        """Whether the body would come too near to one of these places on this path."""
        line, near_m = LineString(points), self.radius_m + THING_M
        return any(line.distance(Spot(place)) < near_m for place in places)

    def touches(self, points: list[Point], new: frozenset[Point]) -> bool:
        """Whether a path along these points meets one of the new obstacles."""
        if not new or len(points) < 2:
            return bool(new)
        return self._meets(points, new)

    def units(self, section: Section, things_too: bool) -> frozenset[int]:
        """Units of a section that a silent body blocks.

        `things_too`: also those that an obstacle or a robot in our way blocks.
        """
        if not self.bodies and not (things_too and (self.things or self.standing)):
            return frozenset()
        if things_too and self.things and section.id in self._out_of_reach:
            return self._near(section, things_too) | self._out_of_reach[section.id]
        return self._near(section, things_too)

    def out_of_reach(self, section: Section, at: Point, units: Iterable[int]) -> bool:
        """The robot tried in vain to work on beside an obstacle: the nearest of `units` is left out.

        `at`: where the robot is. The range sensors see one side of an obstacle only, so a unit that is
        far enough from what is known of it need not be. Returns whether there was such a unit.
        """
        if not any(dist(at, thing) < self.radius_m + OUT_OF_REACH_M for thing in self.things):
            return False
        spot = Spot(at)
        near = [(LineString(section.unit_lines[unit]).distance(spot), unit) for unit in units]
        near_m, unit = min(near, default=(inf, 0))
        if near_m > OUT_OF_REACH_M:
            return False
        self._out_of_reach.setdefault(section.id, set()).add(unit)
        return True

    def _near(self, section: Section, things_too: bool) -> frozenset[int]:
        key = section.id, things_too
        if key not in self._units:
            bodies = [(Spot(at), self.unit_m) for at in self.bodies]
            if things_too:
                bodies += [(Spot(at), self.radius_m + THING_M) for at in self.things]
                bodies += [(Spot(at), self.unit_m) for at in self._stand]
            rows = [LineString(swath) for swath in section.swaths]
            bodies = [b for b in bodies if any(row.distance(b[0]) < b[1] for row in rows)]
            self._units[key] = frozenset(
                unit
                for unit, line in enumerate(section.unit_lines)
                if any(LineString(line).distance(spot) < reach_m for spot, reach_m in bodies)
            )
        return self._units[key]
