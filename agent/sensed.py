"""What the range sensors see that neither the map nor the others' beats explain.

Safety does not depend on messages: a robot whose beats are lost, and a box that somebody put down,
are seen. A hit is strange where it lies off every wall and off every robot that was heard.
"""

from collections.abc import Iterable, Sequence
from math import cos, inf, isfinite, pi, sin, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from agent.ports import Observation

Point = tuple[float, float]
WALL_M = 0.12  # a hit this near to a wall is the wall: errors of range and of place
BODY_M = 0.25  # and this near to a body, that body: its beat is rounded, and it has moved since


@njit(cache=True, error_model="numpy")
def _strange(x, y, heading, ranges, reach, walls, bodies, found):  # type: ignore[no-untyped-def]
    """Write strange hits to `found` (n, 2), nearest rays in their order; returns how many."""
    count = 0
    for n in range(ranges.shape[0]):
        r = ranges[n]
        if not r < reach:
            continue
        angle = heading + n * 2 * pi / ranges.shape[0]
        hx, hy = x + r * cos(angle), y + r * sin(angle)
        known = False
        for k in range(bodies.shape[0]):
            dx, dy, radius = hx - bodies[k, 0], hy - bodies[k, 1], bodies[k, 2]
            if dx * dx + dy * dy < radius * radius:
                known = True
                break
        if known:
            continue
        for k in range(walls.shape[0]):
            ax, ay = walls[k, 0], walls[k, 1]
            ex, ey = walls[k, 2] - ax, walls[k, 3] - ay
            t = ((hx - ax) * ex + (hy - ay) * ey) / (ex * ex + ey * ey)
            t = min(max(t, 0.0), 1.0)
            if sqrt((ax + t * ex - hx) ** 2 + (ay + t * ey - hy) ** 2) < WALL_M:
                known = True
                break
        if not known:
            found[count, 0], found[count, 1] = hx, hy
            count += 1
    return count


class Sensed:
    """Strange hits of one robot. `walls`: segments (n, 4), metres."""

    def __init__(self, walls: NDArray[np.float64], radius_m: float) -> None:
        self.walls, self.radius_m = walls, radius_m

    def strange(
        self, here: Observation, reach_m: float, bodies: Iterable[Sequence[float]]
    ) -> list[Point]:
        """`bodies`: x, y of those that were heard, where they should be now."""
        ranges = np.array(here.ranges_m)
        if not ranges.size or not isfinite(ranges.min(initial=inf)):
            return []
        known = np.array([(x, y, self.radius_m + BODY_M) for x, y in bodies]).reshape(-1, 3)
        found = np.empty((ranges.size, 2))
        count = _strange(
            here.x_m, here.y_m, here.heading_rad, ranges, reach_m, self.walls, known, found
        )
        return [(x, y) for x, y in found[:count].tolist()]
