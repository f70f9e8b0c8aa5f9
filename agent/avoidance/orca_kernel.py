"""The kernel of ORCA for one robot, and the layout of the one array that it is given.

`agent/avoidance/orca.py` describes what it computes, after van den Berg et al. (2011). The array
`work` (SIZE,) is a float64 buffer of a head, `PEERS_MAX` rows of known peers, `GIVEN_MAX` rows
given with a call, `FENCES_MAX` near fences, and scratch. It is one argument, because each array
argument costs a dispatcher 0.1 to 0.2 us. Positions stay double until they are relative to us; from
there on all is single precision, bit for bit that of the RVO2 library.
"""

from math import nan, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.avoidance.half_planes import Table, beside_agent, beside_wall
from agent.avoidance.k_nearest import Number, Real, take
from agent.avoidance.linear_program import DX, DY, ONE, PX, PY, ZERO, Lines, solve, violation
from agent.avoidance.obstacle_tree import WALLS_MAX, Longs, Singles, near_walls
from agent.avoidance.stopping_constraint import before_agent, within_grip
from agent.interface.config import NEIGHBOURS_MAX
from agent.kernels.kernel import njit

Buffer = NDArray[np.float64]  # (SIZE,)

f32: Any = np.float32  # a number of single precision is a float to callers
PEERS_MAX = 256  # a row for every slot of a fleet, including those of operators' devices
GIVEN_MAX = 32  # rows a caller may give; the nearest `NEIGHBOURS_MAX` of them count
FENCES_MAX = 64  # fences near a robot; the nearest are kept
FENCE_SLACK_M = 2.0  # near fences are gathered again after the robot has moved this far
CREEP_M_S = 0.5  # greatest speed at which a body inside its margin is made to leave a fence

# the head: written at each call up to NOW_S, the rows in use when they change, the rest once
X, Y, VX, VY, WANT_X, WANT_Y, NOW_S, FIRST_ROW, LAST_ROW, RANGE = range(10)
RADIUS, SPEED_MAX, HORIZON, WALL_HORIZON, DT, AGE_MAX, COS, SIN = range(10, 18)
NEIGHBOURS, FENCES, FENCE_RADIUS, FENCE_REACH, BRAKING, GATHERED_X, GATHERED_Y = range(18, 25)
STOPPING = 25  # deceleration for stopping before other robots; 0: no such constraint
TOLD = 26  # speed that wheels without slip have by what the calls so far gave
HEAD = 28  # even: rows stay aligned
# Columns of a neighbour, one cache line. Its position was already moved on by MOVED_ON_S.
ROW_X, ROW_Y, ROW_VX, ROW_VY, ROW_RADIUS, ROW_SHARE, ROW_HEARD_S, ROW_MOVED_ON_S = range(8)
ROW_COLUMNS = 8
UNKNOWN = -1.0  # radius of a row that is free
ROWS = PEERS_MAX + GIVEN_MAX
FENCE_AT = HEAD + ROWS * ROW_COLUMNS
LINES_MAX = FENCES_MAX + WALLS_MAX + 2 * NEIGHBOURS_MAX
# scratch, so that no call allocates (0.05 us an array): twice LINES_MAX lines of four float32
SCRATCH_AT = FENCE_AT + FENCES_MAX * 4
NEAR_AT = SCRATCH_AT + 2 * 2 * LINES_MAX
SQUARES_AT = NEAR_AT + WALLS_MAX  # after as many int64; then as many float32
SIZE = SQUARES_AT + WALLS_MAX // 2


# The speed towards a fence is at most the distance to it over this: two periods, and the wheels.
FENCE_S = 0.4


@njit(cache=True, error_model="numpy", inlined=True)
def _fence_lines(work: Buffer, lines: Lines) -> int:
    """Half-planes against fences: towards one only as fast as can still be braked from."""
    n = 0
    for k in range(int(work[FENCES])):
        at = FENCE_AT + 4 * k
        ex, ey = work[at + 2] - work[at], work[at + 3] - work[at + 1]
        px, py = work[at] - work[X], work[at + 1] - work[Y]
        square = ex * ex + ey * ey
        t = min(max(-(px * ex + py * ey) / square, 0.0), 1.0) if square > 0.0 else 0.0
        px, py = px + t * ex, py + t * ey
        distance = sqrt(px * px + py * py)
        if distance > work[FENCE_REACH] or distance < 1e-9:
            continue
        px, py, room = px / distance, py / distance, distance - work[FENCE_RADIUS]
        if room > 0.0:
            limit = min(sqrt(2.0 * work[BRAKING] * room), room / FENCE_S)
        else:
            limit = max(room, -CREEP_M_S)
        lines[n, PX], lines[n, PY] = f32(px * limit), f32(py * limit)
        lines[n, DX], lines[n, DY] = f32(-py), f32(px)
        n += 1
    return n


@njit(cache=True, error_model="numpy", inlined=True)
def _nearest(work: Buffer, near: Longs, squares: Singles) -> Number:
    """Offsets of the nearest rows in range, nearest first, moved on by their age."""
    x, y, now = work[X], work[Y], work[NOW_S]
    reach, most, count = f32(work[RANGE] * work[RANGE]), int(work[NEIGHBOURS]), np.int64(0)
    for row in range(int(work[FIRST_ROW]), int(work[LAST_ROW])):
        at = HEAD + row * ROW_COLUMNS
        if work[at + ROW_RADIUS] < 0.0:
            continue
        age = now - work[at + ROW_HEARD_S]
        # It may have stopped since: assume it stands where it was last heard.
        if age > work[AGE_MAX]:
            age = 0.0
        dx = f32(work[at + ROW_X] + work[at + ROW_VX] * age - x)
        dy = f32(work[at + ROW_Y] + work[at + ROW_VY] * age - y)
        square = dx * dx + dy * dy
        if square < reach:
            count, reach = take(near, squares, count, most, reach, at, square)
    return count


@njit(cache=True, error_model="numpy", inlined=True)
def _stop_lines(work: Buffer, near: Longs, count: Number, lines: Lines, hard: Number) -> Number:
    """Half-planes within which we can stop before each of the nearest, after the `hard` ones.

    A peer that was not heard for too long counts as standing."""
    own = sqrt(work[VX] * work[VX] + work[VY] * work[VY]) + work[STOPPING] * work[DT]
    own = min(own, work[SPEED_MAX])
    for k in range(count):
        at = near[k]
        age, ux, uy = work[NOW_S] - work[at + ROW_HEARD_S], work[at + ROW_VX], work[at + ROW_VY]
        if age > work[AGE_MAX]:
            age, ux, uy = 0.0, 0.0, 0.0
        dx = work[at + ROW_X] + ux * age - work[X]
        dy = work[at + ROW_Y] + uy * age - work[Y]
        hard += before_agent(dx, dy, ux, uy, work[RADIUS] + work[at + ROW_RADIUS],
                             age + work[at + ROW_MOVED_ON_S], work[STOPPING], own,
                             work[SPEED_MAX], lines, hard)  # fmt: skip
    return hard


@njit(cache=True, error_model="numpy", inlined=True)
def _choose(
    work: Buffer, lines: Lines, hard: Number, spare: Lines, near: Longs, squares: Singles
) -> tuple[Real, Real]:
    """Half-planes of the neighbours after the `hard` ones, and the velocity of them all.

    The `hard` ones are of fences; a robot that brakes before another one is kept off them.
    """
    count, first = _nearest(work, near, squares), hard
    if work[STOPPING] > 0.0:
        hard = _stop_lines(work, near, count, lines, hard)
    vx, vy, now = f32(work[VX]), f32(work[VY]), work[NOW_S]
    wx, wy, radius = f32(work[WANT_X]), f32(work[WANT_Y]), f32(work[RADIUS])
    per_horizon, per_step = ONE / f32(work[HORIZON]), ONE / f32(work[DT])
    for k in range(count):
        at = near[k]
        age, ux, uy = now - work[at + ROW_HEARD_S], work[at + ROW_VX], work[at + ROW_VY]
        share = f32(work[at + ROW_SHARE])
        if age > work[AGE_MAX]:
            age, ux, uy, share = 0.0, 0.0, 0.0, ONE
        dx = f32(work[at + ROW_X] + ux * age - work[X])
        dy = f32(work[at + ROW_Y] + uy * age - work[Y])
        beside_agent(dx, dy, vx, vy, f32(ux), f32(uy), radius + f32(work[at + ROW_RADIUS]), share,
                     per_horizon, per_step, lines, hard + k)  # fmt: skip
    if work[SIN] != 0.0:
        for k in range(hard, hard + count):
            if violation(lines, k, wx, wy) > ZERO:  # a robot is in the way: keep right of it
                wx, wy = (f32(work[WANT_X] * work[COS] + work[WANT_Y] * work[SIN]),
                          f32(work[WANT_Y] * work[COS] - work[WANT_X] * work[SIN]))  # fmt: skip
                break
    wx, wy = solve(lines, hard + count, hard, f32(work[SPEED_MAX]), wx, wy, spare)
    change = f32(work[STOPPING] * work[DT])
    if hard > first and change > ZERO:
        wx, wy = within_grip(wx, wy, vx, vy, f32(work[TOLD]), change, lines, first, hard)
    work[TOLD] = max(sqrt(wx * wx + wy * wy), work[TOLD] - change)
    return wx, wy


@njit(cache=True, error_model="numpy")
def _scratch(work: Buffer) -> tuple[Lines, Lines, Longs, Singles]:
    """Lines, as many again, and the nearest with their squared distances: views of the buffer."""
    both = work[SCRATCH_AT:NEAR_AT].view(f32).reshape((2, LINES_MAX, 4))
    return (
        both[0],
        both[1],
        work[NEAR_AT:SQUARES_AT].view(np.int64),
        work[SQUARES_AT:SIZE].view(f32),
    )


@njit(cache=True, error_model="numpy")
def _gathered(work: Buffer) -> bool:
    """Whether the fences in the buffer are those that matter here."""
    dx, dy = work[X] - work[GATHERED_X], work[Y] - work[GATHERED_Y]
    return dx * dx + dy * dy <= FENCE_SLACK_M * FENCE_SLACK_M


@njit(cache=True, error_model="numpy")
def velocity(work: Buffer) -> tuple[float, float]:
    """The velocity (vx, vy) to take, m/s, from the packed buffer `work` (see the top of this file).

    Not a number where the fences must be gathered first.
    """
    if not _gathered(work):
        return f32(nan), f32(nan)
    lines, spare, near, squares = _scratch(work)
    return _choose(work, lines, _fence_lines(work, lines), spare, near, squares)


@njit(cache=True, error_model="numpy")
def velocity_among_walls(work: Buffer, table: Table, root: int) -> tuple[float, float]:
    """As `velocity` for the buffer `work`, with the half-planes of an `ObstacleTree`, m/s.

    `table` (edges, COLUMNS) and `root` are those of the tree.
    """
    if not _gathered(work):
        return f32(nan), f32(nan)
    lines, spare, near, squares = _scratch(work)
    stack = np.empty(2 * table.shape[0] + 8, np.int64)
    hard = _fence_lines(work, lines)
    x, y, vx, vy = f32(work[X]), f32(work[Y]), f32(work[VX]), f32(work[VY])
    horizon, radius = f32(work[WALL_HORIZON]), f32(work[RADIUS])
    reach = horizon * f32(work[SPEED_MAX]) + radius
    count = near_walls(table, root, x, y, reach * reach, stack, near, squares)
    for k in range(count):
        hard += beside_wall(table, near[k], x, y, vx, vy, radius, ONE / horizon, lines, hard)
    return _choose(work, lines, hard, spare, near, squares)
