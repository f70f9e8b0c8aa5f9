"""The planning map: its polygons cover the free floor, and its ways are nearly the shortest there are."""

from itertools import pairwise
from random import Random

import numpy as np
import pytest

from agent.mapping.building import Floor
from agent.paths.nav_mesh import Mesh, rectangles
from sim.scenarios.building_generator import rooms, warehouse


@pytest.mark.parametrize("seed", range(5))
def test_rectangles_cover_every_free_cell_once(seed: int) -> None:
    blocked = np.random.default_rng(seed).random((30, 40)) < 0.3
    boxes, box_of = rectangles(blocked)
    count = np.zeros(blocked.shape, dtype=int)
    for number, (r0, r1, c0, c1) in enumerate(boxes):
        count[r0:r1, c0:c1] += 1
        assert (box_of[r0:r1, c0:c1] == number).all()
    assert (count == ~blocked).all()


@pytest.mark.parametrize("drawing", [warehouse(4, 5, 8, 2, 1, 4), rooms(3, 32)])
def test_ways_are_at_most_a_few_percent_longer_than_the_shortest(drawing: str) -> None:
    floor = Floor.drawn(drawing, 1.0, 0.3)
    mesh = Mesh(floor.inflated, floor.origin, floor.fine_m)
    rng = Random(1)
    free = np.argwhere(~floor.inflated).tolist()
    ratios, taut = [], []
    for _ in range(40):
        a, b = (
            (floor.origin[0] + (c + 0.5) * floor.fine_m, floor.origin[1] + (r + 0.5) * floor.fine_m)
            for r, c in (rng.choice(free), rng.choice(free))
        )
        shortest = floor.route.length_m(a, b)
        way = mesh.way(a, b)
        if way is None or shortest < 2.0:
            continue
        ratios.append(mesh.metres(a, b) / shortest)
        legs = (float(np.hypot(q[0] - p[0], q[1] - p[1])) for p, q in pairwise(way))
        taut.append(sum(legs) / shortest)
    print(np.mean(ratios), max(ratios), np.mean(taut))
    assert len(ratios) > 20
    assert min(ratios) > 0.99 and np.mean(ratios) < 1.06 and max(ratios) < 1.15
    assert np.mean(taut) <= np.mean(ratios)


def test_one_search_gives_what_a_star_gives() -> None:
    floor = Floor.drawn(warehouse(3, 3, 6, 2, 1, 3), 1.0, 0.3)
    mesh = Mesh(floor.inflated, floor.origin, floor.fine_m)
    a, b = (0.5, 0.5), (20.5, 8.5)
    nodes, metres = mesh.onto(b)
    assert mesh.metres(a, b) == pytest.approx((mesh.field_m(a)[nodes] + metres).min())
