"""People that walk and vehicles that pass: bodies of the world that no frame announces.

They follow a route at their speed. One that yields stands while a robot is in its way, as a person
does who sees the machine. Robots know of them only what their range sensors see.
"""

from collections.abc import Callable
from itertools import pairwise
from math import atan2, hypot
from typing import NamedTuple

from agent.interface.config import CONTROL_PERIOD_US, S
from sim.fleet.scheduler import Script
from sim.world.world import World

CLEAR_M = 0.6  # from body to body, at which one that yields stands: an arm's length
XY = tuple[float, float]


class Shape(NamedTuple):
    """What moves: a disc where `wide_m` is 0, else a box that points along its way."""

    long_m: float  # diameter or length
    wide_m: float = 0.0

    @property
    def reach_m(self) -> float:
        """From its middle to its farthest point."""
        return hypot(self.long_m, self.wide_m) / 2


def walk(
    world: World, now_us: Callable[[], int], shape: Shape, route: list[XY], speed_m_s: float,
    yields: bool,
) -> Script[None]:  # fmt: skip
    """Appear at the first point of the route, follow it, and vanish at its end."""
    number = None
    for (x_m, y_m), (to_x_m, to_y_m) in pairwise(route):
        long_m = hypot(to_x_m - x_m, to_y_m - y_m)
        heading_rad = atan2(to_y_m - y_m, to_x_m - x_m)
        gone_m = 0.0
        while gone_m < long_m or number is None:
            share = min(gone_m / long_m, 1.0) if long_m > 0 else 1.0
            place = (x_m + (to_x_m - x_m) * share, y_m + (to_y_m - y_m) * share)
            at_us = now_us()
            if number is None or not (yields and _in_the_way(world, place, shape)):
                if number is not None:
                    world.remove_box(number)
                number = _put(world, place, shape, heading_rad)
                gone_m += speed_m_s * CONTROL_PERIOD_US / S
            yield at_us + CONTROL_PERIOD_US
    now_us()
    if number is not None:
        world.remove_box(number)


def _put(world: World, place: XY, shape: Shape, heading_rad: float) -> int:
    if shape.wide_m:
        return world.add_box(*place, shape.long_m, shape.wide_m, heading_rad)
    return world.add_disc(*place, shape.long_m / 2)


def _in_the_way(world: World, place: XY, shape: Shape) -> bool:
    return any(
        hypot(place[0] - body.position[0], place[1] - body.position[1])
        < shape.reach_m + body.radius_m + CLEAR_M
        for body in world.robots.values()
    )
