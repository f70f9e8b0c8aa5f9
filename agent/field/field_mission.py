"""The field mission: cover every unit of every section with an implement, together.

A section is worked as legs: swath legs with the implement down, transit legs with it up. A unit
counts as covered when the robot has passed from its one end to its other with the implement down
and never further from the line than the overlap allows. What was missed is worked again.
"""

from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from functools import partial
from math import copysign, dist, hypot, inf, sqrt
from typing import Final

from shapely.geometry import LineString
from shapely.geometry import Point as Spot

from agent.claims.claim_headway import NO_HEADWAY, Headway
from agent.field.bar_swing import COURSE_M, BarSwing
from agent.field.displacement_detector import DisplacementDetector
from agent.field.field_map import Field, Section
from agent.field.field_obstructions import BLOCKED_M, FieldObstructions
from agent.field.ground_parts import GroundParts
from agent.field.parking import Parking
from agent.field.section_choice import SectionChooser
from agent.field.travel_times import TravelTimes
from agent.field.work_leg import STRAIGHT_M, SWUNG_M, LeadInOut, WorkLeg, working_leg
from agent.interface.config import LEASE_US, S
from agent.interface.geometry import Point
from agent.interface.mission import STILL, ClaimRequest, FleetView, Mission, MotionRequest
from agent.interface.observation import Observation
from agent.motion.implement_clearance import LEAD_M, Implement
from agent.motion.obstacle_detector import stopping_m
from agent.motion.path_tracker import FollowedWay, PathTracker
from agent.motion.swept_ground import ASIDE_M
from agent.paths.route import Route
from crdt import Phase, Progress

ASTRAY_M: Final = 4.0  # further from its line than this swath width, a robot replans its way back
NEAR_END_S: Final = 5.0  # claim the next section when this much work is left

SLOW_M_S: Final = 0.05  # below this speed the direction of motion is noise
ALIGNED_M: Final = 0.05  # a robot that starts this near to its line begins its first unit straight
# A bar end that begins a unit this much late leaves less than the cells by which work is judged.
LATE_M: Final = 0.02
TILT_MIN: Final = 0.1  # sine of a tilt that every field tolerates: control is no more exact
REST_M: Final = (
    40.0  # further back than a swath or two, missed units are left to the plan of the fleet
)
SOON_M: Final = 6.0  # nearer than this to its work, a robot announces its implement
WAITING_M: Final = 0.1  # this far before its first unit, a robot that drifts sideways waits
DOUBTED_US: Final = 1 * S  # a push at walking speed is seen after 0.7 s at most
# Units under silent bodies are given up only after this time, as long as others leave a standing owner
# its sections: a robot restarts within it, and a loose plug is found.
SILENT_FOR_US: Final = 3 * LEASE_US
UNDER_A_BODY: Final = "a silent robot is on the rest"  # for the trace
# Further off a way without work, a robot heads for the next corner, if it is in sight. Back to the line
# it would meet those again that pushed it off.
AIM_M: Final = 0.1
# Nearer than this to the corner, it goes back to the line: turns between rows are shorter, and end
# where the next row begins only if they are driven on their line.
AIM_LEAST_M: Final = 6.0


_wish = tuple.__new__  # a third of the time of keyword arguments; one is made each period


# The accuracy of the place may use up this share of the tolerance of a unit; the rest is for tracking.
# A robot whose units would not count stands instead of working them again and again.
ACCURACY_SHARE: Final = 0.75


class FieldMission(Mission):
    """One robot's part in the field, for a body that turns on the spot. Places are (x, y)
    metres.
    """

    replans = True
    beside_m = BLOCKED_M  # margin to a silent body
    turns_on_the_spot = True  # at a corner of a swath, where it swings its bar round the corner
    past_end_m = 0.0  # the robot has to be this far beyond the last unit of a leg for it to count
    # Replan before a section is given back. False: the subclass watches for stalls itself.
    plans_without_headway = True

    def __init__(
        self,
        field: Field,
        route: Route,
        radius_m: float,
        speed_m_s: float,
        deceleration_m_s2: float,
        travel: TravelTimes | None = None,
        parts: GroundParts | None = None,
    ) -> None:
        """`route`: plans paths in the field. `radius_m`: of every body. `speed_m_s`,
        `deceleration_m_s2`: of our body. `travel`: times of such bodies, for the plan of the fleet.
        `parts`: of the field, that no body can leave; None: it is one.
        """
        self.field, self.route, self.radius_m = field, route, radius_m
        self.speed_m_s, self.deceleration_m_s2 = speed_m_s, deceleration_m_s2
        self.tolerance_m = field.tracking_tolerance_m
        self.position_accuracy_max_m = ACCURACY_SHARE * self.tolerance_m
        self.choosing = SectionChooser(field, speed_m_s, travel, parts)
        self.section: Section | None = None
        self.legs: list[WorkLeg] = []
        self.tracker: FollowedWay | None = None
        self.leg = WorkLeg(())
        self.unit = 0  # index into the leg's units
        self.worst_m = 0.0  # largest cross-track error inside the current unit
        self.half_m = field.implement_width_m / 2
        # Sine of the tilt up to which the bar covers the width of its swath without the overlap.
        reach = 1.0 - field.overlap_m / field.implement_width_m
        self.tilt_max = max(sqrt(1.0 - reach * reach), TILT_MIN)
        # How far back on the leg the left and the right end of the lowered bar have been.
        self.ends_begun_m = inf, inf
        self.course_begun_m = inf, inf  # the same by its last move of `COURSE_M`
        self.course_from: Point | None = None  # where that move began
        self.ends_reached_m = 0.0, 0.0  # how far they have come while they passed the end of a unit
        self.course_reached_m = 0.0, 0.0  # the same by its moves of `COURSE_M`
        self.swing = BarSwing([])
        self.lifted = False  # the implement was up since the last check
        self.missed: int | None = None  # the unit that was driven last and does not count
        self.retried: set[int] = set()  # units of the section that were worked again at once
        self.failed: set[int] = set()  # units of the section that were driven and do not count
        self.beside: set[int] = set()  # units of the section that are left out beside a thing
        self.advanced = False  # a unit of the section was worked since it was begun
        self.up = False  # the implement was up in the last period
        self.lifted_to_m = 0.0  # arc length of the leg up to which it was up
        self.shove = DisplacementDetector(speed_m_s, deceleration_m_s2)
        # Units that were passed while a displacement may have begun, and since when they wait. They count
        # once there was none.
        self.doubted: list[int] = []
        self.doubted_at_us = 0
        self.headway = Headway()
        self.worked: set[int] = set()  # units of the current section not in the progress yet
        self.heading_to: int | Point | None = None  # section or place an approach path leads to
        # From a thing to the lines of units at which the bar may have been up because of it.
        way_m = stopping_m(speed_m_s, deceleration_m_s2) + LEAD_M
        self.beside_bar_m = hypot(self.half_m + ASIDE_M, way_m) + field.unit_m
        bar_m = Implement(field.implement_width_m / 2 - field.overlap_m, radius_m).reach_m
        self.parking = Parking(field, radius_m, speed_m_s, bar_m)
        self.blockage = FieldObstructions(route, radius_m, deceleration_m_s2, self.beside_m, bar_m)

    @property
    def section_units(self) -> Mapping[int, int]:
        return {section.id: section.units for section in self.field.sections}

    @property
    def outline(self) -> list[Point]:
        """The field without its holes."""
        return [(float(x), float(y)) for x, y, *_ in self.field.polygon.exterior.coords]

    def worked_lines(self, progress: Progress) -> Iterable[Sequence[Point]]:
        for section in self.field.sections:
            name = section.id
            if progress.covered(name):
                for line, _ in section.stretches(partial(progress.has, name)):
                    yield [(float(x), float(y)) for x, y, *_ in line]

    @property
    def remaining_path(self) -> list[Point]:
        """What is left of the leg that we drive, and the legs after it."""
        now = [] if self.tracker is None else self.tracker.remaining_path
        return [*now, *(point for leg in self.legs for point in leg.points)]

    # ---------------------------------------------------------------- choosing

    def choose(self, view: FleetView) -> ClaimRequest | None:
        rest_for_s = 0.0 if self.section is None else self._left_m / self.speed_m_s
        return self.choosing.choose(view, self._own_end(view), rest_for_s, self._waiting(view))

    def _own_end(self, view: FleetView) -> Point:
        if self.legs:
            return self.legs[-1].points[-1]
        if self.tracker is not None:
            return self.tracker.points[-1]
        return view.here.x_m, view.here.y_m

    # ---------------------------------------------------------------- working

    def approach(self, section: int, view: FleetView) -> MotionRequest:
        self._look_round(view)
        if self.heading_to != section:
            self.heading_to = section
            self.parking.forget()
            legs = self._legs(self.field.section(section), view)
            self.legs, self.tracker = [legs[0]] if legs and not legs[0].units else [], None
        return self._drive(view)[0]

    def accepts_goal(self, goal: Point) -> bool:
        return self.route.admits(goal)

    def travel(self, goal: Point, view: FleetView) -> MotionRequest:
        self._look_round(view)
        if self.heading_to != goal or (self.tracker is None and not self.legs):
            self.heading_to, self.tracker = goal, None
            self.legs = [WorkLeg(self.blockage.path((view.here.x_m, view.here.y_m), goal, view))]
        return self._drive(view)[0]

    def begin(self, section: int, view: FleetView) -> None:
        self.section, self.heading_to = self.field.section(section), None
        self.worked.clear()
        self.doubted.clear()
        self.retried.clear()
        self.failed.clear()
        self.beside.clear()
        self.missed = None
        self.advanced = False
        self.headway.begin()
        self.parking.forget()
        self.legs, self.tracker = self._legs(self.section, view), None

    def abandon(self) -> None:
        self.section, self.heading_to = None, None
        self.legs, self.tracker = [], None

    def on_stalled(self, view: FleetView) -> None:
        """Replan from here round standing robots near by; the units under them come last."""
        self.blockage.stand_before(view)
        self._go_round(view)

    def on_implement_raised(self) -> None:
        """The implement is up, so the current unit, if any, has to be worked again."""
        self.worst_m, self.lifted = inf, True

    def idle(self, view: FleetView) -> MotionRequest:
        """No work for us: stand still, but not where a robot works or will work."""
        self.heading_to = None
        self._look_round(view)
        before = self.parking.spot
        self.parking.observe(view)
        spot = self.parking.spot
        if spot is None:
            self.legs, self.tracker = [], None
            return STILL
        if spot != before or self.tracker is None:
            here = (view.here.x_m, view.here.y_m)
            if dist(here, spot) <= self.tolerance_m:
                return STILL
            self.legs, self.tracker = [WorkLeg(self.blockage.path(here, spot, view))], None
        return self._drive(view)[0]

    def work(self, view: FleetView) -> MotionRequest:
        if self.section is None:  # resumed after a stop or a sync that forgot the geometry
            held = view.allocation.assigned_sections(view.slot)
            begun = [s for s in held if view.allocation.phase_of(s) is Phase.STARTED]
            self.begin((begun or held)[0], view)
        assert self.section is not None
        self.choosing.observe(view)
        self._look_round(view)
        wish, passed = self._drive(view)
        covered = self._undoubted(passed, view.now_us)
        self.worked.update(covered)
        missing = self._missing(view)
        if not missing and self._rest_waits(view):
            self.given_up_why = UNDER_A_BODY
            self.choosing.gave_back(self.section.id, self.section.units, view.now_us)
            self.abandon()
            return wish._replace(covered=tuple(covered), tool_on=False, given_up=True)
        if not missing:
            self.section = None
            return _covering(wish, covered, True, True)
        if self.tracker is None and not self.legs and not self.doubted:
            self.legs = self._legs(self.section, view)
            self.headway.again()
        self.advanced = self.advanced or bool(covered)
        if self._far_behind:
            return self._leave_rest(wish, covered)
        if self._turns_back():
            self.legs, self.tracker = self._legs(self.section, view), None
            self.headway.again()
        late = self.headway.observe(bool(covered), self._left_m, view.now_us)
        if late and self.plans_without_headway:
            self.on_stalled(view)
        lost = self.headway.lost
        if lost and ((view.leave_out and self._leaves_out(view)) or self._leaves_out_beside(view)):
            self.headway.begin()
            self._go_round(view)
        elif lost:
            self.given_up_why = NO_HEADWAY
            self.choosing.gave_back(self.section.id, self.section.units - missing, view.now_us)
            self.abandon()
            return wish._replace(covered=tuple(covered), tool_on=False, given_up=True)
        rest_for_s = max(missing * self.field.unit_m, self._left_m) / self.speed_m_s
        return _covering(wish, covered, False, rest_for_s < NEAR_END_S)

    def _undoubted(self, passed: list[int], now_us: int) -> list[int]:
        """The units that count now, of those passed in this period and before.

        A push is seen only after it has moved the robot by decimetres. A unit whose end it reached
        meanwhile was not worked to its end. What is not seen within `DOUBTED_US` is no push: a velocity
        that is always a little too low must not hold units back.
        """
        if self.shove.doubtful and (passed or self.doubted):
            if not self.doubted:
                self.doubted_at_us = now_us
            self.doubted += passed
            if now_us - self.doubted_at_us < DOUBTED_US:
                return []
            passed = []
        covered = self.doubted + passed if self.doubted else passed
        self.doubted = []
        return covered

    def _on_displaced(self) -> None:
        """The robot did not drive the way by which its place changed."""
        if self.doubted:
            self.missed = self.doubted[-1]
            self.doubted = []
        self.on_implement_raised()

    def _leaves_out(self, view: FleetView) -> bool:
        """Whether the next unit is out of reach beside an obstacle that an operator confirmed."""
        assert self.section is not None
        section, progress = self.section, view.progress
        blocked = self._blocked(view, last=True) | self.worked
        left = [
            unit
            for unit in range(section.units)
            if unit not in blocked and not progress.has(section.id, unit)
        ]
        return self.blockage.out_of_reach(section, (view.here.x_m, view.here.y_m), left)

    def _leaves_out_beside(self, view: FleetView) -> bool:
        """Whether units are left out that could not be worked, because a thing stays under the bar.

        They are tried again in another turn first: people go away, and another robot may do them."""
        assert self.section is not None
        section, before = self.section, len(self.beside)
        if not view.under_bar or not self.choosing.has_given_back(section.id):
            return False
        for unit in self.failed - self.worked - self.beside:
            line = LineString(section.unit_lines[unit])
            near = any(line.distance(Spot(at)) < self.beside_bar_m for at in view.under_bar)
            if near and not view.progress.has(section.id, unit):
                self.beside.add(unit)
        return len(self.beside) > before

    def _turns_back(self) -> bool:
        """Whether to work a unit again at once that was just missed, because the bar had to go up.

        Later, the whole way back is for this unit. It is tried once: the body in the way may stay.
        """
        missed, self.missed = self.missed, None
        if missed is None or missed in self.retried or not self.turns_on_the_spot:
            return False
        self.retried.add(missed)
        return True

    @property
    def at_work(self) -> bool:
        if self.section is None:
            return False
        if self.leg.units:
            return True
        if self.tracker is None or not self.legs:
            return False
        return self.tracker.total_m - self.tracker.along_m < SOON_M

    @property
    def _far_behind(self) -> bool:
        """Whether what was missed is so far back that it is planned again, for the whole fleet."""
        planned = self.choosing.fleet_plan is not None
        if not planned or not self.advanced or self.tracker is None:
            return False
        return not self.leg.units and self.leg.length_m > REST_M

    def _leave_rest(self, wish: MotionRequest, covered: list[int]) -> MotionRequest:
        """Give the section back with the units that were missed."""
        self.abandon()
        self.given_up_why = "the rest is far back"
        return wish._replace(covered=tuple(covered), tool_on=False, given_up=True)

    @property
    def _left_m(self) -> float:
        """What is left of all legs."""
        now_m = 0.0 if self.tracker is None else self.tracker.total_m - self.tracker.along_m
        return now_m + sum(leg.length_m for leg in self.legs)

    def _missing(self, view: FleetView) -> int:
        """Number of units that no robot has covered and that can be covered."""
        assert self.section is not None
        section = self.section
        progress = view.progress
        # Few are left, so this question of every control period stays cheap in a long section.
        self.worked = {u for u in self.worked if not progress.has(section.id, u)}
        known = progress.covered(section.id) + len(self.worked)
        if known == section.units:
            return 0
        blocked = 0
        for unit in self._blocked(view, last=True):
            if unit not in self.worked and not progress.has(section.id, unit):
                blocked += 1
        return section.units - known - blocked

    def _left_over(self, section: Section, view: FleetView) -> bool:
        """Whether units are left, silent bodies are on some of them, and none can be worked now."""
        bodies = self.blockage.units(section, things_too=False)
        if not bodies:
            return False
        blocked = self.blockage.units(section, things_too=True) if view.leave_out else bodies
        mine = self.worked if self.section is section else frozenset[int]()
        left = [
            unit
            for unit in range(section.units)
            if unit not in mine and not view.progress.has(section.id, unit)
        ]
        return not bodies.isdisjoint(left) and blocked.issuperset(left)

    def _waiting(self, view: FleetView) -> frozenset[int]:
        """The free sections of which only units under silent bodies are left, while there is hope for
        these: a silent robot may come back, and one behind a cut has driven on.

        A section that is DONE stays so. So they are ended as they are only if nothing else is left to do,
        and all silent robots have been silent for long.
        """
        if not self.blockage.bodies:
            return frozenset()
        phase_of, apart = view.allocation.phase_of, self.choosing.apart(view)
        begun = [
            s for s in self.field.sections if phase_of(s.id) is not Phase.DONE and s.id not in apart
        ]
        waiting = frozenset(
            s.id for s in begun if phase_of(s.id) is Phase.FREE and self._left_over(s, view)
        )
        if len(waiting) == len(begun) and self._are_silent_for_long(view):
            return frozenset()
        return waiting

    def _rest_waits(self, view: FleetView) -> bool:
        """Whether to give our section back instead of ending it, because of units under silent bodies."""
        assert self.section is not None
        if not self._left_over(self.section, view):
            return False
        phase_of, apart = view.allocation.phase_of, self.choosing.apart(view)
        others = [
            s
            for s in self.field.sections
            if s is not self.section and phase_of(s.id) is not Phase.DONE and s.id not in apart
        ]
        ends = all(phase_of(s.id) is Phase.FREE and self._left_over(s, view) for s in others)
        return not (ends and self._are_silent_for_long(view))

    def _are_silent_for_long(self, view: FleetView) -> bool:
        newest_at_us = max(view.fell_silent_at_us.values(), default=view.now_us - SILENT_FOR_US)
        return view.now_us - newest_at_us >= SILENT_FOR_US

    def _look_round(self, view: FleetView) -> None:
        """Update the obstructions in the field and replan if they changed.

        A leg at work that none of them is in the way of is driven to its end: a unit that was begun
        would have to be begun again.
        """
        new = self.blockage.observe(view)
        if new is not None and not (new and self.blockage.touches(self._way_left(view), new)):
            return
        if self._leg_stays(view):
            assert self.section is not None
            units = frozenset(self.leg.units)
            self.legs = self._legs_from(self.leg.points[-1], self.section, view, units)
        else:
            self._go_round(view)
        self.headway.again()  # the way may be longer now

    def _leg_stays(self, view: FleetView) -> bool:
        """Whether we are on a leg at work whose other units are free."""
        if self.section is None or self.tracker is None or not self.turns_on_the_spot:
            return False
        ahead = self.leg.units[self.unit :]
        return bool(ahead) and self._blocked(view, last=False).isdisjoint(ahead)

    def _go_round(self, view: FleetView) -> None:
        self.legs, self.tracker, self.heading_to = [], None, None
        if self.section is not None:
            self.legs = self._legs(self.section, view)

    def _way_left(self, view: FleetView) -> list[Point]:
        """What is left of all legs, from where we are."""
        ahead = [] if self.tracker is None else self.tracker.remaining_path
        legs = [point for leg in self.legs for point in leg.points]
        return [(view.here.x_m, view.here.y_m), *ahead, *legs]

    def _blocked(self, view: FleetView, last: bool) -> frozenset[int]:
        """Units that are not worked now.

        Units under a silent member's body stay visibly uncovered in the progress until it is towed
        away. Units under an obstacle come last, and are skipped if an operator ordered it.
        """
        assert self.section is not None
        blocked = self.blockage.units(self.section, things_too=view.leave_out or not last)
        return blocked.union(self.beside) if self.beside else blocked

    def _drive(self, view: FleetView) -> tuple[MotionRequest, list[int]]:
        """The motion along the legs, and the units that were completed."""
        here = view.here
        covered: list[int] = []
        if self.shove.observe(here, view.now_us):
            self._on_displaced()
        while True:
            if self.tracker is None:
                if not self.legs:
                    return STILL, covered
                self.leg = self.legs.pop(0)
                points = list(self.leg.points)
                self.tracker = PathTracker(points, self.speed_m_s, self.deceleration_m_s2)
                self.unit, self.worst_m, self.lifted_to_m = 0, 0.0, 0.0
                self.ends_begun_m, self.ends_reached_m = (inf, inf), (0.0, 0.0)
                self.course_begun_m, self.course_reached_m = (inf, inf), (0.0, 0.0)
                self.course_from = None
                self.swing = BarSwing(points)
            self._line.locate(here.x_m, here.y_m)
            covered += self._passed(view)
            if not self.tracker.arrived:
                break
            self.tracker = None
        if self.tracker.gap_m > ASTRAY_M:  # pushed, or giving way to others: another way back
            self._go_astray(view)
            return STILL, covered
        vx_m_s, vy_m_s = self._velocity(here)
        # Not sooner: the ground before the leg may be another robot's section.
        on_line = self.tracker.gap_m <= LEAD_M
        tool_on = bool(self.leg.units) and on_line
        return _wish(
            MotionRequest, (vx_m_s, vy_m_s, 0.0, tool_on, (), False, False, False, False, -1)
        ), covered

    @property
    def _line(self) -> PathTracker:
        """The polyline that a body follows that need not steer."""
        assert isinstance(self.tracker, PathTracker)
        return self.tracker

    def _velocity(self, here: Observation) -> Point:
        """The velocity along the leg, (x, y) metres a second.

        The bar is at right angles to the motion. A robot that drifts sideways waits on its lead-in
        until both ends of the bar would begin the first unit in time. It does not wait while the
        bar is up because a body is near.
        """
        line = self._line
        steers = self.turns_on_the_spot and bool(self.leg.units)
        if line.gap_m > AIM_M and self.turns_on_the_spot and not self.leg.units:
            place = here.x_m, here.y_m
            corner = line.next_corner
            if dist(place, corner) > AIM_LEAST_M and self.blockage.way.straight(place, corner):
                return line.towards_corner(*place)
        moving = (here.vx_m_s, here.vy_m_s) if steers else None
        vx_m_s, vy_m_s = line.velocity(here.x_m, here.y_m, moving)
        left_m = LEAD_M - self._along_m(here) if self._on_lead_in else 0.0
        if left_m <= 0.0 or self.up or max(self.ends_begun_m) <= LEAD_M:
            return vx_m_s, vy_m_s
        ux, uy = line.direction
        forward_m_s, aside_m_s = vx_m_s * ux + vy_m_s * uy, vy_m_s * ux - vx_m_s * uy
        wait_m = left_m - WAITING_M
        brake_m_s = copysign(sqrt(2.0 * self.deceleration_m_s2 * abs(wait_m)), wait_m)
        forward_m_s = min(forward_m_s, brake_m_s)
        return ux * forward_m_s - uy * aside_m_s, uy * forward_m_s + ux * aside_m_s

    @property
    def _on_lead_in(self) -> bool:
        """Whether we are on the first segment of a leg, with units, that is not worked by a
        steered robot.
        """
        tracker = self.tracker
        return bool(
            self.turns_on_the_spot and self.leg.units and self.unit == 0
            and isinstance(tracker, PathTracker) and tracker.piece == 0 and tracker.gap_m <= LEAD_M
        )  # fmt: skip

    def _along_m(self, here: Observation) -> float:
        """Arc length on the line of our segment of the leg; also before its beginning."""
        line = self._line
        piece = min(line.piece, len(line.points) - 2)
        (ax, ay), (ux, uy) = line.points[piece], line.direction
        return line.starts_m[piece] + (here.x_m - ax) * ux + (here.y_m - ay) * uy

    def _tilt(self, here: Observation) -> float | None:
        """Sine of the angle from the line to the motion, positive to the left; None for a robot that
        stands, whose direction of motion is noise.
        """
        speed_m_s = hypot(here.vx_m_s, here.vy_m_s)
        if speed_m_s < SLOW_M_S:
            return None
        ux, uy = self._line.direction
        return (here.vy_m_s * ux - here.vx_m_s * uy) / speed_m_s

    def _observe_bar(self, here: Observation) -> None:
        """Note how far back on the leg the ends of the lowered bar are."""
        assert self.tracker is not None
        if not self.turns_on_the_spot or self.tracker.gap_m > LEAD_M:
            return
        tilt = self._tilt(here)
        if tilt is not None:
            ux, uy = self._line.direction
            if here.vx_m_s * ux + here.vy_m_s * uy < 0.0:  # backwards: its ends change sides
                tilt = -tilt
            if abs(tilt) > self.tilt_max:
                self.ends_begun_m = inf, inf
                return
        elif abs(self.tracker.off_m) > ALIGNED_M:
            return
        self.ends_begun_m = self._nearer(self.ends_begun_m, self._along_m(here), tilt or 0.0)

    def _observe_course(self, here: Observation) -> None:
        """Note where the ends of the bar were at its last move of `COURSE_M`, which it follows: how far
        back they began it, and how far they came.

        A robot that begins to drive has no such move behind it, and may drift aside within the first.
        One that sways while it waits has a velocity to all sides, and its bar turns to none of them.
        """
        ux, uy = self._line.direction
        place = here.x_m, here.y_m
        from_x_m, from_y_m = self.course_from or place
        dx_m, dy_m = place[0] - from_x_m, place[1] - from_y_m
        way_m = hypot(dx_m, dy_m)
        if way_m < COURSE_M:
            self.course_from = from_x_m, from_y_m
            return
        self.course_from = place
        tilt = copysign(1.0, dx_m * ux + dy_m * uy) * (dy_m * ux - dx_m * uy) / way_m
        along_m = self._along_m(here)
        if abs(tilt) <= self.tilt_max and (self._on_lead_in or max(self.course_begun_m) == inf):
            began_m = along_m - (dx_m * ux + dy_m * uy)
            self.course_begun_m = self._nearer(self.course_begun_m, began_m, tilt)
        self.course_reached_m = self._further(self.course_reached_m, along_m, tilt)

    def _nearer(self, ends_m: Point, along_m: float, tilt: float) -> Point:
        """Where on the leg the ends of the bar are, or `ends_m` if that is further back."""
        ahead_m = self.half_m * tilt
        return min(ends_m[0], along_m - ahead_m), min(ends_m[1], along_m + ahead_m)

    def _further(self, ends_m: Point, along_m: float, tilt: float) -> Point:
        """Where on the leg the ends of the bar are, or `ends_m` if that is further on."""
        ahead_m = self.half_m * tilt
        return max(ends_m[0], along_m - ahead_m), max(ends_m[1], along_m + ahead_m)

    def _go_astray(self, view: FleetView) -> None:
        """Replan the rest of the work from our current position."""
        self.tracker, self.heading_to = None, None
        self.legs = self._legs(self.section, view) if self.section is not None else []

    def _passed(self, view: FleetView) -> list[int]:
        """Units of the current leg whose end we have passed cleanly."""
        assert self.tracker is not None
        if not self.leg.units:
            return []
        passed = []
        self.up = self.lifted
        if self.lifted:  # it is lowered here; the part without work may reach into the next unit
            self.lifted, self.lifted_to_m = False, self.tracker.along_m + self._lags_m()
            self.ends_begun_m = self.course_begun_m = inf, inf
            self.course_from = None
            self.swing.restart()
            if self.unit == 0 and self.tracker.along_m <= LEAD_M:
                self.worst_m = 0.0  # the implement was up before the unit only
        if self._on_lead_in or max(self.ends_begun_m) == inf:
            self._observe_bar(view.here)
        if self.turns_on_the_spot:
            self._observe_course(view.here)
            self.swing.observe(self._line.piece, self._line.along_m, view.here.x_m, view.here.y_m)
        if self.tracker.along_m > LEAD_M / 2:  # before that a robot may come from the side
            self.worst_m = max(self.worst_m, self._off_m(view.here))
        lead_m = LEAD_M if self.turns_on_the_spot else 0.0
        piece_m = (self.tracker.total_m - 2 * lead_m) / len(self.leg.units)
        while self.unit < len(self.leg.units):
            end_m = lead_m + (self.unit + 1) * piece_m
            is_last = self.unit + 1 == len(self.leg.units)
            past_m = SWUNG_M if self._is_corner(end_m) else self.past_end_m * is_last
            if self.tracker.along_m < end_m + past_m or self._bar_lags(view.here, end_m):
                break
            begun_m = lead_m + self.unit * piece_m
            wrongly = self.swing.wrongly and self._has_corner(begun_m, end_m)
            if not wrongly and self.worst_m <= self.tolerance_m and self._down_since(begun_m):
                passed.append(self.leg.units[self.unit])
            else:
                self.failed.add(self.leg.units[self.unit])
                self.missed = self.missed if is_last else self.leg.units[self.unit]
            self.unit += 1
            self.worst_m, self.swing.wrongly = self._off_m(view.here), False
        return passed

    def _off_m(self, here: Observation) -> float:
        """How far the robot may be from its line: as it senses, and as its place may be wrong."""
        assert self.tracker is not None
        return self.tracker.aside_m + here.position_accuracy_m

    def _bar_lags(self, here: Observation, end_m: float) -> bool:
        """Whether an end of the bar of a robot that is pushed aside has not passed the end of the
        unit yet.
        """
        assert self.tracker is not None
        if not self.turns_on_the_spot or self._is_corner(end_m):
            return False  # a steered robot's tracker has no pieces, and at a corner the bar swings round
        tilt = self._tilt(here)
        if tilt is not None:
            self.ends_reached_m = self._further(self.ends_reached_m, self._along_m(here), tilt)
        return min(*self.ends_reached_m, *self.course_reached_m) < end_m - LATE_M

    def _down_since(self, begun_m: float) -> bool:
        """Whether the implement was down before this place; at a corner, before the turn."""
        if self.unit == 0 and self._is_corner(begun_m):
            return self.lifted_to_m < begun_m - STRAIGHT_M
        late_m = max(*self.ends_begun_m, *self.course_begun_m) - begun_m
        if self.turns_on_the_spot:
            return late_m <= LATE_M and self.lifted_to_m <= begun_m
        return self.lifted_to_m <= begun_m + (LEAD_M if self.unit == 0 else LATE_M)

    def _lags_m(self) -> float:
        """How far the end of the bar of a steered body that is further back is behind its middle."""
        return 0.0

    def _is_corner(self, at_m: float) -> bool:
        return self.turns_on_the_spot and self._has_corner(at_m, at_m)

    def _has_corner(self, begun_m: float, end_m: float) -> bool:
        """Whether the leg turns between these places or at them."""
        corners_m = self._line.starts_m[1:-1]
        return any(begun_m - STRAIGHT_M < at_m < end_m + STRAIGHT_M for at_m in corners_m)

    def _leads(self, section: Section, units: tuple[int, ...]) -> LeadInOut:
        if not self.turns_on_the_spot:
            return (), ()
        return section.leads(units[0], units[-1], LEAD_M)

    def _legs(self, section: Section, view: FleetView) -> list[WorkLeg]:
        """Legs from here: the uncovered stretches of the section, nearest end first, joined by
        transits.
        """
        return self._legs_from((view.here.x_m, view.here.y_m), section, view, frozenset())

    def _legs_from(
        self, at: Point, section: Section, view: FleetView, driven: frozenset[int]
    ) -> list[WorkLeg]:
        """Legs as above, from a place, (x, y) metres, and without the units `driven`."""
        stretches = self._stretches(section, view, False, driven)
        if not stretches:
            stretches = self._stretches(section, view, True, driven)
        if not stretches:
            return []
        if self._from_last(section, stretches, at, view):
            stretches = [WorkLeg(leg.points[::-1], leg.units[::-1]) for leg in reversed(stretches)]
        legs: list[WorkLeg] = []
        for leg in stretches:
            first, last = leg.points[0], leg.points[-1]
            if dist(at, last) + 1e-6 < dist(at, first):
                leg = WorkLeg(leg.points[::-1], leg.units[::-1])
            if dist(at, leg.points[0]) > self.tolerance_m:
                legs.append(WorkLeg(self.blockage.path(at, leg.points[0], view)))
            legs.append(leg)
            at = leg.points[-1]
        return legs

    def _from_last(
        self, section: Section, stretches: list[WorkLeg], at: Point, view: FleetView
    ) -> bool:
        """Whether to begin with the last stretch: as planned, or, in a section that was begun, as it
        is nearer.
        """
        entry = self.choosing.entry(section.id, view.progress.covered(section.id))
        if entry is not None:
            return entry == 1
        return dist(at, stretches[-1].points[-1]) < dist(at, stretches[0].points[0])

    def _stretches(
        self, section: Section, view: FleetView, last: bool,
        driven: frozenset[int] = frozenset(),
    ) -> list[WorkLeg]:  # fmt: skip
        """The stretches left to work, without the units `driven`; `last`: include those that come
        last.
        """
        mine: AbstractSet[int] = driven
        if self.section is section:
            mine = driven.union(self.worked, self.doubted)
        blocked = self.blockage.units(section, things_too=view.leave_out or not last)
        if self.beside and self.section is section:
            blocked = blocked.union(self.beside)
        return [
            working_leg(points, units, self._leads(section, units))
            for points, units in section.stretches(
                lambda unit: (
                    unit not in mine
                    and unit not in blocked
                    and not view.progress.has(section.id, unit)
                )
            )
        ]


def _covering(
    wish: MotionRequest, covered: list[int], finished: bool, near_end: bool
) -> MotionRequest:
    """The motion request of a working robot, with these units completed."""
    vx_m_s, vy_m_s, turn_rad_s, tool_on, *_ = wish
    held = (tuple(covered), finished, wish.given_up, near_end, wish.hold, wish.parcel_action)
    return _wish(MotionRequest, (vx_m_s, vy_m_s, turn_rad_s, tool_on, *held))
