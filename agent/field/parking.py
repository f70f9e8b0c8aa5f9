"""Where a robot without work parks: beside the remaining work, out of every robot's way.

A robot that only evades approaching robots ends in a corner, and there it blocks the row that leads
into the corner for good. So it leaves early, for the nearest place with room on every side: the
middle of a finished unit with no open unit beside it. It also leaves if a working robot beside it
is stuck. That robot may have no other way than past it.

If there is no such place (a field hardly larger than the fleet, or before any unit is finished), it
parks where working robots arrive latest. That follows from the lines that they hold and their
driving order.
"""

import itertools
from collections.abc import Iterable, Sequence
from math import dist, hypot
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from agent.field.field_map import Field
from agent.interface.config import MS, S
from agent.interface.geometry import Point, Polyline
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView
from agent.motion.deadlock_yield import APART_M as PAST_M
from agent.motion.deadlock_yield import NEAR_M
from agent.motion.implement_clearance import LEAD_M
from crdt.progress import BLOCK_UNITS

# Between two hulls, beside a line that will be worked: a robot that drives its lead beyond the end of
# the line must not take a parked robot there for an obstruction.
ROOM_M: Final = NEAR_M + LEAD_M
APART_M: Final = 1.0  # between the hulls of two parked robots
STUCK_US: Final = 10 * S  # a working robot without a way round us by then is stuck: two detours
# A working robot that stays inside this radius counts as stuck (detours are this long).
STRAY_M: Final = 4.0
LOOK_US: Final = 1 * S  # open lines change with units, and a unit takes seconds
NEAR_MAX: Final = 200  # places examined, nearest first: a field has room near by or not at all
SAMPLE_M: Final = 1.0  # sampling step of open lines
# Used where no place has room on every side:
PASS_M: Final = 0.35  # between hulls beside a line that is worked: ORCA's margin twice
FENCE_M: Final = 0.3  # distance to a fence
AROUND_M: Final = 12.0  # search radius for places
GROUND_M: Final = 0.75  # spacing of the examined places
SOON_S: Final = 12.0  # leave now if a robot arrives within this time
LATE_S: Final = 60.0  # later arrivals count as equally good
GAIN_S: Final = 1.0  # minimum improvement for moving to another place
HASTY_US: Final = 250 * MS  # check period if a robot arrives soon


class Parking:
    """The parking place of one idle robot. Places are (x, y) metres."""

    def __init__(
        self, field: Field, radius_m: float, speed_m_s: float = 2.5, bar_m: float = 0.0
    ) -> None:
        """`bar_m`: from the middle of a body to a line that is worked with the bar down."""
        self.field, self.radius_m, self.speed_m_s = field, radius_m, speed_m_s
        self.bar_m = bar_m
        self._look_period_us = LOOK_US
        self.spot: Point | None = None  # where to go; None: stay

        # For each section: its covered units when it was looked at, and points on the lines left.
        self._left: dict[int, tuple[tuple[int, ...], NDArray[np.float64]]] = {}
        self._looked_at_us: int | None = None
        # For each robot that works near us, by slot: its position, and since when it is there.
        self._beside: dict[int, tuple[float, float, int]] = {}
        self._kept_ground: shapely.Geometry | None = None  # once it was needed

    @property
    def room_m(self) -> float:
        """Distance from the middle of a parked robot to an open line."""
        return max(2 * self.radius_m + ROOM_M, self.bar_m)

    def observe(self, view: FleetView) -> None:
        """Look for a reason to leave, and choose the new place; sets `spot`.

        Call it each control period. It does something once a second, and more often if a robot
        arrives soon.
        """
        if (
            self._looked_at_us is not None
            and view.now_us - self._looked_at_us < self._look_period_us
        ):
            return
        self._looked_at_us, self._look_period_us = view.now_us, LOOK_US
        open_lines = self._open_lines(view)
        here = (view.here.x_m, view.here.y_m)
        self._watch(view)
        if self.spot is not None and self._free(self.spot, open_lines, view):
            return
        self.spot = None
        if len(open_lines) and not self._free(here, open_lines, view):
            self.spot = self._choose(here, open_lines, view)

    def forget(self) -> None:
        """There is work: the next parking begins with a new search."""
        self.spot, self._looked_at_us = None, None
        self._beside.clear()

    def _watch(self, view: FleetView) -> None:
        near_m, seen = 2 * self.radius_m + PAST_M, dict[int, tuple[float, float, int]]()
        for slot, (pose, _) in view.neighbours.items():
            gap_m = hypot(pose.x_m - view.here.x_m, pose.y_m - view.here.y_m)
            if pose.state != State.WORKING or gap_m > near_m:
                continue
            x_m, y_m, start_at_us = self._beside.get(slot, (pose.x_m, pose.y_m, view.now_us))
            got_on = hypot(pose.x_m - x_m, pose.y_m - y_m) > STRAY_M
            seen[slot] = (pose.x_m, pose.y_m, view.now_us) if got_on else (x_m, y_m, start_at_us)
        self._beside = seen

    def _open_lines(self, view: FleetView) -> NDArray[np.float64]:
        """Points on the lines of all units that are left, (n, 2) metres; in the order of sections."""
        progress, lines = view.progress, self._left
        for section in self.field.sections:
            blocks = range((section.units - 1) // BLOCK_UNITS + 1)
            done = tuple([progress.bits(section.id, block) for block in blocks])
            kept = lines.get(section.id)
            if kept is None or kept[0] != done:
                left = [
                    line
                    for unit, line in enumerate(section.unit_lines)
                    if not progress.has(section.id, unit)
                ]
                lines[section.id] = done, _samples(left)
        return np.concatenate([lines[section.id][1] for section in self.field.sections])

    def _units(self, view: FleetView, done: bool) -> Iterable[Polyline]:
        for section in self.field.sections:
            for unit, line in enumerate(section.unit_lines):
                if view.progress.has(section.id, unit) is done:
                    yield line

    def _free(self, at: Point, open_lines: NDArray[np.float64], view: FleetView) -> bool:
        """Whether a place has room to every open line, and no other robot parks or works there."""
        if _gap_m(at, open_lines) < self.room_m:
            return False
        for x_m, y_m, start_at_us in self._beside.values():
            stuck = view.now_us - start_at_us >= STUCK_US
            if stuck and hypot(at[0] - x_m, at[1] - y_m) < 2 * self.radius_m + PAST_M:
                return False
        here_m = hypot(at[0] - view.here.x_m, at[1] - view.here.y_m)
        apart_m = 2 * self.radius_m + APART_M
        for slot, neighbour in view.neighbours.items():
            pose = neighbour.pose
            gap_m = hypot(at[0] - pose.x_m, at[1] - pose.y_m)
            if pose.state == State.WORKING or gap_m >= apart_m:
                continue
            if gap_m < here_m or (gap_m == here_m and slot < view.slot):
                return False  # it is there before us
        return True

    def _choose(
        self, here: Point, open_lines: NDArray[np.float64], view: FleetView
    ) -> Point | None:
        """The nearest free place; if there is none, the roomiest place near by."""
        middles = [_middle(line) for line in self._units(view, done=True)]
        middles.sort(key=lambda at: (hypot(at[0] - here[0], at[1] - here[1]), at))
        for at in middles[:NEAR_MAX]:
            if self._free(at, open_lines, view):
                return at
        return self._latest(here, view)

    # ---------------------------------------------------------------- where there is no room

    def _latest(self, here: Point, view: FleetView) -> Point | None:
        """The place near by where working robots arrive latest, less our travel time; None: stay
        here.
        """
        arrivals = self._arrivals(view)
        places = np.vstack(([here], self._ground(here)))
        coming_for_s = np.full(len(places), LATE_S)
        reach_m = 2 * self.radius_m + PASS_M
        for x_m, y_m, at_s in arrivals:
            near = np.hypot(places[:, 0] - x_m, places[:, 1] - y_m) < reach_m
            coming_for_s[near] = np.minimum(coming_for_s[near], at_s)
        if coming_for_s[0] < SOON_S:
            self._look_period_us = HASTY_US
        for slot, (pose, _) in view.neighbours.items():
            gap_m = np.hypot(places[:, 0] - pose.x_m, places[:, 1] - pose.y_m)
            taken = gap_m < reach_m
            taken[0] &= slot < view.slot and pose.state != State.WORKING
            coming_for_s[taken] = 0.0
        worth_for_s = (
            coming_for_s - np.hypot(places[:, 0] - here[0], places[:, 1] - here[1]) / self.speed_m_s
        )
        best = int(np.argmax(worth_for_s))
        if coming_for_s[0] >= SOON_S or worth_for_s[best] < worth_for_s[0] + GAIN_S:
            return None
        return float(places[best, 0]), float(places[best, 1])

    def _arrivals(self, view: FleetView) -> list[tuple[float, float, float]]:
        """Places x, y that others will pass at work, and in how many seconds, from their
        sections.
        """
        found: list[tuple[float, float, float]] = []
        for slot, (pose, _) in view.neighbours.items():
            at, so_far_m = (pose.x_m, pose.y_m), 0.0
            if slot not in view.live:
                continue
            for number in view.allocation.assigned_sections(slot):
                section = self.field.section(number)
                left = [
                    line
                    for unit, line in enumerate(section.unit_lines)
                    if not view.progress.has(number, unit)
                ]
                if not left:
                    continue
                first, last = left[0][0], left[-1][-1]
                if dist(at, last) < dist(at, first):
                    left = [line[::-1] for line in reversed(left)]
                for line in left:
                    for x_m, y_m in _samples([(at, line[0]), line]).tolist():
                        so_far_m += dist(at, (x_m, y_m))
                        at = x_m, y_m
                        found.append((x_m, y_m, so_far_m / self.speed_m_s))
                if so_far_m > LATE_S * self.speed_m_s:
                    break
        return found

    def _free_ground(self) -> shapely.Geometry:
        if self._kept_ground is None:
            self._kept_ground = self.field.polygon.buffer(-self.radius_m - FENCE_M)
            shapely.prepare(self._kept_ground)
        return self._kept_ground

    def _ground(self, here: Point) -> NDArray[np.float64]:
        """Places (n, 2) of free ground round us, metres."""
        steps = np.arange(-AROUND_M, AROUND_M + GROUND_M, GROUND_M)
        x_m, y_m = np.meshgrid(
            np.round(here[0] / GROUND_M) * GROUND_M + steps,
            np.round(here[1] / GROUND_M) * GROUND_M + steps,
        )
        inside = shapely.contains_xy(self._free_ground(), x_m, y_m)
        return np.column_stack((x_m[inside], y_m[inside]))


def _middle(line: Polyline) -> Point:
    """The middle along the line, which may differ from the middle between its ends."""
    lengths_m = [hypot(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(line)]
    left_m = sum(lengths_m) / 2
    for ((ax, ay), (bx, by)), length_m in zip(itertools.pairwise(line), lengths_m, strict=True):
        if left_m <= length_m > 0.0:
            share = left_m / length_m
            return ax + share * (bx - ax), ay + share * (by - ay)
        left_m -= length_m
    return line[-1]


def _samples(lines: Iterable[Sequence[Point]]) -> NDArray[np.float64]:
    """Points on the lines, (n, 2) metres, at most `SAMPLE_M` apart."""
    found: list[Point] = []
    for line in lines:
        for (ax, ay), (bx, by) in itertools.pairwise(line):
            count = int(hypot(bx - ax, by - ay) / SAMPLE_M) + 1
            found += [
                (ax + k / count * (bx - ax), ay + k / count * (by - ay)) for k in range(count)
            ]
        found.append(line[-1])
    return np.array(found, dtype=np.float64).reshape(-1, 2)


def _gap_m(at: Point, points: NDArray[np.float64]) -> float:
    if len(points) == 0:
        return float("inf")
    return float(np.hypot(points[:, 0] - at[0], points[:, 1] - at[1]).min())
