"""Where a ring along the fences bends more than a body that steers can follow, it is cut.

Each piece is straight or bends gently. At a cut it goes on straight by up to half a width, as far as the
middle of the body may go: what an implement sweeps at a corner by swinging, this one has to sweep
by going past it in both directions.
"""

from math import atan2, cos, hypot, pi, sin

from shapely.geometry import LineString, Point
from shapely.geometry.base import BaseGeometry

from agent.field import XY, Polyline

BEND_RAD = 0.3  # a smaller corner is rounded, within half the usual tolerance
WINDOW_M = 1.2  # the length over which it is rounded
SPARE, SPARE_RAD = 1.1, 0.05  # an arc may be drawn as chords
STEP_M = 0.05  # how finely the end of a piece is looked for


def cut_at_corners(
    ring: Polyline, turn_radius_m: float, reach_m: float, free: BaseGeometry
) -> list[Polyline]:
    """Pieces of a ring, in its order."""
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
            pieces.append([ring[k]])
            turned_rad = run_m = 0.0
    result = []
    for k, piece in enumerate(pieces):
        if k > 0:
            piece.insert(0, _beyond(piece[1], piece[0], reach_m, free))
        if k + 1 < len(pieces):
            piece.append(_beyond(piece[-2], piece[-1], reach_m, free))
        line = LineString(piece).simplify(0.001)
        result.append(tuple((float(x), float(y)) for x, y in line.coords))
    return result


def _turn(a: XY, b: XY, c: XY) -> float:
    turn_rad = atan2(c[1] - b[1], c[0] - b[0]) - atan2(b[1] - a[1], b[0] - a[0])
    return (turn_rad + pi) % (2 * pi) - pi


def _beyond(a: XY, b: XY, reach_m: float, free: BaseGeometry) -> XY:
    """The furthest free point straight on from b, coming from a."""
    course = atan2(b[1] - a[1], b[0] - a[0])
    end = b
    for k in range(1, int(reach_m / STEP_M) + 1):
        at = (b[0] + k * STEP_M * cos(course), b[1] + k * STEP_M * sin(course))
        if not free.contains(Point(at)):
            break
        end = at
    return end
