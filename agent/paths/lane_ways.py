"""Ways over lanes: lines through ground that is too narrow for the cells of a path grid.

Lanes meet at their ends. Ends that lie in one region of free cells are joined over cells.
"""

from collections.abc import Mapping, Sequence
from heapq import heappop, heappush
from itertools import pairwise
from math import dist, hypot, inf
from typing import NamedTuple

from agent.interface.geometry import Point


class Leg(NamedTuple):
    """A part of a way: along a lane, or between two places over cells."""

    points: tuple[Point, ...]
    is_lane: bool


class _Foot(NamedTuple):
    """The place on a lane that is nearest to some point."""

    off_m: float
    lane: int
    at: Point
    before: int  # the corner of the lane before it


class LaneWays:
    """The lanes of one path grid. Places are (x, y) metres."""

    def __init__(self, lanes: Sequence[Sequence[Point]]) -> None:
        """`lanes`: each of two places or more."""
        self.lines = tuple(tuple((x_m, y_m) for x_m, y_m in lane) for lane in lanes)
        self.ends = tuple(sorted({end for line in self.lines for end in (line[0], line[-1])}))

    def without(self, bodies: Sequence[Point], reach_m: float) -> list[tuple[Point, ...]]:
        """The lanes that come no nearer than `reach_m` to any of these places."""
        return [
            line
            for k, line in enumerate(self.lines)
            if all(self._foot(body, k).off_m >= reach_m for body in bodies)
        ]

    def off_m(self, point: Point) -> float:
        """How far the nearest lane is; infinity without lanes."""
        return self._nearest(point).off_m if self.lines else inf

    def legs(
        self, start: Point, from_region: int, goal: Point, to_region: int, ends: Mapping[Point, int]
    ) -> list[Leg] | None:
        """The shortest way from start to goal over lanes; None: there is none.

        `from_region`, `to_region`, `ends`: the region of free cells in which start, goal and each end of
        a lane lie; 0: none, so a start or a goal is beside a lane.
        """
        links: dict[Point, list[Leg]] = {end: [] for end in ends}
        for line in self.lines:
            links[line[0]].append(Leg(line, True))
            links[line[-1]].append(Leg(line[::-1], True))
        for end, region in ends.items():
            if region:
                others = [to for to, same in ends.items() if same == region and to != end]
                links[end] += [Leg((end, to), False) for to in others]
        first, last = links.setdefault(start, []), []
        if from_region:
            first += [
                Leg((start, end), False) for end, region in ends.items() if region == from_region
            ]
        if to_region:
            last = [Leg((end, goal), False) for end, region in ends.items() if region == to_region]
        if not from_region:
            first += self._out(start)
        if not to_region:
            last = [Leg(leg.points[::-1], True) for leg in self._out(goal)]
        if not from_region and not to_region:
            first += self._along(start, goal)
        for leg in last:
            links[leg.points[0]].append(leg)
        return _shortest(start, goal, links)

    def _out(self, point: Point) -> list[Leg]:
        """From a place to the nearest lane and along it to both of its ends."""
        foot = self._nearest(point)
        line = self.lines[foot.lane]
        back = (point, foot.at, *line[: foot.before + 1][::-1])
        return [Leg(back, True), Leg((point, foot.at, *line[foot.before + 1 :]), True)]

    def _along(self, start: Point, goal: Point) -> list[Leg]:
        """From start to goal, if one lane is the nearest to both."""
        a, b = self._nearest(start), self._nearest(goal)
        if a.lane != b.lane:
            return []
        line = self.lines[a.lane]
        between = line[a.before + 1 : b.before + 1] or line[b.before + 1 : a.before + 1][::-1]
        return [Leg((start, a.at, *between, b.at, goal), True)]

    def _nearest(self, point: Point) -> _Foot:
        return min(self._foot(point, lane) for lane in range(len(self.lines)))

    def _foot(self, point: Point, lane: int) -> _Foot:
        found = []
        for k, ((ax, ay), (bx, by)) in enumerate(pairwise(self.lines[lane])):
            dx, dy = bx - ax, by - ay
            square = dx * dx + dy * dy
            share = 0.0
            if square > 0.0:
                share = ((point[0] - ax) * dx + (point[1] - ay) * dy) / square
                share = min(max(share, 0.0), 1.0)
            at = ax + share * dx, ay + share * dy
            found.append(_Foot(dist(point, at), lane, at, k))
        return min(found)


def _length_m(points: Sequence[Point]) -> float:
    return sum(hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(points))


def _shortest(start: Point, goal: Point, links: Mapping[Point, Sequence[Leg]]) -> list[Leg] | None:
    """The legs of the shortest way; None: there is none."""
    lengths_m: dict[Point, float] = {start: 0.0}
    by: dict[Point, Leg] = {}
    waiting = [(0.0, start)]
    while waiting:
        at_m, at = heappop(waiting)
        if at == goal:
            break
        if at_m > lengths_m[at]:
            continue
        for leg in links.get(at, ()):
            to, to_m = leg.points[-1], at_m + _length_m(leg.points)
            if to_m < lengths_m.get(to, inf):
                lengths_m[to], by[to] = to_m, leg
                heappush(waiting, (to_m, to))
    if goal not in by:
        return None
    legs: list[Leg] = []
    at = goal
    while at != start:
        legs.append(by[at])
        at = by[at].points[0]
    return legs[::-1]
