"""Range sensors: rays from a robot's centre to the nearest fence, blocked cell, obstacle or robot.

For speed, the loops are reversed. Instead of testing each ray against all things, each thing in
reach is applied to all rays at once, in loops without branches that the compiler turns into vector
instructions. Only blocked cells are traversed ray by ray (Amanatides and Woo 1987). The robot's own
body is not seen. A ray that starts inside something measures 0. Ranges are accurate to a tenth of a
millimetre.
"""

from math import floor, pi
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.world.drive_trains import HEADING, RADIUS, X, Y
from sim.world.walls import (
    AT_X,
    AT_Y,
    BOX,
    COS,
    DISC,
    FIRST,
    HALF_X,
    HALF_Y,
    HEAD,
    SHAPE,
    SIN,
    STAMP,
)

f32 = np.float32
LANES = 8  # float32 numbers in a vector register
# Rows of beams: direction in the body frame, direction in the field, result.
UNIT_X, UNIT_Y, DX, DY, RANGE = range(5)


class Lidar(NamedTuple):
    """A ring of equal rays, counter-clockwise from the heading."""

    rays: int = 36
    range_m: float = 10.0

    def beams(self) -> NDArray[np.float32]:
        """Working memory of a scan, see `UNIT_X`; columns past the last ray are padding."""
        padded = -(-self.rays // LANES) * LANES
        angle = np.arange(padded) * (2 * pi / self.rays)
        table = np.zeros((5, padded), dtype=np.float32)
        table[UNIT_X], table[UNIT_Y] = np.cos(angle), np.sin(angle)
        return table


@njit(cache=True, error_model="numpy")
def _segment(beams, px, py, ex, ey):  # type: ignore[no-untyped-def]
    """A segment from (px, py), relative to the robot, along (ex, ey): Cramer's rule for every
    ray."""
    dx, dy, best = beams[DX], beams[DY], beams[RANGE]
    cross = f32(px * ey - py * ex)
    px, py, ex, ey = f32(px), f32(py), f32(ex), f32(ey)
    low, high = f32(-1e-6), f32(1.000001)  # no ray slips between two sides of a corner
    for n in range(dx.size):
        both = dx[n] * ey - dy[n] * ex
        t, s = cross / both, (px * dy[n] - py * dx[n]) / both
        met = (t >= f32(0)) & (s >= low) & (s <= high) & (t < best[n])
        best[n] = t if met else best[n]


@njit(cache=True, error_model="numpy")
def _disc(beams, px, py, radius):  # type: ignore[no-untyped-def]
    dx, dy, best = beams[DX], beams[DY], beams[RANGE]
    if px * px + py * py <= radius * radius:
        best[:] = f32(0)
        return
    px, py, square = f32(px), f32(py), f32(radius * radius)
    for n in range(dx.size):
        aside = px * dy[n] - py * dx[n]
        # Not a number: the ray misses.
        t = px * dx[n] + py * dy[n] - np.sqrt(square - aside * aside)
        met = (t >= f32(0)) & (t < best[n])
        best[n] = t if met else best[n]


@njit(cache=True, error_model="numpy")
def _box(beams, row, ox, oy, reach):  # type: ignore[no-untyped-def]
    px, py, c, s = row[AT_X] - ox, row[AT_Y] - oy, row[COS], row[SIN]
    a, b = row[HALF_X], row[HALF_Y]
    if abs(px) + abs(py) > 1.5 * (reach + a + b):
        return
    if abs(c * px + s * py) <= a and abs(c * py - s * px) <= b:
        beams[RANGE, :] = f32(0)
        return
    ux, uy, vx, vy = c * a, s * a, -s * b, c * b  # half the sides, in the field
    _segment(beams, px - ux - vx, py - uy - vy, 2 * ux, 2 * uy)
    _segment(beams, px - ux + vx, py - uy + vy, 2 * ux, 2 * uy)
    _segment(beams, px - ux - vx, py - uy - vy, 2 * vx, 2 * vy)
    _segment(beams, px + ux - vx, py + uy - vy, 2 * vx, 2 * vy)


@njit(cache=True, error_model="numpy")
def _walls(beams, floats, ints, ox, oy, reach):  # type: ignore[no-untyped-def]
    """Test every segment in the buckets within reach once, marked with the number of this scan."""
    count, columns, rows = ints[0], ints[1], ints[2]
    if count == 0:
        return
    west, south, side = floats[0, 0], floats[0, 1], floats[0, 2]
    ints[STAMP] += 1
    items = HEAD + columns * rows + 1
    stamps = ints.size - count - FIRST
    for r in range(max(int((oy - reach - south) / side), 0),
                   min(int((oy + reach - south) / side), rows - 1) + 1):  # fmt: skip
        for c in range(max(int((ox - reach - west) / side), 0),
                       min(int((ox + reach - west) / side), columns - 1) + 1):  # fmt: skip
            bucket = HEAD + r * columns + c
            for n in range(items + ints[bucket], items + ints[bucket + 1]):
                k = ints[n]
                if ints[stamps + k] == ints[STAMP]:
                    continue
                ints[stamps + k] = ints[STAMP]
                px, py, ex, ey = floats[k, 0] - ox, floats[k, 1] - oy, floats[k, 2], floats[k, 3]
                t = min(max(-(px * ex + py * ey) / (ex * ex + ey * ey), 0.0), 1.0)
                if (px + t * ex) ** 2 + (py + t * ey) ** 2 < reach * reach:
                    _segment(beams, px, py, ex, ey)


@njit(cache=True, error_model="numpy")
def _cells(floats, blocked, ox, oy, dx, dy, best):  # type: ignore[no-untyped-def]
    """Nearest blocked cell along one ray, up to `best`."""
    west, south, side = floats[1, 0], floats[1, 1], floats[1, 2]
    rows, columns = blocked.shape
    c, r = floor((ox - west) / side), floor((oy - south) / side)
    step_c, step_r = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    next_c = (west + (c + (dx > 0.0)) * side - ox) / dx if dx != 0.0 else np.inf
    next_r = (south + (r + (dy > 0.0)) * side - oy) / dy if dy != 0.0 else np.inf
    wide, high = abs(side / dx), abs(side / dy)
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


@njit(cache=True, error_model="numpy")
def scan(motion, me, floats, ints, blocked, obstacles, reach, beams):  # type: ignore[no-untyped-def]
    """Ranges of robot `me` into the last row of `beams` (5, rays), metres; inf beyond `reach`.

    `motion` (robots, 7); `floats`, `ints`, `blocked` (rows, columns) and `obstacles` (n, 7) as in
    `walls`.
    """
    ox, oy = motion[me, X], motion[me, Y]
    c, s = np.cos(motion[me, HEADING]), np.sin(motion[me, HEADING])
    for n in range(beams.shape[1]):
        ux, uy = beams[UNIT_X, n], beams[UNIT_Y, n]
        beams[DX, n], beams[DY, n] = c * ux - s * uy, s * ux + c * uy
        beams[RANGE, n] = reach
    _walls(beams, floats, ints, ox, oy, reach)
    for j in range(motion.shape[0]):
        px, py, far = motion[j, X] - ox, motion[j, Y] - oy, reach + motion[j, RADIUS]
        if px * px + py * py < far * far and j != me:
            _disc(beams, px, py, motion[j, RADIUS])
    for k in range(obstacles.shape[0]):
        if obstacles[k, SHAPE] == DISC:
            px, py = obstacles[k, AT_X] - ox, obstacles[k, AT_Y] - oy
            _disc(beams, px, py, obstacles[k, HALF_X])
        elif obstacles[k, SHAPE] == BOX:
            _box(beams, obstacles[k], ox, oy, reach)
    for n in range(beams.shape[1]):
        best = beams[RANGE, n]
        if floats[1, 3] != 0.0:
            best = _cells(floats, blocked, ox, oy, beams[DX, n], beams[DY, n], best)
        beams[RANGE, n] = best if best < reach else np.inf


@njit(cache=True, error_model="numpy")
def scan_all(motion, floats, ints, blocked, obstacles, reach, beams, out):  # type: ignore[no-untyped-def]
    """Every robot's ranges, metres, one row of `out` (robots, rays) each. `motion` (robots, 7) and
    `beams` (5, rays) as for `scan`."""
    for me in range(motion.shape[0]):
        scan(motion, me, floats, ints, blocked, obstacles, reach, beams)
        out[me] = beams[RANGE, : out.shape[1]]
