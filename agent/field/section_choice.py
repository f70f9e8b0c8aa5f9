"""Chooses the next section of a robot: one of its own share, or one that no robot takes.

All robots compute the same partition (`agent/field/section_shares.py`). Here is what this robot
knows about the others: where each will be free, which sections silent robots left, and which
sections were left to another robot and not taken.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from math import cos, dist, hypot, sin
from typing import Final

from agent.claims.standing_owners import STANDS, StandingOwners
from agent.field.field_map import Field
from agent.field.fleet_plan import JOBS_MAX, FleetPlan, FreedRobot
from agent.field.ground_parts import GroundParts
from agent.field.section_shares import SectionJob, shares
from agent.field.travel_times import Remainder, TravelTimes
from agent.interface.config import LEASE_US, S
from agent.interface.geometry import Point
from agent.interface.mission import ClaimRequest, FleetView
from crdt import Phase

# A section that others do not take for this long is ours. A claim takes 0.25 s, and robots may have
# different views of the fleet for 2 s.
UNTAKEN_US: Final = 5 * S
AGAIN_US: Final = 20 * S  # a section that we gave back is left to others first; doubled each time
AGAIN_TIMES: Final = 5  # doublings at most, to ten minutes: 255 hand-overs last for two days
STAYS_M: Final = 4.0  # an owner that moves further than this does not stand still
AGAIN_PLAN_US: Final = 1 * S  # a robot without a section plans again this often


class SectionChooser:
    """One robot's choice of sections, and what it remembers about the other robots."""

    def __init__(
        self, field: Field, speed_m_s: float, travel: TravelTimes | None = None,
        parts: GroundParts | None = None,
    ) -> None:  # fmt: skip
        """`speed_m_s`: at which sections are worked; shares are cut by the time that they take.
        `travel`: of this field; None: no plan of the fleet is made. `parts`: of the field, that no body
        can leave; None: it is one."""
        self.field, self.speed_m_s, self.parts = field, speed_m_s, parts
        self.fleet_plan = None if travel is None else FleetPlan(travel)
        # The change counter of the allocation, the live robots and the time when nothing was for us.
        self._empty = -1, frozenset[int](), 0
        self.reserved: dict[int, list[int]] = {}  # silent member -> its sections, in its order
        self._plan: dict[int, list[SectionJob]] = {}
        # The change counter of the allocation when nothing was free; and when all free sections were
        # left to others, with the time since then.
        self._none_free = -1
        self._left = -1, 0
        # Sections that we gave back: until when others have them, how often, and units done.
        self._gave: dict[int, tuple[int, int, int]] = {}
        self.standing = StandingOwners(STAYS_M)
        self._entry = (
            -1,
            0,
            0,
        )  # the section that we chose last, the end to enter at, units covered then
        # When others should have claimed free sections, by section and by the robot that the plan gives
        # it to; and when this was noted.
        self._due: tuple[int, dict[tuple[int, int], int]] = (0, {})

    def choose(
        self, view: FleetView, end: Point, rest_for_s: float = 0.0,
        waiting: frozenset[int] = frozenset(),
    ) -> ClaimRequest | None:  # fmt: skip
        """The section to claim next, with our bid; None if there is none for us now.

        `end`: where we will be free, (x, y) metres. `rest_for_s`: until then. `waiting`: free sections
        that cannot be worked at present.
        """
        self._reserve(view)
        waiting = waiting | self.apart(view)
        taken = waiting.union(*self.reserved.values())
        self.observe(view)
        free = [
            job
            for job in self._jobs(view)
            if job.section not in taken and not self._left_to_others(job.section, view)
        ]
        if free and self.fleet_plan is not None and len(free) <= JOBS_MAX:
            return self._planned(self.fleet_plan, free, view, end, rest_for_s)
        if free:
            self._plan = shares(free, self._anchors(view, end), self.speed_m_s)
            mine = self._plan.get(view.slot)
            if not mine:  # more robots than sections are left
                mine = free if self._untaken(view) else []
            if not mine:
                return None
            return self._bid(
                view,
                min(
                    mine, key=lambda job: min(hypot(e[0] - end[0], e[1] - end[1]) for e in job.ends)
                ),
            )
        return self._orphan(view, waiting)

    def apart(self, view: FleetView) -> frozenset[int]:
        """The sections behind passages that are too narrow for us, by number."""
        if self.parts is None:
            return frozenset()
        return self.parts.apart_from((view.here.x_m, view.here.y_m))

    def _meets(self, slot: int, view: FleetView) -> bool:
        """Whether another robot, which is heard, is in the part of the field in which we are."""
        if self.parts is None:
            return True
        pose, here = view.neighbours[slot].pose, (view.here.x_m, view.here.y_m)
        return self.parts.part_at((pose.x_m, pose.y_m)) == self.parts.part_at(here)

    def observe(self, view: FleetView) -> None:
        """Note which owners stand still. Call it while we work, too.

        A robot that has stood for long gives its section to the first one that is free."""
        self.standing.observe(view, partial(_units_done, view))

    def _planned(
        self,
        plan: FleetPlan,
        free: list[SectionJob],
        view: FleetView,
        end: Point,
        rest_for_s: float,
    ) -> ClaimRequest | None:
        """The first section of our row in the plan of the fleet."""
        changes, live, empty_at_us = self._empty
        same = changes == view.allocation.changes and live == view.live
        if same and view.now_us - empty_at_us < AGAIN_PLAN_US:
            return None
        jobs = {job.section: job for job in free}
        left = {section: self._remainder(section, view, plan.travel) for section in jobs}
        robots = {view.slot: FreedRobot(end, round(1000 * rest_for_s))}
        for slot in sorted(view.live - {view.slot}):
            if slot in view.neighbours and self._meets(slot, view):
                robots[slot] = self._freed(slot, view, plan.travel)
        rows = plan.plan(left, robots)
        self._plan = {slot: [jobs[section] for section in row] for slot, row in rows.items()}
        mine = self._plan[view.slot] or self._overdue(rows, robots, free, view)
        if not mine:
            self._empty = view.allocation.changes, view.live, view.now_us
            return None
        section = mine[0].section
        if section in plan.entries:
            self._entry = section, plan.entries[section], view.progress.covered(section)
        return self._bid(view, mine[0])

    def entry(self, section: int, covered: int) -> int | None:
        """The end, 0 or 1, at which the plan enters what is left of the section that we chose last.

        `covered`: its units; None if these are not those planned, or it is another section.
        """
        chosen, end, units = self._entry
        return end if (section, covered) == (chosen, units) else None

    def _remainder(self, section: int, view: FleetView, travel: TravelTimes) -> Remainder | None:
        progress = view.progress
        covered, units = progress.covered(section), self.field.section(section).units
        if not 0 < covered < units:
            return None
        return travel.remainder(self.field.section(section), partial(progress.has, section))

    def _overdue(
        self,
        rows: Mapping[int, Sequence[int]],
        robots: Mapping[int, FreedRobot],
        free: Sequence[SectionJob],
        view: FleetView,
    ) -> list[SectionJob]:
        """The free sections that another robot would have claimed by now, had it our plan; the
        nearest first.

        What happens to other sections does not put this off: at the end of a field one is finished
        every second, and the last rest would be left to a robot that does not take it.
        """
        noted_at_us, known = self._due
        if view.now_us - noted_at_us > 2 * AGAIN_PLAN_US:
            known = {}  # we had work, or nobody might move
        due_at_us = {
            (row[0], slot): view.now_us + 1000 * robots[slot].ready_at_ms + UNTAKEN_US
            for slot, row in rows.items()
            if row
        }
        due_at_us |= {key: at_us for key, at_us in known.items() if key in due_at_us}
        self._due = view.now_us, due_at_us
        overdue = {section for (section, _), at_us in due_at_us.items() if at_us <= view.now_us}
        late = [job for job in free if job.section in overdue]
        here = view.here.x_m, view.here.y_m
        return sorted(late, key=lambda job: min(dist(at, here) for at in job.ends))

    def _freed(self, slot: int, view: FleetView, travel: TravelTimes) -> FreedRobot:
        """Where and when another robot will have worked what it holds."""
        pose = view.neighbours[slot].pose
        at, ready_at_ms = (pose.x_m, pose.y_m), 0
        allocation = view.allocation
        held = allocation.assigned_sections(slot)
        for number in sorted(held, key=lambda s: allocation.phase_of(s) is not Phase.STARTED):
            rest = self._remainder(number, view, travel)
            if rest is None:
                ways_for_ms = travel.lead_for_ms(at)[2 * number : 2 * number + 2].tolist()
                ends, work_for_ms = self.field.section(number).ends, int(travel.work_for_ms[number])
            else:
                ends, work_for_ms = rest.ends, rest.work_for_ms
                ways_for_ms = [1000 * dist(at, end) / self.speed_m_s for end in ends]
            backwards = ways_for_ms[1] < ways_for_ms[0]
            at = ends[0] if backwards else ends[1]
            ready_at_ms += round(min(ways_for_ms)) + work_for_ms
        return FreedRobot(at, ready_at_ms)

    def _untaken(self, view: FleetView) -> bool:
        """Whether no robot has taken for `UNTAKEN_US` what we left to others.

        Two equally near robots may each expect the other one to take a section, or its owner does
        not work.
        """
        if self._left[0] != view.allocation.changes or view.now_us < self._left[1]:
            self._left = view.allocation.changes, view.now_us
        return view.now_us - self._left[1] >= UNTAKEN_US

    def _jobs(self, view: FleetView) -> list[SectionJob]:
        if self._none_free == view.allocation.changes:
            return []
        jobs = []
        for section in self.field.sections:
            if view.allocation.phase_of(section.id) is Phase.FREE:
                left = 1.0 - view.progress.covered(section.id) / section.units
                work_for_s = section.length_m * left / self.speed_m_s
                jobs.append(SectionJob(section.id, work_for_s, section.ends))
        if not jobs:
            self._none_free = view.allocation.changes
        return jobs

    def _anchors(self, view: FleetView, end: Point) -> dict[int, Point]:
        """Where each live member will be free: the end of its work, or its current position."""
        anchors: dict[int, Point] = {view.slot: end}
        for slot in sorted(view.live - {view.slot}):
            neighbour = view.neighbours.get(slot)
            owned = view.allocation.assigned_sections(slot)
            if neighbour is None or not self._meets(slot, view):
                continue
            pose = neighbour.pose
            anchors[slot] = (pose.x_m, pose.y_m)
            if owned:  # it will end where its course leads
                course = (cos(pose.course_rad), sin(pose.course_rad))
                anchors[slot] = max(
                    self.field.section(owned[-1]).ends,
                    key=lambda at: (at[0] - pose.x_m) * course[0] + (at[1] - pose.y_m) * course[1],
                )
        return anchors

    def _reserve(self, view: FleetView) -> None:
        """Keep a silent member's run for it; forget reservations of those that are back."""
        silent = view.fell_silent_at_us
        for slot in [s for s in self.reserved if s not in silent]:
            del self.reserved[slot]
        for slot in silent:
            if slot not in self.reserved:
                self.reserved[slot] = [job.section for job in self._plan.get(slot, [])]

    def _orphan(self, view: FleetView, waiting: frozenset[int]) -> ClaimRequest | None:
        """A section of a silent or standing member, if only sections that such members own or
        planned are left; or one of our own that we could not give back.
        """
        for slot in sorted(view.fell_silent_at_us, key=lambda s: view.fell_silent_at_us[s]):
            if view.now_us - view.fell_silent_at_us[slot] < LEASE_US:
                continue
            for section in reversed(self.reserved.get(slot, [])):
                free = view.allocation.phase_of(section) is Phase.FREE and section not in waiting
                if free and not self._left_to_others(section, view):
                    return self._bid(view, self._job(view, section))
            for section in sorted(view.allocation.assigned_sections(slot), reverse=True):
                if view.allocation.stays(section) or section in waiting:
                    continue
                return self._bid(view, self._job(view, section))._replace(takeover=True)
        for slot in self.standing.standing():
            for section in view.allocation.assigned_sections(slot):
                if view.allocation.stays(section) or section in waiting:
                    continue
                if not self._left_to_others(section, view):
                    self.standing.forget(slot)
                    bid = self._bid(view, self._job(view, section))
                    return bid._replace(takeover=True, why=f"robot {slot} {STANDS}")
        for section in view.allocation.assigned_sections(view.slot):  # we could not give it back
            if view.allocation.stays(section) and not self._left_to_others(section, view):
                return self._bid(view, self._job(view, section))
        return None

    def gave_back(self, section: int, units: int, now_us: int) -> None:
        """We made no progress on a section: leave it to others first, for longer each time.

        `units`: number of its finished units.
        """
        times = self._gave.get(section, (0, 0, 0))[1] + 1
        end_at_us = now_us + (AGAIN_US << min(times - 1, AGAIN_TIMES))
        self._gave[section] = end_at_us, times, units

    def has_given_back(self, section: int) -> bool:
        """Whether we made no progress on this section once before."""
        return section in self._gave

    def _left_to_others(self, section: int, view: FleetView) -> bool:
        end_at_us, _, units = self._gave.get(section, (0, 0, 0))
        return view.now_us < end_at_us and view.progress.covered(section) <= units

    def _job(self, view: FleetView, section: int) -> SectionJob:
        return SectionJob(section, 0.0, self.field.section(section).ends)

    def _bid(self, view: FleetView, job: SectionJob) -> ClaimRequest:
        """The private cost: metres to the nearer end, in 31 steps of a geometric scale."""
        way_m = min(hypot(x - view.here.x_m, y - view.here.y_m) for x, y in job.ends)
        bid = 0
        while bid < 31 and way_m > 1.25**bid:
            bid += 1
        return ClaimRequest(job.section, bid)


def _units_done(view: FleetView, sections: Sequence[int]) -> int:
    return sum(view.progress.covered(section) for section in sections)
