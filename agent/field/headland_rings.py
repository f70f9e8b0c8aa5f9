"""The rings of a headland, in pieces: where they begin and end, and how they turn in narrow tips.

A bar that ends in a corner from both sides leaves the outside of the corner out. So pieces meet
where the ring is straight, and at least in the middle between two corners.

A bar that turns back by almost half a turn does not swing: the robot reverses, and what lies ahead
of it stays. That happens in the tip of a field, and all along a part that is hardly wider than the
implement. There the ring gets a short side across, so that it turns twice by about a right angle.
It leaves the line by half the overlap at most, the tolerance of driving.
"""

import itertools
from collections.abc import Iterator, Sequence
from math import dist, hypot, inf, radians
from typing import Final, NamedTuple

import numpy as np
import shapely
from shapely.geometry import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from agent.interface.geometry import Point, Polyline
from agent.motion.path_tracker import ARRIVED_M, turn_at

CORNER_RAD: Final = 0.05  # a sharper one keeps half a width from where pieces meet, if it can
BENT_RAD: Final = 1e-3  # a smaller turn is none
BENT_M: Final = 0.1  # pieces do not meet nearer than this to a turn of any size
CUT_STEP_M: Final = 1.0  # step of the search for a straight place for a cut
# From here on, a turn is given a side across. `sim/world/coverage_truth.py` takes more than 170
# degrees for reversing, and no robot's course is exact.
TIP_RAD: Final = radians(160.0)
TIP_M: Final = 0.1  # corners within this length are driven as one
# Of the working width: that is half of a side of the arc round a corner of the field. A tip that takes in
# an arc would leave the ring.
TIP_SHARE: Final = 1 / 40
# A robot passes corners nearer to each other than `ARRIVED_M` as one. So a bend of such sides that turns
# back within this length is a tip, too: the round end of a part hardly wider than the implement.
BEND_M: Final = 0.3
ARC_RAD: Final = 0.3  # a smaller turn belongs to an arc
ARC_SHARE: Final = (
    5  # points of an arc are passed within this part of the slack; the side uses it up
)
JOIN_M: Final = 2.0  # from the line to the side across a tip
LOOP_SHARE: Final = (
    1.02  # of the slack: the axis of a part that is bent by millimetres is outside of it
)
NO_TURN_M: Final = 1e-6  # points nearer than this are one


def rings(inset: BaseGeometry) -> Iterator[LineString]:
    """Each closed line along the fences.

    `inset`: where the middle of an implement may be, so that it stays within the fences, metres.
    """
    for part in parts(inset):
        for ring in (part.exterior, *part.interiors):
            yield LineString(ring.coords)


def parts(shape: BaseGeometry) -> list[Polygon]:
    """The polygons that a shape consists of, from west to east."""
    if isinstance(shape, Polygon):
        return [] if shape.is_empty else [shape]
    if isinstance(shape, MultiPolygon):
        return sorted(shape.geoms, key=lambda part: part.bounds)
    return [part for part in getattr(shape, "geoms", []) if isinstance(part, Polygon)]


def pieces(ring: LineString, section_length_m: float, width_m: float) -> Iterator[Polyline]:
    """A ring in pieces of about the wanted length, each a polyline of (x, y) metres.

    `width_m`: of the implement.
    """
    count = max(1, round(ring.length / section_length_m))
    wanted = [ring.length * k / count for k in range(count)]
    turns = _turns(ring)
    cuts = sorted({round(_straight(ring, cut, count, width_m, turns), 6) for cut in wanted})
    for start, end in zip(cuts, [*cuts[1:], cuts[0] + ring.length], strict=True):
        yield tuple((float(p[0]), float(p[1])) for p in _along(ring, start, end))


def _along(ring: LineString, start: float, end: float) -> list[tuple[float, ...]]:
    """The ring from one arc length to another, across its closing point if necessary."""
    if end <= ring.length:
        return list(substring(ring, start, end).coords)
    first = list(substring(ring, start, ring.length).coords)
    return first + list(substring(ring, 0.0, end - ring.length).coords)[1:]


class _Turns(NamedTuple):
    """Where a ring turns, metres along it."""

    corners: list[float]
    bends: list[float]  # corners are bends, too


def _turns(ring: LineString) -> _Turns:
    places = shapely.get_coordinates(ring)
    edges_m = shapely.length(shapely.linestrings(np.stack((places[:-1], places[1:]), axis=1)))
    points = [(x_m, y_m) for x_m, y_m in places.tolist()]
    found, along = _Turns([], []), 0.0
    for k, (a, b) in enumerate(itertools.pairwise(points)):
        turn_rad = abs(turn_at(points[k - 1] if k else points[-2], a, b))
        if turn_rad > CORNER_RAD:
            found.corners.append(along)
        if turn_rad > BENT_RAD:
            found.bends.append(along)
        along += float(edges_m[k])
    return found


def _straight(ring: LineString, cut: float, count: int, width_m: float, turns: _Turns) -> float:
    """The arc length nearest to `cut` that is half a width from every corner.

    If there is none, it is the one furthest from any turn in this one of `count` equal pieces of
    the ring.
    """
    length, (corners, bends) = float(ring.length), turns

    def apart(at: float, other: float) -> float:
        return abs((at - other + length / 2) % length - length / 2)

    def is_straight(at: float) -> bool:
        return all(apart(at, c) >= width_m / 2 + CUT_STEP_M for c in corners) and all(
            apart(at, b) >= BENT_M for b in bends
        )

    steps = (k * CUT_STEP_M * sign for k in range(int(length / 2)) for sign in (1, -1))
    found = next((cut + step for step in steps if is_straight((cut + step) % length)), None)
    if found is None and bends:
        gaps = list(itertools.pairwise([*bends, bends[0] + length]))
        near = [gap for gap in gaps if apart(sum(gap) / 2, cut) <= length / count / 2]
        start, end = max(near or gaps, key=lambda gap: (round(gap[1] - gap[0], 6), -gap[0]))
        found = (start + end) / 2
    return float((cut if found is None else found) % length)


# ---------------------------------------------------------------- tips


def swinging(ring: LineString, slack_m: float, width_m: float) -> LineString:
    """The ring with a side across wherever it turns back; the same ring if it does so nowhere.

    `slack_m`: how far it may leave the ring, half the overlap. `width_m`: of the implement.
    """
    loop = _loop(ring, slack_m)
    if loop is not None:
        return loop
    points = [(float(x), float(y)) for x, y in ring.coords]
    points = [b for a, b in itertools.pairwise(points) if dist(a, b) > NO_TURN_M]
    count = len(points)
    longest = max(range(count), key=lambda k: dist(points[k - 1], points[k]))
    points = points[longest:] + points[:longest]  # no tip lies across the closing point
    result: list[Point] = []
    at, tips = 0, list(_tips(points, min(TIP_M, TIP_SHARE * width_m)))
    for number, (first, last) in enumerate(tips):
        tip = points[first : last + 1]
        end = tips[number + 1][0] if number + 1 < len(tips) else count
        before, passed = _join([*points[at:first], tip[0]][::-1], points[at - 1], slack_m)
        after, skipped = _join([tip[-1], *points[last + 1 : end]], points[end % count], slack_m)
        side = _across(points[first - 1], tip, points[(last + 1) % count], slack_m)
        result += [*points[at : first - passed], before, *side, after]
        at = last + 1 + skipped
    return LineString([*result, *points[at:], *(result or points)[:1]]) if at else ring


def _join(way: Sequence[Point], beyond: Point, slack_m: float) -> tuple[Point, int]:
    """Where the line is joined to the side across a tip, and how many points of it are passed.

    `way`: from the tip on, its first point included. `beyond`: the point after them. The line is joined
    `JOIN_M` from the tip, or in the middle of a side that ends in a corner before that. Points of an arc
    are passed as long as none is further than `slack_m` from the straight way.
    """
    run_m, last = 0.0, way[0]
    for k, (here, ahead) in enumerate(itertools.pairwise([*way, beyond])):
        side_m = dist(here, ahead)
        on = [*way, beyond][k + 2] if k + 2 < len(way) + 1 else None
        gentle = on is not None and abs(turn_at(here, ahead, on)) <= ARC_RAD
        share = min(1.0, (JOIN_M - run_m) / side_m)
        if not gentle:
            share = min(share, 0.5)
        to = here[0] + (ahead[0] - here[0]) * share, here[1] + (ahead[1] - here[1]) * share
        straight = LineString([way[0], to])
        if k and any(
            straight.distance(shapely.Point(each)) > slack_m / ARC_SHARE for each in way[1 : k + 1]
        ):
            return last, k
        if share < 1.0 or not gentle:
            return to, k
        run_m += side_m
        last = to
    raise AssertionError("the last side ends in no arc")


def _loop(ring: LineString, slack_m: float) -> LineString | None:
    """A rectangle round the long axis of a ring that is nowhere further from it than `slack_m`."""
    if Polygon(ring).area > slack_m * ring.length:
        return None
    points = shapely.get_coordinates(ring)
    a, b = max(itertools.combinations(points, 2), key=lambda pair: dist(*pair))
    length_m = dist(a, b)
    ux, uy = (b - a) / length_m if length_m > NO_TURN_M else (1.0, 0.0)
    if np.abs((points - a) @ (-uy, ux)).max() > slack_m:
        return None
    corners = [
        (float(x - uy * aside_m), float(y + ux * aside_m))
        for (x, y), aside_m in ((a, -slack_m), (b, -slack_m), (b, slack_m), (a, slack_m))
    ]
    box = LineString([*corners, corners[0]])
    # The axis of a bent part lies outside of it.
    near = Polygon(ring).buffer(slack_m * LOOP_SHARE, quad_segs=64)
    return box if box.difference(near).length < slack_m else None


def _tips(points: Sequence[Point], tip_m: float) -> Iterator[tuple[int, int]]:
    """The first and the last point of each tip, with points near by that belong to no longer side.

    `points`: of a ring, none twice. `tip_m`: corners within this length are one tip.
    """
    count, done = len(points), 0
    first = 0
    while first < count:
        last = _turned_back(points, first, tip_m)
        if last is None:
            last = _turned_back(points, first, BEND_M, ARRIVED_M)
        if last is None:
            first += 1
            continue
        while first > done and dist(points[first - 1], points[first]) < tip_m:
            first -= 1
        while last + 1 < count and dist(points[last], points[last + 1]) < tip_m:
            last += 1
        yield first, last
        first = done = last + 1


def _turned_back(
    points: Sequence[Point], first: int, tip_m: float, side_max_m: float = inf
) -> int | None:
    """The point at which a turn that begins at `first` has turned back; None if it does not, within
    `tip_m` and on sides of less than `side_max_m`.
    """
    count, turned_rad, run_m = len(points), 0.0, 0.0
    for last in range(first, count):
        side_m = dist(points[last - 1], points[last]) if last > first else 0.0
        run_m += side_m
        if run_m > tip_m or side_m >= side_max_m:
            return None
        turned_rad += turn_at(points[last - 1], points[last], points[(last + 1) % count])
        if abs(turned_rad) > TIP_RAD:
            return last
    return None


def _across(before: Point, tip: Sequence[Point], after: Point, slack_m: float) -> list[Point]:
    """The two ends of the side that replaces the points of a tip."""
    into, out = _unit(before, tip[0]), _unit(tip[-1], after)
    if dist(into, out) > NO_TURN_M:
        ux, uy = _unit(out, into)
    else:  # it goes on as it came, after a whole turn
        ux, uy = into
    turned_rad = sum(
        turn_at(a, b, c) for a, b, c in zip((before, *tip), tip, (*tip[1:], after), strict=False)
    )
    nx, ny = (-uy, ux) if turned_rad > 0.0 else (uy, -ux)
    on_m = max(x * ux + y * uy for x, y in tip)
    aside = [x * nx + y * ny for x, y in tip]
    aside_m, half_m = (min(aside) + max(aside)) / 2, (max(aside) - min(aside)) / 2
    half_m = max(half_m, slack_m)
    return [
        (on_m * ux + at_m * nx, on_m * uy + at_m * ny)
        for at_m in (aside_m - half_m, aside_m + half_m)
    ]


def _unit(a: Sequence[float], b: Sequence[float]) -> Point:
    length = hypot(b[0] - a[0], b[1] - a[1])
    return (b[0] - a[0]) / length, (b[1] - a[1]) / length
