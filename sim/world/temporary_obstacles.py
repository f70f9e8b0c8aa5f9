"""Boxes that appear where robots want to go, and vanish again.

Their positions and times depend only on the seed, with one exception: nothing is put on a robot or
right before it. Each obstacle therefore has several candidate positions, and the first one that is
free at its time is used.
"""

from collections.abc import Iterable, Iterator
from functools import partial
from math import hypot, pi
from random import Random
from typing import NamedTuple

import shapely
from shapely.geometry import MultiPolygon, Polygon

from agent.interface.geometry import Point
from sim.world.world import World

PLACES = 8  # candidates; an obstacle does not appear if all of them are taken
DRAWS_MAX = 1_000  # for a position in the area; an area that fails this often has no room for a box


class TemporaryObstacle(NamedTuple):
    """A box with the instants at which it appears and vanishes, and where it may stand."""

    birth_at_us: int
    expiry_at_us: int
    places: tuple[Point, ...]  # in order of preference
    width_m: float
    depth_m: float
    heading_rad: float

    @property
    def radius_m(self) -> float:
        """Of the disc round all corners of the box."""
        return hypot(self.width_m, self.depth_m) / 2


def random_temporary_obstacle_generator(
    seed: int | str,
    area: Polygon | MultiPolygon,
    mean_period_s: float = 20.0,
    lasts_for_s: tuple[float, float] = (5.0, 40.0),
    size_m: tuple[float, float] = (0.5, 1.5),
    begin_at_s: float = 0.0,
    end_at_s: float = 3600.0,
) -> Iterator[TemporaryObstacle]:
    """Boxes in the area, in order of birth: one every `mean_period_s` on average, at random instants.

    ValueError if the area has no room for the largest box.
    """
    rng = Random(f"{seed}/obstacles")
    inside = area.buffer(-size_m[1] * 0.75)
    if inside.is_empty:
        raise ValueError(f"no room for a box of {size_m[1]} m in this area")
    now_s = begin_at_s
    while True:
        now_s += rng.expovariate(1.0 / mean_period_s)
        if now_s >= end_at_s:
            return
        birth_at_us = round(now_s * 1e6)
        yield TemporaryObstacle(
            birth_at_us=birth_at_us,
            expiry_at_us=birth_at_us + round(rng.uniform(*lasts_for_s) * 1e6),
            places=tuple(_place(rng, inside) for _ in range(PLACES)),
            width_m=rng.uniform(*size_m),
            depth_m=rng.uniform(*size_m),
            heading_rad=rng.uniform(0.0, pi),
        )


def _place(rng: Random, area: Polygon | MultiPolygon) -> Point:
    west, south, east, north = area.bounds
    for _ in range(DRAWS_MAX):
        spot = (rng.uniform(west, east), rng.uniform(south, north))
        if area.contains(shapely.Point(spot)):
            return spot
    inner = area.representative_point()
    return float(inner.x), float(inner.y)


def schedule(
    world: World, obstacles: Iterable[TemporaryObstacle], clearance_m: float = 1.0
) -> list[TemporaryObstacle]:
    """Let them come and go in the world; returns a list of those that appeared, as they appear.

    None appears closer to a robot than its clearance plus its braking distance.
    """
    appeared: list[TemporaryObstacle] = []

    def come(obstacle: TemporaryObstacle) -> None:
        for x_m, y_m in obstacle.places:
            if _free(world, x_m, y_m, obstacle.radius_m + clearance_m):
                number = world.add_box(
                    x_m, y_m, obstacle.width_m, obstacle.depth_m, obstacle.heading_rad
                )
                world.at(obstacle.expiry_at_us, partial(world.remove_box, number))
                appeared.append(obstacle._replace(places=((x_m, y_m),)))
                return

    for obstacle in obstacles:
        world.at(obstacle.birth_at_us, partial(come, obstacle))
    return appeared


def _free(world: World, x_m: float, y_m: float, margin_m: float) -> bool:
    for robot in world.robots.values():
        braking_m = robot.chassis.speed_m_s**2 / (2 * robot.chassis.braking_m_s2)
        at_x, at_y = robot.position
        if hypot(at_x - x_m, at_y - y_m) < margin_m + robot.radius_m + braking_m:
            return False
    return True
