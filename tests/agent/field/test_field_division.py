"""Swaths leave nothing out: buffered, they cover the morphological opening of the field.

Driven exactly, an implement of width w covers everything a disc of diameter w reaches inside the
fences: `polygon.buffer(-w / 2).buffer(w / 2)`. Driven off by the allowed half overlap v / 2, it
still covers what `sim/world/coverage_truth.py` asks for: `polygon.buffer(-w / 2).buffer((w - v) / 2)`.
"""

import json
import math
from collections.abc import Iterator
from itertools import pairwise
from math import atan2, cos, dist, pi, radians, sin, tan
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pyproj import CRS, Transformer
from shapely import affinity, unary_union
from shapely.geometry import LineString, MultiPolygon, Point, Polygon, box
from shapely.geometry.base import BaseGeometry

from agent.field.field_division import (
    PIECE_MIN_M,
    _best_angle,
    _cut,
    _strips,
    _swaths_least,
    divide,
)
from agent.field.field_map import Field
from agent.interface.geometry import Polyline
from sim.world.coverage_truth import BACK_COS
from tests.examples import examples

FIELDS = Path(__file__).parents[4] / "shared/data/fields/isoxml-dotnet/partfields13.geojson"
WIDTH_M, OVERLAP_M = 4.0, 0.2
ARC_SEGMENTS = 64  # of a quarter circle; the sagitta of a 2 m arc is then 0.15 mm
SLIVER_M = 0.02  # gaps that a shrink by this removes are arcs drawn as chords
POINT_M = 1e-9  # a side shorter than this has no course
GRID_M = 1e-5  # without a grid, GEOS loses parts of unions of areas with common sides


def swept(swath: Polyline, half_m: float) -> Iterator[Polygon]:
    """What a bar of twice `half_m` passes along a swath: a rectangle for each side, and both sectors
    between the two courses at each corner.

    A buffer of the line is not the same. It sweeps corners at the ends of a line that closes, also
    where the robot turns back, and it can leave out the inside of a short ring.
    """
    points = [swath[0], *(b for a, b in pairwise(swath) if dist(a, b) > POINT_M)]
    courses = [atan2(b[1] - a[1], b[0] - a[0]) for a, b in pairwise(points)]
    for (a, b), course in zip(pairwise(points), courses, strict=True):
        x, y = half_m * sin(course), half_m * cos(course)
        yield Polygon(
            [(a[0] - x, a[1] + y), (b[0] - x, b[1] + y), (b[0] + x, b[1] - y), (a[0] + x, a[1] - y)]
        )
    for at, (before, after) in zip(points[1:-1], pairwise(courses), strict=True):
        turn = (after - before + pi) % (2 * pi) - pi
        if turn == 0.0 or cos(turn) < BACK_COS:
            continue
        steps = 2 + int(abs(turn) * ARC_SEGMENTS * 2 / pi)
        for end in (pi / 2, -pi / 2):
            angles = [before + end + turn * k / steps for k in range(steps + 1)]
            arc = [(at[0] + half_m * cos(way), at[1] + half_m * sin(way)) for way in angles]
            yield Polygon([at, *arc])


def covered(field: Field, half_m: float) -> BaseGeometry:
    """What bars of twice `half_m` pass along all swaths."""
    swaths = [swath for section in field.sections for swath in section.swaths]
    passed = [area for swath in swaths for area in swept(swath, half_m)]
    return shapely.union_all(passed, grid_size=GRID_M)


def gaps(field: Field, polygon: Polygon, width_m: float, half_m: float) -> BaseGeometry:
    """What was asked for and not covered, without slivers."""
    asked = polygon.buffer(-width_m / 2).buffer(half_m, quad_segs=ARC_SEGMENTS)
    left = shapely.difference(asked, covered(field, half_m), grid_size=GRID_M)
    return left.buffer(-SLIVER_M / 2)


def check(polygon: Polygon, width_m: float = WIDTH_M, overlap_m: float = OVERLAP_M) -> Field:
    field = divide("field", polygon, (0.0, 0.0), (0.0, 0.0), width_m, overlap_m)
    for half_m in (width_m / 2, (width_m - overlap_m) / 2):
        left = gaps(field, polygon, width_m, half_m)
        where = left.representative_point() if not left.is_empty else None
        assert left.is_empty, f"{left.area:.4f} m2 at {where} of {polygon.wkt}"
    fence = polygon.boundary
    for section in field.sections:
        for swath in section.swaths:
            beside_m = fence.distance(LineString(swath))
            assert beside_m >= (width_m - overlap_m) / 2 - 0.06, f"{beside_m} m of {swath}"
    return field


def outlines() -> dict[str, Polygon]:
    if not FIELDS.exists():
        return {}
    shapes = {}
    for feature in json.loads(FIELDS.read_text())["features"]:
        rings = feature["geometry"]["coordinates"]
        if feature["geometry"]["type"] == "MultiPolygon":
            rings = rings[0]
        lon, lat = rings[0][0]
        local = CRS.from_proj4(f"+proj=aeqd +lat_0={lat} +lon_0={lon} +datum=WGS84 +units=m")
        to_metres = Transformer.from_crs("EPSG:4326", local, always_xy=True).transform
        outline = [[to_metres(*point) for point in ring] for ring in rings]
        shapes[feature["properties"]["name"]] = Polygon(outline[0], outline[1:])
    return shapes


OUTLINES = outlines()
real = pytest.mark.skipif(not OUTLINES, reason="../shared/data/fields is absent")


@real
@pytest.mark.parametrize("name", sorted(OUTLINES))
def test_real_fields_are_covered(name: str) -> None:
    check(OUTLINES[name], width_m=9.0, overlap_m=0.3)


@st.composite
def polygons(draw: st.DrawFn) -> Polygon:
    """Star-shaped outlines with up to two round holes, one to a few dozen widths across."""
    corners = draw(st.integers(3, 12))
    radii = draw(st.lists(st.floats(6.0, 60.0), min_size=corners, max_size=corners))
    angle = draw(st.floats(0.0, pi))
    outline = [
        (r * cos(angle + 2 * pi * k / corners), r * sin(angle + 2 * pi * k / corners))
        for k, r in enumerate(radii)
    ]
    shape: BaseGeometry = Polygon(outline)
    for _ in range(draw(st.integers(0, 2))):
        at = draw(st.floats(-25.0, 25.0)), draw(st.floats(-25.0, 25.0))
        sides, size_m = draw(st.integers(3, 9)), draw(st.floats(1.0, 8.0))
        hole = Polygon([(cos(2 * pi * k / sides), sin(2 * pi * k / sides)) for k in range(sides)])
        shape = shape.difference(affinity.translate(affinity.scale(hole, size_m, size_m), *at))
    if isinstance(shape, MultiPolygon):
        shape = max(shape.geoms, key=lambda part: part.area)
    assume(isinstance(shape, Polygon) and not shape.buffer(-WIDTH_M / 2 - 0.1).is_empty)
    assert isinstance(shape, Polygon)
    return shape


@given(polygons())
@settings(max_examples=examples(60), deadline=None)
def test_random_polygons_with_holes_are_covered(polygon: Polygon) -> None:
    check(polygon)


@st.composite
def narrow(draw: st.DrawFn) -> Polygon:
    """Boxes that overlap at any angle, and wedges; many are hardly wider than the implement."""
    shapes: list[BaseGeometry] = []
    for _ in range(draw(st.integers(1, 4))):
        length_m, wide_m = draw(st.floats(4.0, 40.0)), draw(st.floats(4.0, 12.0))
        end_m = draw(st.sampled_from([wide_m, 2.0, 0.0]))
        shape = Polygon([(0, 0), (length_m, 0), (length_m, end_m), (0, wide_m)])
        turned = affinity.rotate(shape, draw(st.floats(0.0, 360.0)), origin=(0, 0))
        shapes.append(affinity.translate(turned, draw(st.floats(0, 20)), draw(st.floats(0, 20))))
    shape = unary_union(shapes)
    if isinstance(shape, MultiPolygon):
        shape = max(shape.geoms, key=lambda part: part.area)
    assume(isinstance(shape, Polygon) and not shape.buffer(-WIDTH_M / 2 - 0.1).is_empty)
    assert isinstance(shape, Polygon)
    return shape


@given(narrow())
@settings(max_examples=examples(60), deadline=None)
def test_random_narrow_fields_are_covered(polygon: Polygon) -> None:
    check(polygon)


def star(points: int, far_m: float, near_m: float) -> Polygon:
    corners = [
        (r * cos(pi * k / points), r * sin(pi * k / points))
        for k in range(2 * points)
        for r in (far_m if k % 2 == 0 else near_m,)
    ]
    return Polygon(corners)


def wedge(length_m: float, degrees: float) -> Polygon:
    half_m = length_m * tan(radians(degrees / 2))
    return Polygon([(0, 0), (length_m, -half_m), (length_m, half_m)])


ODD = {
    "a diamond with a hole": Polygon(
        [(0, -6), (-6, 0), (0, 6), (6, 0)], [[(-0.625, 2.165), (-0.625, -2.165), (3.125, 0.0)]]
    ),
    "a triangle of 7.8 m": Polygon([(0, 0), (7.8, 0), (3.9, 6.75)]),
    "a star whose ring has no straight place": star(7, 12.0, 6.0),
    "a star of slender arms": star(5, 40.0, 12.0),
    "a wedge of 3 degrees": wedge(120.0, 3.0),
    "a wedge of 9 degrees": wedge(60.0, 9.0),
    "a wedge of 19 degrees": wedge(60.0, 19.0),
    "a wedge with a blunt end": Polygon([(0, -2.02), (80, -6), (80, 6), (0, 2.02)]),
    "a strip 5 cm wider than the implement": box(0, 0, 60, 4.05),
    "a square 3 cm wider than the implement": box(0, 0, 4.03, 4.03),
    "a bent strip": LineString([(0, 0), (20, 0), (30, 15), (60, 15)]).buffer(2.04),
    "a comb": unary_union([box(0, 0, 44, 5), *(box(10 * k, 4, 10 * k + 4.5, 30) for k in range(5))]),
    "a U": Polygon([(0, 0), (40, 0), (40, 30), (35, 30), (35, 5), (5, 5), (5, 30), (0, 30)]),
    "a round island near the fence": box(0, 0, 40, 30).difference(Point(12, 9).buffer(4.7)),
    "islands near each other": box(0, 0, 60, 40).difference(
        unary_union([Point(20, 20).buffer(5), Point(34.5, 20).buffer(5), box(25, 28, 32, 33)])
    ),
    "two parts": unary_union([box(0, 0, 20, 15), box(30, 2, 45, 20), box(19, 5, 31, 8)]),
}  # fmt: skip


@pytest.mark.parametrize("name", ODD)
def test_an_odd_field_is_covered(name: str) -> None:
    polygon = ODD[name]
    check(polygon)
    check(affinity.rotate(polygon, 37.0))


def test_a_part_of_millimetres_at_a_large_overlap_is_one_loop() -> None:
    """It was driven to and fro, because its axis was a centimetre outside of it: 0.2 m2 were left."""
    points = [
        (19.3725, 9.5637), (23.3382, 10.0863), (23.9657, 5.3251), (20.0, 4.8024), (19.6601, 7.3812),
        (13.6028, 5.1259), (12.2338, 28.3664), (19.4481, 8.9900),
    ]  # fmt: skip
    check(Polygon(points), overlap_m=1.5)


def test_a_narrow_part_is_covered_at_a_large_overlap() -> None:
    """The ring came back to its line beside the tip, on the arc round the corner there. Of 595 narrow
    outlines at this overlap, 15 were left with gaps of up to 2 m2; none at 0.2 and 0.6 m.
    """
    points = [
        (14.89, 11.5), (15.78, 13.53), (11.92, 12.24), (8.87, 21.33), (21, 25.41), (25.09, 34.7),
        (28.75, 33.09), (26.13, 27.13), (46.09, 33.82), (49.14, 24.73), (20.91, 15.25), (18.55, 9.89),
    ]  # fmt: skip
    check(Polygon(points), overlap_m=1.5)


def test_a_field_narrower_than_the_implement_is_refused() -> None:
    with pytest.raises(ValueError, match="nowhere as wide as the implement"):
        check(Polygon([(0, 0), (100, 0), (100, 3), (0, 3)]))


def strips_one_by_one(deep: BaseGeometry, angle_deg: float, strip_m: float) -> list[list[Polyline]]:
    """A slow model of `_strips`: each strip is cut by itself, its pieces from west to east."""
    turned = affinity.rotate(deep, -angle_deg, origin=(0.0, 0.0))
    west, south, east, north = turned.bounds
    rows = max(1, math.ceil((north - south) / strip_m - 1e-9))
    found = []
    for row in range(rows):
        low_m, high_m = (south + (north - south) / rows * at for at in (row, row + 1))
        cut = turned.intersection(box(west - 1, low_m, east + 1, high_m))
        swaths = []
        for piece in sorted(getattr(cut, "geoms", [cut]), key=lambda piece: piece.bounds):
            left_m, _, right_m, _ = piece.bounds
            if piece.area > PIECE_MIN_M**2:
                more_m = PIECE_MIN_M * (right_m - left_m < PIECE_MIN_M)
                ends = [
                    (left_m - more_m, (low_m + high_m) / 2),
                    (right_m + more_m, (low_m + high_m) / 2),
                ]
                back = affinity.rotate(LineString(ends), angle_deg, origin=(0.0, 0.0))
                swaths.append(tuple((x, y) for x, y in back.coords))
        found.append(swaths)
    return found


@given(
    st.lists(st.floats(8.0, 60.0), min_size=5, max_size=13), st.floats(0.0, 180.0),
    st.sampled_from([1.8, 3.7, 5.8]), st.booleans(),
)  # fmt: skip
@settings(max_examples=examples(40))
def test_strips_of_one_call_are_those_that_are_cut_one_by_one(
    radii_m: list[float], angle_deg: float, strip_m: float, hole: bool
) -> None:
    """Rows of a star have several pieces, and their order is that in which they are driven."""
    deep = drawn_star(radii_m, hole)
    made, model = (cut(deep, angle_deg, strip_m) for cut in (_strips, strips_one_by_one))
    assert [len(row) for row in made] == [len(row) for row in model]
    for swaths, wanted in zip(made, model, strict=True):
        assert np.allclose(np.asarray(swaths), np.asarray(wanted), atol=1e-9)


def drawn_star(radii_m: list[float], hole: bool) -> Polygon:
    turns = [2 * pi * k / len(radii_m) for k in range(len(radii_m))]
    star = Polygon([(r * cos(a), r * sin(a)) for r, a in zip(radii_m, turns, strict=True)])
    return star.difference(box(-3.0, -2.0, 3.0, 2.0)) if hole else star


def check_angle(polygon: Polygon, strip_m: float) -> None:
    """The angle against a slow model, which cuts the field at every angle."""
    deep = polygon.buffer(-strip_m)
    if deep.is_empty:
        return
    angles = {k * 10.0 for k in range(18)}
    for a, b in pairwise(polygon.exterior.coords):
        if dist(a, b) >= 0.05 * polygon.exterior.length:
            angles.add(round(math.degrees(atan2(b[1] - a[1], b[0] - a[0])) % 180.0, 3))
    costs = []
    for angle in angles:
        cut = _cut(deep, angle, strip_m)
        assert _swaths_least(deep, angle, strip_m) <= len(cut.row_of)
        costs.append((len(cut.row_of), round(sum((cut.right_m - cut.left_m).tolist()), 3), angle))
    assert _best_angle(polygon, deep, strip_m) == min(costs)[2]


@given(
    st.lists(st.floats(8.0, 60.0), min_size=5, max_size=13),
    st.sampled_from([1.8, 3.8, 5.8]), st.booleans(),
)  # fmt: skip
@settings(max_examples=examples(30))
def test_the_angle_is_that_of_all_angles_cut(
    radii_m: list[float], strip_m: float, hole: bool
) -> None:
    check_angle(drawn_star(radii_m, hole), strip_m)


@real
@pytest.mark.sampled(10)
@pytest.mark.parametrize("name", sorted(OUTLINES))
def test_the_angle_of_a_real_field_is_that_of_all_angles_cut(name: str) -> None:
    check_angle(OUTLINES[name], 6.8)


def test_parts_beyond_a_neck_have_rows_of_their_own() -> None:
    """With common rows a part had one more than it needs, which lay on its ring all along."""
    one, other = box(0.0, 0.0, 20.0, 40.0), affinity.rotate(box(26.0, 3.0, 49.3, 38.0), 20.0)
    neck = box(19.0, 19.0, 30.0, 21.0)

    def rows(polygon: Polygon) -> int:
        field = divide("field", polygon, (0.0, 0.0), (0.0, 0.0), 4.0)
        return sum(len(swath) == 2 for section in field.sections for swath in section.swaths)

    assert rows(unary_union([one, neck, other])) == rows(one) + rows(other)
