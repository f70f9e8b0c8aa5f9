"""Rings are cut where a body cannot follow, and nothing of them is lost."""

from math import radians, sin

import pytest
from shapely.geometry import LineString, MultiLineString, Polygon, box
from shapely.ops import unary_union

from agent.field.corner_cuts import cut_at_corners
from agent.field.field_division import divide
from agent.field.field_map import Field, Polyline
from agent.field.field_plan import FieldValues, divided
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.motion.tractor_tracker import BEND_HALF_M, smooth_way
from sim.world.coverage_truth import Coverage, coverage, sample_points
from sim.world.ground_truth import TrackPoint

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


def swept(field: Field) -> Coverage:
    """What a body that turns on the spot works of a field, if it drives each swath as it is rounded."""
    track: list[TrackPoint] = []
    for swath in (swath for section in field.sections for swath in section.swaths):
        way = smooth_way(list(swath), BEND_HALF_M)[:, :2]
        track += [(len(track) + k, float(x), float(y), True) for k, (x, y) in enumerate(way)]
        track.append((len(track), *track[-1][1:3], False))
    raster = sample_points(field.polygon, field.implement_width_m, field.overlap_m)
    return coverage(raster, {0: track}, field.implement_width_m)


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
