"""What a map of worked ground says, held against exact polygons."""

from random import Random

import numpy as np
import shapely
from shapely.geometry import Polygon, box

from agent.implements.as_applied_map import AsAppliedMap
from crdt import Progress

FIELD = box(0.0, 0.0, 60.0, 40.0)


def test_a_cell_is_whole_only_when_all_of_it_was_worked() -> None:
    for seed in range(4):
        rng, ground = Random(seed), AsAppliedMap(FIELD, Progress())
        worked, cells = [], set[tuple[int, int]]()
        x, y, heading = rng.uniform(15, 45), rng.uniform(10, 30), rng.uniform(0, 6.28)
        before: np.ndarray | None = None
        for _ in range(60):
            x, y = x + 0.15 * np.cos(heading), y + 0.15 * np.sin(heading)
            heading += rng.uniform(-0.02, 0.02)
            left = np.array((x - 3 * np.sin(heading), y + 3 * np.cos(heading)))
            right = np.array((x + 3 * np.sin(heading), y - 3 * np.cos(heading)))
            if before is not None:
                corners = np.array((before[0], before[1], right, left))
                cells |= set(ground.paint(corners))
                worked.append(Polygon(corners).buffer(0.001))
            before = np.array((left, right))
        union, edge_m = shapely.union_all(worked), ground.cell_m
        inside = 0
        for row, column in cells:
            low = ground.origin + np.array((column, row)) * edge_m
            cell = box(*low, *(low + edge_m))
            # The middle of each part was worked; a part has 5 cm, so at most half of that is missing.
            assert union.buffer(0.5 * ground.part_m * 2**0.5).contains(cell), seed
            inside += 1
        whole = union.buffer(-edge_m * 2**0.5).area / edge_m**2
        assert inside >= whole * 0.99, "no whole cell is forgotten"


def test_what_another_machine_has_worked_needs_no_work() -> None:
    progress = Progress()
    ground = AsAppliedMap(FIELD, progress)
    place = np.array([[10.1, 10.1], [-0.5, 10.0], [61.0, 10.0], [-5.0, -5.0], [1e6, 1e6]])
    assert ground.needs(place).tolist() == [True, False, False, False, False]
    column, row = np.floor((place[0] - ground.origin) / ground.cell_m).astype(int).tolist()
    progress.cover(row, column)
    assert not ground.needs(place)[0]
    assert ground.area_m2() == ground.cell_m**2


def test_a_large_field_has_larger_cells() -> None:
    large = AsAppliedMap(box(0.0, 0.0, 5000.0, 900.0), Progress())
    assert (
        large.cell_m == 0.5
        and large.paint(np.array([[1e5, 0], [1e5, 1], [1e5 + 1, 1], [1e5 + 1, 0.0]])) == []
    )


def test_a_piece_of_ground_of_kilometres_is_not_painted_and_takes_no_memory() -> None:
    large = AsAppliedMap(box(0.0, 0.0, 2000.0, 2000.0), Progress())
    wide = np.array([[0.0, 0.0], [1500.0, 1500.0], [1500.2, 1500.0], [0.2, 0.0]])
    assert large.paint(wide) == [] and large.too_large == 1
    boom = 1000.0 + wide * 70.0 / 1500.0  # the widest boom, aslant
    large.paint(boom)
    assert large.too_large == 1


def test_a_boom_that_reaches_beyond_the_last_cell_paints_what_is_on_the_map() -> None:
    """All of it was lost: work along the east or north edge of a field whose size fills all cells."""
    for wide_m, deep_m in ((2558.0, 100.0), (100.0, 8190.0)):
        ground = AsAppliedMap(box(0.0, 0.0, wide_m, deep_m), Progress())
        assert ground.cell_m == 0.25
        corner = np.array((wide_m, deep_m))
        boom = corner + np.array([[-6.0, -3.0], [6.0, -3.0], [6.0, -1.0], [-6.0, -1.0]])
        if deep_m > wide_m:
            boom = corner + np.array([[-3.0, 6.0], [-3.0, -6.0], [-1.0, -6.0], [-1.0, 6.0]])
        assert ground.paint(boom)
        assert not ground.needs(np.array([corner - 2.0]))[0]
