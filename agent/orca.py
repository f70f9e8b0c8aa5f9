"""ORCA: the velocity nearest to the wanted one that collides with nobody for a while.

Optimal Reciprocal Collision Avoidance (van den Berg, Guy, Lin, Manocha 2011): one half-plane of
permitted velocities a neighbour, then a linear program in two dimensions; where the half-planes
exclude everything, the velocity that violates them least (their section 5.3). Each half-plane takes
`share` of the avoidance on us: 0.5 with a peer that does the same, 1.0 with one that does not move.
"""

from math import sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

EPSILON = 1e-5
COLUMNS = 6  # of a neighbour row: dx, dy, vx, vy, combined radius, share
LINES_MAX = 32
FENCE_S = (
    0.4  # towards a fence at most so fast that it is this far away: two periods, and the wheels
)


@njit(cache=True)
def _lp1(lines, number, radius, ox, oy, direction):  # type: ignore[no-untyped-def]
    """Best point on one line within the disc and the lines before it: (feasible, x, y)."""
    px, py, dx, dy = lines[number]
    dot = px * dx + py * dy
    disc = dot * dot + radius * radius - px * px - py * py
    if disc < 0.0:
        return False, 0.0, 0.0
    root = sqrt(disc)
    left, right = -dot - root, -dot + root
    for i in range(number):
        denominator = dx * lines[i, 3] - dy * lines[i, 2]
        numerator = lines[i, 2] * (py - lines[i, 1]) - lines[i, 3] * (px - lines[i, 0])
        if abs(denominator) <= EPSILON:
            if numerator < 0.0:
                return False, 0.0, 0.0
            continue
        t = numerator / denominator
        if denominator >= 0.0:
            right = min(right, t)
        else:
            left = max(left, t)
        if left > right:
            return False, 0.0, 0.0
    if direction:
        t = right if ox * dx + oy * dy > 0.0 else left
    else:
        t = dx * (ox - px) + dy * (oy - py)
        t = min(max(t, left), right)
    return True, px + t * dx, py + t * dy


@njit(cache=True)
def _lp2(lines, count, radius, ox, oy, direction):  # type: ignore[no-untyped-def]
    """(line that failed or count, x, y)."""
    if direction:
        x, y = ox * radius, oy * radius
    elif ox * ox + oy * oy > radius * radius:
        norm = sqrt(ox * ox + oy * oy)
        x, y = ox / norm * radius, oy / norm * radius
    else:
        x, y = ox, oy
    for i in range(count):
        if lines[i, 2] * (lines[i, 1] - y) - lines[i, 3] * (lines[i, 0] - x) > 0.0:
            found, nx, ny = _lp1(lines, i, radius, ox, oy, direction)
            if not found:
                return i, x, y
            x, y = nx, ny
    return count, x, y


@njit(cache=True)
def _lp3(lines, count, hard, begin, radius, x, y):  # type: ignore[no-untyped-def]
    """No velocity satisfies all: minimise the worst violation; the first `hard` lines hold."""
    distance = 0.0
    projected = np.empty((count, 4))
    for i in range(begin, count):
        if lines[i, 2] * (lines[i, 1] - y) - lines[i, 3] * (lines[i, 0] - x) <= distance:
            continue
        n = hard
        projected[:hard] = lines[:hard]
        for j in range(hard, i):
            determinant = lines[i, 2] * lines[j, 3] - lines[i, 3] * lines[j, 2]
            if abs(determinant) <= EPSILON:
                if lines[i, 2] * lines[j, 2] + lines[i, 3] * lines[j, 3] > 0.0:
                    continue
                projected[n, 0] = 0.5 * (lines[i, 0] + lines[j, 0])
                projected[n, 1] = 0.5 * (lines[i, 1] + lines[j, 1])
            else:
                t = (
                    lines[j, 2] * (lines[i, 1] - lines[j, 1])
                    - lines[j, 3] * (lines[i, 0] - lines[j, 0])
                ) / determinant
                projected[n, 0] = lines[i, 0] + t * lines[i, 2]
                projected[n, 1] = lines[i, 1] + t * lines[i, 3]
            dx, dy = lines[j, 2] - lines[i, 2], lines[j, 3] - lines[i, 3]
            norm = sqrt(dx * dx + dy * dy)
            projected[n, 2], projected[n, 3] = dx / norm, dy / norm
            n += 1
        failed, nx, ny = _lp2(projected, n, radius, -lines[i, 3], lines[i, 2], True)
        if failed >= n:
            x, y = nx, ny  # else floating point broke the theorem: keep the current result
        distance = lines[i, 2] * (lines[i, 1] - y) - lines[i, 3] * (lines[i, 0] - x)
    return x, y


@njit(cache=True)
def avoid(vx, vy, wx, wy, speed_max, horizon_s, dt_s, rows, count, hard, lines):  # type: ignore[no-untyped-def]
    """Own velocity, wanted velocity, neighbour rows (`COLUMNS`): the velocity to take, m/s.

    The first `hard` lines are there already (fences); the neighbours' come after them.
    """
    for i in range(count):
        k = hard + i
        px, py, ovx, ovy, radius, share = rows[i]
        rvx, rvy = vx - ovx, vy - ovy
        distance2, radius2 = px * px + py * py, radius * radius
        if distance2 > radius2:
            wx_, wy_ = rvx - px / horizon_s, rvy - py / horizon_s
            w2 = wx_ * wx_ + wy_ * wy_
            dot = wx_ * px + wy_ * py
            if dot < 0.0 and dot * dot > radius2 * w2:  # on the cut-off circle
                w = sqrt(w2)
                ux, uy = wx_ / w, wy_ / w
                lines[k, 2], lines[k, 3] = uy, -ux
                scale = radius / horizon_s - w
                ux, uy = scale * ux, scale * uy
            else:  # on a leg
                leg = sqrt(distance2 - radius2)
                if px * wy_ - py * wx_ > 0.0:
                    dx, dy = (
                        (px * leg - py * radius) / distance2,
                        (px * radius + py * leg) / distance2,
                    )
                else:
                    dx, dy = (
                        -(px * leg + py * radius) / distance2,
                        -(-px * radius + py * leg) / distance2,
                    )
                lines[k, 2], lines[k, 3] = dx, dy
                along = rvx * dx + rvy * dy
                ux, uy = along * dx - rvx, along * dy - rvy
        else:  # touching already: be apart within one period
            wx_, wy_ = rvx - px / dt_s, rvy - py / dt_s
            w = sqrt(wx_ * wx_ + wy_ * wy_)
            if w < EPSILON:
                wx_, wy_, w = 1.0, 0.0, 1.0
            ux, uy = wx_ / w, wy_ / w
            lines[k, 2], lines[k, 3] = uy, -ux
            scale = radius / dt_s - w
            ux, uy = scale * ux, scale * uy
        lines[k, 0], lines[k, 1] = vx + share * ux, vy + share * uy
    failed, x, y = _lp2(lines, hard + count, speed_max, wx, wy, False)
    if failed < hard + count:
        x, y = _lp3(lines, hard + count, hard, failed, speed_max, x, y)
    return x, y


@njit(cache=True)
def fence_lines(x, y, radius, braking_m_s2, reach, fences, lines):  # type: ignore[no-untyped-def]
    """Half-planes that keep a body from fences: towards one only as fast as it can still brake.

    `fences`: ax, ay, bx, by a row. Returns how many lines were written.
    """
    n = 0
    for k in range(fences.shape[0]):
        ax, ay, bx, by = fences[k]
        ex, ey = bx - ax, by - ay
        t = ((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey)
        t = min(max(t, 0.0), 1.0)
        dx, dy = ax + t * ex - x, ay + t * ey - y
        distance = sqrt(dx * dx + dy * dy)
        if distance > reach or distance < 1e-9 or n >= lines.shape[0]:
            continue
        nx, ny = dx / distance, dy / distance
        room = distance - radius
        limit = (
            min(sqrt(2.0 * braking_m_s2 * room), room / FENCE_S) if room > 0.0 else max(room, -0.5)
        )
        lines[n, 0], lines[n, 1] = nx * limit, ny * limit
        lines[n, 2], lines[n, 3] = -ny, nx
        n += 1
    return n


class Avoidance:
    """One robot's ORCA with its scratch memory."""

    def __init__(
        self,
        radius_m: float,
        speed_max_m_s: float,
        braking_m_s2: float,
        horizon_s: float,
        dt_s: float,
        fences: NDArray[np.float64],
    ) -> None:
        self.radius_m, self.speed_max_m_s, self.braking_m_s2 = radius_m, speed_max_m_s, braking_m_s2
        self.horizon_s, self.dt_s, self.fences = horizon_s, dt_s, fences
        self.reach_m = radius_m + speed_max_m_s**2 / (2 * braking_m_s2) + speed_max_m_s * dt_s
        self._rows: NDArray[np.float64] = np.zeros((LINES_MAX, COLUMNS))
        self._lines: NDArray[np.float64] = np.zeros((2 * LINES_MAX, 4))

    def velocity(
        self,
        at: tuple[float, float],
        own: tuple[float, float],
        wanted: tuple[float, float],
        rows: list[tuple[float, ...]],
    ) -> tuple[float, float]:
        """`rows`: dx, dy, vx, vy, combined radius, share; nearest first, at most `LINES_MAX`."""
        count = min(len(rows), LINES_MAX)
        for k in range(count):
            self._rows[k] = rows[k]
        hard = fence_lines(at[0], at[1], self.radius_m, self.braking_m_s2, self.reach_m,
                           self.fences, self._lines[:LINES_MAX])  # fmt: skip
        if not rows and hard == 0:
            return wanted
        x, y = avoid(own[0], own[1], wanted[0], wanted[1], self.speed_max_m_s, self.horizon_s,
                     self.dt_s, self._rows, count, hard, self._lines)  # fmt: skip
        return float(x), float(y)
