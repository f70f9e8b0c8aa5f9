"""Cuts a ring along the fences where it bends more than a body that steers can follow.

Each piece is straight or bends gently. At a cut it goes on straight by up to half a width, as far
as the middle of the body may go. An implement that swings sweeps a corner by turning; this one has
to go past the corner in both directions. At a sharp corner with a fence ahead, the piece ends in a
bend away from that fence. The outer end of the bar then runs ahead of the body, into the corner. Of
several bends those two are taken with which both pieces together leave the least. A piece ends before
its bar would reach over a fence.

A body that turns on the spot drives a corner in one go instead, where it has room for that. Ways are
rounded before they are driven, so the line swings out first: the rounded one then passes the corner
itself, and the bar swings over all that it can reach from there. Cut pieces leave a part of the corner
where the body is nearly as wide as the implement, because it cannot go past the corner.
"""

from itertools import pairwise, product
from math import atan2, ceil, copysign, cos, hypot, inf, pi, sin

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from agent.interface.geometry import Point, Polyline
from agent.motion.implement_clearance import LEAD_M
from agent.motion.path_tracker import turn_at
from agent.motion.tractor_tracker import BEND_HALF_M, smooth_way

BEND_RAD = 0.3  # a smaller corner is rounded, within half the usual tolerance
WINDOW_M = 1.2  # the length over which it is rounded
SPARE, SPARE_RAD = 1.1, 0.05  # tolerances for an arc that is drawn as chords
STEP_M = 0.05  # step of the search for the end of a piece
SHARP_RAD = 1.2  # a corner that turns by less is swept to its end by going past it
ACUTE_RAD = 1.9  # in a corner that turns by more the line does not swing out
# At the end of a piece; of those that are as good, the first, and the same at both ends. With 0.42 rad
# the outer end of the bar is ahead by 40 % of its half. A right angle needs that, and a sharper corner
# more. Between two near fences a bend ends far before the corner, and going straight on leaves less.
TURN_INS_RAD = (0.42, 0.5, 0.58, 0.66, 0.74, 0.82, 0.34, 0.0, 0.12, 0.22)
AS_GOOD_M2 = 0.003  # a twentieth of a cell of the coverage check
BESIDE_M = 0.03  # errors of tracking: the bar counts as shorter by this on both sides
PAST_END_M = 0.2  # so far the bar goes on beyond the end of a piece, at least
SWEEP_STEP_M = 0.2  # between places of the bar
RUN_M = 0.8  # the bend, and straight on after it where it is tight: the body's course settles there
# So far the lowered bar may reach over a fence at the end of a piece and on the lead-out behind it. The
# check of reachable ground lets a bar cross by as much between its places. Half of the usual overlap is
# twice this, and the rest of it is for errors of tracking.
OVER_M = 0.05
TRIED_AT_ONCE = 8  # places for an end, from the furthest on
TAIL_LEAST_M = 0.05  # a shorter end is left out of a line, and the course would be another one
CHORDS = 5  # number of chords of the bend at the end
# So far past a corner a rounded way goes: half the usual overlap, for errors of tracking.
PAST_M = 0.1
# Of it, from the most on, until the bar stays where it may be. Before the corner a wide one reaches
# further over the fence.
PAST_SHARES = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0, -0.2, -0.4)
OUT_SHARE = 0.8  # of the reach: a longer way out leaves ground beside the line
SIDE_SHARE = 0.4  # of the shorter side of a corner, for the way out


def cut_at_corners(
    ring: Polyline, turn_radius_m: float, reach_m: float, free: BaseGeometry,
    room: BaseGeometry | None = None, asked: BaseGeometry | None = None,
    inside: BaseGeometry | None = None, beside: BaseGeometry | None = None,
) -> list[Polyline]:  # fmt: skip
    """The pieces of a ring in its order, as polylines of (x, y) metres.

    `turn_radius_m`: the smallest of the body. `reach_m`: half the implement width. `free`: where
    the middle of the body may be at the end of a piece. `room`: where it may be in a corner, if the body
    can turn on the spot. `asked`: the ground that is to be worked; None: bends are not compared.
    `inside`: where the whole bar may be at the end of a piece; None: anywhere. `beside`: the same in
    a corner that is driven in one go.
    """
    pieces: list[list[Point]] = [[ring[0]]]
    most_rad = SPARE * WINDOW_M / turn_radius_m + SPARE_RAD
    turned_rad = run_m = 0.0  # what the piece has turned by within the window
    for k in range(1, len(ring)):
        pieces[-1].append(ring[k])
        if k + 1 == len(ring):
            break
        turn_rad = turn_at(ring[k - 1], ring[k], ring[k + 1])
        run_m += hypot(ring[k][0] - ring[k - 1][0], ring[k][1] - ring[k - 1][1])
        if run_m > WINDOW_M:
            turned_rad, run_m = 0.0, 0.0
        turned_rad += turn_rad
        if abs(turn_rad) > BEND_RAD or abs(turned_rad) > most_rad:
            out = _swung_out(ring[k - 1], ring[k], ring[k + 1], reach_m, room, beside)
            if out:
                pieces[-1][-1:] = out
                turned_rad = run_m = 0.0
                continue
            pieces.append([ring[k]])
            turned_rad = run_m = 0.0
    bend_m = max(turn_radius_m * SPARE, reach_m / 2)
    for before, after in pairwise(pieces):
        turn_rad = turn_at(before[-2], before[-1], after[1])
        ends = _ends(before, after[::-1], turn_rad, reach_m, bend_m, free, asked, inside)
        before[:], after[:] = ends[0], ends[1][::-1]
    result = []
    for piece in pieces:
        line = LineString(piece).simplify(0.001)
        result.append(tuple((float(x), float(y)) for x, y in line.coords))
    return result


def _ends(
    into: list[Point], out: list[Point], turn_rad: float, reach_m: float, bend_m: float,
    free: BaseGeometry, asked: BaseGeometry | None, inside: BaseGeometry | None,
) -> tuple[list[Point], list[Point]]:  # fmt: skip
    """Two pieces that end in the same corner, with their continuations past it.

    `out`: from its far end, as if it were driven towards the corner.
    """
    corner = into[-1]
    ground = shapely.Point(corner).buffer(2 * reach_m)
    ground = ground.intersection(asked) if asked is not None else shapely.Point()
    ends = [
        (_on(into, turn_rad, by_rad, reach_m, bend_m, free, inside),
         _on(out, -turn_rad, by_rad, reach_m, bend_m, free, inside))
        for by_rad in TURN_INS_RAD
    ]  # fmt: skip
    best, least_m2 = ends[0], inf
    if ground.is_empty or all(each == ends[0] for each in ends):
        return best
    swept = [tuple(_swept(piece, corner, reach_m) for piece in both) for both in ends]
    left = [ground.difference(first) for first, _ in swept]
    for k, j in sorted(product(range(len(ends)), repeat=2), key=lambda kj: kj[0] != kj[1]):
        left_m2 = left[k].difference(swept[j][1]).area
        if left_m2 < least_m2 - AS_GOOD_M2:
            best, least_m2 = (ends[k][0], ends[j][1]), left_m2
    return best


def _swept(piece: list[Point], corner: Point, reach_m: float) -> BaseGeometry:
    """What the bar passes over on the end of a piece, near a corner."""
    (ax, ay), (bx, by) = piece[-2:]
    past = PAST_END_M / hypot(bx - ax, by - ay)
    line = LineString([*piece[:-1], (bx + (bx - ax) * past, by + (by - ay) * past)])
    from_m = max(0.0, line.project(shapely.Point(corner)) - 3 * reach_m)
    count = ceil((line.length - from_m) / SWEEP_STEP_M) + 1
    at = shapely.line_interpolate_point(line, np.linspace(from_m, line.length, count))
    places = shapely.get_coordinates(at)
    courses = np.diff(places, axis=0)
    courses /= np.hypot(*courses.T)[:, np.newaxis]
    bars = np.stack((-courses[:, 1], courses[:, 0]), axis=1) * (reach_m - BESIDE_M)
    left, right = places[:-1] + bars, places[:-1] - bars
    # From each place to the next, with the bar as it is there: it swings where the course bends.
    ahead_left, ahead_right = places[1:] + bars, places[1:] - bars
    strips = shapely.polygons(np.stack((left, ahead_left, ahead_right, right), axis=1))
    swings = [
        shapely.convex_hull(shapely.multipoints(np.stack(ends)))
        for ends in (*zip(ahead_left, left[1:], places[1:], strict=False),
                     *zip(ahead_right, right[1:], places[1:], strict=False))
    ]  # fmt: skip
    return shapely.union_all([*strips, *swings])


def _swung_out(
    a: Point,
    b: Point,
    c: Point,
    reach_m: float,
    room: BaseGeometry | None,
    beside: BaseGeometry | None,
) -> list[Point]:
    """Three points instead of the corner b of a, b, c, for a body that turns on the spot; none if it has
    no room for them.
    """
    turn_rad = turn_at(a, b, c)
    into, onward = atan2(b[1] - a[1], b[0] - a[0]), atan2(c[1] - b[1], c[0] - b[0])
    side_m = min(hypot(b[0] - a[0], b[1] - a[1]), hypot(c[0] - b[0], c[1] - b[1]))
    way_m = min(max(BEND_HALF_M, OUT_SHARE * reach_m), SIDE_SHARE * side_m)
    if room is None or way_m < BEND_HALF_M or abs(turn_rad) > ACUTE_RAD:
        return []
    before = b[0] - way_m * cos(into), b[1] - way_m * sin(into)
    after = b[0] + way_m * cos(onward), b[1] + way_m * sin(onward)
    aside = into + turn_rad / 2 - copysign(pi / 2, turn_rad)  # away from the inside of the corner
    for share in PAST_SHARES:
        # Rounding takes the first summand off.
        out_m = BEND_HALF_M / 2 * sin(abs(turn_rad) / 2) + PAST_M * share
        out = b[0] + out_m * cos(aside), b[1] + out_m * sin(aside)
        way = smooth_way([a, before, out, after, c], BEND_HALF_M)
        if not room.contains(LineString(way[:, :2])):
            return []
        if beside is None or bar_stays(way, reach_m, beside):
            return [before, out, after]
    return []


def _on(
    piece: list[Point], turn_rad: float, turn_in_rad: float, reach_m: float, bend_m: float,
    free: BaseGeometry, inside: BaseGeometry | None,
) -> list[Point]:  # fmt: skip
    """The piece, whose end is where the ring turns by `turn_rad`, with its continuation past the
    corner: straight, or with a bend of `turn_in_rad`.
    """
    a, b = piece[-2:]
    end, is_fence_ahead = _beyond(a, b, reach_m, free)
    course = atan2(b[1] - a[1], b[0] - a[0])
    side_m, most_m = hypot(b[0] - a[0], b[1] - a[1]), hypot(end[0] - a[0], end[1] - a[1])
    straight_m = _fitting(a, course, most_m, [(0.0, 0.0)], reach_m, None, inside)
    is_fence_ahead = is_fence_ahead or straight_m < most_m
    if is_fence_ahead and abs(turn_rad) >= SHARP_RAD:
        # In an acute corner the bend nears the fence ahead.
        bend = _bend(bend_m, copysign(turn_in_rad, turn_rad))
        begun_m = _fitting(a, course, most_m - bend[-1][0], bend, reach_m, free, inside)
        if begun_m > 0.0:
            return [*piece[:-1], *_placed(a, course, begun_m, bend)]
    if straight_m <= 0.0 or abs(straight_m - side_m) < STEP_M / 2:
        return [*piece]
    kept = piece if straight_m > side_m else piece[:-1]
    return [*kept, *_placed(a, course, straight_m, [(0.0, 0.0)])]


def _fitting(
    a: Point, course: float, most_m: float, shape: list[Point], reach_m: float,
    free: BaseGeometry | None, inside: BaseGeometry | None,
) -> float:  # fmt: skip
    """How far from a, and at most how far, the end of a piece may begin; 0 if it may nowhere.

    `shape`: the end, metres ahead and to the left of where it begins. Its last point is on `free`
    ground. All along it and on the lead behind it the bar is `inside`.
    """
    bars = _bars(shape, reach_m)
    offsets_m = np.arange(0.0, min(most_m, 2 * reach_m + RUN_M), STEP_M)
    for first in range(0, len(offsets_m), TRIED_AT_ONCE):
        begun_m = most_m - offsets_m[first : first + TRIED_AT_ONCE]
        fits = np.ones(len(begun_m), dtype=np.bool_)
        if free is not None:
            last = _at(a, course, begun_m, np.array(shape[-1:]))
            fits &= shapely.contains_xy(free, last[:, 0, 0], last[:, 0, 1])
        if inside is not None:
            placed = _at(a, course, begun_m, bars)
            ends = shapely.contains_xy(inside, placed[:, :, 0], placed[:, :, 1])
            fits &= np.all(ends, axis=1)
        for k in np.flatnonzero(fits):
            if inside is None:
                return float(begun_m[k])
            lines = shapely.linestrings(placed[k].reshape(-1, 2, 2))
            if bool(np.all(shapely.covers(inside, lines))):
                return float(begun_m[k])
    return 0.0


def _bars(shape: list[Point], reach_m: float) -> NDArray[np.float64]:
    """(2 * places, 2): both ends of the lowered bar at places of an end of a piece, and on the straight
    way to it.
    """
    (ax, ay), (bx, by) = shape[-2:] if len(shape) > 1 else ((-1.0, 0.0), shape[0])
    past = LEAD_M / hypot(bx - ax, by - ay)
    longer = [(-reach_m - 2 * BEND_HALF_M, 0.0), *shape,
              (bx + (bx - ax) * past, by + (by - ay) * past)]  # fmt: skip
    way = smooth_way(longer, BEND_HALF_M)
    return _ends_of_bars(way[way[:, 0] >= -reach_m], reach_m).reshape(-1, 2)


def _ends_of_bars(way: NDArray[np.float64], reach_m: float) -> NDArray[np.float64]:
    """(places, 2, 2): both ends of the bar at each row of a way, see `smooth_way`."""
    bars = np.stack((-np.sin(way[:, 2]), np.cos(way[:, 2])), axis=1) * reach_m
    return np.stack((way[:, :2] + bars, way[:, :2] - bars), axis=1)


def bar_stays(way: NDArray[np.float64], reach_m: float, inside: BaseGeometry) -> bool:
    """Whether the whole bar is inside at each row of a way, see `smooth_way`."""
    bars = shapely.linestrings(_ends_of_bars(way, reach_m))
    return bool(np.all(shapely.covers(inside, bars)))


def _at(
    a: Point, course: float, begun_m: NDArray[np.float64], shape: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(begins, points, 2): the points of a shape for each place at which it begins, metres."""
    ahead_m = begun_m[:, np.newaxis] + shape[:, 0]
    left_m = shape[:, 1]
    return np.stack(
        (a[0] + ahead_m * cos(course) - left_m * sin(course),
         a[1] + ahead_m * sin(course) + left_m * cos(course)),
        axis=2,
    )  # fmt: skip


def _placed(a: Point, course: float, begun_m: float, shape: list[Point]) -> list[Point]:
    points = _at(a, course, np.array([begun_m]), np.array(shape))[0]
    return [(float(x), float(y)) for x, y in points]


def _bend(bend_m: float, turn_in_rad: float) -> list[Point]:
    """Points of a bend, metres ahead and to the left of where it begins.

    `turn_in_rad`: positive to the left.
    """
    most_rad, side = abs(turn_in_rad), copysign(1.0, turn_in_rad)
    ways = [
        (bend_m * sin(turned), side * bend_m * (1.0 - cos(turned)))
        for turned in (most_rad * k / CHORDS for k in range(CHORDS + 1))
    ]
    on_m, aside_m = ways[-1]
    tail_m = _tail_m(bend_m, most_rad)
    if tail_m > 0.0:
        ways.append((on_m + tail_m * cos(most_rad), aside_m + side * tail_m * sin(most_rad)))
    return ways


def _tail_m(bend_m: float, turn_in_rad: float) -> float:
    tail_m = RUN_M - bend_m * turn_in_rad
    return tail_m if tail_m > TAIL_LEAST_M else 0.0


def _beyond(a: Point, b: Point, reach_m: float, free: BaseGeometry) -> tuple[Point, bool]:
    """The furthest free point straight on from b, coming from a; and whether a fence ended it."""
    course = atan2(b[1] - a[1], b[0] - a[0])
    end = b
    for k in range(1, int(reach_m / STEP_M) + 1):
        at = (b[0] + k * STEP_M * cos(course), b[1] + k * STEP_M * sin(course))
        if not free.contains(shapely.Point(at)):
            return end, True
        end = at
    return end, False
