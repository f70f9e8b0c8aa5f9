"""Range sensing: CPU time a ray against pymunk's own segment queries, and a hall full of robots."""

from collections.abc import Callable, Iterator
from functools import partial
from math import cos, inf, pi, sin
from random import Random
from statistics import median
from time import process_time

import numba
import numpy as np
import pymunk

from agent.interface.effects import Drive
from agent.interface.geometry import Point
from sim.world.drive_trains import EXPIRES_US, STEP_US, Chassis
from sim.world.lidar import Lidar
from sim.world.world import World
from tools.bench.figure import Figure

SEED = 20
RAYS = 36
RANGE_M = 10.0
RADIUS_M = 0.4


def hall(seed: int, robots: int) -> tuple[World, pymunk.Space]:
    """Shelves in rows, robots anywhere between them; the same in a space of pymunk alone."""
    rng = Random(f"{seed}/lidar/{robots}")
    side_m = max(20.0, 6.0 * robots**0.5)
    rings: list[list[Point]] = [[(0.0, 0.0), (side_m, 0.0), (side_m, side_m), (0.0, side_m)]]
    aisles = np.arange(4.0, side_m - 6.0, 8.0).tolist()
    shelves = [(x, y) for x in aisles for y in np.arange(4.0, side_m - 3.0, 6.0).tolist()]
    for x, y in shelves:
        rings.append([(x, y), (x + 4.0, y), (x + 4.0, y + 1.0), (x, y + 1.0)])
    world = World(rings, seed, Lidar(RAYS, RANGE_M))
    space = pymunk.Space()
    for ring in rings:
        for a, b in zip(ring, [*ring[1:], ring[0]], strict=True):
            space.add(pymunk.Segment(space.static_body, a, b, 0.0))
    places: list[Point] = []
    while len(places) < robots:
        x, y = rng.uniform(1.0, side_m - 1.0), rng.uniform(1.0, side_m - 1.0)
        clear = all((x - a) ** 2 + (y - b) ** 2 > (2.5 * RADIUS_M) ** 2 for a, b in places)
        off = all(not (a - 0.5 < x < a + 4.5 and b - 0.5 < y < b + 1.5) for a, b in shelves)
        if clear and off:
            places.append((x, y))
            world.add_robot(len(places) - 1, (x, y), RADIUS_M, Chassis(), rng.uniform(-pi, pi))
    discs = [pymunk.Circle(space.static_body, RADIUS_M, place) for place in places]
    for number, disc in enumerate(discs):
        disc.filter = pymunk.ShapeFilter(group=number + 1)  # a robot does not see itself
        space.add(disc)
    return world, space


def by_pymunk(world: World, space: pymunk.Space) -> list[list[float]]:
    """What a program that has pymunk at hand would write: for each robot its ranges in metres."""
    rows = []
    for slot, robot in world.robots.items():
        (x, y), heading = robot.position, robot.heading_rad
        own = pymunk.ShapeFilter(group=slot + 1)
        row = []
        for n in range(RAYS):
            angle = heading + n * 2 * pi / RAYS
            end = (x + RANGE_M * cos(angle), y + RANGE_M * sin(angle))
            hit = space.segment_query_first((x, y), end, 0.0, own)
            row.append(inf if hit is None else hit.alpha * RANGE_M)
        rows.append(row)
    return rows


def by_kernel(world: World) -> list[tuple[float, ...]]:
    """For each robot its ranges in metres, one robot after the other, as `sense` does."""
    return [world.ranges(index) for index in range(len(world.robots))]


def seconds(work: Callable[[], object]) -> float:
    """CPU time that `work` takes."""
    start = process_time()
    work()
    return process_time() - start


def figures(quick: bool) -> Iterator[Figure]:
    """Rays against pymunk, and a step of a hall full of robots, for few and for many."""
    rounds = 7 if quick else 21
    for robots in (10, 100):
        yield from rays(SEED, robots, rounds)
    for robots, target_us in ((6, 30.0), (100, 500.0)):
        yield step(SEED, robots, rounds, target_us)


def rays(seed: int, robots: int, rounds: int) -> Iterator[Figure]:
    """Time a ray takes against pymunk, and the share of rays that agree within 1 mm."""
    world, space = hall(seed, robots)
    against = f"pymunk {pymunk.version} segment_query_first"
    ours = [r for row in by_kernel(world) for r in row]
    theirs = [r for row in by_pymunk(world, space) for r in row]
    equal = sum(a == b or abs(a - b) <= 0.001 for a, b in zip(ours, theirs, strict=True))
    share = equal / len(ours)
    yield Figure(
        f"rays within 1 mm, {robots} robots", share, "share", ">= 0.99", share >= 0.99,
        against, f"{len(ours)} rays, no robot overlaps another",
    )  # fmt: skip
    repeat = 1000 // robots
    ratios, per_ray_ns = [], []
    for _ in range(rounds):
        theirs_s = seconds(partial(by_pymunk, world, space))
        ours_s = seconds(lambda: [by_kernel(world) for _ in range(repeat)]) / repeat
        ratios.append(ours_s / theirs_s)
        per_ray_ns.append(ours_s / len(ours) * 1e9)
    ratio = median(ratios)
    scope = f"one core, {RAYS} rays of {RANGE_M:g} m a robot, all of the Python on both sides"
    yield Figure(
        f"time a ray, {robots} robots", ratio, "ratio", "<= 0.05", ratio <= 0.05,
        f"{against}; numba {numba.__version__}", scope,
    )  # fmt: skip
    yield Figure(
        f"time a ray, {robots} robots, absolute", median(per_ray_ns), "ns", "", None, "", scope
    )


def step(seed: int, robots: int, rounds: int, target_us: float) -> Figure:
    """All robots drive about, and into each other where they meet: the worst of cases."""
    world, _ = hall(seed, robots)
    rng = Random(f"{seed}/step")
    steps = 200

    def some() -> float:
        for body in world.robots.values():
            course = rng.uniform(-pi, pi)
            body.drive(Drive(cos(course), sin(course)), world.now_us)
            world.rows[body.index, EXPIRES_US] = inf  # so that steps are timed, and nothing else
        return seconds(lambda: world.advance(world.now_us + steps * STEP_US)) / steps * 1e6

    some()
    cost_us = median(some() for _ in range(5 * rounds))
    return Figure(
        f"world step, {robots} robots", cost_us, "us", f"<= {target_us:g}", cost_us <= target_us,
        f"pymunk {pymunk.version} inside", "10 ms of wheels, physics, judge of contacts, tracks",
    )  # fmt: skip
