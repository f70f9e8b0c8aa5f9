"""Ground that a ring leaves in a sharp corner is worked by strokes of their own."""

from dataclasses import replace
from math import dist

import pytest
from shapely.geometry import LineString, Polygon, box

from agent.field.corner_cuts import PAST_END_M
from agent.field.corner_strokes import (
    LEAST_M2,
    NEARER_M,
    STROKE_M,
    STROKES_MAX,
    TOUCHES_M,
    CornerStrokes,
    sharp_corners,
)
from agent.field.field_map import Field, Section
from agent.field.field_plan import FieldValues, divided, planned_radius_m
from agent.interface.geometry import Point, Polyline
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.motion.holonomic_motion import FENCE_M
from agent.motion.implement_clearance import LEAD_M
from agent.motion.path_tracker import turn_at
from tests.agent.field.test_corner_cuts import swept

NECK = Polygon([(-28, -31), (28, -27), (2, 0), (21, 31), (-28, 31), (-2, 2)])
CHORD_M = 0.02  # between a chord and its arc
BOW = Polygon([(-35, -62), (35, -45), (5, 0), (26, 62), (-35, 62), (-5, 1)])
WIDTH_M = 2.5
SPOT = (NECK, Vehicle(radius_m=0.6, drive=DriveTrain.DIFFERENTIAL))
TRACTOR = (BOW, Vehicle(radius_m=0.8, drive=DriveTrain.ACKERMANN))


def planned(outline: Polygon, vehicle: Vehicle) -> Field:
    return divided("sharp", outline, (0.0, 0.0), FieldValues(WIDTH_M), vehicle)


def strokes_of(field: Field) -> list[Section]:
    """Sections that are nothing else than strokes into a corner."""
    return [
        section
        for section in field.sections
        if all(LineString(swath).length < STROKE_M + 0.05 for swath in section.swaths)
    ]


@pytest.mark.parametrize("outline, vehicle, share", [(*SPOT, 0.25), (*TRACTOR, 0.72)])
def test_strokes_work_a_part_of_what_both_pieces_leave(
    outline: Polygon, vehicle: Vehicle, share: float
) -> None:
    field = planned(outline, vehicle)
    own = strokes_of(field)
    plain = replace(field, sections=tuple(s for s in field.sections if s not in own))
    before, after = (
        len(swept(each, PAST_END_M, planned_radius_m(vehicle)).missed) for each in (plain, field)
    )
    assert before > 3 and after <= share * before, (before, after)


@pytest.mark.parametrize("outline, vehicle", [SPOT, TRACTOR])
def test_body_and_bar_stay_where_they_may_be(outline: Polygon, vehicle: Vehicle) -> None:
    sections = strokes_of(planned(outline, vehicle))
    assert sections and all(len(section.swaths) <= STROKES_MAX for section in sections)
    keep_m = vehicle.radius_m + FENCE_M
    for stroke in (stroke for section in sections for stroke in section.swaths):
        assert outline.buffer(-keep_m).contains(LineString(stroke))
        led_out = LineString((*stroke, beyond(stroke[-2], stroke[-1], LEAD_M)))
        assert outline.buffer(NEARER_M - keep_m).contains(led_out)
        past = LineString((*stroke, beyond(stroke[-2], stroke[-1], PAST_END_M)))
        bars = past.buffer(WIDTH_M / 2, cap_style="flat")
        assert outline.buffer(TOUCHES_M + CHORD_M).contains(bars)
        turns = zip(stroke, stroke[1:], stroke[2:], strict=False)
        turned_rad = sum(abs(turn_at(*three)) for three in turns)
        assert turned_rad <= sum(map(dist, stroke, stroke[1:])) / planned_radius_m(vehicle)


def beyond(a: Point, b: Point, by_m: float) -> Point:
    share = by_m / dist(a, b)
    return b[0] + (b[0] - a[0]) * share, b[1] + (b[1] - a[1]) * share


@pytest.mark.parametrize("drive", DriveTrain)
@pytest.mark.parametrize("width_m", (2.5, 4.0))
def test_where_nothing_is_left_no_stroke_is_planned(drive: DriveTrain, width_m: float) -> None:
    vehicle = Vehicle(radius_m=0.6, drive=drive)
    field = divided("box", box(0, 0, 60, 40), (0.0, 0.0), FieldValues(width_m), vehicle)
    assert not strokes_of(field)


def test_a_body_that_moves_in_any_direction_gets_no_stroke() -> None:
    assert not strokes_of(planned(NECK, Vehicle(radius_m=0.6, drive=DriveTrain.MECANUM)))


def test_ground_of_less_than_a_cell_is_no_reason_for_a_stroke() -> None:
    outline = box(0, 0, 20, 20)
    row: Polyline = ((19.0, 1.0), (19.0, 19.0))
    for side_m, strokes in ((0.9 * LEAST_M2**0.5, 0), (2.0 * LEAST_M2**0.5, 1)):
        patch = box(4.0, 0.8, 4.0 + side_m, 0.8 + side_m)
        found = CornerStrokes(outline, patch, [row], 1.8, 1.0, 0.8).into((4.0, 1.0))
        assert len(found) == strokes


def test_only_corners_are_sharp() -> None:
    ring = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (9.0, 19.0), (0.0, 0.0))
    assert sharp_corners(ring) == [(10.0, 0.0), (9.0, 19.0)]
