"""Where a robot without work stands: beside what is still to be worked, in nobody's way.

Running away from whoever comes near ends in a corner, and a robot in a corner blocks the row that
leads into it for good. So it leaves in time, for the nearest place with room on every side: the middle
of a unit that is done and lies next to no open one. And it leaves where one that works is beside it and
does not get on: that one may have nowhere to go but past it.
"""

import itertools
from collections.abc import Iterable, Sequence
from math import hypot
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agent.config import S
from agent.field import Field, Polyline
from agent.giving_way import APART_M as PAST_M
from agent.giving_way import NEAR_M
from agent.leg import LEAD_M
from agent.lifecycle import State
from agent.mission import FleetView

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


class Parking:
    def __init__(self, field: Field, radius_m: float) -> None:
        self.field, self.radius_m = field, radius_m
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
        if self._looked_us is not None and view.now_us - self._looked_us < LOOK_US:
            return
        self._looked_us = view.now_us
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
        return max(middles[:NEAR_MAX], key=lambda at: (_gap_m(at, open_lines), at), default=None)


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


def _gap_m(at: Point, points: NDArray[np.float64]) -> float:
    if len(points) == 0:
        return float("inf")
    return float(np.hypot(points[:, 0] - at[0], points[:, 1] - at[1]).min())
