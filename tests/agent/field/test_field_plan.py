"""A field as declared vehicles drive in it: what is refused, and what the curves are."""

from math import cos, pi, radians, sin, tan

import pytest
from shapely.geometry import LineString, Polygon, box

from agent.field.field_plan import (
    CLEARANCE_M,
    PIVOT_RADIUS_M,
    SECTION_LEAST_M,
    SECTIONS_EACH,
    SHORTER_FROM_ROBOTS,
    TURN_SPARE,
    FieldError,
    FieldPlan,
    FieldValues,
    divided,
    planned_radius_m,
)
from agent.field.fleet_plan import JOBS_MAX
from agent.interface.vehicle import DriveTrain, Vehicle

OUTLINE, ORIGIN = box(-30.0, -20.0, 30.0, 20.0), (51.0, 0.0)


def test_the_gate_is_a_corner_unless_it_is_declared() -> None:
    assert divided("f", OUTLINE, ORIGIN, FieldValues(), Vehicle()).gate == (-30.0, -20.0)
    field = divided("f", OUTLINE, ORIGIN, FieldValues(gate=(0.0, -20.0)), Vehicle())
    assert field.gate == (0.0, -20.0)


@pytest.mark.parametrize(
    ("values", "key"),
    [
        (FieldValues(gate=(31.0, 0.0)), "field.gate: "),
        (FieldValues(implement_width_m=41.0), "field.implement_width_m: "),
        (FieldValues(overlap_m=0.09), "field.overlap_m: 0.09 m: .* use 0.1 m at least"),
    ],
)
def test_a_value_that_does_not_fit_is_named(values: FieldValues, key: str) -> None:
    with pytest.raises(FieldError, match=key):
        divided("f", OUTLINE, ORIGIN, values, Vehicle())


@pytest.mark.parametrize(
    ("drive", "wrong_m", "least_m"),
    [(DriveTrain.ACKERMANN, 0.15, 0.2), (DriveTrain.DIFFERENTIAL, 0.1, 0.15)],
)
def test_a_body_that_steers_needs_a_wider_overlap(
    drive: DriveTrain, wrong_m: float, least_m: float
) -> None:
    """With 0.1 m, fleets worked the bends of their lines again and again until the time limit."""
    body = Vehicle(drive=drive)
    with pytest.raises(FieldError, match=rf"field.overlap_m: .* use {least_m} m at least"):
        divided("f", OUTLINE, ORIGIN, FieldValues(overlap_m=wrong_m), body)
    assert divided("f", OUTLINE, ORIGIN, FieldValues(overlap_m=least_m), body).sections


def test_a_vehicle_too_wide_for_its_swaths_is_named() -> None:
    field = divided("f", OUTLINE, ORIGIN, FieldValues(implement_width_m=1.6), Vehicle())
    with pytest.raises(FieldError, match=r"fleet.radius_m: 0.8 m is too wide"):
        FieldPlan(field, Vehicle())


def test_planned_curves_are_wider_than_the_tightest() -> None:
    tractor = Vehicle(drive=DriveTrain.ACKERMANN, wheelbase_m=2.0, steer_rad=radians(45.0))
    assert tractor.turn_radius_m == pytest.approx(2.0 / tan(radians(45.0)))
    assert planned_radius_m(tractor) == pytest.approx(TURN_SPARE * 2.0)
    assert planned_radius_m(Vehicle(drive=DriveTrain.DIFFERENTIAL)) == PIVOT_RADIUS_M
    assert planned_radius_m(Vehicle()) == 0.0


def test_fences_are_the_outline() -> None:
    plan = FieldPlan(divided("f", OUTLINE, ORIGIN, FieldValues(), Vehicle()), Vehicle())
    assert plan.fences.shape == (4, 4)
    assert plan.turn_radius_m == 0.0


@pytest.mark.parametrize("side_m", [60.0, 200.0, 1000.0])
def test_a_section_is_a_small_share_of_what_a_robot_works(side_m: float) -> None:
    field, swath_m = box(0.0, 0.0, side_m, side_m), side_m
    for robots in (SHORTER_FROM_ROBOTS, 24, 60, 108):
        values = FieldValues(robots=robots, gate=(0.0, 0.0))
        sections = divided("f", field, ORIGIN, values, Vehicle()).sections
        share_m = sum(section.length_m for section in sections) / robots / SECTIONS_EACH
        # The last swath of a section may make it longer than wanted.
        longest_m = max(min(share_m, values.section_length_m), SECTION_LEAST_M) + swath_m
        assert max(section.length_m for section in sections) <= longest_m, robots
        few = divided("f", field, ORIGIN, values._replace(robots=1), Vehicle()).sections
        assert len(sections) <= max(JOBS_MAX, len(few)), robots


@pytest.mark.parametrize("side_m", [30.0, 200.0])
def test_few_robots_get_sections_as_long_as_declared(side_m: float) -> None:
    """Each section begins with a way: one tractor took 28 % longer with short ones."""
    field = box(0.0, 0.0, side_m, side_m)
    one, few = (
        divided("f", field, ORIGIN, FieldValues(robots=n, gate=(0.0, 0.0)), Vehicle()).sections
        for n in (1, 6)
    )
    assert one == few


def test_a_robot_in_a_sharp_corner_has_a_way_to_each_section() -> None:
    """The last cell of the path grid in the corner was alone, so ways from there led across fences."""
    outline = Polygon(
        [
            (r * cos(0.7 + pi * k / 6), r * sin(0.7 + pi * k / 6))
            for k in range(12)
            for r in (70.0 if k % 2 == 0 else 11.0,)
        ]
    )
    field = divided("star", outline, ORIGIN, FieldValues(), Vehicle())
    plan = FieldPlan(field, Vehicle())
    room = outline.buffer(-Vehicle().radius_m)
    for tip in outline.buffer(-Vehicle().radius_m - CLEARANCE_M).exterior.coords:
        for section in field.sections:
            way = plan.route.path((tip[0], tip[1]), section.ends[0])
            assert room.covers(LineString(way)), tip
