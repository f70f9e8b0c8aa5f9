"""Where a robot without work stands: beside what is still to be worked, in nobody's way.

Running away from whoever comes near ends in a corner, and a robot in a corner blocks the row that
leads into it for good. So it leaves in time, for the nearest place with room on every side: the middle
of a unit that is done and lies next to no open one. And it leaves where one that works is beside it and
does not get on: that one may have nowhere to go but past it.

Where there is no such room, in a field hardly larger than the fleet or before anything is done, it stands
where those that work come latest, by the lines that they hold and the order in which they drive them.
"""

import itertools
from collections.abc import Iterable, Sequence
from functools import cached_property
from math import hypot
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from agent.field.field_map import Field, Polyline
from agent.interface.config import MS, S
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView
from agent.motion.deadlock_yield import APART_M as PAST_M
from agent.motion.deadlock_yield import NEAR_M
from agent.motion.implement_clearance import LEAD_M

Point = tuple[float, float]

# Between two hulls, beside a line that will be worked: a robot that nears its end, a lead beyond it, is
# not to take one that rests there for one in its way.
ROOM_M: Final = NEAR_M + LEAD_M
APART_M: Final = 1.0  # between hulls of two that rest
STUCK_US: Final = 10 * S  # who works has found no way round us by then: two detours
STRAY_M: Final = 4.0  # who goes to and fro within this does not get on: a detour is as long
LOOK_US: Final = 1 * S  # open lines change with units, and a unit takes seconds
NEAR_MAX: Final = 200  # places looked at, nearest first: a field has room near by or not at all
SAMPLE_M: Final = 1.0  # of open lines
# Where there is no room on every side:
PASS_M: Final = (
    0.35  # between hulls, beside a line on which one that works passes us: ORCA's margin twice
)
FENCE_M: Final = 0.3  # and to a fence
AROUND_M: Final = 12.0  # places are looked for so far away
GROUND_M: Final = 0.75  # between places that are looked at
SOON_S: Final = 12.0  # somebody comes so soon: leave now
LATE_S: Final = 60.0  # later than this is all the same
GAIN_S: Final = 1.0  # what another place must be better by
HASTY_US: Final = 250 * MS  # it is looked so often where somebody comes soon


class Parking:
    def __init__(self, field: Field, radius_m: float, speed_m_s: float = 2.5) -> None:
        self.field, self.radius_m, self.speed_m_s = field, radius_m, speed_m_s
        self._look_us = LOOK_US
        self.spot: Point | None = None  # where to go; none: stay
        self._looked_us: int | None = None
        self._beside: dict[
            int, tuple[float, float, int]
        ] = {}  # who works near us: where, since when

    @property
    def room_m(self) -> float:
        """From the middle of a robot that rests to a line that is open."""
        return 2 * self.radius_m + ROOM_M

    def look(self, view: FleetView) -> None:
        """Once a second: is there a reason to leave, and where to?"""
        if self._looked_us is not None and view.now_us - self._looked_us < self._look_us:
            return
        self._looked_us, self._look_us = view.now_us, LOOK_US
        open_lines = _samples(self._units(view, done=False))
        here = (view.here.x_m, view.here.y_m)
        self._watch(view)
        if self.spot is not None and self._free(self.spot, open_lines, view):
            return
        self.spot = None
        if len(open_lines) and not self._free(here, open_lines, view):
            self.spot = self._choose(here, open_lines, view)

    def forget(self) -> None:
        """There is work: the next rest looks again."""
        self.spot, self._looked_us = None, None
        self._beside.clear()

    def _watch(self, view: FleetView) -> None:
        near_m, seen = 2 * self.radius_m + PAST_M, dict[int, tuple[float, float, int]]()
        for slot, (pose, _) in view.neighbours.items():
            gap_m = hypot(pose.x_m - view.here.x_m, pose.y_m - view.here.y_m)
            if pose.state != State.WORKING or gap_m > near_m:
                continue
            x_m, y_m, since_us = self._beside.get(slot, (pose.x_m, pose.y_m, view.now_us))
            got_on = hypot(pose.x_m - x_m, pose.y_m - y_m) > STRAY_M
            seen[slot] = (pose.x_m, pose.y_m, view.now_us) if got_on else (x_m, y_m, since_us)
        self._beside = seen

    def _units(self, view: FleetView, done: bool) -> Iterable[Polyline]:
        for section in self.field.sections:
            for unit, line in enumerate(section.unit_lines):
                if view.progress.has(section.id, unit) is done:
                    yield line

    def _free(self, at: Point, open_lines: NDArray[np.float64], view: FleetView) -> bool:
        """Room to every open line, nobody else that rests here, and nobody whom we keep from work."""
        if _gap_m(at, open_lines) < self.room_m:
            return False
        for x_m, y_m, since_us in self._beside.values():
            stuck = view.now_us - since_us >= STUCK_US
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
        """The nearest place that is free; where there is none, the roomiest of those near by."""
        middles = [_middle(line) for line in self._units(view, done=True)]
        middles.sort(key=lambda at: (hypot(at[0] - here[0], at[1] - here[1]), at))
        for at in middles[:NEAR_MAX]:
            if self._free(at, open_lines, view):
                return at
        return self._latest(here, view)

    # ---------------------------------------------------------------- where there is no room

    def _latest(self, here: Point, view: FleetView) -> Point | None:
        """The place near by where those that work come latest, the way there taken off; none: stay."""
        arrivals = self._arrivals(view)
        places = np.vstack(([here], self._ground(here)))
        coming_s = np.full(len(places), LATE_S)
        reach_m = 2 * self.radius_m + PASS_M
        for x_m, y_m, at_s in arrivals:
            near = np.hypot(places[:, 0] - x_m, places[:, 1] - y_m) < reach_m
            coming_s[near] = np.minimum(coming_s[near], at_s)
        if coming_s[0] < SOON_S:
            self._look_us = HASTY_US
        for slot, (pose, _) in view.neighbours.items():
            gap_m = np.hypot(places[:, 0] - pose.x_m, places[:, 1] - pose.y_m)
            taken = gap_m < reach_m
            taken[0] &= slot < view.slot and pose.state != State.WORKING
            coming_s[taken] = 0.0
        worth_s = (
            coming_s - np.hypot(places[:, 0] - here[0], places[:, 1] - here[1]) / self.speed_m_s
        )
        best = int(np.argmax(worth_s))
        if coming_s[0] >= SOON_S or worth_s[best] < worth_s[0] + GAIN_S:
            return None
        return float(places[best, 0]), float(places[best, 1])

    def _arrivals(self, view: FleetView) -> list[tuple[float, float, float]]:
        """Places that others will pass at work, and in how many seconds, by what they hold."""
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
                if _distance(at, last) < _distance(at, first):
                    left = [line[::-1] for line in reversed(left)]
                for line in left:
                    for x_m, y_m in _samples([(at, line[0]), line]).tolist():
                        so_far_m += _distance(at, (x_m, y_m))
                        at = x_m, y_m
                        found.append((x_m, y_m, so_far_m / self.speed_m_s))
                if so_far_m > LATE_S * self.speed_m_s:
                    break
        return found

    @cached_property
    def _free_ground(self) -> shapely.Geometry:
        free = self.field.polygon.buffer(-self.radius_m - FENCE_M)
        shapely.prepare(free)
        return free

    def _ground(self, here: Point) -> NDArray[np.float64]:
        """Places (n, 2) of free ground round us."""
        steps = np.arange(-AROUND_M, AROUND_M + GROUND_M, GROUND_M)
        x_m, y_m = np.meshgrid(
            np.round(here[0] / GROUND_M) * GROUND_M + steps,
            np.round(here[1] / GROUND_M) * GROUND_M + steps,
        )
        inside = shapely.contains_xy(self._free_ground, x_m, y_m)
        return np.column_stack((x_m[inside], y_m[inside]))


def _middle(line: Polyline) -> Point:
    """Of the line's way, not of its ends: a unit may go round a corner."""
    lengths_m = [hypot(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(line)]
    left_m = sum(lengths_m) / 2
    for ((ax, ay), (bx, by)), length_m in zip(itertools.pairwise(line), lengths_m, strict=True):
        if left_m <= length_m > 0.0:
            share = left_m / length_m
            return ax + share * (bx - ax), ay + share * (by - ay)
        left_m -= length_m
    return line[-1]


def _samples(lines: Iterable[Sequence[Point]]) -> NDArray[np.float64]:
    """Points on the lines, (n, 2), every metre at least."""
    found: list[Point] = []
    for line in lines:
        for (ax, ay), (bx, by) in itertools.pairwise(line):
            count = int(hypot(bx - ax, by - ay) / SAMPLE_M) + 1
            found += [
                (ax + k / count * (bx - ax), ay + k / count * (by - ay)) for k in range(count)
            ]
        found.append(line[-1])
    return np.array(found, dtype=np.float64).reshape(-1, 2)


def _distance(a: Point, b: Point) -> float:
    return hypot(a[0] - b[0], a[1] - b[1])


def _gap_m(at: Point, points: NDArray[np.float64]) -> float:
    if len(points) == 0:
        return float("inf")
    return float(np.hypot(points[:, 0] - at[0], points[:, 1] - at[1]).min())
