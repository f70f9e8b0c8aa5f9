"""Cuts a ring along the fences where it bends more than a body that steers can follow.

Each piece is straight or bends gently. At a cut it goes on straight by up to half a width, as far
as the middle of the body may go. An implement that swings sweeps a corner by turning; this one has
to go past the corner in both directions. At a corner about as sharp as a right angle with a fence
ahead, the piece ends in a bend away from that fence. The outer end of the bar then runs ahead of
the body, into the corner.

A body that turns on the spot drives a corner in one go instead, where it has room for that. Ways are
rounded before they are driven, so the line swings out first: the rounded one then passes the corner
itself, and the bar swings over all that it can reach from there. Cut pieces leave a part of the corner
where the body is nearly as wide as the implement, because it cannot go past the corner.
"""

from math import atan2, copysign, cos, hypot, pi, sin

from shapely.geometry import LineString, Point
from shapely.geometry.base import BaseGeometry

from agent.field.field_map import XY, Polyline
from agent.motion.tractor_tracker import BEND_HALF_M, smooth_way

BEND_RAD = 0.3  # a smaller corner is rounded, within half the usual tolerance
WINDOW_M = 1.2  # the length over which it is rounded
SPARE, SPARE_RAD = 1.1, 0.05  # tolerances for an arc that is drawn as chords
STEP_M = 0.05  # step of the search for the end of a piece
SHARP_RAD = 1.2  # a corner that turns by less is swept to its end by going past it
ACUTE_RAD = 1.9  # in a corner that turns by more there is no room to leave a bend again
TURN_IN_RAD = 0.42  # at the end of a piece: the bar's outer end is then 40 % of its half ahead
RUN_M = 0.8  # the bend, and straight on after it where it is tight: the body's course settles there
CHORDS = 5  # number of chords of the bend at the end
# So far past a corner a rounded way goes: half the usual overlap, for errors of tracking.
PAST_M = 0.1
OUT_SHARE = 0.8  # of the reach: a longer way out leaves ground beside the line
SIDE_SHARE = 0.4  # of the shorter side of a corner, for the way out


def cut_at_corners(
    ring: Polyline, turn_radius_m: float, reach_m: float, free: BaseGeometry,
    room: BaseGeometry | None = None,
) -> list[Polyline]:  # fmt: skip
    """The pieces of a ring in its order, as polylines of (x, y) metres.

    `turn_radius_m`: the smallest of the body. `reach_m`: half the implement width. `free`: where
    the middle of the body may be at the end of a piece. `room`: where it may be in a corner, if the body
    can turn on the spot.
    """
    pieces: list[list[XY]] = [[ring[0]]]
    most_rad = SPARE * WINDOW_M / turn_radius_m + SPARE_RAD
    turned_rad = run_m = 0.0  # what the piece has turned by within the window
    for k in range(1, len(ring)):
        pieces[-1].append(ring[k])
        if k + 1 == len(ring):
            break
        turn_rad = _turn(ring[k - 1], ring[k], ring[k + 1])
        run_m += hypot(ring[k][0] - ring[k - 1][0], ring[k][1] - ring[k - 1][1])
        if run_m > WINDOW_M:
            turned_rad, run_m = 0.0, 0.0
        turned_rad += turn_rad
        if abs(turn_rad) > BEND_RAD or abs(turned_rad) > most_rad:
            out = _swung_out(ring[k - 1], ring[k], ring[k + 1], reach_m, room)
            if out:
                pieces[-1][-1:] = out
                turned_rad = run_m = 0.0
                continue
            pieces.append([ring[k]])
            turned_rad = run_m = 0.0
    bend_m = max(turn_radius_m * SPARE, reach_m / 2)
    result = []
    for k, piece in enumerate(pieces):
        if k > 0:
            turn_rad = -_turn(pieces[k - 1][-2], piece[0], piece[1])
            piece = _on(piece[::-1], turn_rad, reach_m, bend_m, free)[::-1]
        if k + 1 < len(pieces):
            turn_rad = _turn(piece[-2], piece[-1], pieces[k + 1][1])
            piece = _on(piece, turn_rad, reach_m, bend_m, free)
        line = LineString(piece).simplify(0.001)
        result.append(tuple((float(x), float(y)) for x, y in line.coords))
    return result


def _swung_out(a: XY, b: XY, c: XY, reach_m: float, room: BaseGeometry | None) -> list[XY]:
    """Three points instead of the corner b of a, b, c, for a body that turns on the spot; none if it has
    no room for them.
    """
    turn_rad = _turn(a, b, c)
    into, onward = atan2(b[1] - a[1], b[0] - a[0]), atan2(c[1] - b[1], c[0] - b[0])
    side_m = min(hypot(b[0] - a[0], b[1] - a[1]), hypot(c[0] - b[0], c[1] - b[1]))
    way_m = min(max(BEND_HALF_M, OUT_SHARE * reach_m), SIDE_SHARE * side_m)
    if room is None or way_m < BEND_HALF_M or abs(turn_rad) > ACUTE_RAD:
        return []
    before = b[0] - way_m * cos(into), b[1] - way_m * sin(into)
    after = b[0] + way_m * cos(onward), b[1] + way_m * sin(onward)
    aside = into + turn_rad / 2 - copysign(pi / 2, turn_rad)  # away from the inside of the corner
    out_m = (
        BEND_HALF_M / 2 * sin(abs(turn_rad) / 2) + PAST_M
    )  # rounding takes the first summand off
    out = b[0] + out_m * cos(aside), b[1] + out_m * sin(aside)
    way = smooth_way([a, before, out, after, c], BEND_HALF_M)
    return [before, out, after] if room.contains(LineString(way[:, :2])) else []


def _on(
    piece: list[XY], turn_rad: float, reach_m: float, bend_m: float, free: BaseGeometry
) -> list[XY]:
    """The piece, whose end is where the ring turns by `turn_rad`, with its continuation past the
    corner.
    """
    a, b = piece[-2:]
    end, is_fence_ahead = _beyond(a, b, reach_m, free)
    course = atan2(b[1] - a[1], b[0] - a[0])
    # Length of the bend and its straight end along the way to `end`.
    ahead_m = bend_m * sin(TURN_IN_RAD) + _tail_m(bend_m) * cos(TURN_IN_RAD)
    straight_m = hypot(end[0] - a[0], end[1] - a[1]) - ahead_m
    turns_in = is_fence_ahead and SHARP_RAD <= abs(turn_rad) <= ACUTE_RAD
    while turns_in and straight_m > 0.0:  # in an acute corner the bend nears the fence ahead
        bend = _bend(a, course, straight_m, bend_m, copysign(1.0, turn_rad))
        if free.contains(Point(bend[-1])):
            return [*piece[:-1], *bend]
        straight_m -= STEP_M
    return [*piece, end]


def _bend(a: XY, course: float, straight_m: float, bend_m: float, side: float) -> list[XY]:
    """Points of a bend that begins `straight_m` from `a`; `side`: 1 to the left, -1 to the
    right.
    """
    ways = [
        (bend_m * sin(turned), bend_m * (1.0 - cos(turned)))
        for turned in (TURN_IN_RAD * k / CHORDS for k in range(CHORDS + 1))
    ]
    on_m, aside_m = ways[-1]
    tail_m = _tail_m(bend_m)
    if tail_m > 0.0:
        ways.append((on_m + tail_m * cos(TURN_IN_RAD), aside_m + tail_m * sin(TURN_IN_RAD)))
    return [
        (
            a[0] + (straight_m + on_m) * cos(course) - side * aside_m * sin(course),
            a[1] + (straight_m + on_m) * sin(course) + side * aside_m * cos(course),
        )
        for on_m, aside_m in ways
    ]


def _tail_m(bend_m: float) -> float:
    return max(0.0, RUN_M - bend_m * TURN_IN_RAD)


def _turn(a: XY, b: XY, c: XY) -> float:
    turn_rad = atan2(c[1] - b[1], c[0] - b[0]) - atan2(b[1] - a[1], b[0] - a[0])
    return (turn_rad + pi) % (2 * pi) - pi


def _beyond(a: XY, b: XY, reach_m: float, free: BaseGeometry) -> tuple[XY, bool]:
    """The furthest free point straight on from b, coming from a; and whether a fence ended it."""
    course = atan2(b[1] - a[1], b[0] - a[0])
    end = b
    for k in range(1, int(reach_m / STEP_M) + 1):
        at = (b[0] + k * STEP_M * cos(course), b[1] + k * STEP_M * sin(course))
        if not free.contains(Point(at)):
            return end, True
        end = at
    return end, False
