"""Range sensors: rays from a robot's centre to the nearest fence, blocked cell, obstacle or robot.

One compiled kernel a scan. Segments are met bucket by bucket along each ray, nearest first; blocked
cells by the walk of Amanatides and Woo (1987); discs and boxes by those in range. The robot's own
body is not seen. A ray that starts inside something measures 0.
"""

from math import cos, floor, inf, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.vehicle import HEADING, RADIUS, X, Y
from sim.walls import AT_X, AT_Y, BOX, DISC, FIRST, HALF_X, HEAD, SHAPE

Floats = NDArray[np.float64]
NEAR_MAX = 128  # discs within range of one robot; more of them cannot stand side by side there


class Lidar(NamedTuple):
    """A ring of equal rays, counter-clockwise from the heading."""

    rays: int = 36
    range_m: float = 10.0

    def table(self) -> Floats:
        """(1 + rays, 2): the reach, then unit vectors in the body frame."""
        angle = np.arange(self.rays) * (2 * pi / self.rays)
        return np.vstack(([self.range_m, 0.0], np.column_stack((np.cos(angle), np.sin(angle)))))


@njit(cache=True)
def _segment(floats, k, ox, oy, dx, dy, best):  # type: ignore[no-untyped-def]
    x, y, ex, ey = floats[k]
    denominator = dx * ey - dy * ex
    if denominator == 0.0:
        return best
    px, py = x - ox, y - oy
    t = (px * ey - py * ex) / denominator
    if t < 0.0 or t >= best:
        return best
    s = (px * dy - py * dx) / denominator
    return t if -1e-9 <= s <= 1.000000001 else best  # no ray slips between two sides of a corner


@njit(cache=True)
def _walls(floats, ints, ox, oy, dx, dy, best):  # type: ignore[no-untyped-def]
    """Nearest segment along the ray, up to `best`."""
    count, columns, rows = ints[0], ints[1], ints[2]
    west, south, side, _ = floats[0]
    if count == 0:
        return best
    c, r = floor((ox - west) / side), floor((oy - south) / side)
    if c < 0 or r < 0 or c >= columns or r >= rows:
        for k in range(FIRST, floats.shape[0]):  # out here there is no bucket to start from
            best = _segment(floats, k, ox, oy, dx, dy, best)
        return best
    step_c, step_r = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    next_c = (west + (c + (dx > 0.0)) * side - ox) / dx if dx != 0.0 else inf
    next_r = (south + (r + (dy > 0.0)) * side - oy) / dy if dy != 0.0 else inf
    wide = abs(side / dx) if dx != 0.0 else inf
    high = abs(side / dy) if dy != 0.0 else inf
    items = HEAD + columns * rows + 1
    while True:
        bucket = HEAD + r * columns + c
        for n in range(items + ints[bucket], items + ints[bucket + 1]):
            best = _segment(floats, ints[n], ox, oy, dx, dy, best)
        if min(next_c, next_r) >= best:
            return best
        if next_c < next_r:
            c += step_c
            next_c += wide
        else:
            r += step_r
            next_r += high
        if c < 0 or r < 0 or c >= columns or r >= rows:
            return best


@njit(cache=True)
def _cells(floats, blocked, ox, oy, dx, dy, best):  # type: ignore[no-untyped-def]
    """Nearest blocked cell along the ray, up to `best`."""
    west, south, side, _ = floats[1]
    rows, columns = blocked.shape
    c, r = floor((ox - west) / side), floor((oy - south) / side)
    step_c, step_r = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    next_c = (west + (c + (dx > 0.0)) * side - ox) / dx if dx != 0.0 else inf
    next_r = (south + (r + (dy > 0.0)) * side - oy) / dy if dy != 0.0 else inf
    wide = abs(side / dx) if dx != 0.0 else inf
    high = abs(side / dy) if dy != 0.0 else inf
    t = 0.0
    while t < best:
        if 0 <= c < columns and 0 <= r < rows and blocked[r, c]:
            return t
        if next_c < next_r:
            t = next_c
            c += step_c
            next_c += wide
        else:
            t = next_r
            r += step_r
            next_r += high
    return best


@njit(cache=True)
def _box(box, ox, oy, dx, dy, best):  # type: ignore[no-untyped-def]
    """Slabs in the frame of the box."""
    _, x, y, half_x, half_y, c, s = box
    px, py = c * (ox - x) + s * (oy - y), c * (oy - y) - s * (ox - x)
    vx, vy = c * dx + s * dy, c * dy - s * dx
    near, far = 0.0, best
    for p, v, half in ((px, vx, half_x), (py, vy, half_y)):
        if abs(v) < 1e-15:
            if abs(p) > half:
                return best
            continue
        a, b = (-half - p) / v, (half - p) / v
        near, far = max(near, min(a, b)), min(far, max(a, b))
    return near if near <= far else best


@njit(cache=True)
def _near(motion, me, obstacles, reach, near):  # type: ignore[no-untyped-def]
    """Robots and discs within reach, relative: x, y, distance squared less radius squared."""
    found = 0
    ox, oy = motion[me, X], motion[me, Y]
    for j in range(motion.shape[0]):
        px, py, radius = motion[j, X] - ox, motion[j, Y] - oy, motion[j, RADIUS]
        far = reach + radius
        if j != me and found < NEAR_MAX and px * px + py * py < far * far:
            near[found] = px, py, px * px + py * py - radius * radius
            found += 1
    for k in range(obstacles.shape[0]):
        if obstacles[k, SHAPE] == DISC and found < NEAR_MAX:
            px, py, radius = obstacles[k, AT_X] - ox, obstacles[k, AT_Y] - oy, obstacles[k, HALF_X]
            near[found] = px, py, px * px + py * py - radius * radius
            found += 1
    return found


@njit(cache=True)
def scan(motion, me, floats, ints, blocked, obstacles, rays, out):  # type: ignore[no-untyped-def]
    """Ranges of robot `me` into `out`, metres; inf beyond reach. `rays` from `Lidar.table`."""
    ox, oy, reach = motion[me, X], motion[me, Y], rays[0, 0]
    near = np.empty((NEAR_MAX, 3))
    found = _near(motion, me, obstacles, reach, near)
    c, s = cos(motion[me, HEADING]), sin(motion[me, HEADING])
    for n in range(out.shape[0]):
        ux, uy = rays[n + 1]
        dx, dy = c * ux - s * uy, s * ux + c * uy
        best = reach
        for k in range(found):
            ahead = dx * near[k, 0] + dy * near[k, 1]
            if near[k, 2] <= 0.0:
                best = 0.0
            elif ahead > 0.0:
                square = ahead * ahead - near[k, 2]
                if square >= 0.0:
                    best = min(best, ahead - sqrt(square))
        for k in range(obstacles.shape[0]):
            if obstacles[k, SHAPE] == BOX:
                best = _box(obstacles[k], ox, oy, dx, dy, best)
        if floats[1, 3] != 0.0:
            best = _cells(floats, blocked, ox, oy, dx, dy, best)
        best = _walls(floats, ints, ox, oy, dx, dy, best)
        out[n] = best if best < reach else inf


@njit(cache=True)
def scan_all(motion, floats, ints, blocked, obstacles, rays, out):  # type: ignore[no-untyped-def]
    """Every robot's ranges, one row each."""
    for me in range(motion.shape[0]):
        scan(motion, me, floats, ints, blocked, obstacles, rays, out[me])
