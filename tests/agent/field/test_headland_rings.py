"""Rings meet where they are straight, and turn in tips by less than a robot takes for reversing."""

from collections.abc import Sequence
from itertools import pairwise
from math import atan2, degrees, dist, pi

import pytest
import shapely
from shapely.geometry import LineString, Polygon, box

from agent.field.headland_rings import pieces, rings, swinging
from agent.interface.geometry import Point

WIDTH_M, SLACK_M = 4.0, 0.1


def ring_of(polygon: Polygon) -> LineString:
    (ring,) = rings(polygon.buffer(-WIDTH_M / 2))
    return ring


def turns_deg(line: Sequence[Point]) -> list[float]:
    courses = [atan2(b[1] - a[1], b[0] - a[0]) for a, b in pairwise(line) if dist(a, b) > 1e-9]
    return [
        abs(degrees((after - before + pi) % (2 * pi) - pi)) for before, after in pairwise(courses)
    ]


def test_a_ring_without_tips_stays_as_it_is() -> None:
    around = shapely.Point(0, 0).buffer(20).difference(box(-3, -3, 3, 3))
    for shape in (box(0, 0, 40, 30), Polygon([(0, 0), (40, 0), (20, 35)]), around):
        for ring in rings(shape.buffer(-WIDTH_M / 2)):
            assert swinging(ring, SLACK_M, WIDTH_M) is ring


@pytest.mark.parametrize("end_m", (0.0, 3.9, 3.95))
def test_in_a_tip_a_ring_turns_twice_and_stays_within_half_the_overlap(end_m: float) -> None:
    ring = ring_of(Polygon([(0, -end_m / 2), (60, -4), (60, 4), (0, end_m / 2)]))
    turned = swinging(ring, SLACK_M, WIDTH_M)
    assert max(turns_deg([*turned.coords, turned.coords[1]])) < 95.0
    assert turned.hausdorff_distance(ring) <= SLACK_M
    assert min(map(dist, turned.coords, turned.coords[1:])) >= 2 * SLACK_M - 1e-9


@pytest.mark.parametrize("size", [(0.03, 0.03), (0.0005, 0.0005), (0.15, 1.0), (0.05, 90.0)])
def test_a_ring_without_width_becomes_a_rectangle(size: Point) -> None:
    ring = ring_of(box(0, 0, WIDTH_M + size[0], WIDTH_M + size[1]))
    turned = swinging(ring, SLACK_M, WIDTH_M)
    assert turns_deg([*turned.coords, turned.coords[1]]) == pytest.approx([90.0] * 4)
    assert turned.hausdorff_distance(ring) <= SLACK_M * 1.5


def test_a_bent_ring_keeps_to_its_line() -> None:
    """A rectangle round its long axis left it by twice as much, towards a fence."""
    bent = LineString([(0, 0), (8, 0.28), (16, 0), (8, 0.3), (0, 0)])
    assert shapely.hausdorff_distance(swinging(bent, 0.3, 4.0), bent, densify=0.01) <= 0.3 * 1.5


def test_pieces_meet_where_the_ring_is_straight() -> None:
    sides = 40  # a side of 4.7 m: no place is half a width and a metre from both corners
    for ring in (
        ring_of(box(0, 0, 90, 60)),
        ring_of(shapely.Point(0, 0).buffer(32, quad_segs=sides // 4)),
    ):
        found = list(pieces(ring, 60.0, WIDTH_M))
        assert len(found) == round(ring.length / 60.0)
        assert sum(LineString(piece).length for piece in found) == pytest.approx(ring.length)
        for piece, following in zip(found, [*found[1:], found[0]], strict=True):
            assert dist(piece[-1], following[0]) < 1e-5
            assert turns_deg([*piece[-2:], *following[:2]]) == pytest.approx([0.0], abs=0.01)


@pytest.mark.parametrize("width_m", [1.0, 2.0, 3.0, 4.0])
def test_a_tip_does_not_take_in_the_arc_beside_it(width_m: float) -> None:
    """A needle of the field ends in an arc of sides that shrink with the implement."""
    field = Polygon([(0, 0), (40, 0), (40, 30), (21, 30), (20, 9), (19, 30), (0, 30)])
    for ring in rings(field.buffer(-width_m / 2)):
        turned = swinging(ring, 0.05, width_m)
        assert turned.hausdorff_distance(ring) <= 0.05 * 1.5
