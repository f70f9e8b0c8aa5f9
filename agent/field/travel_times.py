"""How long a fleet's bodies take in a field: for each section, and between the ends of all of them.

The model is that of the body: a trapezoid of speed on each straight piece, and a stop at its end.
Ways that are not straight lead over corners of the field and ends of other sections; they are at most
a little longer than what `Route` finds, and a matrix of them costs milliseconds.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.field.field_map import Field, Section
from agent.interface.geometry import Point, Polyline
from agent.motion.implement_clearance import LEAD_M
from agent.motion.path_tracker import PathTracker
from agent.paths.nav_mesh import spread
from agent.paths.route import Route

Whole = NDArray[np.int64]
Floats = NDArray[np.float64]

LEADS_KEPT = 512  # places: two for each of 108 robots, and those of sections that were begun
UNJOINED = 2.0  # a way that is not found takes this many times the straight one


class Remainder(NamedTuple):
    """What is left of a section that was begun."""

    ends: tuple[Point, Point]  # where its first uncovered unit begins and its last one ends, metres
    work_for_ms: int  # from the one end to the other


class Solution(NamedTuple):
    """A plan: the rows of job indices, the end at which the first job of each row is entered, and the
    last finish."""

    rows: list[list[int]]
    entries: list[int]
    last_finish_at_ms: int


class TravelTimes:
    """Times of one field and one kind of body, in whole milliseconds. End `e` of section `s` is
    2 s + e."""

    def __init__(
        self,
        field: Field,
        route: Route,
        speed_m_s: float,
        acceleration_m_s2: float,
        deceleration_m_s2: float,
        corners: Sequence[Point] = (),
    ) -> None:
        """`corners`: places by which ways go round the corners of the field, metres."""
        self.field, self.route = field, route
        self.speed_m_s, self.corners = speed_m_s, tuple(corners)
        self.acceleration_m_s2, self.deceleration_m_s2 = acceleration_m_s2, deceleration_m_s2
        self._leads: dict[Point, Whole] = {}  # of the newest places (`lead_for_ms`)
        # Of the newest problems (`agent/field/fleet_plan.py`).
        self.plans: dict[bytes, Solution] = {}
        # What follows from these, once it was needed. Not `cached_property`: a compiled one computes
        # its value at each look.
        self._kept_ends: Floats | None = None
        self._kept_opened: list[Point] | None = None
        self._kept_nodes: Floats | None = None
        self._kept_works: Whole | None = None
        self._kept_links: Whole | None = None
        self._kept_ways: Floats | None = None
        # Seconds and metres for one metre a second more or less, up and down together.
        self._ramp_s2_m = 1 / acceleration_m_s2 + 1 / deceleration_m_s2

    def straight_for_s(self, lengths_m: Floats) -> Floats:
        """Seconds from standing to standing over each of `lengths_m`, (n,) or of any other shape."""
        ramps_m = self.speed_m_s**2 / 2 * self._ramp_s2_m
        short = np.sqrt(2 * np.minimum(lengths_m, ramps_m) * self._ramp_s2_m)
        return short + np.maximum(lengths_m - ramps_m, 0.0) / self.speed_m_s

    @property
    def ends(self) -> Floats:
        """(2 sections, 2): where each section begins and ends, metres."""
        if self._kept_ends is None:
            self._kept_ends = np.array(
                [end for section in self.field.sections for end in section.ends], dtype=np.float64
            ).reshape(-1, 2)
        return self._kept_ends

    @property
    def _opened(self) -> list[Point]:
        """The nodes, those at fences moved to free ground unless a lane leads to them."""
        if self._kept_opened is None:
            places = [*self.ends.tolist(), *self.corners]
            on_lanes = self.route.lanes.ends
            self._kept_opened = [
                (x_m, y_m) if (x_m, y_m) in on_lanes else self.route.opened((x_m, y_m))
                for x_m, y_m in places
            ]
            self._kept_opened.extend(on_lanes)
        return self._kept_opened

    @property
    def _nodes(self) -> Floats:
        """(2 sections + others, 2): the ends, the corners, and the ends of lanes, metres."""
        if self._kept_nodes is None:
            others = [*self.corners, *self.route.lanes.ends]
            corners = np.array(others, dtype=np.float64).reshape(-1, 2)
            self._kept_nodes = np.vstack((self.ends, corners))
        return self._kept_nodes

    @property
    def work_for_ms(self) -> Whole:
        """(sections,): all swaths of each section, with the turns between them."""
        if self._kept_works is None:
            works_for_ms = [self.driven_for_ms(section.swaths) for section in self.field.sections]
            self._kept_works = np.array(works_for_ms, dtype=np.int64)
        return self._kept_works

    def remainder(self, section: Section, is_covered: Callable[[int], bool]) -> Remainder:
        """What is left of a section with an uncovered unit. `is_covered`: of each unit."""
        left = [line for line, _ in section.stretches(lambda unit: not is_covered(unit))]
        return Remainder((left[0][0], left[-1][-1]), self.driven_for_ms(left))

    def driven_for_ms(self, lines: Sequence[Polyline]) -> int:
        """To work these lines in this order. The robot stands at both ends of each of them."""
        for_s, turns_m = 0.0, []
        for line in lines:
            for_s += self._line_for_s(line)
        for before, after in pairwise(lines):
            turns_m.append(hypot(after[0][0] - before[-1][0], after[0][1] - before[-1][1]))
        return round(1000 * (for_s + float(self.straight_for_s(np.array(turns_m)).sum())))

    def _line_for_s(self, line: Polyline) -> float:
        """One line with its lead-in and lead-out, as `PathTracker` passes its corners."""
        lengths_m = [hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(line)]
        lengths_m[0], lengths_m[-1] = lengths_m[0] + LEAD_M, lengths_m[-1] + LEAD_M
        if len(line) == 2:
            return float(self.straight_for_s(np.array(lengths_m)).sum())
        tracker = PathTracker(list(line), self.speed_m_s, self.deceleration_m_s2)
        return self._passed_for_s(lengths_m, tracker.passing_m_s)

    def _passed_for_s(self, lengths_m: Sequence[float], passing_m_s: Sequence[float]) -> float:
        """From standing to standing over segments, with these highest speeds at their ends."""
        up, down, for_s, now_m_s = self.acceleration_m_s2, self.deceleration_m_s2, 0.0, 0.0
        for length_m, end_m_s in zip(lengths_m, passing_m_s[1:], strict=True):
            end_m_s = min(end_m_s, sqrt(now_m_s**2 + 2 * up * length_m))
            # The speed at which as much is left as braking to the end takes.
            top2 = (2 * up * down * length_m + down * now_m_s**2 + up * end_m_s**2) / (up + down)
            top_m_s = max(min(self.speed_m_s, sqrt(top2)), now_m_s, end_m_s)
            ramps_m = (top_m_s**2 - now_m_s**2) / (2 * up) + (top_m_s**2 - end_m_s**2) / (2 * down)
            for_s += (top_m_s - now_m_s) / up + (top_m_s - end_m_s) / down
            for_s += max(length_m - ramps_m, 0.0) / top_m_s
            now_m_s = end_m_s
        return for_s

    @property
    def link_for_ms(self) -> Whole:
        """(2 sections, 2 sections): from each end to each other one."""
        if self._kept_links is None:
            self._kept_links = self._links_for_ms()
        return self._kept_links

    def _links_for_ms(self) -> Whole:
        links_for_ms: Whole = np.rint(self._ways_for_ms[: len(self.ends)]).astype(np.int64)
        return links_for_ms

    @property
    def _ways_for_ms(self) -> Floats:
        """(nodes, 2 sections): from each node to each end."""
        if self._kept_ways is None:
            self._kept_ways = self._all_ways_for_ms()
        return self._kept_ways

    def _all_ways_for_ms(self) -> Floats:
        count, ends = len(self._nodes), len(self.ends)
        straight_for_ms = np.full((count, count), np.inf)
        for a in range(count):
            straight_for_ms[a] = self._straight_for_ms(self._opened[a], a)
        for a, b, length_m in self._over_lanes():
            straight_for_ms[a, b] = 1000 * float(self.straight_for_s(np.array([length_m]))[0])
        direct = np.minimum(straight_for_ms, straight_for_ms.T)
        np.fill_diagonal(direct, 0.0)
        ways_for_ms = _shortest(direct)[:, :ends]
        apart_m = np.hypot(*(self._nodes[:, None, :] - self.ends[None, :, :]).transpose(2, 0, 1))
        lost = ~np.isfinite(ways_for_ms)
        ways_for_ms[lost] = UNJOINED * 1000 * self.straight_for_s(apart_m[lost])
        return ways_for_ms

    def _over_lanes(self) -> list[tuple[int, int, float]]:
        """Nodes that lanes join, and the metres between them. An end of a section at one of a lane is
        there twice.
        """
        lanes = self.route.lanes
        first = len(self._nodes) - len(lanes.ends)
        node_of = {end: first + k for k, end in enumerate(lanes.ends)}
        joined = []
        for line in lanes.lines:
            length_m = sum(hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(line))
            joined.append((node_of[line[0]], node_of[line[-1]], length_m))
        for a, (x_m, y_m) in enumerate(self.ends.tolist()):
            if (x_m, y_m) in node_of:
                joined.append((a, node_of[x_m, y_m], 0.0))
        return joined

    def lead_for_ms(self, start: Point) -> Whole:
        """(2 sections,): from a place, (x, y) metres, to each end; not to be changed.

        Kept for the newest places: peers of one process ask for the same ones, and each asks again.
        """
        found = self._leads.get(start)
        if found is None:
            if len(self._leads) >= LEADS_KEPT:
                self._leads.clear()
            found = self._leads[start] = self._lead_for_ms(start)
        return found

    def _lead_for_ms(self, start: Point) -> Whole:
        direct_for_ms = self._straight_for_ms(self.route.opened(start))
        seen = np.flatnonzero(np.isfinite(direct_for_ms))
        if seen.size == 0:
            apart_m = np.hypot(self.ends[:, 0] - start[0], self.ends[:, 1] - start[1])
            return np.rint(UNJOINED * 1000 * self.straight_for_s(apart_m)).astype(np.int64)
        over = direct_for_ms[seen, None] + self._ways_for_ms[seen]
        soonest: Whole = np.rint(over.min(axis=0)).astype(np.int64)
        return soonest

    def way_for_ms(self, start: Point, goal: Point) -> int:
        """Between two places, (x, y) metres, that need not be ends."""
        if self.route.straight(self.route.opened(start), self.route.opened(goal)):
            apart_m = hypot(goal[0] - start[0], goal[1] - start[1])
            return round(1000 * float(self.straight_for_s(np.array([apart_m]))[0]))
        return int((self.lead_for_ms(start) + self.lead_for_ms(goal)).min())

    def _straight_for_ms(self, start: Point, after: int = -1) -> Floats:
        """To each end and corner with a number above `after` that is in sight; infinity to the
        others."""
        found = np.full(len(self._nodes), np.inf)
        apart_m = np.hypot(self._nodes[:, 0] - start[0], self._nodes[:, 1] - start[1])
        times_for_ms = 1000 * self.straight_for_s(apart_m)
        for b in range(after + 1, len(self._nodes)):
            if self.route.straight(start, self._opened[b]):
                found[b] = times_for_ms[b]
        return found


def nearest_jobs(link_for_ms: Whole, count: int) -> Whole:
    """(jobs, n): for each job the jobs that are reached soonest, soonest first; n <= `count`.

    `link_for_ms`: (2 jobs, 2 jobs), from end to end.
    """
    jobs = len(link_for_ms) // 2
    soonest = link_for_ms.reshape(jobs, 2, jobs, 2).min(axis=(1, 3))
    np.fill_diagonal(soonest, np.iinfo(np.int64).max)
    order: Whole = np.argsort(soonest, axis=1, kind="stable")
    return np.ascontiguousarray(order[:, : max(1, min(count, jobs - 1))])


def _shortest(direct_for_ms: Floats) -> Floats:
    """The least time between any two nodes, (nodes, nodes), where the straight ways take
    `direct_for_ms`, of the same shape; infinite where there is none."""
    count = len(direct_for_ms)
    joined = np.isfinite(direct_for_ms)
    np.fill_diagonal(joined, False)
    first = np.concatenate(([0], np.cumsum(joined.sum(axis=1))))
    others, lengths = np.nonzero(joined)[1], np.maximum(direct_for_ms[joined], 1e-3)
    least_for_ms = np.full((count, count), np.inf)
    np.fill_diagonal(least_for_ms, 0.0)
    for node in range(count):
        spread(first, others, lengths, np.array([node]), least_for_ms[node])
    return least_for_ms
