"""The map: rays against sampling, inflation against geometry, obstacles that come and go, saving."""

from itertools import pairwise
from math import cos, inf, pi, sin
from random import Random

import numpy as np
import pytest
import shapely
from hypothesis import example, given, note, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from agent.mapping.inflation import Inflation, cell_of
from agent.mapping.occupancy_grid import CELL_M, INFLATION_M, Obstacle, OccupancyGrid
from agent.mapping.ray_evidence import HIT, MISS, MOST, weigh_scan
from tests.examples import examples
from tools.bench.kernels.occupancy_fleet import OccupancyFleet

BODY_M = 0.30
S = 1_000_000
seeds = st.integers(0, 1 << 30)


def squares(cells: NDArray[np.bool_]) -> shapely.MultiPolygon:
    """Cells as geometry in metres, the origin at the corner of the grid."""
    rows, columns = np.nonzero(cells)
    boxes = shapely.box(
        columns * CELL_M, rows * CELL_M, (columns + 1) * CELL_M, (rows + 1) * CELL_M
    )
    return shapely.multipolygons(boxes) if len(boxes) else shapely.MultiPolygon()


def ring(grid: OccupancyGrid, at: tuple[float, float], truth: shapely.Geometry, rays: int = 72,
         reach_m: float = 5.0) -> int:  # fmt: skip
    """One scan of a world of shapes, ray by ray through GEOS."""
    ranges = []
    for n in range(rays):
        angle = 2 * pi * n / rays
        end = (at[0] + reach_m * cos(angle), at[1] + reach_m * sin(angle))
        hit = shapely.intersection(shapely.LineString([at, end]), truth)
        ranges.append(inf if hit.is_empty else shapely.distance(hit, shapely.Point(at)))
    return grid.observe(at, 0.0, ranges, reach_m)


@given(seeds)
@example(93249)  # through a corner of a cell
@settings(deadline=None, max_examples=examples(60))
def test_a_ray_weighs_the_cells_it_passes(seed: int) -> None:
    note(f"seed {seed}")
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(1, 20, 2)
    x, y = rng.uniform(0, columns), rng.uniform(0, rows)
    angle, length = rng.uniform(-pi, pi), rng.uniform(0.5, 15)
    evidence = np.zeros((rows, columns), dtype=np.int8)
    solid, stamps = np.zeros((rows, columns), np.bool_), np.zeros((rows, columns), np.int64)
    hits = bool(rng.integers(2))
    far = length + 1.0 if hits else length
    toggled = np.empty((100, 3), dtype=np.int64)
    count = weigh_scan(evidence, solid, stamps, 1, 0.0, 0.0, 1.0, x, y, angle, np.array([length]), far,
                       np.empty((0, 3)), toggled)  # fmt: skip
    t = np.arange(0, length - 0.02, 0.001)
    r, c = np.floor(y + t * sin(angle)).astype(int), np.floor(x + t * cos(angle)).astype(int)
    inside = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
    passed = set(zip(r[inside].tolist(), c[inside].tolist(), strict=True))
    weighed = {(int(a), int(b)) for a, b in np.argwhere(evidence < 0)}
    end = int(np.floor(y + length * sin(angle))), int(np.floor(x + length * cos(angle)))
    line = shapely.LineString([(x, y), (x + length * cos(angle), y + length * sin(angle))])
    for row, column in weighed - passed - {end}:  # a corner that no step falls into
        assert shapely.box(column, row, column + 1, row + 1).distance(line) < 1e-9, (row, column)
    assert len(passed - weighed) <= 2, "the last cell, and one that is touched by less than a step"
    assert set(np.unique(evidence[evidence < 0])) <= {-MISS}
    assert count == int(solid.sum()) == int((evidence == HIT).sum()) <= hits


@given(seeds)
@settings(deadline=None, max_examples=examples(60))
def test_inflation_is_what_geometry_says_after_any_change(seed: int) -> None:
    note(f"seed {seed}")
    rng = np.random.default_rng(seed)
    solid = rng.random(tuple(rng.integers(1, 25, 2))) < 0.05
    reach = float(rng.choice([0.0, 0.5, 1.0, 2.2, 3.7]))
    layer = Inflation(solid, reach)
    for _ in range(5):
        cells = np.argwhere(rng.random(solid.shape) < 0.05)
        solid[cells[:, 0], cells[:, 1]] ^= True
        layer.toggle(np.column_stack((cells, solid[cells[:, 0], cells[:, 1]])).astype(np.int64))
        near = np.zeros_like(solid)
        for r, c in np.argwhere(solid):
            i, j = np.ogrid[: solid.shape[0], : solid.shape[1]]
            gap = np.hypot(np.maximum(abs(i - r) - 1, 0), np.maximum(abs(j - c) - 1, 0))
            near |= gap < reach
        assert np.array_equal(layer.blocked, near | solid)


@given(seeds)
@settings(deadline=None, max_examples=examples(40))
def test_a_way_keeps_its_distance_from_all_that_is_solid(seed: int) -> None:
    note(f"seed {seed}")
    rng = np.random.default_rng(seed)
    fixed = rng.random((40, 40)) < 0.02
    grid = OccupancyGrid(40, 40, (0.0, 0.0), BODY_M, fixed)
    free = np.argwhere(~grid.tight.blocked)
    if len(free) < 2:
        return
    ends = free[rng.integers(len(free), size=2)] + rng.uniform(0, 1, (2, 2))
    start, goal = ((float(c) * CELL_M, float(r) * CELL_M) for r, c in ends)
    path = grid.plan(start, goal)
    if path is not None:
        assert path[0] == start and path[-1] == goal
        gap_m = shapely.distance(shapely.LineString(path), squares(grid.solid))
        assert np.isnan(gap_m) or gap_m >= BODY_M + INFLATION_M - 1e-5


def test_a_wall_is_seen_and_a_box_that_leaves_is_forgotten() -> None:
    grid = OccupancyGrid(40, 40, (-4.0, -4.0), BODY_M)
    wall = shapely.box(1.5, -3.9, 1.7, 3.9)
    box = shapely.box(-2.0, -0.4, -1.4, 0.4)
    for _ in range(5):
        ring(grid, (0.0, 0.0), shapely.union(wall, box))
    assert grid.solid[20, 27] and grid.solid[20, 12]
    for _ in range(MOST + 1):  # 0.35 s at 20 Hz
        ring(grid, (0.0, 0.0), wall)
    assert not grid.solid[20, 12]
    assert grid.solid[20, 27], "the wall stays"


def test_one_false_echo_closes_nothing_that_is_known_to_be_free() -> None:
    grid = OccupancyGrid(20, 20, (0.0, 0.0), BODY_M)
    for _ in range(5):
        grid.observe((2.0, 2.0), 0.0, [inf] * 36, 1.5)
    assert grid.observe((2.0, 2.0), 0.0, [1.0] + [inf] * 35, 1.5) == 0
    assert grid.observe((2.0, 2.0), 0.0, [1.0] + [inf] * 35, 1.5) == 1


def test_known_robots_are_no_obstacles() -> None:
    grid = OccupancyGrid(20, 20, (0.0, 0.0), BODY_M)
    other = (3.2, 2.0, 0.35)
    for _ in range(3):
        grid.observe((2.0, 2.0), 0.0, [0.9] + [inf] * 35, 3.0, [other])
    assert not grid.solid.any()


def test_broken_measurements_are_no_evidence() -> None:
    grid = OccupancyGrid(20, 20, (0.0, 0.0), BODY_M)
    nan = float("nan")
    assert grid.observe((2.0, 2.0), 0.0, [nan, -1.0, nan, -inf], 3.0) == 0
    assert grid.observe((nan, 2.0), 0.0, [1.0], 3.0) == 0
    assert grid.observe((2.0, 2.0), 0.0, [], 3.0) == 0
    assert grid.observe((-50.0, 90.0), 0.0, [1.0] * 8, 3.0) == 0
    assert not grid.evidence.any()


def test_start_and_goal_beside_a_wall_are_carved_free() -> None:
    fixed = np.zeros((30, 30), dtype=np.bool_)
    fixed[0] = True
    grid = OccupancyGrid(30, 30, (0.0, 0.0), BODY_M, fixed)
    before = grid.tight.blocked.copy()
    path = grid.plan((1.0, 0.45), (5.0, 0.45))
    assert path is not None
    assert not any(p[1] < 0.2 for p in path), "the wall itself is not carved"
    assert np.array_equal(grid.tight.blocked, before), "after the query all is back"
    assert np.array_equal(grid.tight.planner.blocked, before)
    assert grid.plan((1.0, 3.0), (5.0, 0.1)) is None, "nobody goes into a wall"
    assert grid.plan((1.0, 3.0), (9.0, 3.0)) is None, "nor out of the map"


@pytest.mark.parametrize("seed", range(20))
def test_m16_a_way_out_of_the_inflation_passes_no_corner_nearer_than_the_body(seed: int) -> None:
    """A robot beside a rack stood for good: its first leg passed a corner at two thirds of its radius."""
    print(f"seed {seed}")
    rng = Random(seed)
    fixed = np.zeros((60, 60), dtype=np.bool_)
    for _ in range(6):
        row, column = rng.randrange(5, 50), rng.randrange(5, 50)
        fixed[row : row + rng.randrange(2, 8), column : column + rng.randrange(2, 8)] = True
    grid = OccupancyGrid(60, 60, (0.0, 0.0), BODY_M, fixed)
    solid = (np.argwhere(fixed)[:, ::-1] + 0.5) * grid.cell_m  # middles of the solid cells

    def gap_m(x_m: float, y_m: float) -> float:
        beyond = np.maximum(np.abs(solid - (x_m, y_m)) - grid.cell_m / 2, 0.0)
        return float(np.hypot(beyond[:, 0], beyond[:, 1]).min())

    tried = 0
    while tried < 20:
        start, goal = ((rng.uniform(0.5, 11.5), rng.uniform(0.5, 11.5)) for _ in range(2))
        inflated = bool(
            grid.tight.blocked[cell_of((start[1] / CELL_M - 0.5, start[0] / CELL_M - 0.5))]
        )
        # Its body touches no wall, and it is in the inflation.
        if not inflated or gap_m(*start) < BODY_M or gap_m(*goal) < 2 * BODY_M:
            continue
        tried += 1
        path = grid.plan(start, goal)
        if path is None:
            continue
        nearest = min(
            gap_m(ax + t * (bx - ax), ay + t * (by - ay))
            for (ax, ay), (bx, by) in pairwise(path)
            for t in np.linspace(0.0, 1.0, 50)
        )
        assert nearest >= BODY_M - 1e-6, (seed, start, goal, path)


def test_a_robot_that_the_map_calls_solid_is_not_shut_in() -> None:
    grid = OccupancyGrid(30, 30, (0.0, 0.0), BODY_M)
    grid.place(Obstacle(3.0, 3.0, 0.25, 0, 10 * S, owner=1, number=1), now_us=0)
    assert grid.plan((3.0, 3.0), (5.0, 5.0)) is not None


def test_a_little_longer_and_further_away_is_better() -> None:
    """A gap that is just wide enough, and a wide one near by."""
    fixed = np.zeros((60, 60), dtype=np.bool_)
    fixed[30] = True
    fixed[30, 27:33] = False  # 1.2 m: 0.4 m on either side of the centre
    fixed[30, 34:56] = False
    grid = OccupancyGrid(60, 60, (0.0, 0.0), BODY_M, fixed)
    path = grid.plan((6.0, 2.0), (6.0, 10.0))
    assert path is not None and max(x for x, _ in path) > 7.2
    assert grid.cost_m(path) < 8.8
    gap_m = shapely.distance(shapely.LineString(path), squares(grid.solid))
    assert gap_m > BODY_M + INFLATION_M + 0.1
    fixed[30, 34:56] = True
    path = OccupancyGrid(60, 60, (0.0, 0.0), BODY_M, fixed).plan((6.0, 2.0), (6.0, 10.0))
    assert path is not None and max(x for x, _ in path) < 6.6, "the narrow one where it is the only"


def test_an_obstacle_stands_from_birth_to_expiry() -> None:
    grid = OccupancyGrid(30, 30, (0.0, 0.0), BODY_M)
    obstacle = Obstacle(3.0, 3.0, 0.3, 2 * S, 5 * S, owner=4, number=7)
    assert grid.place(obstacle, now_us=0) == 0 and not grid.solid.any()
    assert grid.expire(2 * S) > 0 and grid.solid[15, 15]
    assert grid.expire(5 * S - 1) == 0
    assert grid.expire(5 * S) > 0 and not grid.solid.any() and not grid.obstacles


@given(seeds)
@settings(deadline=None, max_examples=examples(40))
def test_obstacles_that_overlap_come_and_go_independently(seed: int) -> None:
    note(f"seed {seed}")
    rng = np.random.default_rng(seed)
    grid = OccupancyGrid(30, 30, (0.0, 0.0), BODY_M)
    now_us = 0
    for _ in range(25):
        now_us += int(rng.integers(S))
        x, y = rng.uniform(-1, 7, 2).tolist()
        born = now_us + int(rng.integers(-S, S))
        grid.place(Obstacle(x, y, float(rng.uniform(0, 1.5)), born, born + int(rng.integers(4 * S)),
                            int(rng.integers(3)), int(rng.integers(3))), now_us)  # fmt: skip
        if rng.random() < 0.2:
            grid.remove(int(rng.integers(3)), int(rng.integers(3)))
        expected = np.zeros((30, 30), dtype=np.bool_)
        for obstacle in grid.obstacles.values():
            assert obstacle.expires_at_us > now_us
            if obstacle.stands(now_us):
                r, c = np.ogrid[:30, :30]
                dx = np.maximum(
                    np.maximum(c - obstacle.x_m / CELL_M, obstacle.x_m / CELL_M - c - 1), 0
                )
                dy = np.maximum(
                    np.maximum(r - obstacle.y_m / CELL_M, obstacle.y_m / CELL_M - r - 1), 0
                )
                expected |= np.hypot(dx, dy) <= obstacle.radius_m / CELL_M
        assert np.array_equal(grid.solid, expected)
        fresh = Inflation(expected, grid.tight.reach_cells)
        assert np.array_equal(grid.tight.blocked, fresh.blocked)


def test_a_saved_map_is_the_same_map() -> None:
    rng = np.random.default_rng(8)
    fixed = rng.random((33, 47)) < 0.02
    grid = OccupancyGrid(33, 47, (-2.0, 5.0), BODY_M, fixed, inflation_m=0.2)
    for _ in range(6):
        at = rng.uniform(0, 4), rng.uniform(6, 10)
        grid.observe(at, 0.3, rng.uniform(0.5, 4.0, 36).tolist(), 3.5)
    grid.place(Obstacle(1.0, 7.0, 0.3, 0, 9 * S, 3, 1), 0)
    grid.place(Obstacle(3.0, 8.0, 0.3, 0, 2 * S, 3, 2), 0)
    data = grid.to_bytes()
    same, later = OccupancyGrid.from_bytes(data, 0), OccupancyGrid.from_bytes(data, 3 * S)
    assert np.array_equal(same.evidence, grid.evidence) and np.array_equal(same.solid, grid.solid)
    assert np.array_equal(same.tight.blocked, grid.tight.blocked)
    assert same.obstacles == grid.obstacles and list(later.obstacles) == [(3, 1)]
    assert same.plan((0.1, 6.0), (5.0, 10.0)) == grid.plan((0.1, 6.0), (5.0, 10.0))
    assert same.to_bytes() == data


@given(st.binary(max_size=200), st.integers(0, 300), st.integers(0, 255))
@settings(deadline=None, max_examples=examples(150))
def test_a_damaged_file_is_refused(noise: bytes, where: int, value: int) -> None:
    whole = OccupancyGrid(9, 7, (0.0, 0.0), BODY_M).to_bytes()
    changed = bytearray(whole)
    changed[where % len(whole)] = value
    for data in (noise, whole[: where % len(whole)], b"HLM1" + noise, bytes(changed)):
        try:
            grid = OccupancyGrid.from_bytes(data, 0)
        except ValueError:
            continue
        assert grid.solid.size <= 1 << 24
    with pytest.raises(ValueError, match="not a saved map"):
        OccupancyGrid.from_bytes(b"", 0)


@pytest.mark.parametrize("seed", [1, 2])
def test_maps_of_many_at_once_are_what_each_alone_would_have(seed: int) -> None:
    rng = np.random.default_rng(seed)
    fixed = rng.random((30, 40)) < 0.05
    fleet = OccupancyFleet(5, fixed, (-1.0, 2.0), 0.3, 0.5)
    alone = [OccupancyGrid(30, 40, (-1.0, 2.0), 0.3, fixed) for _ in range(5)]
    for _ in range(30):
        places = rng.uniform((-0.8, 2.2, -pi), (6.8, 7.8, pi), (5, 3))
        ranges = rng.uniform(0.2, 4.0, (5, 24)).astype(np.float32)
        ranges[rng.random((5, 24)) < 0.2] = inf
        news = fleet.observe(places, ranges, 3.0)
        for k, grid in enumerate(alone):
            others = [(x, y, 0.5) for j, (x, y, _) in enumerate(places.tolist()) if j != k]
            x, y, heading = places[k].tolist()
            assert news[k] == grid.observe((x, y), heading, ranges[k].tolist(), 3.0, others)
    for one, other in zip(fleet.grids, alone, strict=True):
        assert np.array_equal(one.evidence, other.evidence)
        assert np.array_equal(one.seen, other.seen)
        assert np.array_equal(one.tight.blocked, other.tight.blocked)
        assert np.array_equal(one.unseen(3), other.unseen(3))
