"""ORCA for one robot: the velocity nearest to the wanted one that collides with nobody for a while.

Optimal Reciprocal Collision Avoidance (van den Berg, Guy, Lin, Manocha 2011). Each robot near gives
one half-plane of permitted velocities, of which `share` is ours: 0.5 with a peer that does the
same, 1.0 with one that stands or is stopped, anything between by right of way where both agree.
Walls and fences come first and are never traded against robots (the paper's section 5.4).

    orca = Avoidance(radius_m, speed_max_m_s, braking_m_s2, horizon_s, dt_s, fences)
    orca.know(slot, x_m, y_m, vx_m_s, vy_m_s, radius_m, 0.5, now_s)    on every pose heard
    orca.among_known((x, y), (vx, vy), (wx, wy), now_s)                every control period

The kernel has one argument, because each array argument costs its dispatcher 0.1 to 0.2 us: a
float64 buffer of a head, `PEERS_MAX` rows of known peers, `GIVEN_MAX` rows given with a call,
`FENCES_MAX` near fences, and scratch. Positions stay double until they are relative to us; from
there on all is single precision, bit for bit that of the RVO2 library (see `agent.orca_fleet` for
many robots). Metres and seconds, x east, y north.
"""

from math import cos, inf, nan, pi, sin, sqrt
from struct import Struct

import numpy as np
from numba import njit
from numpy.typing import NDArray

from agent.config import NEIGHBOUR_RANGE_M, NEIGHBOURS_MAX
from agent.half_planes import beside_agent, beside_wall
from agent.linear_program import DX, DY, ONE, PX, PY, ZERO, solve, violation
from agent.nearest import take
from agent.obstacle_tree import NO_WALLS, ObstacleTree
from agent.orca_fleet import WALLS_MAX, near_walls
from agent.stopping_room import before_agent, within_grip

f32 = np.float32
XY = tuple[float, float]
PEERS_MAX = 256  # a row for every slot of a fleet, operators' devices included
GIVEN_MAX = 32  # rows a caller may give; the nearest `NEIGHBOURS_MAX` of them count
FENCES_MAX = 64  # fences near a robot; the nearest are kept
FENCE_SLACK_M = 2.0  # near fences are looked for again after this much travel
CREEP_M_S = 0.5  # a body inside its margin to a fence leaves it no faster than this

# the head: written at each call up to NOW_S, the rows in use when they change, the rest once
X, Y, VX, VY, WANT_X, WANT_Y, NOW_S, FIRST_ROW, LAST_ROW, RANGE = range(10)
RADIUS, SPEED_MAX, HORIZON, WALL_HORIZON, DT, AGE_MAX, COS, SIN = range(10, 18)
NEIGHBOURS, FENCES, FENCE_RADIUS, FENCE_REACH, BRAKING, GATHERED_X, GATHERED_Y = range(18, 25)
STOPPING = 25  # deceleration to stop with before others; 0: that is not asked of us
HEAD = 26  # even: rows stay aligned
# a row of a neighbour, a cache line; MOVED_ON_S: of its way since it was heard this is in its place
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

_CALL, _ROWS_IN_USE, _ROW = Struct("7d"), Struct("3d"), Struct("8d")
_ROWS_AT = 8 * FIRST_ROW
_write_call = _CALL.pack_into


FENCE_S = (
    0.4  # towards a fence at most so fast that it is this far away: two periods, and the wheels
)


@njit(cache=True, error_model="numpy")
def _fence_lines(work, lines):  # type: ignore[no-untyped-def]
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


@njit(cache=True, error_model="numpy")
def _nearest(work, near, squares):  # type: ignore[no-untyped-def]
    """Offsets of the nearest rows in range, nearest first, moved on by their age."""
    x, y, now = work[X], work[Y], work[NOW_S]
    reach, most, count = f32(work[RANGE] * work[RANGE]), int(work[NEIGHBOURS]), 0
    for row in range(int(work[FIRST_ROW]), int(work[LAST_ROW])):
        at = HEAD + row * ROW_COLUMNS
        if work[at + ROW_RADIUS] < 0.0:
            continue
        age = now - work[at + ROW_HEARD_S]
        if age > work[AGE_MAX]:  # it may have stopped meanwhile: it is where it was heard
            age = 0.0
        dx = f32(work[at + ROW_X] + work[at + ROW_VX] * age - x)
        dy = f32(work[at + ROW_Y] + work[at + ROW_VY] * age - y)
        square = dx * dx + dy * dy
        if square < reach:
            count, reach = take(near, squares, count, most, reach, at, square)
    return count


@njit(cache=True, error_model="numpy")
def _stop_lines(work, near, count, lines, hard):  # type: ignore[no-untyped-def]
    """Half-planes within which we can stop before each of the nearest, after the `hard` ones."""
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


@njit(cache=True, error_model="numpy")
def _choose(work, lines, hard, spare, near, squares):  # type: ignore[no-untyped-def]
    """Half-planes of the neighbours after the `hard` ones, and the velocity of them all."""
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
            if violation(lines, k, wx, wy) > ZERO:  # somebody is in the way: keep right of it
                wx, wy = (f32(work[WANT_X] * work[COS] + work[WANT_Y] * work[SIN]),
                          f32(work[WANT_Y] * work[COS] - work[WANT_X] * work[SIN]))  # fmt: skip
                break
    wx, wy = solve(lines, hard + count, hard, f32(work[SPEED_MAX]), wx, wy, spare)
    if hard > first and work[STOPPING] > 0.0:
        return within_grip(wx, wy, vx, vy, f32(work[STOPPING] * work[DT]), lines, first, hard)
    return wx, wy


@njit(cache=True, error_model="numpy")
def _scratch(work):  # type: ignore[no-untyped-def]
    """Lines, as many again, and the nearest with their squared distances: views of the buffer."""
    both = work[SCRATCH_AT:NEAR_AT].view(f32).reshape((2, LINES_MAX, 4))
    return (
        both[0],
        both[1],
        work[NEAR_AT:SQUARES_AT].view(np.int64),
        work[SQUARES_AT:SIZE].view(f32),
    )


@njit(cache=True, error_model="numpy")
def _gathered(work):  # type: ignore[no-untyped-def]
    """Whether the fences in the buffer are those that matter here."""
    dx, dy = work[X] - work[GATHERED_X], work[Y] - work[GATHERED_Y]
    return dx * dx + dy * dy <= FENCE_SLACK_M * FENCE_SLACK_M


@njit(cache=True, error_model="numpy")
def velocity(work):  # type: ignore[no-untyped-def]
    """The velocity (vx, vy) to take, m/s, from a packed buffer (see the top of this file).

    Not a number where the fences must be gathered first.
    """
    if not _gathered(work):
        return f32(nan), f32(nan)
    lines, spare, near, squares = _scratch(work)
    return _choose(work, lines, _fence_lines(work, lines), spare, near, squares)


@njit(cache=True, error_model="numpy")
def velocity_among_walls(work, table, root):  # type: ignore[no-untyped-def]
    """As `velocity`, with the half-planes of an `ObstacleTree` as well."""
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


class Avoidance:
    """One robot's ORCA: what it knows of its peers, and the memory of its kernel."""

    def __init__(
        self,
        radius_m: float,
        speed_max_m_s: float,
        braking_m_s2: float,
        horizon_s: float,
        dt_s: float,
        fences: NDArray[np.float64],
        *,
        walls: ObstacleTree = NO_WALLS,
        wall_horizon_s: float = 2.0,
        range_m: float = NEIGHBOUR_RANGE_M,
        age_max_s: float = 1.0,
        keep_right_rad: float = 0.0,
        stopping_m_s2: float = 0.0,
    ) -> None:
        """`radius_m` is kept from `fences` ((n, 4): ax, ay, bx, by) by braking, and from `walls`.

        A peer not heard for `age_max_s` counts as standing where it was. `keep_right_rad` turns
        the wanted velocity to the right where a robot is in its way: without it two robots head on
        stop before each other for ever. A few hundredths will do; it must be equal fleet-wide.
        `stopping_m_s2`: never be where braking by this does not stop us before another robot that
        halts (`agent/stopping_room.py`); 0: rely on what they do, as plain ORCA does.
        """
        assert radius_m >= 0 and horizon_s > 0 and dt_s > 0 and 0 <= keep_right_rad < pi / 4
        self.radius_m, self.range_m, self.walls = radius_m, range_m, walls
        self._fences = np.asarray(fences, dtype=np.float64).reshape(-1, 4)
        self._work = work = np.zeros(SIZE)
        work[HEAD:FENCE_AT].reshape(-1, ROW_COLUMNS)[:, ROW_RADIUS] = UNKNOWN
        work[RADIUS], work[SPEED_MAX], work[HORIZON] = radius_m, speed_max_m_s, horizon_s
        work[WALL_HORIZON], work[DT], work[AGE_MAX] = wall_horizon_s, dt_s, age_max_s
        work[COS], work[SIN] = cos(keep_right_rad), sin(keep_right_rad)
        work[NEIGHBOURS], work[FENCE_RADIUS], work[BRAKING] = NEIGHBOURS_MAX, radius_m, braking_m_s2
        work[FENCE_REACH] = radius_m + speed_max_m_s**2 / (2 * braking_m_s2) + speed_max_m_s * dt_s
        work[STOPPING] = stopping_m_s2
        work[GATHERED_X] = work[GATHERED_Y] = inf
        self._last = 0
        self._open = walls.root < 0  # no walls but fences
        self._use_known()

    def fence(self, fences: NDArray[np.float64]) -> None:
        """Other fences from now on: what is sensed, where nothing is known beforehand."""
        self._fences = fences
        self._work[GATHERED_X] = self._work[GATHERED_Y] = inf

    def know(self, slot: int, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float,
             radius_m: float, share: float, heard_s: float) -> None:  # fmt: skip
        """The newest pose of a peer; `share` of the avoidance is ours (1: it will not give way)."""
        assert 0 <= slot < PEERS_MAX and 0.0 <= share <= 1.0 and radius_m >= 0.0
        _ROW.pack_into(self._work, 8 * (HEAD + slot * ROW_COLUMNS), x_m, y_m, vx_m_s, vy_m_s,  # type: ignore[arg-type]
                       radius_m, share, heard_s, 0.0)  # fmt: skip
        if slot >= self._last:
            self._last = slot + 1
            self._use_known()

    def forget(self, slot: int) -> None:
        self._work[HEAD + slot * ROW_COLUMNS + ROW_RADIUS] = UNKNOWN

    def among_known(self, at: XY, own: XY, wanted: XY, now_s: float) -> XY:
        """The velocity to take among the known peers, from place, own and wanted velocity."""
        # One by one, and all in one function: stars and calls would cost a tenth of all.
        x, y = at
        vx, vy = own
        wx, wy = wanted
        work = self._work
        _write_call(work, 0, x, y, vx, vy, wx, wy, now_s)  # type: ignore[arg-type]
        if self._open:
            vx, vy = velocity(work)
            if vx == vx:  # a number: the fences were those that matter
                return vx, vy
        return self._run(at)

    def _use_known(self) -> None:
        _ROWS_IN_USE.pack_into(self._work, _ROWS_AT, 0, self._last, self.range_m)  # type: ignore[arg-type]

    def velocity(self, at: XY, own: XY, wanted: XY, rows: list[tuple[float, ...]]) -> XY:
        """The same from `rows` alone: dx, dy, vx, vy, combined radius, share; at any distance. And
        for how long, in seconds, it was moved on since it was heard, where stopping is asked for."""
        count = min(len(rows), GIVEN_MAX)
        for k in range(count):
            dx, dy, vx, vy, combined, share = rows[k][:6]
            moved_on_s = rows[k][6] if len(rows[k]) > 6 else 0.0
            _ROW.pack_into(self._work, 8 * (HEAD + (PEERS_MAX + k) * ROW_COLUMNS), at[0] + dx,  # type: ignore[arg-type]
                           at[1] + dy, vx, vy, combined - self.radius_m, share, 0.0,
                           moved_on_s)  # fmt: skip
        _write_call(self._work, 0, *at, *own, *wanted, 0.0)  # type: ignore[arg-type]
        _ROWS_IN_USE.pack_into(self._work, _ROWS_AT, PEERS_MAX, PEERS_MAX + count, inf)  # type: ignore[arg-type]
        found = self._run(at)
        self._use_known()
        return found

    def _run(self, at: XY) -> XY:
        x, y = self._kernel()
        if x != x:  # not a number: too far from where fences were looked for
            self._gather(at)
            x, y = self._kernel()
        return x, y

    def _kernel(self) -> XY:
        if self._open:
            x, y = velocity(self._work)
        else:
            x, y = velocity_among_walls(self._work, self.walls.table, self.walls.root)
        return x, y

    def _gather(self, at: XY) -> None:
        """Copy the fences that may come into reach before the next time."""
        self._work[GATHERED_X], self._work[GATHERED_Y] = at
        a, along = self._fences[:, :2], self._fences[:, 2:] - self._fences[:, :2]
        square = np.maximum(np.sum(along * along, axis=1), 1e-18)
        t = np.clip(np.sum((np.asarray(at) - a) * along, axis=1) / square, 0.0, 1.0)
        distance = np.hypot(*(a + t[:, np.newaxis] * along - np.asarray(at)).T)
        near = np.argsort(distance, kind="stable")[:FENCES_MAX]
        near = near[distance[near] <= self._work[FENCE_REACH] + FENCE_SLACK_M]
        self._work[FENCES] = len(near)
        self._work[FENCE_AT : FENCE_AT + 4 * len(near)] = self._fences[near].reshape(-1)
