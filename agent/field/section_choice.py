"""Chooses the next section of a robot: one of its own share, or one that no robot takes.

All robots compute the same partition (`agent/field/section_partition.py`). Here is what this robot
knows about the others: where each will be free, which sections silent robots left, and which
sections were left to another robot and not taken.
"""

from math import cos, hypot, sin
from typing import Final

from agent.field.field_map import Field
from agent.field.section_partition import Point, SectionJob, shares
from agent.interface.config import CONTROL_PERIOD_US, LEASE_US, S
from agent.interface.mission import ClaimRequest, FleetView
from crdt import Phase

# A section that others do not take for this long is ours. A claim takes 0.25 s, and robots may have
# different views of the fleet for 2 s.
UNTAKEN_US: Final = 5 * S
AGAIN_US: Final = 20 * S  # a section that we gave back is left to others first; doubled each time
AGAIN_TIMES: Final = 5  # doublings at most, to ten minutes: 255 hand-overs last for two days
STANDS_US: Final = 60 * S  # a live owner that stands still keeps its sections this long: 3 leases
STAYS_M: Final = 4.0  # an owner that moves further than this does not stand still
FORGET_US: Final = 2 * CONTROL_PERIOD_US  # a longer gap does not count: we were not free to choose


class SectionChooser:
    """One robot's choice of sections, and what it remembers about the other robots."""

    def __init__(self, field: Field, speed_m_s: float) -> None:
        """`speed_m_s`: at which sections are worked; shares are cut by the time that they take."""
        self.field, self.speed_m_s = field, speed_m_s
        self.reserved: dict[int, list[int]] = {}  # silent member -> its sections, in its order
        self._plan: dict[int, list[SectionJob]] = {}
        # The change counter of the allocation when nothing was free; and when all free sections were
        # left to others, with the time since then.
        self._none_free = -1
        self._left = -1, 0
        # Sections that we gave back: until when others have them, how often, and units done.
        self._gave: dict[int, tuple[int, int, int]] = {}
        # Live owners: position, units done, and for how long they have stood there.
        self._stands: dict[int, tuple[Point, int, int]] = {}
        self._asked_at_us = 0

    def choose(self, view: FleetView, end: Point) -> ClaimRequest | None:
        """The section to claim next, with our bid; None if there is none for us now.

        `end`: where we will be free, (x, y) metres.
        """
        self._reserve(view)
        taken = {s for sections in self.reserved.values() for s in sections}
        self._watch(view)
        free = [
            job
            for job in self._jobs(view)
            if job.section not in taken and not self._left_to_others(job.section, view)
        ]
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
        return self._orphan(view)

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
            if neighbour is None:
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

    def _orphan(self, view: FleetView) -> ClaimRequest | None:
        """A section of a silent or standing member, if only sections that such members own or
        planned are left.
        """
        for slot in sorted(view.fell_silent_at_us, key=lambda s: view.fell_silent_at_us[s]):
            if view.now_us - view.fell_silent_at_us[slot] < LEASE_US:
                continue
            for section in reversed(self.reserved.get(slot, [])):
                if view.allocation.phase_of(section) is Phase.FREE:
                    return self._bid(view, self._job(view, section))
            for section in sorted(view.allocation.assigned_sections(slot), reverse=True):
                return self._bid(view, self._job(view, section))._replace(takeover=True)
        for slot, (_, _, stood_for_us) in sorted(self._stands.items()):
            for section in view.allocation.assigned_sections(slot):
                if stood_for_us >= STANDS_US and not self._left_to_others(section, view):
                    del self._stands[slot]
                    return self._bid(view, self._job(view, section))._replace(takeover=True)
        return None

    def gave_back(self, section: int, units: int, now_us: int) -> None:
        """We made no progress on a section: leave it to others first, for longer each time.

        `units`: number of its finished units.
        """
        times = self._gave.get(section, (0, 0, 0))[1] + 1
        end_at_us = now_us + (AGAIN_US << min(times - 1, AGAIN_TIMES))
        self._gave[section] = end_at_us, times, units

    def _left_to_others(self, section: int, view: FleetView) -> bool:
        end_at_us, _, units = self._gave.get(section, (0, 0, 0))
        return view.now_us < end_at_us and view.progress.covered(section) <= units

    def _watch(self, view: FleetView) -> None:
        """Measure how long live owners have stood still without completing a unit.

        Only time in which we were free to choose counts, because a fleet stop halts all robots.
        """
        passed_for_us, self._asked_at_us = view.now_us - self._asked_at_us, view.now_us
        seen: dict[int, tuple[Point, int, int]] = {}
        for slot in view.live - {view.slot}:
            neighbour, owned = view.neighbours.get(slot), view.allocation.assigned_sections(slot)
            if neighbour is None or not owned:
                continue
            at = neighbour.pose.x_m, neighbour.pose.y_m
            units = sum(view.progress.covered(section) for section in owned)
            was, had, stood_for_us = self._stands.get(slot, (at, units, 0))
            if had != units or hypot(at[0] - was[0], at[1] - was[1]) > STAYS_M:
                was, stood_for_us = at, 0
            stood_for_us += passed_for_us if passed_for_us <= FORGET_US else 0
            seen[slot] = was, units, stood_for_us
        self._stands = seen

    def _job(self, view: FleetView, section: int) -> SectionJob:
        return SectionJob(section, 0.0, self.field.section(section).ends)

    def _bid(self, view: FleetView, job: SectionJob) -> ClaimRequest:
        """The private cost: metres to the nearer end, in 31 steps of a geometric scale."""
        way_m = min(hypot(x - view.here.x_m, y - view.here.y_m) for x, y in job.ends)
        bid = 0
        while bid < 31 and way_m > 1.25**bid:
            bid += 1
        return ClaimRequest(job.section, bid)
