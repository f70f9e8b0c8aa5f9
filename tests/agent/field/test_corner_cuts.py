"""Rings are cut where a body cannot follow, and nothing of them is lost."""

from math import dist, radians, sin

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, MultiLineString, Polygon, box
from shapely.ops import unary_union

from agent.field.corner_cuts import PAST_END_M, cut_at_corners
from agent.field.field_division import LEANS_M, divide
from agent.field.field_map import Field
from agent.field.field_plan import FieldValues, divided, planned_radius_m
from agent.interface.geometry import Point, Polyline
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.motion.implement_clearance import LEAD_M
from agent.motion.tractor_tracker import BEND_HALF_M, smooth_way
from sim.world.coverage_truth import Coverage, coverage, sample_points
from sim.world.ground_truth import TrackPoint
from sim.world.reachable_ground import WorkingBody, reachable_ground

FIELD = box(0, 0, 80, 60)
FREE = FIELD.buffer(-1.2)


def ring(inset_m: float = 2.0) -> Polyline:
    return tuple(FIELD.buffer(-inset_m).exterior.coords)


def test_a_rectangle_becomes_its_sides_each_a_little_longer() -> None:
    pieces = cut_at_corners(ring(), 1.8, 2.0, FREE)
    assert len(pieces) == 4
    whole = unary_union([LineString(piece) for piece in pieces])
    assert LineString(ring()).difference(whole.buffer(0.02)).length < 2.0, (
        "bends leave it at its ends"
    )
    assert all(FREE.buffer(1e-6).contains(LineString(piece)) for piece in pieces)
    longer = sum(LineString(piece).length for piece in pieces) - LineString(ring()).length
    assert longer == pytest.approx(6 * 0.8, abs=0.6), "0.8 m to the fence's margin, at six ends"


def test_a_ring_that_has_no_room_past_its_corners_ends_in_them() -> None:
    """A body of 0.8 m with an implement of 2 m in a pointed field: the plan divided by zero."""
    octagon = shapely.Point(0.0, 0.0).buffer(30.0, quad_segs=2)
    around = tuple(octagon.exterior.coords)
    pieces = cut_at_corners(around, 1.8, 1.0, octagon.buffer(-0.01), asked=octagon)
    assert [pytest.approx(piece[0]) for piece in pieces] == list(around[:-1])


def test_the_two_ends_in_a_corner_may_bend_differently() -> None:
    """Where both bent alike, they left 20 cells in the corners of this field."""
    outline = Polygon([(-28, -31), (28, -27), (2, 0), (21, 31), (-28, 31), (-2, 2)])
    vehicle = Vehicle(radius_m=0.6, drive=DriveTrain.DIFFERENTIAL)
    values = FieldValues(implement_width_m=2.5, overlap_m=0.15)
    field = divided("neck", outline, (0.0, 0.0), values, vehicle)
    told = swept(field, PAST_END_M, planned_radius_m(vehicle))
    assert len(told.missed) < 16, told.missed


@pytest.mark.parametrize("turn_radius_m, pieces", [(1.8, 1), (3.0, None)])
def test_round_corners_stay_whole_where_they_can_be_followed(
    turn_radius_m: float, pieces: int | None
) -> None:
    around = tuple(box(30, 25, 50, 35).buffer(2.0).exterior.coords)
    cut = cut_at_corners(around, turn_radius_m, 2.0, FREE)
    assert pieces is None or len(cut) == pieces
    assert pieces is not None or len(cut) > 4
    for piece in cut:
        way = smooth_way(list(piece), 0.6)
        assert abs(way[:, 3]).max() < 1.3 / min(turn_radius_m, 2.0) or len(piece) < 4


def test_only_bodies_that_steer_have_their_rings_cut() -> None:
    plain = divide("a", FIELD, (0, 0), (0, 0), 4.0)
    steering = divide("a", FIELD, (0, 0), (0, 0), 4.0, turn_radius_m=1.8, keep_m=1.0)
    assert len(plain.sections) == len(steering.sections)
    assert all(len(section.swaths) == 1 for section in plain.sections[:1])
    assert sum(len(s.swaths) for s in steering.sections) > sum(
        len(s.swaths) for s in plain.sections
    )


@pytest.mark.parametrize("lean_deg", (0, 10, -15, 20, -25, 30))
@pytest.mark.parametrize("width_m", (4.0, 5.0, 6.0, 8.0))
def test_i26_a_tractor_sweeps_acute_corners(width_m: float, lean_deg: float) -> None:
    """Where the ring turned by more than 1.9 rad, the plan left 0.9 m2 in each corner."""
    lean_m = 60 * sin(radians(lean_deg))
    outline = Polygon([(0, 0), (80, 0), (80 + lean_m, 60), (lean_m, 60)])
    vehicle = Vehicle(radius_m=0.8, drive=DriveTrain.ACKERMANN)
    values = FieldValues(implement_width_m=width_m)
    field = divided("corners", outline, (0.0, 0.0), values, vehicle)
    ends = MultiLineString([swath for section in field.sections for swath in section.swaths])
    assert outline.buffer(-vehicle.radius_m).contains(ends)
    told = swept(field, PAST_END_M, planned_radius_m(vehicle))
    assert not len(told.missed), f"{len(told.missed)} cells: {told.missed[:8]}"


def swept(field: Field, past_m: float = 0.0, turn_radius_m: float = 0.0) -> Coverage:
    """What a body works of a field, if it drives each swath as it is rounded, and `past_m` further."""
    track: list[TrackPoint] = []
    for swath in (swath for section in field.sections for swath in section.swaths):
        longer = [
            _beyond(swath[1], swath[0], past_m),
            *swath[1:-1],
            _beyond(swath[-2], swath[-1], past_m),
        ]
        way = smooth_way(longer, BEND_HALF_M)[:, :2]
        track += [(len(track) + k, float(x), float(y), True) for k, (x, y) in enumerate(way)]
        track.append((len(track), *track[-1][1:3], False))
    raster = sample_points(field.polygon, field.implement_width_m, field.overlap_m)
    body = WorkingBody(field.implement_width_m, field.overlap_m, 0.8, turn_radius_m)
    ground = reachable_ground(field.polygon, raster, body, [field.polygon.centroid.coords[0][:2]])
    return coverage(raster, {0: track}, field.implement_width_m, ground.cells)


def _beyond(a: Point, b: Point, past_m: float) -> Point:
    share = past_m / dist(a, b)
    return b[0] + (b[0] - a[0]) * share, b[1] + (b[1] - a[1]) * share


SHARP = (
    Polygon([(-28, -31), (28, -27), (2, 0), (21, 31), (-28, 31), (-2, 2)]),
    Polygon([(0, 0), (70, 5), (25, 45)]),
    Polygon([(0, 0), (80, 0), (20, 22)]),
)


@pytest.mark.parametrize("outline", SHARP)
@pytest.mark.parametrize("drive", (DriveTrain.DIFFERENTIAL, DriveTrain.ACKERMANN))
@pytest.mark.parametrize("width_m", (2.5, 4.0, 6.0))
def test_i26_the_bar_stays_within_the_fences(
    outline: Polygon, drive: DriveTrain, width_m: float
) -> None:
    """Pieces of a ring went past sharp corners as far as the body had room. The bar crossed the fence
    ahead by 0.8 m with an implement of 4 m, and by 1.4 m with one of 6 m."""
    values = FieldValues(width_m)
    field = divided("sharp", outline, (0.0, 0.0), values, Vehicle(radius_m=0.6, drive=drive))
    swaths = [swath for section in field.sections for swath in section.swaths]
    over_m = [bar_over_m(outline, swath, width_m / 2) for swath in swaths]
    assert max(over_m) <= values.overlap_m / 2 + LEANS_M, sorted(over_m)[-8:]


@pytest.mark.parametrize("width_m", (3.0, 4.0, 6.0, 12.0))
def test_i26_the_bar_stays_within_the_fences_in_a_corner_that_is_driven_in_one_go(
    width_m: float,
) -> None:
    """It crossed them by 0.17 m with an implement of 6 m, although half of the overlap was 0.1 m."""
    values, outline = FieldValues(width_m), box(0, 0, 100, 80)
    vehicle = Vehicle(radius_m=0.6, drive=DriveTrain.DIFFERENTIAL)
    (ring, *others) = divided("box", outline, (0.0, 0.0), values, vehicle).sections[0].swaths
    assert not others, "no corner is cut"
    assert bar_over_m(outline, ring, width_m / 2) <= values.overlap_m / 2 + LEANS_M


def bar_over_m(outline: Polygon, swath: Polyline, reach_m: float) -> float:
    """How far the lowered bar reaches out of the outline on a swath and on the leads to it."""
    line = [
        _beyond(swath[1], swath[0], LEAD_M),
        *swath[1:-1],
        _beyond(swath[-2], swath[-1], LEAD_M),
    ]
    way = smooth_way(line, BEND_HALF_M)
    bars = np.stack((-np.sin(way[:, 2]), np.cos(way[:, 2])), axis=1) * reach_m
    lines = shapely.linestrings(np.stack((way[:, :2] + bars, way[:, :2] - bars), axis=1))
    outside = shapely.segmentize(shapely.difference(lines, outline), 0.1)
    places = shapely.points(shapely.get_coordinates(outside))
    return float(shapely.distance(outline, places).max(initial=0.0))


@pytest.mark.parametrize("lean_deg", (0, 15, -15))
@pytest.mark.parametrize("width_m", (2.8, 3.0, 4.0))
def test_a_body_that_turns_on_the_spot_works_the_whole_corner(
    width_m: float, lean_deg: float
) -> None:
    """Two rclpy robots, nearly as wide as their implement, left 20 cells in corners."""
    lean_m = 20 * sin(radians(lean_deg))
    outline = Polygon([(0, 0), (21, 0), (21 + lean_m, 20), (lean_m, 20)])
    vehicle = Vehicle(radius_m=0.8, drive=DriveTrain.DIFFERENTIAL)
    values = FieldValues(implement_width_m=width_m)
    field = divided("corners", outline, (0.0, 0.0), values, vehicle)
    assert [len(section.swaths) for section in field.sections[:1]] == [1], "no corner is cut"
    told = swept(field)
    assert not len(told.uncovered), f"{len(told.uncovered)} cells: {told.uncovered[:8]}"


def test_a_corner_without_room_to_swing_out_is_cut() -> None:
    tight = FIELD.buffer(-1.95)
    whole, cut = (cut_at_corners(ring(), 0.6, 2.0, tight, room) for room in (FREE, tight))
    assert (len(whole), len(cut)) == (1, 4)
    assert tight.buffer(1e-6).contains(MultiLineString(cut))


@pytest.mark.parametrize(("overlap_m", "swaths"), [(0.15, 5), (0.19, 5), (0.2, 1)])
def test_corners_are_cut_where_the_overlap_is_smaller_than_the_way_off_the_line(
    overlap_m: float, swaths: int
) -> None:
    """A body that turns on the spot is up to 0.09 m beside its line in a corner. With half an overlap of
    less, no unit there counted, and the fleet worked it again until the time limit."""
    vehicle = Vehicle(radius_m=0.6, drive=DriveTrain.DIFFERENTIAL)
    values = FieldValues(implement_width_m=5.0, overlap_m=overlap_m)
    field = divided("corners", box(0, 0, 40, 30), (0.0, 0.0), values, vehicle)
    assert len(field.sections[0].swaths) == swaths
