"""A box that falls into a field and is taken away again."""

from collections.abc import Callable
from math import hypot

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.geometry import Point
from sim.fleet.moving_obstacles import Shape, has_room
from sim.fleet.scheduler import Script
from sim.world.world import World


def drop(
    world: World, now_us: Callable[[], int], place: Point, size_m: float, for_s: float
) -> Script[None]:
    """Stand there for `for_s`. A box falls beside robots, also right before one that drives, but not on
    one, which it would push away. Where a robot is it waits until there is room, as people do.
    """
    end_at_us = now_us() + round(for_s * S)
    if _is_on_robot(world, place, size_m):
        while not has_room(world, place, Shape(size_m, size_m)):
            yield now_us() + CONTROL_PERIOD_US
            if now_us() >= end_at_us:
                return
    box = world.add_box(*place, size_m)
    yield end_at_us
    now_us()
    world.remove_box(box)


def _is_on_robot(world: World, place: Point, size_m: float) -> bool:
    """Whether a box there would overlap a robot."""
    for body in world.robots.values():
        beyond_m, beside_m = (
            max(abs(at_m - middle_m) - size_m / 2, 0.0)
            for at_m, middle_m in zip(body.position, place, strict=True)
        )
        if hypot(beyond_m, beside_m) < body.radius_m:
            return True
    return False
