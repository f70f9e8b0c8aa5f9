"""Dubins words: the shortest ways between two poses for a body with a smallest turning circle.

Six words of three pieces each: an arc, then a straight or a second arc, then an arc (Dubins 1957;
formulas after Shkel and Lumelsky 2001). A piece is a curvature (1/m, positive to the left) and a
signed length (m, negative backing up). To drive backwards, take the word of both poses turned
round.

Units: metres and radians; x east, y north, headings counter-clockwise from x.
"""

from math import acos, atan2, cos, hypot, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit

Floats = NDArray[np.float64]

WORDS = 6
STRAIGHT_1_M = 1e-9  # a piece with less curvature counts as straight
# A straight piece between two arcs of less than this square, in square radii, is rounding noise: 0.03 mm
# at 3 m. So is its direction. The square of none may come out this little below zero.
NONE_BETWEEN = 1e-10
NO_TURN_RAD = 1e-9  # an arc that is this little less than a full circle is none, by rounding


@njit(cache=True, error_model="numpy")
def step(
    x: float, y: float, heading: float, curvature: float, length: float
) -> tuple[float, float, float]:
    """The pose (x, y, heading) after one piece from such a pose."""
    if abs(curvature) < STRAIGHT_1_M:
        return x + length * cos(heading), y + length * sin(heading), heading
    turned = heading + curvature * length
    return (
        x + (sin(turned) - sin(heading)) / curvature,
        y - (cos(turned) - cos(heading)) / curvature,
        turned,
    )


@njit(cache=True, error_model="numpy")
def words(
    x: float,
    y: float,
    heading: float,
    gx: float,
    gy: float,
    goal_heading: float,
    radius: float,
    lengths: Floats,
    curvatures: Floats,
) -> None:
    """Fill `lengths` and `curvatures`, (6, 3), a word a row; a word that does not exist has
    infinite lengths.

    The words lead forwards from (x, y, heading) to (gx, gy, goal_heading), with arcs of this
    radius.
    """
    full = 2 * pi
    d = hypot(gx - x, gy - y) / radius
    line = atan2(gy - y, gx - x)
    a, b = (heading - line) % full, (goal_heading - line) % full
    sa, sb, ca, cb, cab = sin(a), sin(b), cos(a), cos(b), cos(a - b)
    lengths[:] = np.inf
    square = 2 + d * d - 2 * cab + 2 * d * (sa - sb)
    if abs(square) < NONE_BETWEEN:
        lengths[0] = (b - a) % full, 0.0, 0.0
    elif square > 0.0:
        turn = atan2(cb - ca, d + sa - sb)
        lengths[0] = (turn - a) % full, sqrt(square), (b - turn) % full
    square = 2 + d * d - 2 * cab + 2 * d * (sb - sa)
    if abs(square) < NONE_BETWEEN:
        lengths[1] = (a - b) % full, 0.0, 0.0
    elif square > 0.0:
        turn = atan2(ca - cb, d - sa + sb)
        lengths[1] = (a - turn) % full, sqrt(square), (turn - b) % full
    square = d * d - 2 + 2 * cab + 2 * d * (sa + sb)
    if square > -NONE_BETWEEN:
        p = sqrt(max(square, 0.0))
        turn = atan2(-ca - cb, d + sa + sb) - atan2(-2.0, p)
        lengths[2] = (turn - a) % full, p, (turn - b) % full
    square = d * d - 2 + 2 * cab - 2 * d * (sa + sb)
    if square > -NONE_BETWEEN:
        p = sqrt(max(square, 0.0))
        turn = atan2(ca + cb, d - sa - sb) - atan2(2.0, p)
        lengths[3] = (a - turn) % full, p, (b - turn) % full
    middle = (6 - d * d + 2 * cab + 2 * d * (sa - sb)) / 8
    if abs(middle) <= 1.0:
        p = (full - acos(middle)) % full
        t = (a - atan2(ca - cb, d - sa + sb) + p / 2) % full
        lengths[4] = t, p, (a - b - t + p) % full
    middle = (6 - d * d + 2 * cab + 2 * d * (sb - sa)) / 8
    if abs(middle) <= 1.0:
        p = (full - acos(middle)) % full
        t = (-a + atan2(-ca + cb, d + sa - sb) + p / 2) % full
        lengths[5] = t, p, (b - a - t + p) % full
    for word in range(WORDS):
        for piece in (0, 2):
            if full - NO_TURN_RAD < lengths[word, piece] <= full:
                lengths[word, piece] = 0.0
    lengths *= radius
    k = 1.0 / radius
    curvatures[0], curvatures[1] = (k, 0.0, k), (-k, 0.0, -k)
    curvatures[2], curvatures[3] = (k, 0.0, -k), (-k, 0.0, k)
    curvatures[4], curvatures[5] = (-k, k, -k), (k, -k, k)


def shortest_m(
    start: tuple[float, float, float], goal: tuple[float, float, float], radius_m: float
) -> float:
    """Length of the shortest word between two poses (x, y, heading) in metres and radians,
    forwards."""
    lengths, curvatures = np.empty((WORDS, 3)), np.empty((WORDS, 3))
    words(*start, *goal, radius_m, lengths, curvatures)
    return float(lengths.sum(axis=1).min())


@njit(cache=True, error_model="numpy")
def soonest_for_s(
    starts: Floats, goals: Floats, radius: float, speed: float, bend_speed: float, bend_for_s: float
) -> Floats:
    """Seconds of the soonest word from each start to each goal, forwards, (starts, goals).

    `starts`, `goals`: (n, 3), poses x, y, heading. `speed`, `bend_speed`: metres a second on straight
    pieces and on arcs. `bend_for_s`: seconds that each arc takes more, because wheels have to be turned.
    """
    lengths, curvatures = np.empty((WORDS, 3)), np.empty((WORDS, 3))
    found = np.empty((starts.shape[0], goals.shape[0]))
    for i in range(starts.shape[0]):
        for j in range(goals.shape[0]):
            words(
                starts[i, 0], starts[i, 1], starts[i, 2], goals[j, 0], goals[j, 1], goals[j, 2],
                radius, lengths, curvatures,
            )  # fmt: skip
            least = np.inf
            for word in range(WORDS):
                for_s = 0.0
                for piece in range(3):
                    length = lengths[word, piece]
                    if abs(curvatures[word, piece]) < STRAIGHT_1_M:
                        for_s += length / speed
                    elif length > 1e-6:
                        for_s += length / bend_speed + bend_for_s
                least = min(least, for_s)
            found[i, j] = least
    return found
