"""Braking before fences comes first when a body cannot take the commanded velocity at once.

ORCA chooses a velocity as if the body could brake towards a fence with half of its acceleration. A
body with four wheels turns its velocity by one acceleration vector. A large change along the fence
would leave too little of it for braking, so that change is reduced.

Wheels that slip move a body otherwise than they turn. So a velocity that is kept along a fence is that
of the wheels, because commands that followed what slip adds would speed the body up. And a body that
has to brake hard before a fence is told to make up for what slip adds towards it.
"""

from math import hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from agent.kernels.kernel import njit

Floats = NDArray[np.float64]

LINE_2_M2 = 1e-18  # least squared length of a fence; a single echo is a fence without length
# Of the acceleration: ORCA takes no more than half of it for braking before a fence, so a body that needs
# more has slipped towards it, or was pushed.
HARD_SHARE = 0.5
ROOM_MIN_M = 0.01  # a body this near to a fence, or nearer, uses all of its acceleration to brake


@njit(cache=True, error_model="numpy")
def braking_first(
    x: float, y: float, vx: float, vy: float, wx: float, wy: float, tx: float, ty: float,
    fences: Floats, radius_m: float, acceleration_m_s2: float,
) -> tuple[float, float]:  # fmt: skip
    """The velocity to command, (x, y) metres a second.

    (x, y): the body, metres. (vx, vy): its velocity, (wx, wy): the chosen one, (tx, ty): that of wheels
    without slip by the commands so far, metres a second.
    `fences` (n, 4): ax, ay, bx, by, metres. `radius_m`: of the body. If the change from the one to
    the other does not brake fast enough towards the fence before which the body has to brake most, its
    part along that fence is reduced. Only that one counts: on a round outline of short edges each
    reduction would undo the braking before another edge.
    """
    most_share, most_nx, most_ny = 0.0, 0.0, 0.0
    for k in range(fences.shape[0]):
        ax, ay = fences[k, 0], fences[k, 1]
        ex, ey = fences[k, 2] - ax, fences[k, 3] - ay
        t = ((x - ax) * ex + (y - ay) * ey) / max(ex * ex + ey * ey, LINE_2_M2)
        t = min(max(t, 0.0), 1.0)
        nx, ny = ax + t * ex - x, ay + t * ey - y
        gap_m = hypot(nx, ny)
        if gap_m < LINE_2_M2:
            continue
        nx, ny = nx / gap_m, ny / gap_m
        closing_m_s = vx * nx + vy * ny
        if closing_m_s <= 0.0:
            continue
        room_m = max(gap_m - radius_m, ROOM_MIN_M)
        share = closing_m_s * closing_m_s / (2.0 * room_m * acceleration_m_s2)
        if share > most_share:
            most_share, most_nx, most_ny = share, nx, ny
    nx, ny = most_nx, most_ny
    brakes_m_s = (vx - wx) * nx + (vy - wy) * ny
    if most_share == 0.0 or brakes_m_s <= 0.0:
        return wx, wy
    along_m_s = -(wx - vx) * ny + (wy - vy) * nx
    most_m_s = brakes_m_s * sqrt(max(1.0 / (most_share * most_share) - 1.0, 0.0))
    if abs(along_m_s) > most_m_s:
        along_m_s = most_m_s if along_m_s > 0.0 else -most_m_s
        slips_m_s = -(vx - tx) * ny + (vy - ty) * nx
        keeps_m_s = -vx * ny + vy * nx + along_m_s
        if slips_m_s * keeps_m_s > 0.0:
            along_m_s -= slips_m_s if abs(slips_m_s) < abs(keeps_m_s) else keeps_m_s
        wx = vx - brakes_m_s * nx - along_m_s * ny
        wy = vy - brakes_m_s * ny + along_m_s * nx
    slips_m_s = (vx - tx) * nx + (vy - ty) * ny
    if most_share > HARD_SHARE and slips_m_s > 0.0:
        wx, wy = wx - slips_m_s * nx, wy - slips_m_s * ny
    return wx, wy
