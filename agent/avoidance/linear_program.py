"""Two-dimensional linear programs over half-planes of velocities, inside a disc; float32 kernels.

A half-plane is a row (px, py, dx, dy) of `lines` (half-planes, 4): a point on its border and the
unit direction of the border; permitted is what lies to the left. `radius` is that of the disc: the
greatest speed. van den Berg, Guy, Lin, Manocha, "Reciprocal n-body collision avoidance" (2011),
sections 5.2 and 5.3. Every operation is done in single precision and in the order of the RVO2
library (Apache-2.0), so that results are equal to those of the library to the last bit.

Units: m/s; a point is a velocity (x, y).
"""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from agent.avoidance.k_nearest import Number, Real
from agent.kernels.kernel import njit

Lines = NDArray[np.float32]  # (half-planes, 4), PX to DY

f32 = np.float32
ZERO, HALF, ONE, PARALLEL = f32(0.0), f32(0.5), f32(1.0), f32(1e-5)
PX, PY, DX, DY = range(4)  # columns of a half-plane


@njit(cache=True, error_model="numpy")
def violation(lines: Lines, k: int, x: Real, y: Real) -> Real:
    """How far (x, y) is on the forbidden side of half-plane k; negative where it is permitted."""
    return lines[k, DX] * (lines[k, PY] - y) - lines[k, DY] * (lines[k, PX] - x)


@njit(cache=True, error_model="numpy")
def on_border(
    lines: Lines, number: int, radius: Real, ox: Real, oy: Real, by_direction: bool
) -> tuple[bool, Real, Real]:
    """The best point on the border of half-plane `number`, within the disc and the half-planes
    before it.

    Best is nearest to (ox, oy), or furthest in that unit direction where `by_direction` says so.
    Returns (found, x, y).
    """
    px, py, dx, dy = lines[number, PX], lines[number, PY], lines[number, DX], lines[number, DY]
    dot = px * dx + py * dy
    inside = dot * dot + radius * radius - (px * px + py * py)
    if inside < ZERO:
        return False, ZERO, ZERO
    root = sqrt(inside)
    left, right = -dot - root, -dot + root
    for i in range(number):
        ex, ey = lines[i, DX], lines[i, DY]
        denominator = dx * ey - dy * ex
        numerator = ex * (py - lines[i, PY]) - ey * (px - lines[i, PX])
        if abs(denominator) <= PARALLEL:
            if numerator < ZERO:
                return False, ZERO, ZERO
            continue
        t = numerator / denominator
        if denominator >= ZERO:
            if t < right:
                right = t
        elif t > left:
            left = t
        if left > right:
            return False, ZERO, ZERO
    if by_direction:
        t = right if ox * dx + oy * dy > ZERO else left
    else:
        t = dx * (ox - px) + dy * (oy - py)
        if t < left:
            t = left
        elif t > right:
            t = right
    return True, px + t * dx, py + t * dy


@njit(cache=True, error_model="numpy", inlined=True)
def nearest_permitted(
    lines: Lines, count: Number, radius: Real, ox: Real, oy: Real, by_direction: bool
) -> tuple[int, Real, Real]:
    """The permitted point nearest to (ox, oy), or furthest in that unit direction if
    `by_direction`.

    Returns (count, x, y) for the first `count` half-planes. If no point is left, it returns the
    number of the half-plane at which that happened, and the best point before it.
    """
    if by_direction:
        x, y = ox * radius, oy * radius
    elif ox * ox + oy * oy > radius * radius:
        scale = ONE / sqrt(ox * ox + oy * oy)
        x, y = ox * scale * radius, oy * scale * radius
    else:
        x, y = ox, oy
    for i in range(count):
        if violation(lines, i, x, y) > ZERO:
            found, nx, ny = on_border(lines, i, radius, ox, oy, by_direction)
            if not found:
                return i, x, y
            x, y = nx, ny
    return count, x, y


@njit(cache=True, error_model="numpy", inlined=True)
def least_violating(
    lines: Lines,
    count: Number,
    hard: Number,
    begin: int,
    radius: Real,
    x: Real,
    y: Real,
    spare: Lines,
) -> tuple[Real, Real]:
    """The point that violates the half-planes after the first `hard` ones least; those hold always.

    `begin`: where `nearest_permitted` failed, and (x, y) what it found. `spare` (count, 4):
    scratch.
    """
    distance = ZERO
    for i in range(begin, count):
        if violation(lines, i, x, y) <= distance:
            continue
        px, py, dx, dy = lines[i, PX], lines[i, PY], lines[i, DX], lines[i, DY]
        for k in range(hard):
            for column in range(4):
                spare[k, column] = lines[k, column]
        n = hard
        for j in range(hard, i):
            qx, qy, ex, ey = lines[j, PX], lines[j, PY], lines[j, DX], lines[j, DY]
            both = dx * ey - dy * ex
            if abs(both) <= PARALLEL:
                if dx * ex + dy * ey > ZERO:
                    continue
                spare[n, PX], spare[n, PY] = HALF * (px + qx), HALF * (py + qy)
            else:
                t = (ex * (py - qy) - ey * (px - qx)) / both
                spare[n, PX], spare[n, PY] = px + t * dx, py + t * dy
            ex, ey = ex - dx, ey - dy
            scale = ONE / sqrt(ex * ex + ey * ey)
            spare[n, DX], spare[n, DY] = ex * scale, ey * scale
            n += 1
        reached, nx, ny = nearest_permitted(spare, n, radius, -dy, dx, True)
        if reached >= n:  # else rounding broke what must hold in theory: keep the current result
            x, y = nx, ny
        distance = violation(lines, i, x, y)
    return x, y


@njit(cache=True, error_model="numpy", inlined=True)
def solve(
    lines: Lines, count: Number, hard: Number, radius: Real, ox: Real, oy: Real, spare: Lines
) -> tuple[Real, Real]:
    """The velocity nearest to (ox, oy) that the first `count` half-planes permit, else the least
    violating.

    The first `hard` of them are never violated. `spare` (count, 4): scratch.
    """
    reached, x, y = nearest_permitted(lines, count, radius, ox, oy, False)
    if reached < count:
        x, y = least_violating(lines, count, hard, reached, radius, x, y, spare)
    return x, y
