"""Strokes of their own into sharp corners, for bodies that steer.

Where a ring is cut at a sharp corner, its two pieces may leave ground on both sides of the tip: beside
each fence lies a place that neither the piece along it nor the one along the other fence reaches. A
third way reaches it, which comes from inside of the field at another angle. It is planned where the
whole plan leaves ground and a way exists that works it: straight or gently bent, with the middle of the
body on free ground and the whole bar within the fences.

All ways are compared that bring the bar over a place which is left: with several bends, in many
directions, and with the place under several parts of the bar.
"""

from collections.abc import Sequence
from math import hypot, pi, sqrt
from typing import Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from agent.field.corner_cuts import (
    AS_GOOD_M2,
    BESIDE_M,
    OVER_M,
    PAST_END_M,
    SHARP_RAD,
    SPARE,
    bar_stays,
)
from agent.interface.geometry import Point, Polyline
from agent.motion.implement_clearance import LEAD_M
from agent.motion.path_tracker import turn_at
from agent.motion.tractor_tracker import BEND_HALF_M, smooth_way

Reals = NDArray[np.float64]
Flags = NDArray[np.bool_]

# A stroke takes 5 to 15 s. Less ground than this, two thirds of a cell of the coverage check, stays.
LEAST_M2: Final = 0.04
STROKES_MAX: Final = 3  # in one corner
SPECK_M2: Final = LEAST_M2 / 8  # a smaller piece of ground is no reason for a stroke
STROKE_M: Final = 2.0  # length of the swath: the course settles in it
RUN_UP_M: Final = 1.5  # before it, for the body alone: the longest that ways to a swath have
SPARE_M: Final = 0.1  # on a stroke, to fences: so far off its line a body may be
NEARER_M: Final = 0.05  # behind it, on the lead-out: so much nearer to a fence, as at ends of rings
RADIUS_LEAST_M: Final = 1.5  # a tighter bend is rounded by more than 0.04 m before it is driven
RADII_M: Final = (2.5, 4.0, 8.0)  # of further bends
HEADINGS: Final = 96  # of a whole turn; with 48, a quarter of the strokes is not found
# Where the place is on the bar, of its half. The middle of the bar reaches no corner.
ACROSS: Final = (-1.0, -0.95, -0.8, -0.5, 0.5, 0.8, 0.95, 1.0)
BAR_SAMPLES: Final = (-1.0, -0.5, 0.5, 1.0)  # of its half: where it is checked against the fences
CHECK_M: Final = 0.25  # between checked places of a way
GRID_M: Final = 0.05  # between points that stand for the ground that is left, at least
POINTS_MAX: Final = 500  # about so many; thousands of ways are computed for each of them
PLACES: Final = 12  # of these points, far from each other: ways are tried to them
TOUCHES_M: Final = 0.01  # a bar that is this much too wide touches the fence; it does not cross it
TRIED: Final = 12  # of the ways that seem best: these are computed as they are driven
# Of the ways that seem best, so many are looked at: on some the bar leaves the field as they are driven.
LOOKED_AT: Final = 60


class _Ways(NamedTuple):
    """Ways that end at (x, y) in metres with this heading: arcs, and straight on past the end."""

    x_m: Reals
    y_m: Reals
    heading_rad: Reals
    bend_1_m: Reals

    def where(self, chosen: Flags | NDArray[np.intp]) -> "_Ways":
        return _Ways(*(values[chosen] for values in self))

    def at(self, along_m: float) -> tuple[Reals, Reals, Reals]:
        """Places and headings this far from the ends of the arcs; negative: before them."""
        x_m, y_m, heading, bend = self
        if along_m >= 0.0:
            return x_m + along_m * np.cos(heading), y_m + along_m * np.sin(heading), heading
        turned = heading + bend * along_m
        # The chord of an arc: its direction is that of its middle.
        chord_m = along_m * np.sinc(bend * along_m / 2 / pi)
        middle = heading + bend * along_m / 2
        return x_m + chord_m * np.cos(middle), y_m + chord_m * np.sin(middle), turned


def sharp_corners(ring: Sequence[Point]) -> list[Point]:
    """The points of a ring at which it turns sharply, metres."""
    return [
        b
        for a, b, c in zip(ring, ring[1:], ring[2:], strict=False)
        if abs(turn_at(a, b, c)) >= SHARP_RAD
    ]


class CornerStrokes:
    """Finds strokes into the corners of one field."""

    def __init__(
        self, outline: Polygon, asked: BaseGeometry, swaths: Sequence[Polyline],
        turn_radius_m: float, reach_m: float, keep_m: float,
    ) -> None:  # fmt: skip
        """`asked`: the ground that is to be worked. `swaths`: of the whole plan. `turn_radius_m`: of
        planned curves. `reach_m`: half the implement width. `keep_m`: how far the middle of the body
        keeps from fences.
        """
        self._asked, self._reach_m = asked, reach_m
        self._room = outline.buffer(-(keep_m + SPARE_M))
        self._last = outline.buffer(-(keep_m - NEARER_M))
        self._inside = outline.buffer(TOUCHES_M)
        self._within = outline.buffer(OVER_M)
        for ground in (self._room, self._last, self._inside, self._within):
            shapely.prepare(ground)
        self._swaths, self._strokes = list(swaths), list[Polyline]()
        self._tree = shapely.STRtree([LineString(swath) for swath in swaths])
        least_m = max(SPARE * turn_radius_m, RADIUS_LEAST_M)
        radii_m = [least_m, *(radius_m for radius_m in RADII_M if radius_m > least_m)]
        self._bends = [0.0, *(side / radius_m for radius_m in radii_m for side in (1.0, -1.0))]

    def into(self, corner: Point) -> list[Polyline]:
        """The strokes into a corner of a ring, all places (x, y) metres. Each ends in the corner."""
        near = shapely.Point(corner).buffer(2 * self._reach_m)
        left = near.intersection(self._asked)
        for k in sorted(self._tree.query(near.buffer(self._reach_m))):
            left = left.difference(_swept(self._swaths[k], near, self._reach_m))
        for stroke in self._strokes:  # into another corner that is near
            left = left.difference(_swept(stroke, near, self._reach_m))
        strokes: list[Polyline] = []
        while len(strokes) < STROKES_MAX:
            left = shapely.union_all([p for p in shapely.get_parts(left) if p.area >= SPECK_M2])
            if left.area < LEAST_M2:
                break
            best = self._best(left, near)
            if best is None:
                break
            strokes.append(best)
            left = left.difference(_swept(best, near, self._reach_m))
        self._strokes += strokes
        return strokes

    def _best(self, left: BaseGeometry, near: BaseGeometry) -> Polyline | None:
        """The stroke that works most of `left`; None if none works enough of it."""
        points = _points_in(left)
        if not len(points):
            return None
        ways = self._drivable(self._to(_apart(points, PLACES)))
        gains = np.count_nonzero(self._works(ways, points), axis=1)
        best, most_m2 = None, LEAST_M2 - AS_GOOD_M2
        tried = 0
        for k in np.argsort(-gains, kind="stable")[:LOOKED_AT]:
            stroke = _polyline(ways.where(np.array([k])))
            led = smooth_way(_longer(stroke, LEAD_M), BEND_HALF_M)
            if not bar_stays(led, self._reach_m, self._within):
                continue
            tried += 1
            if tried > TRIED:
                break
            worked = _swept(stroke, near, self._reach_m).intersection(left)
            # On another machine the last digits of an area may differ.
            if worked.area > most_m2 + AS_GOOD_M2:
                best, most_m2 = stroke, worked.area
        return best

    def _to(self, places: Reals) -> _Ways:
        """All ways that end with the bar over one of these places, (n, 2) metres."""
        headings = np.arange(HEADINGS) * (2 * pi / HEADINGS)
        across = np.array(ACROSS) * (self._reach_m - BESIDE_M)
        k, heading, aside_m, bend = (
            grid.ravel()
            for grid in np.meshgrid(
                np.arange(len(places)), headings, across, np.array(self._bends), indexing="ij"
            )
        )
        before_m = PAST_END_M - BESIDE_M
        x_m = places[k, 0] + aside_m * np.sin(heading) - before_m * np.cos(heading)
        y_m = places[k, 1] - aside_m * np.cos(heading) - before_m * np.sin(heading)
        return _Ways(x_m, y_m, heading, bend)

    def _drivable(self, ways: _Ways) -> _Ways:
        """Those of the ways on which the body stays on free ground and the bar within the fences."""
        x_m, y_m, _ = ways.at(LEAD_M)
        ways = ways.where(shapely.contains_xy(self._last, x_m, y_m))
        for along_m in np.arange(0.0, -STROKE_M - RUN_UP_M, -CHECK_M):
            x_m, y_m, _ = ways.at(along_m)
            ways = ways.where(shapely.contains_xy(self._room, x_m, y_m))
        for along_m in (LEAD_M, *np.arange(0.0, -STROKE_M - 1e-9, -CHECK_M), -STROKE_M - LEAD_M):
            for share in BAR_SAMPLES:
                x_m, y_m, heading = ways.at(along_m)
                aside_m = share * self._reach_m
                ways = ways.where(
                    shapely.contains_xy(
                        self._inside,
                        x_m - aside_m * np.sin(heading),
                        y_m + aside_m * np.cos(heading),
                    )
                )
        return ways

    def _works(self, ways: _Ways, points: Reals) -> Flags:
        """(ways, points): whether the bar passes over each of these points, (n, 2) metres."""
        x_m, y_m, heading, bend = (values[:, np.newaxis] for values in ways)
        dx_m, dy_m = points[:, 0] - x_m, points[:, 1] - y_m
        along_m = dx_m * np.cos(heading) + dy_m * np.sin(heading)
        aside_m = dy_m * np.cos(heading) - dx_m * np.sin(heading)
        half_m = self._reach_m - BESIDE_M
        past = (along_m >= 0.0) & (along_m <= PAST_END_M) & (np.abs(aside_m) <= half_m)
        # In polar coordinates round the middle of the arc.
        straight = np.abs(bend) < 1e-9
        radius_m = 1.0 / np.where(straight, 1.0, bend)
        side = np.sign(radius_m)
        turned = np.arctan2(side * along_m, side * (radius_m - aside_m))
        on_m = np.where(straight, along_m, turned * radius_m)
        off_m = np.where(straight, aside_m, radius_m - side * np.hypot(along_m, radius_m - aside_m))
        on = (on_m <= 0.0) & (on_m >= -STROKE_M) & (np.abs(off_m) <= half_m)
        works: Flags = past | on
        return works


def _polyline(way: _Ways) -> Polyline:
    """The swath of one way."""
    steps = 1 if abs(way.bend_1_m[0]) < 1e-9 else round(STROKE_M / CHECK_M / 2)
    places = [way.at(-STROKE_M + STROKE_M * k / steps)[:2] for k in range(steps + 1)]
    return tuple((float(x_m[0]), float(y_m[0])) for x_m, y_m in places)


def _points_in(shape: BaseGeometry) -> Reals:
    """(n, 2): points of a grid in a shape, metres."""
    west, south, east, north = shape.bounds
    step_m = max(GRID_M, sqrt(shape.area / POINTS_MAX))
    x_m, y_m = np.meshgrid(np.arange(west, east, step_m), np.arange(south, north, step_m))
    inside = shapely.contains_xy(shape, x_m.ravel(), y_m.ravel())
    found: Reals = np.column_stack((x_m.ravel(), y_m.ravel()))[inside]
    return found


def _apart(points: Reals, most: int) -> Reals:
    """At most so many of the points, each as far from those before it as possible."""
    chosen, apart_m = [0], np.full(len(points), np.inf)
    while len(chosen) < min(most, len(points)):
        apart_m = np.minimum(apart_m, np.hypot(*(points - points[chosen[-1]]).T))
        chosen.append(int(np.argmax(apart_m)))
    some: Reals = points[chosen]
    return some


def _swept(swath: Polyline, near: BaseGeometry, reach_m: float) -> BaseGeometry:
    """What the bar passes over on a swath and past its ends, at least near a place."""
    way = smooth_way(_longer(swath, PAST_END_M), BEND_HALF_M)
    close = shapely.dwithin(shapely.points(way[:, :2]), near, 2 * reach_m)
    bars = np.column_stack((-np.sin(way[:, 2]), np.cos(way[:, 2]))) * (reach_m - BESIDE_M)
    left, right = way[:, :2] + bars, way[:, :2] - bars
    both = close[:-1] & close[1:]
    corners = np.stack((left[:-1], left[1:], right[1:], right[:-1]), axis=1)[both]
    # Where it bends tightly, the bar moves backwards at its inner end; a hull is what it passes over.
    return shapely.union_all(shapely.convex_hull(shapely.multipoints(corners)))


def _longer(swath: Polyline, past_m: float) -> list[Point]:
    """A swath that goes on at both ends."""
    return [_past(swath[1], swath[0], past_m), *swath, _past(swath[-2], swath[-1], past_m)]


def _past(a: Point, b: Point, past_m: float) -> Point:
    share = past_m / hypot(b[0] - a[0], b[1] - a[1])
    return b[0] + (b[0] - a[0]) * share, b[1] + (b[1] - a[1]) * share
