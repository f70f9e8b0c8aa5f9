"""ORCA for one robot: the velocity nearest to the wanted one without a collision for a time horizon.

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
there on all is single precision, bit for bit that of the RVO2 library (see
`tools.bench.kernels.orca_fleet` for many robots). Metres and seconds, x east, y north.
"""

from math import cos, inf, pi, sin
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from agent.avoidance.fence_distance import gather
from agent.avoidance.obstacle_tree import NO_WALLS, ObstacleTree
from agent.avoidance.orca_kernel import (
    AGE_MAX,
    BRAKING,
    COS,
    DT,
    FENCE_AT,
    FENCE_RADIUS,
    FENCE_REACH,
    FENCE_SLACK_M,
    FENCES,
    FENCES_MAX,
    FIRST_ROW,
    GATHERED_X,
    GATHERED_Y,
    GIVEN_MAX,
    HEAD,
    HORIZON,
    NEIGHBOURS,
    PEERS_MAX,
    RADIUS,
    ROW_COLUMNS,
    ROW_RADIUS,
    SIN,
    SIZE,
    SPEED_MAX,
    STOPPING,
    UNKNOWN,
    WALL_HORIZON,
    velocity,
    velocity_among_walls,
)
from agent.interface.config import NEIGHBOUR_RANGE_M, NEIGHBOURS_MAX
from agent.interface.geometry import Point

_CALL, _ROWS_IN_USE, _ROW = Struct("7d"), Struct("3d"), Struct("8d")
_ROWS_AT = 8 * FIRST_ROW
_write_call, _write_all = _CALL.pack_into, Struct("10d").pack_into


class OrcaSolver:
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
        halts (`agent/avoidance/stopping_constraint.py`); 0: rely on what they do, as plain ORCA does.
        """
        assert radius_m >= 0 and horizon_s > 0 and dt_s > 0 and 0 <= keep_right_rad < pi / 4
        self.radius_m, self.range_m, self.walls = radius_m, range_m, walls
        self._fences = np.asarray(fences, dtype=np.float64).reshape(-1, 4)
        self._work = work = np.zeros(SIZE)
        self._bytes = work.data.cast("B")  # writing through this view takes half the time
        self._near_fences = work[FENCE_AT : FENCE_AT + 4 * FENCES_MAX]
        self._gaps = np.empty(FENCES_MAX)
        work[HEAD:FENCE_AT].reshape(-1, ROW_COLUMNS)[:, ROW_RADIUS] = UNKNOWN
        work[RADIUS], work[SPEED_MAX], work[HORIZON] = radius_m, speed_max_m_s, horizon_s
        work[WALL_HORIZON], work[DT], work[AGE_MAX] = wall_horizon_s, dt_s, age_max_s
        work[COS], work[SIN] = cos(keep_right_rad), sin(keep_right_rad)
        work[NEIGHBOURS], work[FENCE_RADIUS], work[BRAKING] = NEIGHBOURS_MAX, radius_m, braking_m_s2
        self._reach_m = radius_m + speed_max_m_s**2 / (2 * braking_m_s2) + speed_max_m_s * dt_s
        work[FENCE_REACH] = self._reach_m
        work[STOPPING] = stopping_m_s2
        work[GATHERED_X] = work[GATHERED_Y] = inf
        self._last = 0
        self._more_m = 0.0  # kept from fences beyond the radius
        self._open = walls.root < 0  # no walls but fences
        self._use_known()

    def fence(self, fences: NDArray[np.float64]) -> None:
        """Replace the fences by others, (n, 4): ax, ay, bx, by. For what is sensed, where nothing
        is known beforehand."""
        self._fences = fences
        self._work[GATHERED_X] = self._work[GATHERED_Y] = inf

    def keep_more_from_fences(self, more_m: float) -> None:
        """Keep so many metres more than the radius from fences, from now on; not from `walls`."""
        if more_m == self._more_m:
            return
        work = self._work
        work[FENCE_RADIUS], work[FENCE_REACH] = self.radius_m + more_m, self._reach_m + more_m
        work[GATHERED_X] = work[GATHERED_Y] = inf  # what was gathered may not reach so far
        self._more_m = more_m

    def know(self, slot: int, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float,
             radius_m: float, share: float, heard_at_s: float) -> None:  # fmt: skip
        """Set the newest pose of a peer. `share`, 0 to 1, of the avoidance is ours; 1: it will not
        give way."""
        assert 0 <= slot < PEERS_MAX and 0.0 <= share <= 1.0 and radius_m >= 0.0
        _ROW.pack_into(self._bytes, 8 * (HEAD + slot * ROW_COLUMNS), x_m, y_m, vx_m_s, vy_m_s,
                       radius_m, share, heard_at_s, 0.0)  # fmt: skip
        if slot >= self._last:
            self._last = slot + 1
            self._use_known()

    def forget(self, slot: int) -> None:
        """Avoid a peer no longer, until its next pose."""
        self._work[HEAD + slot * ROW_COLUMNS + ROW_RADIUS] = UNKNOWN

    def among_known(self, at: Point, own: Point, wanted: Point, now_s: float) -> Point:
        """The velocity to take among the known peers: (x, y) in m/s.

        `at` is the own place in metres, `own` and `wanted` are velocities in m/s.
        """
        # Not with star arguments or helper functions: those would cost a tenth of the time.
        x, y = at
        vx, vy = own
        wx, wy = wanted
        _write_call(self._bytes, 0, x, y, vx, vy, wx, wy, now_s)
        if self._open:
            vx, vy = velocity(self._work)
            if vx == vx:  # a number: the fences were those that matter
                return vx, vy
        return self._run(at)

    def _use_known(self) -> None:
        _ROWS_IN_USE.pack_into(self._bytes, _ROWS_AT, 0, self._last, self.range_m)

    def velocity(
        self, at: Point, own: Point, wanted: Point, rows: list[tuple[float, ...]]
    ) -> Point:
        """The velocity to take among neighbours given in `rows` alone, at any distance, in m/s.

        A row is dx, dy, vx, vy, combined radius, share of the avoidance; metres and m/s relative to
        `at`. Where stopping is asked for, a seventh number may say for how many seconds its place
        was moved on since it was heard. `own` and `wanted` are velocities in m/s.
        """
        count = min(len(rows), GIVEN_MAX)
        x, y = at
        for k in range(count):
            row = rows[k]
            dx, dy, vx, vy, combined, share = row[:6]
            moved_on_for_s = row[6] if len(row) > 6 else 0.0
            _ROW.pack_into(self._bytes, 8 * (HEAD + (PEERS_MAX + k) * ROW_COLUMNS), x + dx, y + dy,
                           vx, vy, combined - self.radius_m, share, 0.0, moved_on_for_s)  # fmt: skip
        _write_all(self._bytes, 0, x, y, *own, *wanted, 0.0, PEERS_MAX, PEERS_MAX + count, inf)
        found = self._run(at)
        self._use_known()
        return found

    def _run(self, at: Point) -> Point:
        x, y = self._kernel()
        if x != x:  # not a number: too far from where fences were looked for
            self._gather(at)
            x, y = self._kernel()
        return x, y

    def _kernel(self) -> Point:
        if self._open:
            x, y = velocity(self._work)
        else:
            x, y = velocity_among_walls(self._work, self.walls.table, self.walls.root)
        return x, y

    def _gather(self, at: Point) -> None:
        """Copy the fences that may come into reach before the next time."""
        x, y = at
        self._work[GATHERED_X], self._work[GATHERED_Y] = x, y
        reach_m = self._work[FENCE_REACH] + FENCE_SLACK_M
        self._work[FENCES] = gather(x, y, self._fences, reach_m, self._near_fences, self._gaps)
