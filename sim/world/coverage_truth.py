"""The ground that was really worked, from true tracks and nothing else.

The implement is a bar of the full working width through the robot's centre, at right angles to its
motion; where the motion turns, the bar swings with it. It works while the implement is down. A cell
counts when its centre was swept.

The area asked for is everything the bar reaches with the robot's centre half a width inside the
fences, less half the overlap, which is the tolerance of driving:
`polygon.buffer(-width / 2).buffer((width - overlap) / 2)`. `sim/world/reachable_ground.py` computes
which part of it a body can reach, and a run is judged by that part.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon

from sim.world.ground_truth import Track, TrackPoint
from sim.world.raster import Raster, fitting_m, rasterise

Floats = NDArray[np.float64]
# By slot. An array is (points, 4), see `strokes_of`.
Tracks = Mapping[int, Track | Sequence[TrackPoint] | Floats]

MERGE_M = 0.05  # shorter moves have no reliable direction: slip, and coming to rest
BACK_COS = -0.985  # a turn of more than 170 degrees is reversing: the bar does not swing
AGAIN_WIDTHS = 2.0  # a robot that has driven this many widths since it worked a cell works it again
NEVER_US = np.iinfo(np.int64).max


class Coverage(NamedTuple):
    """What was worked of an area that was asked for, by all robots together and by each."""

    share: float  # of the area asked for
    twice: float  # share worked by two robots or more
    again: float  # share worked again by a robot that had worked it before
    last_at_us: int  # when the last cell was first worked
    uncovered: Floats  # (n, 2): centres of the cells never worked
    area_m2: float  # the area asked for
    worked_m2: dict[int, float]  # of that area, by each robot
    reached: float  # share worked of what can be reached
    missed: Floats  # (n, 2): centres of the cells that can be reached and were never worked


def sample_points(
    polygon: Polygon | MultiPolygon, width_m: float, overlap_m: float, raster_m: float = 0.25
) -> Raster:
    """The cells of the area that can be asked for, of `raster_m` or as coarse as its extent needs."""
    assert 0.0 <= overlap_m < width_m
    area = polygon.buffer(-width_m / 2).buffer((width_m - overlap_m) / 2)
    return rasterise(area, fitting_m(area, raster_m))


def coverage(
    raster: Raster, tracks: Tracks, width_m: float, reachable: NDArray[np.bool_] | None = None
) -> Coverage:
    """Sweep an implement of `width_m` along the tracks, and count what it worked.

    `reachable`: (rows, columns), the cells of the raster that the bodies can work; None: all.
    """
    shape = raster.cells.shape
    robots = np.zeros(shape, dtype=np.uint8)
    again = np.zeros(shape, dtype=np.bool_)
    first_at_us = np.full(shape, NEVER_US)
    worked_m2: dict[int, float] = {}
    place = np.array([raster.west_m, raster.south_m, raster.cell_m])
    for slot, track in sorted(tracks.items()):
        driven = np.full(shape, -1.0, dtype=np.float32)
        _sweep(strokes_of(track), width_m, place, raster.cells, first_at_us, driven, again)
        mine = driven >= 0.0
        robots += mine
        worked_m2[slot] = float(np.count_nonzero(mine)) * raster.cell_m**2
    asked = int(np.count_nonzero(raster.cells))
    worked = robots > 0
    can = raster.cells if reachable is None else reachable
    return Coverage(
        share=float(np.count_nonzero(worked)) / max(asked, 1),
        twice=float(np.count_nonzero(robots > 1)) / max(asked, 1),
        again=float(np.count_nonzero(again)) / max(asked, 1),
        last_at_us=int(first_at_us[worked].max()) if worked.any() else 0,
        uncovered=raster.centres(raster.cells & ~worked),
        area_m2=raster.area_m2,
        worked_m2=worked_m2,
        reached=float(np.count_nonzero(worked & can)) / max(int(np.count_nonzero(can)), 1),
        missed=raster.centres(can & ~worked),
    )


def strokes_of(track: Track | Sequence[TrackPoint] | Floats) -> Floats:
    """The straight pieces worked, short ones merged, as an array (n, 8).

    Each row: from x, y, to x, y, metres; microseconds; metres driven so far; and the course before,
    a unit vector (0, 0 at the beginning of a run). `track` as an array is (points, 4):
    microseconds, x, y, and 1 if the implement is down.
    """
    points = track.to_array() if isinstance(track, Track) else np.asarray(track, dtype=np.float64)
    strokes: Floats = _strokes(points.reshape(-1, 4))
    return strokes


@njit(cache=True, error_model="numpy")
def _strokes(track):  # type: ignore[no-untyped-def]
    out = np.empty((max(track.shape[0] - 1, 0), 8))
    found, working, has_course = 0, False, False
    ax = ay = cx = cy = driven = 0.0
    for k in range(track.shape[0] - 1):
        if track[k, 3] == 0.0:
            working = False
            driven += np.hypot(track[k + 1, 1] - track[k, 1], track[k + 1, 2] - track[k, 2])
            continue
        if not working:
            working, has_course = True, False
            ax, ay = track[k, 1], track[k, 2]
        last = k + 2 == track.shape[0] or track[k + 1, 3] == 0.0
        dx, dy = track[k + 1, 1] - ax, track[k + 1, 2] - ay
        length = np.hypot(dx, dy)
        if length < MERGE_M and not last:
            continue
        if length < MERGE_M and has_course:  # the end of a run continues in the last direction
            along = max(dx * cx + dy * cy, 0.0)
            dx, dy = along * cx, along * cy
        if length < 1e-9:
            continue
        driven += length
        was_x, was_y = (cx, cy) if has_course else (0.0, 0.0)
        if length >= MERGE_M or not has_course:
            cx, cy, has_course = dx / length, dy / length, True
        out[found] = ax, ay, ax + dx, ay + dy, track[k + 1, 0], driven, was_x, was_y
        found += 1
        ax, ay = ax + dx, ay + dy
    return out[:found]


@njit(cache=True, error_model="numpy")
def _swung(rx, ry, was_x, was_y, cx, cy):  # type: ignore[no-untyped-def]
    """Whether the bar passed over a point when its course turned; the shorter way round."""
    left = 1.0 if was_x * cy - was_y * cx > 0.0 else -1.0
    # The bar's right end goes from the right of the old course to the right of the new one.
    from_old = left * (was_y * ry + was_x * rx)
    to_new = -left * (rx * cx + ry * cy)
    return (from_old >= 0.0 and to_new >= 0.0) or (from_old <= 0.0 and to_new <= 0.0)


@njit(cache=True, error_model="numpy")
def cells_near(a, b, margin, origin, side, count):  # type: ignore[no-untyped-def]
    """First column or row that a stroke from `a` to `b` comes within `margin` of, and one past the
    last. Metres; `origin` is where the raster begins, `side` the width of a cell."""
    first = int((min(a, b) - margin - origin) / side)
    last = int((max(a, b) + margin - origin) / side)
    return max(first, 0), min(last, count - 1) + 1


@njit(cache=True, error_model="numpy")
def _sweep(strokes, width, place, cells, first_at_us, driven, again):  # type: ignore[no-untyped-def]
    """Mark the cells under the bar along each stroke, and under its swing before it."""
    west, south, side = place
    rows, columns = cells.shape
    half = width / 2 + 1e-9
    for k in range(strokes.shape[0]):
        ax, ay, bx, by, t_us, way, was_x, was_y = strokes[k]
        length = np.hypot(bx - ax, by - ay)
        if length == 0.0:
            continue
        cx, cy = (bx - ax) / length, (by - ay) / length
        turned = (was_x != 0.0 or was_y != 0.0) and was_x * cx + was_y * cy > BACK_COS
        for r in range(*cells_near(ay, by, half, south, side, rows)):
            ry = south + (r + 0.5) * side - ay
            for c in range(*cells_near(ax, bx, half, west, side, columns)):
                if not cells[r, c]:
                    continue
                rx = west + (c + 0.5) * side - ax
                along, across = rx * cx + ry * cy, abs(rx * cy - ry * cx)
                under = -1e-9 <= along <= length + 1e-9 and across <= half
                if not under and turned and rx * rx + ry * ry <= half * half:
                    under = _swung(rx, ry, was_x, was_y, cx, cy)
                if under:
                    before = driven[r, c]
                    if before >= 0.0 and way - before > AGAIN_WIDTHS * width:
                        again[r, c] = True
                    driven[r, c] = way
                    first_at_us[r, c] = min(first_at_us[r, c], np.int64(t_us))
