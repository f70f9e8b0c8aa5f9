"""Dividing a field: headland rings along the fences, parallel swaths inside, bundled to sections.

With implement width w and overlap v, the ring runs w/2 inside the fence and serves everything up to
w - v from it. What is deeper is cut into strips not wider than w - v at the best angle. Each
strip's swath is as long as the strip is deep inside. So a robot on a swath is never nearer to a
fence than (w - v) / 2, and ring and strips together leave nothing out
(`tests/agent/field/test_field_division.py`).
"""

from collections.abc import Sequence
from math import atan2, ceil, degrees
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import affinity
from shapely.geometry import LineString, MultiLineString, Polygon
from shapely.geometry.base import BaseGeometry

from agent.field.corner_cuts import OVER_M, cut_at_corners
from agent.field.corner_strokes import CornerStrokes, sharp_corners
from agent.field.field_map import UNITS_MAX, Field, Section
from agent.field.headland_rings import pieces, rings, swinging
from agent.interface.geometry import Point, Polyline

Reals = NDArray[np.float64]
Whole = NDArray[np.int64]

SWEEP_DEG = 10.0  # step of the angles that are tried besides the directions of the edges
EDGE_SHARE_MIN = 0.05  # edges shorter than this share of the outline propose no angle
UNITS_LEAST = 8  # of a whole field, so that in a tiny one, work beside a standing robot counts
UNIT_LEAST_M = 1.0  # shortest unit: three times the lead of a stretch
# The lead-out of a stretch goes 5 cm beyond this, and the body keeps 15 cm from the fence there.
KEEP_MORE_M = 0.25
# So much more than half of the overlap the bar of a row reaches over a fence that is nearly along it:
# the lead-out goes on towards the fence. In a corner that is driven in one go it may do as much.
LEANS_M = 0.02
ASTRAY_M = 0.1  # how far off its way a body may drive a corner; 0.087 measured
PIECE_MIN_M = 0.05  # strips that touch the deep part by less are served by the ring


def divide(
    name: str,
    polygon: Polygon,
    origin: tuple[float, float],
    gate: Point,
    implement_width_m: float,
    overlap_m: float = 0.2,
    section_length_m: float = 250.0,
    unit_m: float = 5.0,
    turn_radius_m: float = 0.0,
    keep_m: float = 0.0,
    pivots: bool = False,
) -> Field:
    """The field with its sections. Raises ValueError if no part of it can be worked.

    `polygon`: metres in the local frame. `origin`: latitude and longitude of (0, 0), degrees.
    `gate`: (x, y) metres. `section_length_m`, `unit_m`: wanted lengths of swath in a section and in
    a unit. For a body that steers (`turn_radius_m` > 0) the rings are cut at the corners that it
    cannot follow; every piece goes on straight while the middle of the body keeps `keep_m` from
    fences. `pivots`: the body can turn on the spot, and drives corners in one go. Its lowered bar reaches
    over a fence by no more than half of the overlap and `LEANS_M`.
    """
    width_m, strip_m = implement_width_m, implement_width_m - overlap_m
    assert 0.0 < overlap_m < implement_width_m / 2
    lines = list(rings(polygon.buffer(-width_m / 2)))
    if not lines:
        raise ValueError(f"{name} is nowhere as wide as the implement ({width_m} m)")
    deep = polygon.buffer(-(width_m - overlap_m))
    if turn_radius_m == 0.0:
        lines = [swinging(line, overlap_m / 2, width_m) for line in lines]
    bundles = [[piece] for line in lines for piece in pieces(line, section_length_m, width_m)]
    corners = [corner for (ring,) in bundles for corner in sharp_corners(ring)]
    if turn_radius_m > 0.0:
        free = polygon.buffer(-(keep_m + KEEP_MORE_M))
        # Where the lines are narrower than that, a corner that is driven in one go would not count.
        in_one_go = pivots and overlap_m / 2 >= ASTRAY_M
        room = polygon.buffer(-(keep_m + ASTRAY_M)) if in_one_go else None
        asked = polygon.buffer(-width_m / 2).buffer((width_m - overlap_m) / 2)
        inside = polygon.buffer(OVER_M)
        beside = polygon.buffer(overlap_m / 2 + LEANS_M)
        shapely.prepare(inside)
        shapely.prepare(beside)
        bundles = [
            cut_at_corners(ring, turn_radius_m, width_m / 2, free, room, asked, inside, beside)
            for (ring,) in bundles
        ]
    # Parts beyond a neck have rows of their own, at their own angle: with common ones a part may need one
    # more, which lies on its ring.
    for part in sorted(shapely.get_parts(deep), key=lambda part: part.bounds):
        if not part.is_empty:
            angle_deg = _best_angle(polygon, part, strip_m)
            bundles += _strip_bundles(part, angle_deg, strip_m, section_length_m)
    if turn_radius_m > 0.0:
        # Sections of their own: a ring with its strokes would be the work of one robot, and it drives
        # pieces of a ring less exactly where it comes to them out of the corner.
        swaths = [swath for bundle in bundles for swath in bundle]
        strokes = CornerStrokes(polygon, asked, swaths, turn_radius_m, width_m / 2, keep_m)
        bundles += filter(None, map(strokes.into, corners))
    work_m = sum(_length(swath) for bundle in bundles for swath in bundle)
    unit_m = min(unit_m, max(UNIT_LEAST_M, work_m / UNITS_LEAST))
    sections = tuple(
        Section(number, tuple(swaths), tuple(max(1, round(_length(s) / unit_m)) for s in swaths))
        for number, swaths in enumerate(bundles)
    )
    assert len(sections) <= 0xFFFF and all(s.units <= UNITS_MAX for s in sections)
    return Field(
        name=name,
        exterior=_points(polygon.exterior.coords[:-1]),
        holes=tuple(_points(hole.coords[:-1]) for hole in polygon.interiors),
        origin=origin,
        gate=gate,
        implement_width_m=implement_width_m,
        overlap_m=overlap_m,
        unit_m=unit_m,
        sections=sections,
    )


def _points(coordinates: Sequence[tuple[float, ...]]) -> Polyline:
    return tuple((float(p[0]), float(p[1])) for p in coordinates)


def _length(swath: Polyline) -> float:
    return float(LineString(swath).length)


def _best_angle(polygon: Polygon, deep: BaseGeometry, strip_m: float) -> float:
    """The direction with the fewest swaths, degrees; among equals the shortest total length.

    Directions are tried in the order of the least that they can have, until none can be better.
    """
    edges = list(zip(polygon.exterior.coords, polygon.exterior.coords[1:], strict=False))
    long_enough = EDGE_SHARE_MIN * polygon.exterior.length
    angles = {
        round(degrees(atan2(b[1] - a[1], b[0] - a[0])) % 180.0, 3)
        for a, b in edges
        if LineString((a, b)).length >= long_enough
    }
    angles |= {k * SWEEP_DEG for k in range(round(180.0 / SWEEP_DEG))}

    best: tuple[int, float, float] | None = None
    for least, angle in sorted((_swaths_least(deep, angle, strip_m), angle) for angle in angles):
        if best is not None and least > best[0]:
            break  # so have all others
        cut = _cut(deep, angle, strip_m)
        total_m = sum((cut.right_m - cut.left_m).tolist())
        cost = len(cut.row_of), round(total_m, 3), angle
        best = cost if best is None else min(best, cost)
    assert best is not None
    return best[2]


def _swaths_least(deep: BaseGeometry, angle_deg: float, strip_m: float) -> int:
    """How many swaths there are at least. This bound needs no intersections, which take most of the time.

    The area of each row is the integral of x dy along the parts of all edges in it. A row has no more
    pieces than there are edges, so one of them is large enough where the area is as large as that many
    pieces which are just too small.
    """
    turned, lows_m, height_m = _turned(deep, angle_deg, strip_m)
    areas_m2, corners = np.zeros(len(lows_m)), 0
    for part in shapely.get_parts(turned):
        for number, ring in enumerate((part.exterior, *part.interiors)):
            points = shapely.get_coordinates(ring)
            corners += len(points)
            edges = np.hstack((points[:-1], points[1:]))
            outwards = (_signed_m2(edges) > 0.0) == (number == 0)
            ax, ay, bx, by = edges[edges[:, 1] != edges[:, 3]].T[:, :, np.newaxis]
            from_m = np.clip(ay, lows_m, lows_m + height_m)
            to_m = np.clip(by, lows_m, lows_m + height_m)
            middle_x_m = ax + ((from_m + to_m) / 2 - ay) * ((bx - ax) / (by - ay))
            area_m2 = np.sum(middle_x_m * (to_m - from_m), axis=0)
            areas_m2 += area_m2 if outwards else -area_m2
    return int(np.count_nonzero(areas_m2 > corners * PIECE_MIN_M**2))


def _signed_m2(edges: Reals) -> float:
    """Twice the area in a ring, positive if it runs counter-clockwise. `edges` (n, 4): from, to x, y."""
    ax, ay, bx, by = edges.T
    return float(np.sum(ax * by - bx * ay))


class _Cut(NamedTuple):
    """Pieces of strips in a field that is turned so that strips run from west to east, by row from
    south to north, and from west to east in a row.
    """

    middles_m: Reals  # (rows,): y of each row
    row_of: Whole  # (pieces,)
    left_m: Reals  # (pieces,): x
    right_m: Reals  # (pieces,): x


def _turned(
    deep: BaseGeometry, angle_deg: float, strip_m: float
) -> tuple[BaseGeometry, Reals, float]:
    """The field turned so that rows run from west to east, the lower side of each row, and the height of
    all of them, metres.
    """
    turned = affinity.rotate(deep, -angle_deg, origin=(0.0, 0.0))
    _, south, _, north = turned.bounds
    rows = max(1, ceil((north - south) / strip_m - 1e-9))
    height_m = (north - south) / rows
    return turned, south + np.arange(rows) * height_m, height_m


def _cut(deep: BaseGeometry, angle_deg: float, strip_m: float) -> _Cut:
    """All rows in one call of shapely: a field has hundreds."""
    turned, lows_m, height_m = _turned(deep, angle_deg, strip_m)
    west, _, east, _ = turned.bounds
    strips = shapely.intersection(
        turned, shapely.box(west - 1, lows_m, east + 1, lows_m + height_m)
    )
    found, row_of = shapely.get_parts(strips, return_index=True)
    deep_enough = shapely.area(found) > PIECE_MIN_M**2
    found, row_of = found[deep_enough], row_of[deep_enough]
    bounds = shapely.bounds(found)
    order = np.lexsort((*bounds.T[::-1], row_of))
    left_m, right_m = bounds[order, 0], bounds[order, 2]
    narrow_m = np.where(right_m - left_m < PIECE_MIN_M, PIECE_MIN_M, 0.0)
    return _Cut(lows_m + height_m / 2, row_of[order], left_m - narrow_m, right_m + narrow_m)


def _strips(deep: BaseGeometry, angle_deg: float, strip_m: float) -> list[list[Polyline]]:
    """Rows of swaths from one side of the field to the other, each row from left to right."""
    cut = _cut(deep, angle_deg, strip_m)
    middle_m = cut.middles_m[cut.row_of]
    ends = np.stack((cut.left_m, middle_m, cut.right_m, middle_m), axis=1).reshape(-1, 2, 2)
    lines = affinity.rotate(MultiLineString(list(ends)), angle_deg, origin=(0.0, 0.0))
    strips: list[list[Polyline]] = [[] for _ in cut.middles_m]
    for row, line in zip(cut.row_of, shapely.get_coordinates(lines).reshape(-1, 2, 2), strict=True):
        strips[row].append(_points(line.tolist()))
    return strips


def _strip_bundles(
    deep: BaseGeometry, angle_deg: float, strip_m: float, section_length_m: float
) -> list[list[Polyline]]:
    """Swaths that lie side by side, bundled until a section is long enough.

    A bundle is a boustrophedon cell (Choset and Pignon 1998): each swath is driven against the one
    before.
    """
    rows = _strips(deep, angle_deg, strip_m)
    bundles: list[list[Polyline]] = []
    open_bundles: list[list[Polyline]] = []
    for row in rows:
        following: list[list[Polyline]] = []
        for swath in row:
            bundle = next((b for b in open_bundles if _side_by_side(b[-1], swath, strip_m)), None)
            if bundle is not None and all(f is not bundle for f in following):
                open_bundles = [b for b in open_bundles if b is not bundle]
            else:
                bundle = []
                bundles.append(bundle)
            previous = bundle[-1] if bundle else None
            if previous is not None and _far(previous[-1], swath[0]) > _far(
                previous[-1], swath[-1]
            ):
                swath = swath[::-1]
            bundle.append(swath)
            if sum(_length(s) for s in bundle) < section_length_m * 0.75:
                following.append(bundle)
        open_bundles = following
    return bundles


def _side_by_side(a: Polyline, b: Polyline, strip_m: float) -> bool:
    return bool(LineString(a).distance(LineString(b)) <= 1.5 * strip_m)


def _far(a: Point, b: Point) -> float:
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2
