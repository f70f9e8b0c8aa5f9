"""Echoes of the range sensors that neither the map nor the beats of other robots explain.

Safety does not depend on messages. The sensors also see a robot whose beats are lost, or a box that
a person put down. An echo is unexplained if it lies off every known wall and every received robot.
"""

from collections.abc import Iterable, Sequence
from math import cos, dist, inf, nan, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from agent.interface.geometry import Point
from agent.interface.observation import Observation
from agent.kernels.kernel import njit

Floats = NDArray[np.float64]
NO_WALLS = np.empty((0, 4))
# Where more echoes are near than ORCA takes, one of several that are so near to each other stands for
# all: first within the one distance, then within twice as much, up to the other.
THIN_MIN_M, THIN_MAX_M = 0.1, 0.4
WALL_M = 0.12  # an echo this near to a wall is the wall: errors of range and position
# An echo this near to a body is the body: its beat is rounded, and it has moved since.
BODY_M = 0.25


@njit(cache=True, error_model="numpy")
def _echoes(
    x: float,
    y: float,
    heading: float,
    ranges: Floats,
    reach: float,
    walls: Floats,
    bodies: Floats,
    found: Floats,
) -> None:
    """Write to `found` (rays, 2) where each ray ends, or NaN if the echo is explained.

    `ranges` (rays,) up to `reach`; `walls` (n, 4) and `bodies` (n, 3: x, y, radius); metres.
    """
    for n in range(ranges.shape[0]):
        found[n, 0] = found[n, 1] = nan
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
            found[n, 0], found[n, 1] = hx, hy


def echoes(
    here: Observation,
    reach_m: float,
    bodies: Sequence[Sequence[float]],
    walls: NDArray[np.float64] = NO_WALLS,
) -> NDArray[np.float64]:
    """Where each ray of an observation ends, (rays, 2) of x, y in metres.

    NaN for a ray that ends beyond `reach_m`, or on a known body or wall. `bodies`: rows of x, y and
    radius, metres. `walls`: segments (n, 4) of ax, ay, bx, by in metres.
    """
    ranges = np.array(here.ranges_m)
    found = np.full((ranges.size, 2), nan)
    if ranges.min(initial=inf) < reach_m:
        known = np.array(bodies, dtype=np.float64).reshape(-1, 3)
        _echoes(here.x_m, here.y_m, here.heading_rad, ranges, reach_m, walls, known, found)
    return found


class UnexplainedEchoes:
    """Compares one robot's scans with the known walls and with the robots that it receives."""

    def __init__(self, walls: NDArray[np.float64], radius_m: float) -> None:
        """`walls`: known segments (n, 4) of ax, ay, bx, by in metres. `radius_m`: of every body."""
        self.walls, self.radius_m = walls, radius_m

    def strange(
        self, here: Observation, reach_m: float, bodies: Iterable[Sequence[float]]
    ) -> list[Point]:
        """Unexplained echoes within `reach_m` of us, (x, y) metres.

        `here`: the observation with its rays. `bodies`: x, y of the known robots, extrapolated to
        now.
        """
        known = [(x, y, self.radius_m + BODY_M) for x, y in bodies]
        found = echoes(here, reach_m, known, self.walls)
        return [(x, y) for x, y in found[~np.isnan(found[:, 0])].tolist()]


def thinned(points: list[Point], most: int) -> list[Point]:
    """At most `most` of these echoes, if so few say the same.

    `points`: (x, y) metres in the order of rays. A sensor of many rays sees a box as dozens of echoes.
    As so many neighbours they would hide from ORCA the robots behind it. More than `most` are returned
    where they are far apart.
    """
    apart_m = THIN_MIN_M
    kept = points
    while len(kept) > most and apart_m <= THIN_MAX_M:
        kept = points[:1]
        for point in points[1:]:
            if dist(point, kept[-1]) >= apart_m:
                kept.append(point)
        apart_m *= 2.0
    return kept
