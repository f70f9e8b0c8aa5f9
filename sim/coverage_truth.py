"""What has really been worked: sample points of the reachable area, swept by true tracks.

The implement serves a disc of its width around the robot's centre while it is down. The area that
can be asked for is what such a disc reaches with its centre half a width inside the fences, but for
half the overlap along the fence, which is the tolerance of driving. Reads tracks of the world only.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapely.geometry import Polygon

TrackPoint = tuple[int, float, float, bool]  # microseconds, x, y, implement down


class Coverage(NamedTuple):
    share: float  # of the sample points
    twice: float  # share of points worked by two robots
    last_us: int  # when the last point was first worked
    uncovered: NDArray[np.float64]  # (n, 2) points never worked


def sample_points(polygon: Polygon, width_m: float, overlap_m: float, raster_m: float) -> NDArray[np.float64]:
    """Points of the area that must be worked, on a raster."""
    reachable = polygon.buffer(-width_m / 2).buffer((width_m - overlap_m) / 2)
    required = reachable.intersection(polygon.buffer(-overlap_m / 2))
    west, south, east, north = required.bounds
    x_m, y_m = np.meshgrid(
        np.arange(west + raster_m / 2, east, raster_m), np.arange(south + raster_m / 2, north, raster_m)
    )
    shapely.prepare(required)
    inside = shapely.contains_xy(required, x_m, y_m)
    return np.column_stack((x_m[inside], y_m[inside]))


def coverage(
    points: NDArray[np.float64], tracks: Mapping[int, Sequence[TrackPoint]], width_m: float
) -> Coverage:
    """Sweep the tracks over the sample points. A track is straight between its positions."""
    tree = cKDTree(points)
    first_us = np.full(len(points), np.iinfo(np.int64).max)
    robots = np.zeros(len(points), dtype=np.int32)
    for _, track in sorted(tracks.items()):
        mine = np.zeros(len(points), dtype=bool)
        for a, b in zip(track, track[1:], strict=False):
            if not (a[3] and b[3]):
                continue
            hit = _near(points, tree, (a[1], a[2]), (b[1], b[2]), width_m / 2)
            mine[hit] = True
            first_us[hit] = np.minimum(first_us[hit], b[0])
        robots += mine
    worked = robots > 0
    last_us = int(first_us[worked].max()) if worked.any() else 0
    return Coverage(float(worked.mean()), float((robots > 1).mean()), last_us, points[~worked])


def _near(
    points: NDArray[np.float64], tree: cKDTree, a: tuple[float, float], b: tuple[float, float], reach_m: float
) -> NDArray[np.int64]:
    """Indices of the points within reach of a short segment."""
    middle = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
    d = np.array((b[0] - a[0], b[1] - a[1]))
    length = float(np.hypot(*d))
    index = np.asarray(tree.query_ball_point(middle, reach_m + length / 2), dtype=np.int64)
    if index.size == 0 or length < 1e-9:
        return index
    offset = points[index] - np.array(a)
    along = np.clip(offset @ d / (length * length), 0.0, 1.0)
    distance = np.hypot(*(offset - along[:, None] * d).T)
    return index[distance <= reach_m]
