"""Permitted velocities next to a neighbour or a wall, one half-plane each; float32 kernels.

van den Berg, Guy, Lin, Manocha (2011), sections 4 and 5.4, with the arithmetic of the RVO2 library
(Apache-2.0) in its order. A wall is a row of an obstacle table (`agent.avoidance.obstacle_tree`):
the edge from its vertex to the vertex of row `NEXT`, solid to the left of that direction.

`table` (edges, COLUMNS) is such a table; `lines` (half-planes, 4) are described in
`agent.avoidance.linear_program`.

Units: metres and m/s; `per_horizon` and `per_step` in 1/s, one over the time to stay apart for, and
over the control period.
"""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from agent.avoidance.k_nearest import Number, Real
from agent.avoidance.linear_program import DX, DY, HALF, ONE, PX, PY, ZERO, Lines
from agent.kernels.kernel import njit

Table = NDArray[np.float32]  # (edges, COLUMNS), a wall a row
Leg = tuple[Real, Real, bool]

f32 = np.float32
SLACK = f32(-1e-5)
INFINITE = f32(np.inf)
# columns of an obstacle table: vertex, unit direction of the edge, convex, rows of the ring's
# next and previous vertex, rows of the tree's left and right child (-1: none)
AT_X, AT_Y, ALONG_X, ALONG_Y, CONVEX, NEXT, PREVIOUS, LEFT, RIGHT, COLUMNS = range(10)


@njit(cache=True, error_model="numpy")
def beside_agent(
    px: Real,
    py: Real,
    vx: Real,
    vy: Real,
    ux: Real,
    uy: Real,
    radius: Real,
    share: Real,
    per_horizon: Real,
    per_step: Real,
    lines: Lines,
    k: Number,
) -> None:
    """Write row k of `lines`: the half-plane against a neighbour at (px, py) from here.

    (vx, vy) is the own velocity, (ux, uy) the neighbour's. `radius` is the sum of both radii.
    `share`, 0 to 1, is how much of the avoidance is ours. `per_step` counts where the two touch
    already.
    """
    rx, ry = vx - ux, vy - uy
    square = px * px + py * py
    radius2 = radius * radius
    if square > radius2:
        wx, wy = rx - per_horizon * px, ry - per_horizon * py
        w2 = wx * wx + wy * wy
        dot = wx * px + wy * py
        if not (dot < ZERO and dot * dot > radius2 * w2):  # on a leg of the cone
            leg = sqrt(square - radius2)
            scale = ONE / square
            if px * wy - py * wx > ZERO:
                dx = (px * leg - py * radius) * scale
                dy = (px * radius + py * leg) * scale
            else:
                dx = -(px * leg + py * radius) * scale
                dy = -(-px * radius + py * leg) * scale
            along = rx * dx + ry * dy
            lines[k, PX] = vx + share * (along * dx - rx)
            lines[k, PY] = vy + share * (along * dy - ry)
            lines[k, DX], lines[k, DY] = dx, dy
            return
        length = sqrt(w2)
        reach = radius * per_horizon
    else:  # touching already: be apart within one step
        wx, wy = rx - per_step * px, ry - per_step * py
        length = sqrt(wx * wx + wy * wy)
        reach = radius * per_step
    if length > ZERO:
        scale = ONE / length
        wx, wy = wx * scale, wy * scale
    else:  # at the centre of the velocity obstacle every direction is equally good
        wx, wy = ONE, ZERO
    out = reach - length
    lines[k, PX], lines[k, PY] = vx + share * (out * wx), vy + share * (out * wy)
    lines[k, DX], lines[k, DY] = wy, -wx


@njit(cache=True, error_model="numpy")
def _covered(
    lines: Lines, count: Number, ax: Real, ay: Real, bx: Real, by: Real, clear: Real
) -> bool:
    """Whether one of the half-planes written so far keeps the robot away from this whole edge."""
    for j in range(count):
        px, py, dx, dy = lines[j, PX], lines[j, PY], lines[j, DX], lines[j, DY]
        if ((ax - px) * dy - (ay - py) * dx) - clear >= SLACK and (
            (bx - px) * dy - (by - py) * dx
        ) - clear >= SLACK:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _leg(px: Real, py: Real, square: Real, radius: Real, side: Real) -> tuple[Real, Real]:
    """Direction of the tangent from here to the circle at (px, py), left (1) or right (-1)."""
    leg = sqrt(square - radius * radius)
    scale = ONE / square
    turn = side * radius
    return (px * leg - py * turn) * scale, (px * turn + py * leg) * scale


@njit(cache=True, error_model="numpy")
def _touching(
    table: Table,
    a: int,
    b: int,
    ax: Real,
    ay: Real,
    bx: Real,
    by: Real,
    s: Real,
    near_a: bool,
    near_b: bool,
    near_line: bool,
    lines: Lines,
    k: Number,
) -> tuple[bool, int]:
    """Half-plane for a body that overlaps the edge: only velocities away from it.

    Returns whether that is the case, and how many half-planes were written.
    """
    if s < ZERO and near_a:
        if table[a, CONVEX] == ZERO:
            return True, 0
        dx, dy = -ay, ax
    elif s > ONE and near_b:
        if table[b, CONVEX] == ZERO or bx * table[b, ALONG_Y] - by * table[b, ALONG_X] < ZERO:
            return True, 0
        dx, dy = -by, bx
    elif ZERO <= s <= ONE and near_line:
        lines[k, PX], lines[k, PY] = ZERO, ZERO
        lines[k, DX], lines[k, DY] = -table[a, ALONG_X], -table[a, ALONG_Y]
        return True, 1
    else:
        return False, 0
    scale = ONE / sqrt(dx * dx + dy * dy)
    lines[k, PX], lines[k, PY], lines[k, DX], lines[k, DY] = ZERO, ZERO, dx * scale, dy * scale
    return True, 1


@njit(cache=True, error_model="numpy")
def _nearest_side(
    table: Table,
    a: int,
    b: int,
    x: Real,
    y: Real,
    vx: Real,
    vy: Real,
    per_horizon: Real,
    radius: Real,
    left: Leg,
    right: Leg,
    lines: Lines,
    k: Number,
) -> int:
    """Write the half-plane at the side of the velocity obstacle that is nearest to the own
    velocity.

    `left`, `right`: (x, y, foreign) of the legs; nothing is written where the nearest leg is
    foreign. Returns how many half-planes were written.
    """
    lx, ly = per_horizon * (table[a, AT_X] - x), per_horizon * (table[a, AT_Y] - y)
    rx, ry = per_horizon * (table[b, AT_X] - x), per_horizon * (table[b, AT_Y] - y)
    cx, cy = rx - lx, ry - ly
    single = a == b
    t = HALF if single else ((vx - lx) * cx + (vy - ly) * cy) / (cx * cx + cy * cy)
    t_left = (vx - lx) * left[0] + (vy - ly) * left[1]
    t_right = (vx - rx) * right[0] + (vy - ry) * right[1]
    on_left = (t < ZERO and t_left < ZERO) or (single and t_left < ZERO and t_right < ZERO)
    clear = radius * per_horizon
    if on_left or (t > ONE and t_right < ZERO):  # on the circle about one end of the cut-off
        ox, oy = (lx, ly) if on_left else (rx, ry)
        wx, wy = vx - ox, vy - oy
        scale = ONE / sqrt(wx * wx + wy * wy)
        wx, wy = wx * scale, wy * scale
        lines[k, PX], lines[k, PY] = ox + clear * wx, oy + clear * wy
        lines[k, DX], lines[k, DY] = wy, -wx
        return 1
    to_cut = to_left = to_right = INFINITE
    if not (t < ZERO or t > ONE or single):
        ex, ey = vx - (lx + t * cx), vy - (ly + t * cy)
        to_cut = ex * ex + ey * ey
    if t_left >= ZERO:
        ex, ey = vx - (lx + t_left * left[0]), vy - (ly + t_left * left[1])
        to_left = ex * ex + ey * ey
    if t_right >= ZERO:
        ex, ey = vx - (rx + t_right * right[0]), vy - (ry + t_right * right[1])
        to_right = ex * ex + ey * ey
    if to_cut <= to_left and to_cut <= to_right:
        ox, oy, dx, dy = lx, ly, -table[a, ALONG_X], -table[a, ALONG_Y]
    elif to_left <= to_right:
        if left[2]:
            return 0
        ox, oy, dx, dy = lx, ly, left[0], left[1]
    else:
        if right[2]:
            return 0
        ox, oy, dx, dy = rx, ry, -right[0], -right[1]
    lines[k, PX], lines[k, PY] = ox + clear * -dy, oy + clear * dx
    lines[k, DX], lines[k, DY] = dx, dy
    return 1


@njit(cache=True, error_model="numpy")
def beside_wall(
    table: Table,
    wall: Number,
    x: Real,
    y: Real,
    vx: Real,
    vy: Real,
    radius: Real,
    per_horizon: Real,
    lines: Lines,
    k: Number,
) -> int:
    """Write row k of `lines` against one edge of an obstacle; returns how many were written, 0 or
    1.

    `wall` is its row in `table`; the robot is at (x, y) with velocity (vx, vy) and this `radius`.
    """
    a, b = wall, int(table[wall, NEXT])
    ax, ay = table[a, AT_X] - x, table[a, AT_Y] - y
    bx, by = table[b, AT_X] - x, table[b, AT_Y] - y
    clear = per_horizon * radius
    if _covered(lines, k, per_horizon * ax, per_horizon * ay, per_horizon * bx, per_horizon * by,
                clear):  # fmt: skip
        return 0
    square_a, square_b, radius2 = ax * ax + ay * ay, bx * bx + by * by, radius * radius
    ex, ey = table[b, AT_X] - table[a, AT_X], table[b, AT_Y] - table[a, AT_Y]
    s = (-ax * ex + -ay * ey) / (ex * ex + ey * ey)
    wx, wy = -ax - s * ex, -ay - s * ey
    oblique = wx * wx + wy * wy <= radius2
    handled, written = _touching(table, a, b, ax, ay, bx, by, s, square_a <= radius2,
                                 square_b <= radius2, oblique, lines, k)  # fmt: skip
    if handled:
        return written
    if oblique and s < ZERO:  # seen along its own line: the first vertex alone makes both legs
        b, bx, by, square_b = a, ax, ay, square_a
    elif oblique and s > ONE:
        a, ax, ay, square_a = b, bx, by, square_b
    single = a == b
    if single and table[a, CONVEX] == ZERO:
        return 0
    if table[a, CONVEX] != ZERO:
        left_x, left_y = _leg(ax, ay, square_a, radius, ONE)
    else:  # not convex: the leg goes on along the cut-off line
        left_x, left_y = -table[a, ALONG_X], -table[a, ALONG_Y]
    if table[b, CONVEX] != ZERO:
        right_x, right_y = _leg(bx, by, square_b, radius, -ONE)
    else:
        right_x, right_y = table[a, ALONG_X], table[a, ALONG_Y]
    # A leg of a convex vertex never points into the neighbouring edge: that one is foreign.
    before = int(table[a, PREVIOUS])
    nx, ny = -table[before, ALONG_X], -table[before, ALONG_Y]
    left_foreign = table[a, CONVEX] != ZERO and left_x * ny - left_y * nx >= ZERO
    if left_foreign:
        left_x, left_y = nx, ny
    nx, ny = table[b, ALONG_X], table[b, ALONG_Y]
    right_foreign = table[b, CONVEX] != ZERO and right_x * ny - right_y * nx <= ZERO
    if right_foreign:
        right_x, right_y = nx, ny
    return _nearest_side(table, a, b, x, y, vx, vy, per_horizon, radius,
                         (left_x, left_y, left_foreign), (right_x, right_y, right_foreign),
                         lines, k)  # fmt: skip
