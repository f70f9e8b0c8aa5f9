"""A field as declared vehicles drive in it: what is refused, and what the curves are."""

from math import radians, tan

import pytest
from shapely.geometry import box

from agent.field.field_plan import (
    PIVOT_RADIUS_M,
    TURN_SPARE,
    FieldError,
    FieldPlan,
    FieldValues,
    divided,
    planned_radius_m,
)
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
    ],
)
def test_a_value_that_does_not_fit_is_named(values: FieldValues, key: str) -> None:
    with pytest.raises(FieldError, match=key):
        divided("f", OUTLINE, ORIGIN, values, Vehicle())


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
