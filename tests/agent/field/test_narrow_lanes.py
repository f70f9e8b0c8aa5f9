"""Ways through ground that is too narrow for the cells of the path grid."""

from collections.abc import Callable
from functools import cache

import pytest
import shapely
from shapely.affinity import rotate
from shapely.geometry import LineString, Polygon, box

from agent.field.field_plan import FieldPlan, FieldValues, divided
from agent.field.narrow_lanes import narrow_lanes
from agent.interface.vehicle import Vehicle
from agent.motion.holonomic_motion import FENCE_M

ORIGIN = (51.0, 0.0)
BODY = Vehicle(radius_m=0.8)


def gateway(side_m: float, lane_m: float) -> Polygon:
    """A field and a yard of 25 m, with a lane of 22 m between them."""
    lane = box(side_m - 1, 20.0, side_m + 21, 20.0 + lane_m)
    return rotate(
        box(0.0, 0.0, side_m, side_m) | lane | box(side_m + 20, 10.0, side_m + 45, 35.0), 30.0
    )


def two_lanes() -> Polygon:
    lanes = box(299.0, 20.0, 341.0, 23.0) | box(299.0, 200.0, 341.0, 206.0)
    return rotate(box(0.0, 0.0, 300.0, 300.0) | box(340.0, 0.0, 640.0, 300.0) | lanes, 17.0)


OUTLINES: dict[str, tuple[Callable[[], Polygon], float]] = {
    "3 m wide, into 20 ha": (lambda: gateway(450.0, 3.0), 12.0),
    "9 m wide, into 576 ha": (lambda: gateway(2400.0, 9.0), 12.0),
    "hardly wider than the body": (lambda: gateway(60.0, 2.1), 4.0),
    "two": (two_lanes, 12.0),
    "a strip": (lambda: rotate(box(0.0, 0.0, 1500.0, 5.0), 33.0), 4.0),
}


@cache
def planned(name: str) -> FieldPlan:
    outline, width_m = OUTLINES[name]
    values = FieldValues(implement_width_m=width_m)
    return FieldPlan(divided(name, outline(), ORIGIN, values, BODY), BODY)


@pytest.mark.parametrize("name", OUTLINES)
def test_ways_lead_through_a_lane_that_no_cell_fits(name: str) -> None:
    """Robots had no way through, stood at the fence before it for good, and worked nothing beyond it."""
    plan = planned(name)
    room = plan.field.polygon.buffer(-BODY.radius_m - FENCE_M)
    shapely.prepare(room)
    ends = [end for section in plan.field.sections for end in section.ends]
    for start in (ends[0], ends[-1], ends[len(ends) // 2]):
        ways = [plan.route.path(start, end) for end in ends]
        assert all(way[0] == start and way[-1] == end for way, end in zip(ways, ends, strict=True))
        assert all(room.covers(LineString(way)) for way in ways)


def test_a_robot_in_a_lane_has_a_way_to_both_sides() -> None:
    plan = planned("3 m wide, into 20 ha")
    (lane,) = plan.route.lanes.lines
    at = LineString(lane).interpolate(0.5, normalized=True)
    room = plan.field.polygon.buffer(-BODY.radius_m - FENCE_M)
    for end in (lane[0], lane[-1]):
        for beside_m in (0.0, 0.3):
            way = plan.route.path((at.x + beside_m, at.y), end)
            assert room.covers(LineString(way[1:])) and LineString(way).length < 25.0
            assert LineString(plan.route.path(end, (at.x + beside_m, at.y))).length < 25.0


def test_times_of_the_plan_lead_through_the_lane() -> None:
    plan = planned("3 m wide, into 20 ha")
    travel, route = plan.travel, plan.route
    last = len(travel.ends) - 1
    for a, b in ((0, last), (last, 0)):
        way_m = route.length_m(tuple(travel.ends[a]), tuple(travel.ends[b]))
        for_s = travel.link_for_ms[a, b] / 1000
        assert (
            way_m / BODY.speed_m_s <= for_s + 1.0 and for_s <= 1.2 * way_m / BODY.speed_m_s + 10.0
        )


def test_a_body_that_stands_in_the_lane_closes_it() -> None:
    plan = planned("3 m wide, into 20 ha")
    (lane,) = plan.route.lanes.lines
    at = LineString(lane).interpolate(0.5, normalized=True)
    assert not plan.route.round([(at.x, at.y)], 1.9).lanes.lines
    assert plan.route.round([(0.0, 0.0)], 1.9).lanes.lines == (lane,)


def test_no_lane_leads_through_a_neck_narrower_than_the_body() -> None:
    field = divided("f", gateway(60.0, 1.9), ORIGIN, FieldValues(), BODY)
    plan = FieldPlan(field, BODY)
    blocked = plan.route.blocked, plan.route.origin_x_m, plan.route.origin_y_m, plan.route.cell_m
    assert narrow_lanes(field, blocked, 1.1, 1.04) == []
