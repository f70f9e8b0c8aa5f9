"""What has really been worked, from true tracks and nothing else.

The implement is a bar of the full working width through the robot's centre, at right angles to its
motion; where the motion turns, the bar swings with it. It works while the implement is down. A cell
counts when its centre was swept.

What can be asked for: everything the bar reaches with the robot's centre half a width inside the
fences, less half the overlap, which is the tolerance of driving:
`polygon.buffer(-width / 2).buffer((width - overlap) / 2)`.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import ceil, hypot
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon

from sim.raster import Raster, rasterise
from sim.truth import Track, TrackPoint

Floats = NDArray[np.float64]
Polyline = Sequence[tuple[float, float]]
Tracks = Mapping[int, Track | Sequence[TrackPoint] | Floats]

MERGE_M = 0.05  # shorter moves have no direction worth a name: slip, and coming to rest
BACK_COS = -0.985  # a turn by more than 170 degrees is going back: the bar does not swing
AGAIN_WIDTHS = 2.0  # a robot that drove this many widths since it worked a cell works it again
NEVER_US = np.iinfo(np.int64).max
SAMPLE_M = 0.25  # along the units
ALONG_COS = 0.87  # the implement passed along a line, not across it: within 30 degrees
AX, AY, BX, BY, T_US, DRIVEN, WAS_X, WAS_Y = range(8)  # one stroke; WAS: its course before


class Coverage(NamedTuple):
    share: float  # of the area asked for
    twice: float  # share worked by two robots or more
    again: float  # share worked again by a robot that had worked it before
    last_us: int  # when the last cell was first worked
    uncovered: Floats  # (n, 2): centres of the cells never worked
    area_m2: float  # asked for
    worked_m2: dict[int, float]  # of it, by each robot


def sample_points(
    polygon: Polygon | MultiPolygon, width_m: float, overlap_m: float, raster_m: float = 0.25
) -> Raster:
    """The cells of the area that can be asked for."""
    assert 0.0 <= overlap_m < width_m
    return rasterise(polygon.buffer(-width_m / 2).buffer((width_m - overlap_m) / 2), raster_m)


def coverage(raster: Raster, tracks: Tracks, width_m: float) -> Coverage:
    """Sweep the tracks over the cells."""
    shape = raster.cells.shape
    robots = np.zeros(shape, dtype=np.uint8)
    again = np.zeros(shape, dtype=np.bool_)
    first_us = np.full(shape, NEVER_US)
    worked_m2: dict[int, float] = {}
    place = np.array([raster.west_m, raster.south_m, raster.cell_m])
    for slot, track in sorted(tracks.items()):
        driven = np.full(shape, -1.0, dtype=np.float32)
        lines = _strokes(_points(track))
        _sweep(lines, width_m, place, raster.cells, first_us, driven, again)
        mine = driven >= 0.0
        robots += mine
        worked_m2[slot] = float(np.count_nonzero(mine)) * raster.cell_m**2
    asked = int(np.count_nonzero(raster.cells))
    worked = robots > 0
    return Coverage(
        share=float(np.count_nonzero(worked)) / max(asked, 1),
        twice=float(np.count_nonzero(robots > 1)) / max(asked, 1),
        again=float(np.count_nonzero(again)) / max(asked, 1),
        last_us=int(first_us[worked].max()) if worked.any() else 0,
        uncovered=raster.centres(raster.cells & ~worked),
        area_m2=raster.area_m2,
        worked_m2=worked_m2,
    )


def units_worked(lines: Sequence[Polyline], tracks: Tracks, tolerance_m: float) -> Floats:
    """Share of each line that an implement passed along, either way, centre within tolerance."""
    samples, owners = [], []
    for owner, line in enumerate(lines):
        for a, b in pairwise(line):
            length_m = hypot(b[0] - a[0], b[1] - a[1])
            count = max(1, ceil(length_m / SAMPLE_M))
            step = (np.arange(count) + 0.5)[:, None] / count
            course = np.array([(b[0] - a[0], b[1] - a[1])]) / max(length_m, 1e-12)
            at = np.array([a]) + step * np.array([(b[0] - a[0], b[1] - a[1])])
            samples.append(np.hstack((at, np.repeat(course, count, axis=0))))
            owners.append(np.full(count, owner))
    if not samples:
        return np.zeros(len(lines))
    table, owner_of = np.vstack(samples), np.concatenate(owners)
    low = table[:, :2].min(axis=0)
    side_m = max(1.0, 2 * tolerance_m)
    columns, rows = (int(n) + 1 for n in (table[:, :2].max(axis=0) - low) / side_m)
    bucket = ((table[:, :2] - low) / side_m).astype(np.int64) @ np.array([1, columns])
    order = np.argsort(bucket, kind="stable")
    ordered = table[order]
    begins = np.searchsorted(bucket[order], np.arange(columns * rows + 1))
    passed = np.zeros(len(table), dtype=np.bool_)
    place = np.array([low[0], low[1], side_m])
    for _, track in sorted(tracks.items()):
        strokes = _strokes(_points(track))
        _pass(strokes, tolerance_m, place, (rows, columns), ordered, begins, passed)
    hits = np.bincount(owner_of[order], weights=passed, minlength=len(lines))
    return hits / np.maximum(np.bincount(owner_of, minlength=len(lines)), 1)


def _points(track: Track | Sequence[TrackPoint] | Floats) -> Floats:
    """(n, 4): microseconds, x, y, implement down."""
    if isinstance(track, Track):
        return track.to_array()
    return np.asarray(track, dtype=np.float64).reshape(-1, 4)


@njit(cache=True)
def _strokes(track):  # type: ignore[no-untyped-def]
    """The straight pieces driven with the implement down, short ones merged; see `AX`..."""
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
        if length < MERGE_M and has_course:  # the end of a run: on in the last direction
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


@njit(cache=True)
def _swung(rx, ry, was_x, was_y, cx, cy):  # type: ignore[no-untyped-def]
    """Whether the bar passed over a point when its course turned; the shorter way round."""
    left = 1.0 if was_x * cy - was_y * cx > 0.0 else -1.0
    # The bar's right end goes from the right of the old course to the right of the new one.
    from_old = left * (was_y * ry + was_x * rx)
    to_new = -left * (rx * cx + ry * cy)
    return (from_old >= 0.0 and to_new >= 0.0) or (from_old <= 0.0 and to_new <= 0.0)


@njit(cache=True)
def _reach(a, b, margin, origin, side, count):  # type: ignore[no-untyped-def]
    """First and one past the last column, or row, that a stroke comes near to."""
    first = int((min(a, b) - margin - origin) / side)
    last = int((max(a, b) + margin - origin) / side)
    return max(first, 0), min(last, count - 1) + 1


@njit(cache=True)
def _sweep(strokes, width, place, cells, first_us, driven, again):  # type: ignore[no-untyped-def]
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
        for r in range(*_reach(ay, by, half, south, side, rows)):
            ry = south + (r + 0.5) * side - ay
            for c in range(*_reach(ax, bx, half, west, side, columns)):
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
                    first_us[r, c] = min(first_us[r, c], np.int64(t_us))


@njit(cache=True)
def _pass(strokes, tolerance, place, shape, samples, begins, passed):  # type: ignore[no-untyped-def]
    """Flag the samples (x, y, course) that a stroke passed along."""
    west, south, side = place
    for k in range(strokes.shape[0]):
        ax, ay, bx, by = strokes[k, AX], strokes[k, AY], strokes[k, BX], strokes[k, BY]
        length = np.hypot(bx - ax, by - ay)
        if length == 0.0:
            continue
        cx, cy = (bx - ax) / length, (by - ay) / length
        for r in range(*_reach(ay, by, tolerance, south, side, shape[0])):
            for c in range(*_reach(ax, bx, tolerance, west, side, shape[1])):
                bucket = r * shape[1] + c
                for n in range(begins[bucket], begins[bucket + 1]):
                    rx, ry = samples[n, 0] - ax, samples[n, 1] - ay
                    along, across = rx * cx + ry * cy, abs(rx * cy - ry * cx)
                    if -1e-9 <= along <= length + 1e-9 and across <= tolerance:
                        straight = abs(cx * samples[n, 2] + cy * samples[n, 3])
                        passed[n] = passed[n] or straight >= ALONG_COS
