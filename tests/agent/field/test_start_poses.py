"""Places of robots at the gate: side by side, on free ground, wherever there is room for them."""

from itertools import combinations
from math import dist

import pytest
from shapely.geometry import LineString, Point, Polygon, box

from agent.field.field_division import divide
from agent.field.field_map import Field, start_poses

SPACING_M, CLEARANCE_M = 4.5, 1.8  # of bodies of 1.5 m radius


def field_of(polygon: Polygon) -> Field:
    return divide("strip", polygon, (48.0, 11.0), polygon.exterior.coords[0][:2], 4.0)


@pytest.mark.parametrize("count", (1, 6))
def test_robots_begin_in_a_strip_that_rows_through_the_gate_miss(count: int) -> None:
    """Tractors of 3 m were refused in a field of 30 by 6 m: "no room for 1 robots"."""
    polygon = box(0.0, 0.0, 30.0, 6.0)
    places = start_poses(field_of(polygon), count, SPACING_M, CLEARANCE_M)
    free = polygon.buffer(-CLEARANCE_M)
    assert len(places) == count and all(free.contains(Point(place)) for place in places)
    assert all(dist(a, b) > SPACING_M - 1e-9 for a, b in combinations(places, 2))


def test_a_strip_that_is_full_is_told() -> None:
    with pytest.raises(ValueError, match="no room for 7 robots near the gate of strip"):
        start_poses(field_of(box(0.0, 0.0, 30.0, 6.0)), 7, SPACING_M, CLEARANCE_M)
    lane = LineString([(0, 0), (20, 0)]).buffer(2.05)
    with pytest.raises(ValueError, match="no room for 1 robots"):
        start_poses(field_of(lane), 1, SPACING_M, 2.1)
