"""Which points of a grid are inside of an area, against shapely, which is asked for each point."""

from math import cos, pi, sin
from random import Random

import numpy as np
import pytest
import shapely
from shapely.geometry import MultiPolygon, Polygon, box

from agent.field.field_map import grid_inside


def same(area: Polygon | MultiPolygon, cell_m: float) -> int:
    """How many points are inside; both ways must agree on each."""
    west, south, east, north = (0.0, 0.0, 1.0, 1.0) if area.is_empty else area.bounds
    x_m = np.arange(west - 1.0, east + 1.0, cell_m, dtype=np.float64)
    y_m = np.arange(south - 1.0, north + 1.0, cell_m, dtype=np.float64)
    found = grid_inside(area, x_m, y_m)
    assert np.array_equal(found, shapely.contains_xy(area, *np.meshgrid(x_m, y_m)))
    return int(found.sum())


@pytest.mark.parametrize("seed", range(20))
def test_it_agrees_with_shapely_for_areas_with_holes_and_parts(seed: int) -> None:
    rng = Random(seed)
    around = [k * 2 * pi / 11 for k in range(11)]
    star = Polygon([(r * cos(a), r * sin(a)) for a in around for r in [rng.uniform(8.0, 30.0)]])
    hole = box(-3.0, -2.0, 2.0, 3.0).buffer(rng.uniform(0.0, 2.0))
    area = star.difference(hole).buffer(-rng.uniform(0.2, 3.0))
    assert same(area, rng.choice((0.25, 0.5, 0.37))) > 0


def test_it_agrees_where_corners_and_edges_lie_on_rows_and_columns() -> None:
    notched = box(0.0, 0.0, 10.0, 6.0).difference(box(3.0, 2.0, 5.0, 6.0))
    assert same(notched, 0.5) == 19 * 11 - 5 * 8
    assert same(notched.difference(box(6.0, 1.0, 8.0, 3.0)), 0.25) > 0
    assert same(MultiPolygon([box(0, 0, 1, 1), box(1.5, 0, 2.5, 4)]), 0.125) > 0
    assert same(Polygon([(0, 0), (4, 4), (8, 0), (4, 8)]), 0.5) > 0
    assert same(Polygon([(0, 0), (40, 1e-7), (40, 3), (0, 3)]), 0.1) > 0, "nearly level"
    assert same(Polygon(), 0.5) == 0
