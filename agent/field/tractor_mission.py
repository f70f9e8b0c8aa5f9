"""The field mission for bodies that steer: stretches joined by paths that such a body can turn on.

What is claimed, counted and announced is as in `FieldMission`. The order of stretches respects the
turning circle: next comes the stretch with the shortest Dubins path to it (Dubins 1957). So a row
nearer than two turning radii is taken only after others, if there are others.
"""

from math import cos, dist, hypot, pi, sin

from agent.field.corner_cuts import PAST_END_M
from agent.field.field_map import Field, Section
from agent.field.field_mission import FieldMission
from agent.field.ground_parts import GroundParts
from agent.field.travel_times import TravelTimes
from agent.field.work_leg import WorkLeg
from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.geometry import Point
from agent.interface.lifecycle import State
from agent.interface.mission import STILL, THERE_M, FleetView, MotionRequest
from agent.motion.implement_clearance import LEAD_M
from agent.motion.tractor_escape import EscapeManoeuvre
from agent.motion.tractor_tracker import (
    AT_WORK,
    BEND_HALF_M,
    ON_THE_WAY,
    SteeredWheels,
    SteeringLimits,
    TractorTracker,
    bend_speed_m_s,
    heading_of,
    smooth_way,
)
from agent.paths.dubins import shortest_m
from agent.paths.route import Route
from agent.paths.tractor_route import Piece, TurnRoute, VehiclePose, sampled

BESIDE_M = 0.5  # further from the leg the implement is up: that may be another robot's section
JOIN_M_S = 1.5  # speed from a turn into a stretch
# Speed into a stretch that begins in a bend. Off its course, the bar would miss the corner.
JOIN_BENT_M_S = 0.4
BENT_M = 1.0  # a stretch whose first straight is shorter begins in a bend
LEAVE_M_S = 0.8  # speed from a stretch into a turn that is not planned yet
ROOM_M = 1.5  # free length beyond the end of a stretch that this speed needs
SLOW_WHEELS_S = 0.5  # from straight to the planned circle; wheels of tractors take 0.9 s
# Two changes of gear, at which wheels turn from lock to lock, and a way between them.
STUCK_US = 7_000_000
MOVED_M = 0.5  # a robot that gets on by less along its path within `STUCK_US` is stuck
BODY_M = 0.5  # between hulls on a path round a body: more than ORCA's disc takes
MAKE_WAY_M = 6.0  # an idle robot keeps this far from a working one
# Length of swath that is not worked beside a silent body: `BODY_M`, the lead-in, and room to stop.
BLOCKED_M = 1.4
STANDING_M_S = 0.1  # a slower robot counts as standing
NEAR_M = 12.0  # bodies further away do not count for the next turn
AGAIN_US = 1_000_000  # between attempts to find a path
HALF_PERIOD_S = CONTROL_PERIOD_US / S / 2  # the course is that of the middle of the control period
assert PAST_END_M < LEAD_M


class TractorMission(FieldMission):
    """One robot's part in the field, for a body that steers."""

    beside_m = BLOCKED_M
    turns_on_the_spot = False
    # A stretch has no lead-out. In a corner the bar is then where it has to be.
    past_end_m = PAST_END_M - LEAD_M
    # `_notice_stuck` watches instead, because a turn is longer than the remaining distance.
    plans_without_headway = False

    def __init__(
        self,
        field: Field,
        route: Route,
        turns: TurnRoute,
        radius_m: float,
        limits: SteeringLimits,
        travel: TravelTimes | None = None,
        wheels: SteeredWheels | None = None,
        parts: GroundParts | None = None,
    ) -> None:
        """`route`: plans paths of a point in the field. `turns`: plans paths of our body.
        `radius_m`: of every body. `limits`, `wheels`: of our chassis, see `TractorTracker`.
        `parts`: see `FieldMission`.
        """
        super().__init__(
            field, route, radius_m, limits.speed_m_s, limits.deceleration_m_s2, travel, parts
        )
        self.turns, self.limits, self.wheels = turns, limits, wheels
        self.reach_m = 2 * radius_m + BODY_M
        self.on_the_way, self.run_out_m = AT_WORK, 0.0
        if 1.0 / (turns.radius_m * limits.steer_1_m_s) > SLOW_WHEELS_S:
            self.on_the_way = ON_THE_WAY
            # The command looks ahead by this. A path that bends at once would be left by 0.2 m.
            self.run_out_m = ON_THE_WAY.preview_for_s * bend_speed_m_s(
                limits.speed_m_s, turns.radius_m
            )
        self.follow: TractorTracker | None = None
        self.bodies: list[tuple[float, float]] = []  # paths go round these since we were stuck
        self.joined = False  # we are at the beginning of the first leg and point along it
        # The path that is watched for progress, and how far along it the last progress was.
        self._followed: TractorTracker | None = None
        self._anchor_m, self._anchor_at_us, self._again_at_us = 0.0, 0, 0
        self._escape = EscapeManoeuvre(turns, radius_m, limits, wheels)

    def approach(self, section: int, view: FleetView) -> MotionRequest:
        self._look_round(view)
        if self.heading_to != section:
            self.heading_to = section
            self.legs, self.follow = self._legs(self.field.section(section), view), None
            self.joined = False
        if self.joined:
            return STILL
        return self._drive(view, only_approach=True)[0]

    def begin(self, section: int, view: FleetView) -> None:
        going, legs = self.heading_to == section, self.legs
        super().begin(section, view)
        if going and legs and not self._is_stale(legs, self.field.section(section), view):
            self.legs = legs  # the approach led to the first of them
        else:
            self.follow, self.joined = None, False
        self.tracker = self.follow

    def _is_stale(self, legs: list[WorkLeg], section: Section, view: FleetView) -> bool:
        """Whether legs that were planned before have units that are covered or blocked now."""
        blocked = self.blockage.units(section, things_too=True)
        units = [unit for leg in legs for unit in leg.units]
        return any(unit in blocked or view.progress.has(section.id, unit) for unit in units)

    def travel(self, goal: Point, view: FleetView) -> MotionRequest:
        """Drive to the goal, (x, y) metres; final directions are tried one after another."""
        self._look_round(view)
        off_m = hypot(goal[0] - view.here.x_m, goal[1] - view.here.y_m)
        if self.joined and off_m > THERE_M and view.now_us >= self._again_at_us:
            # It gave way to others shortly before the end, or was pushed since.
            self.heading_to, self._again_at_us = None, view.now_us + AGAIN_US
        if self.heading_to != goal:
            self.heading_to, self.follow, self.joined = goal, None, False
            away_rad = heading_of((view.here.x_m, view.here.y_m), goal)
            ends = (away_rad + k * pi / 4 for k in (0, 1, -1, 2, -2, 3, -3, 4))
            self.legs = [WorkLeg((goal, (goal[0] + cos(a), goal[1] + sin(a)))) for a in ends]
        return STILL if self.joined else self._drive(view, only_approach=True)[0]

    def abandon(self) -> None:
        super().abandon()
        self.follow, self.joined = None, False

    def idle(self, view: FleetView) -> MotionRequest:
        """Stand still, but not where another robot works or will work."""
        here = VehiclePose(view.here.x_m, view.here.y_m, view.here.heading_rad)
        near = [
            (n.pose.x_m, n.pose.y_m)
            for n in view.neighbours.values()
            if n.pose.state == State.WORKING
            and hypot(n.pose.x_m - here.x_m, n.pose.y_m - here.y_m) < MAKE_WAY_M
        ]
        everybody = [(n.pose.x_m, n.pose.y_m) for n in view.neighbours.values()]
        escape = self._escape.go(here, near, everybody)
        self.parking.observe(view)
        spot = self.parking.spot
        if escape is not None or spot is None:
            self.heading_to, self.follow, self.joined = None, None, False
            return _wish(here, escape, False)
        return self.travel(spot, view)

    def _own_end(self, view: FleetView) -> tuple[float, float]:
        if self.legs:
            return self.legs[-1].points[-1]
        if self.follow is not None:
            return self.follow.points[-1]
        return view.here.x_m, view.here.y_m

    def _go_round(self, view: FleetView) -> None:
        super()._go_round(view)
        self.follow, self.joined = None, False

    def _drive(
        self, view: FleetView, only_approach: bool = False
    ) -> tuple[MotionRequest, list[int]]:
        here = VehiclePose(view.here.x_m, view.here.y_m, view.here.heading_rad)
        covered: list[int] = []
        if self.shove.observe(view.here, view.now_us):
            self._on_displaced()
        self._notice_stuck(view, here)
        while True:
            if self.follow is None and not self._next(view, here, only_approach):
                return STILL, covered
            assert self.follow is not None
            self.follow.locate(*here)
            covered += self._passed(view)
            if self.follow.lost:
                self._lose(view)
                continue
            if not self.follow.arrived:
                break
            self.joined = not self.leg.units
            self.follow = self.tracker = None
        tool = bool(self.leg.units) and self.follow.gap_m <= BESIDE_M
        return _wish(here, self.follow.command(), tool), covered

    def _next(self, view: FleetView, here: VehiclePose, only_approach: bool) -> bool:
        """Begin the next leg, or the path to it. False: there is nothing to drive now.

        `only_approach`: do not begin a leg with units.
        """
        if not self.legs:
            return False
        first, second = self.legs[0].points[:2]
        start = VehiclePose(*first, heading_of(first, second))
        if self.joined and only_approach:
            return False
        if self.joined:
            self.leg, self.joined = self.legs.pop(0), False
            way, end_m_s = smooth_way(list(self.leg.points), BEND_HALF_M), 0.0
            if self.turns.piece_is_free(VehiclePose(*way[-1, :3]), Piece(0.0, ROOM_M)):
                end_m_s = LEAVE_M_S
        else:
            if view.now_us < self._again_at_us:
                return False
            standing = [*self.bodies, *self.blockage.bodies, *view.things]
            round_things = [*standing, *view.under_bar]
            pieces = self.turns.way(here, start, round_things, self.reach_m, self.run_out_m)
            if pieces is None and view.under_bar:  # it may pass, and asks if it may not
                pieces = self.turns.way(here, start, standing, self.reach_m, self.run_out_m)
            if pieces == []:  # we are there
                self.joined = True
                return self._next(view, here, only_approach)
            if pieces is None:  # a robot blocks it, or there is no way out from here
                self.bodies, self._again_at_us = [], view.now_us + AGAIN_US
                self.legs.append(self.legs.pop(0))
                return False
            self.leg = WorkLeg((here[:2], first))
            self.headway.again()  # the remaining distance did not include the turn
            joins_m_s = JOIN_M_S if dist(first, second) > BENT_M else JOIN_BENT_M_S
            stands = only_approach or pieces[-1].length_m < 0.0
            way, end_m_s = sampled(here, pieces), 0.0 if stands else joins_m_s
        manner = AT_WORK if self.leg.units else self.on_the_way
        self.follow = TractorTracker(way, self.limits, end_m_s, manner, self.wheels)
        self.tracker = self.follow
        self.unit, self.worst_m, self.lifted_to_m = 0, 0.0, 0.0
        return True

    def _lags_m(self) -> float:
        return 0.0 if self.follow is None else self.half_m * abs(sin(self.follow.off_rad))

    def _lose(self, view: FleetView) -> None:
        """Too far off the path: plan another one from here."""
        self.follow = self.tracker = None
        self.joined = False
        if self.leg.units and self.section is not None:
            self.legs = self._legs(self.section, view)

    def _notice_stuck(self, view: FleetView, here: VehiclePose) -> None:
        """No progress: go round the standing robots, or work another leg first."""
        follow = self.follow
        if follow is not self._followed or (
            follow is not None and follow.along_m - self._anchor_m > MOVED_M
        ):
            self._followed, self._anchor_at_us = follow, view.now_us
            self._anchor_m = follow.along_m if follow is not None else 0.0
        if follow is None:
            return
        if view.now_us - self._anchor_at_us < STUCK_US:
            return
        self._anchor_at_us = view.now_us
        self.bodies = [
            (n.pose.x_m, n.pose.y_m)
            for n in view.neighbours.values()
            if n.pose.speed_m_s < STANDING_M_S
            and hypot(n.pose.x_m - here.x_m, n.pose.y_m - here.y_m) < NEAR_M
        ]
        self._lose(view)
        if self.leg.units and len(self.legs) > 1:
            self.legs.append(self.legs.pop(0))

    def _legs(self, section: Section, view: FleetView) -> list[WorkLeg]:
        """The uncovered stretches of the section, each next by the shortest turn."""
        left = self._stretches(section, view, last=False)
        left = left or self._stretches(section, view, last=True)
        at = VehiclePose(view.here.x_m, view.here.y_m, view.here.heading_rad)
        legs: list[WorkLeg] = []
        while left:
            k, leg = min(
                ((k, way) for k, leg in enumerate(left) for way in (leg, _turned(leg))),
                key=lambda choice: shortest_m(at, _start(choice[1]), self.turns.radius_m),
            )
            left.pop(k)
            legs.append(leg)
            at = VehiclePose(*leg.points[-1], heading_of(leg.points[-2], leg.points[-1]))
        return legs


def _turned(leg: WorkLeg) -> WorkLeg:
    return WorkLeg(leg.points[::-1], leg.units[::-1])


def _start(leg: WorkLeg) -> VehiclePose:
    return VehiclePose(*leg.points[0], heading_of(leg.points[0], leg.points[1]))


def _wish(here: VehiclePose, command: tuple[float, float] | None, tool_on: bool) -> MotionRequest:
    if command is None:
        return STILL
    speed_m_s, turn_rad_s = command
    course = here.heading_rad + turn_rad_s * HALF_PERIOD_S
    return MotionRequest(speed_m_s * cos(course), speed_m_s * sin(course), turn_rad_s, tool_on)
