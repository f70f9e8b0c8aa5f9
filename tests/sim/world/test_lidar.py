"""Range sensors against pymunk's own segment queries, and against geometry done by hand."""

from itertools import pairwise
from math import cos, hypot, inf, pi, sin
from random import Random

import numpy as np
import pymunk
import pytest

from sim.world.drive_trains import Chassis
from sim.world.lidar import Lidar
from sim.world.walls import Grid
from sim.world.world import World

RANGE_M = 10.0


def pymunk_ranges(
    space: pymunk.Space, x: float, y: float, heading: float, rays: int
) -> list[float]:
    """36 segment queries; the robot's own disc has been taken out of the space."""
    found = []
    for n in range(rays):
        angle = heading + n * 2 * pi / rays
        end = (x + RANGE_M * cos(angle), y + RANGE_M * sin(angle))
        hit = space.segment_query_first((x, y), end, 0.0, pymunk.ShapeFilter())
        found.append(hit.alpha * RANGE_M if hit is not None else inf)
    return found


def cluttered(seed: int, robots: int, gridded: bool = False) -> tuple[World, pymunk.Space]:
    """The same things in our world and in a plain pymunk space."""
    rng = Random(seed)
    ring = [(25 * cos(a) * rng.uniform(0.8, 1.2), 25 * sin(a) * rng.uniform(0.8, 1.2))
            for a in (k * 2 * pi / 40 for k in range(40))]  # fmt: skip
    holes = []
    for _ in range(12):
        cx, cy, r = rng.uniform(-18, 18), rng.uniform(-18, 18), rng.uniform(0.3, 2.0)
        first, sides = rng.uniform(0, pi), rng.randrange(3, 8)
        corners = [first + k * 2 * pi / sides for k in range(sides)]
        holes.append([(cx + r * cos(a), cy + r * sin(a)) for a in corners])
    grid = None
    if gridded:
        blocked = np.random.default_rng(seed).random((60, 60)) < 0.05
        grid = Grid(blocked, -24.0, -24.0, 0.8)
    world = World([ring, *holes], seed, Lidar(36, RANGE_M), grid)
    space = pymunk.Space()
    for outline in (ring, *holes):
        for a, b in pairwise([*outline, outline[0]]):
            space.add(pymunk.Segment(space.static_body, a, b, 0.0))
    if grid is not None:
        for r, c in np.argwhere(grid.blocked):
            west, south = -24.0 + 0.8 * c, -24.0 + 0.8 * r
            cell = [(west + u, south + v) for u in (0.0, 0.8) for v in (0.0, 0.8)]
            space.add(pymunk.Poly(space.static_body, cell))
    for _ in range(6):
        x, y, turn = rng.uniform(-18, 18), rng.uniform(-18, 18), rng.uniform(0, pi)
        w, h, radius = rng.uniform(0.3, 2.0), rng.uniform(0.3, 2.0), rng.uniform(0.2, 1.0)
        world.add_box(x, y, w, h, turn)
        frame = pymunk.Transform.translation(x, y).rotated(turn)
        frame_corners = [(u, v) for u in (-w / 2, w / 2) for v in (-h / 2, h / 2)]
        space.add(pymunk.Poly(space.static_body, frame_corners, frame))
        world.add_disc(y, x, radius)
        space.add(pymunk.Circle(space.static_body, radius, (y, x)))
    for slot in range(robots):
        at = (rng.uniform(-18, 18), rng.uniform(-18, 18))
        world.add_robot(slot, at, 0.4, Chassis(), rng.uniform(-pi, pi))
    return world, space


@pytest.mark.parametrize("gridded", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_agrees_with_pymunk(seed: int, gridded: bool) -> None:
    world, space = cluttered(seed, 40, gridded)
    discs = [pymunk.Circle(space.static_body, 0.4, r.position) for r in world.robots.values()]
    space.add(*discs)
    rays = good = hits = 0
    for slot, robot in world.robots.items():
        space.remove(discs[slot])
        x, y = robot.position
        overlapped = space.point_query_nearest((x, y), 0.0, pymunk.ShapeFilter()) is not None
        expected = pymunk_ranges(space, x, y, robot.heading_rad, 36)
        space.add(discs[slot])
        if overlapped:
            continue  # a ray from inside a shape: pymunk and we mean different things
        for ours, theirs in zip(robot.sense(0).ranges_m, expected, strict=True):
            rays += 1
            hits += ours < inf
            good += ours == theirs or abs(ours - theirs) <= 0.001
    assert rays > 500 and hits > 400
    assert good / rays >= 0.99, f"seed {seed}: {good} of {rays} rays within 1 mm"


def test_distances_by_hand() -> None:
    room = [(-4.0, -3.0), (5.0, -3.0), (5.0, 6.0), (-4.0, 6.0)]
    world = World([room], 1, Lidar(4, 20.0))
    body = world.add_robot(0, (0.0, 0.0), 0.5, Chassis())
    assert body.sense(0).ranges_m == pytest.approx((5.0, 6.0, 4.0, 3.0))
    world.add_robot(1, (3.0, 0.3), 0.5, Chassis())
    assert body.sense(0).ranges_m[0] == pytest.approx(3.0 - 0.4)
    number = world.add_box(0.0, 2.0, 1.0)
    assert body.sense(0).ranges_m[1] == pytest.approx(1.5)
    world.remove_box(number)
    assert body.sense(0).ranges_m[1] == pytest.approx(6.0)


def test_beyond_reach_is_nothing() -> None:
    world = World([], 1, Lidar(8, 5.0))
    body = world.add_robot(0, (0.0, 0.0), 0.5, Chassis())
    world.add_disc(5.7, 0.0, 0.6)
    assert body.sense(0).ranges_m == (inf,) * 8
    world.add_disc(0.0, 5.5, 0.6)
    assert body.sense(0).ranges_m[2] == pytest.approx(4.9)


def test_inside_something_is_zero() -> None:
    world = World([], 1, Lidar(8, 5.0))
    body = world.add_robot(0, (0.0, 0.0), 0.5, Chassis())
    world.add_disc(0.1, 0.0, 0.6)
    assert body.sense(0).ranges_m == (0.0,) * 8


def test_no_ray_slips_out_of_a_closed_ring() -> None:
    """Straight at the corners of a ring, where two segments meet."""
    rng = Random(3)
    for sides in (3, 4, 7, 90):
        ring = [(8 * cos(k * 2 * pi / sides), 8 * sin(k * 2 * pi / sides)) for k in range(sides)]
        world = World([ring], 1, Lidar(sides, 20.0))
        body = world.add_robot(0, (0.0, 0.0), 0.1, Chassis())
        assert max(body.sense(0).ranges_m) == pytest.approx(8.0)
        for _ in range(200):
            x, y = rng.uniform(-1, 1), rng.uniform(-1, 1)
            body.teleport(x, y, rng.uniform(-pi, pi))
            farthest = max(hypot(x - a, y - b) for a, b in ring)
            assert max(body.sense(0).ranges_m) <= farthest + 1e-9
