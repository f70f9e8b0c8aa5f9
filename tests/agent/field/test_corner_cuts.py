"""Rings are cut where a body cannot follow, and nothing of them is lost."""

import pytest
from shapely.geometry import LineString, box
from shapely.ops import unary_union

from agent.field.corner_cuts import cut_at_corners
from agent.field.field_division import divide
from agent.field.field_map import Polyline
from agent.motion.tractor_tracker import smooth_way

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
