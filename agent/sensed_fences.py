"""Fences from range sensors: what ORCA keeps from where nobody knows the walls beforehand.

Echoes of neighbouring rays that are near each other are sides of one thing and joined; a lone echo is
a point. Echoes of robots are left out, ORCA has those from their poses.
"""

from collections.abc import Iterable
from math import cos, hypot, inf, isfinite, pi, sin

import numpy as np
from numpy.typing import NDArray

from agent.ports import Observation

JOINED_M = 0.5  # echoes further apart may have a door between them
OTHER_M = 0.15  # beyond a robot's radius: poses are rounded to 0.05 m and are a beat old
NEAR_M = 1.5  # further echoes cannot be met before the next scan by anything this small and slow


def fences_of(
    here: Observation, others: Iterable[tuple[float, float, float]]
) -> NDArray[np.float64]:
    """Segments (n, 4) in metres: ax, ay, bx, by. `others`: x, y and radius of robots."""
    known = list(others)
    count = len(here.ranges_m)
    points: list[tuple[float, float] | None] = []
    for k, range_m in enumerate(here.ranges_m):
        if not isfinite(range_m) or range_m > NEAR_M:
            points.append(None)
            continue
        angle = here.heading_rad + 2 * pi * k / count
        x, y = here.x_m + range_m * cos(angle), here.y_m + range_m * sin(angle)
        robot = any(hypot(x - a, y - b) < r + OTHER_M for a, b, r in known)
        points.append(None if robot else (x, y))
    rows = []
    for k, a in enumerate(points):
        b = points[(k + 1) % count]
        if a is None:
            continue
        gap_m = inf if b is None else hypot(b[0] - a[0], b[1] - a[1])
        rows.append((*a, *(b if b is not None and gap_m < JOINED_M else a)))
    return np.array(rows, dtype=np.float64).reshape(-1, 4)
