"""People that walk and vehicles that pass: bodies of the world that no frame announces.

They follow a route at their speed. One that yields stands while a robot is in its way, as a person
does that sees the machine, and turns round if the robot stays. Robots know of them only what their
range sensors see.

A robot stands for the mover, and the mover for a robot. Where robots stand at both ends of the
mover's way, all would wait for ever. So one that comes back to where it has turned leaves its route
and goes straight to the side where most room is.
"""

from collections.abc import Callable
from itertools import pairwise
from math import atan2, cos, dist, hypot, pi, sin
from typing import NamedTuple

from agent.interface.config import CONTROL_PERIOD_US, S
from agent.interface.geometry import Point
from sim.fleet.scheduler import Script
from sim.world.world import World

STANDS_M_S = 0.05  # slower is standing
CLEAR_M = 0.6  # from body to body, at which one that yields stands: an arm's length
ENTRY_M = 3.0  # from body to body: a robot that drives stops from 2.5 m/s in less
PATIENCE_US = 5 * S  # for which a person waits before a robot that stands, before it turns round
TURNS_MAX = 1  # one way back; after that the route is blocked at both ends
WAYS_OUT_MAX = 6  # blocked as often as that between robots that wait for it, it is taken away
TURNS_BESIDE_M = (
    0.1  # from body to body, at which a vehicle does not turn: its corners sweep further out
)
LEAVE_M = (
    30.0  # length of the way out: three times the range of the sensors, so no robot waits for it
)
DIRECTIONS = 16  # in which a way out is looked for
LOOK_M = 12.0  # of a way out that is looked at: robots further off have time to see the mover


class Shape(NamedTuple):
    """What moves: a disc where `wide_m` is 0, else a box that points along its way."""

    long_m: float  # diameter or length
    wide_m: float = 0.0

    @property
    def reach_m(self) -> float:
        """From its middle to its farthest point."""
        return hypot(self.long_m, self.wide_m) / 2


def walk(
    world: World, now_us: Callable[[], int], shape: Shape, route: list[Point], speed_m_s: float,
    yields: bool,
) -> Script[None]:  # fmt: skip
    """Appear at the first point of the route, follow it, and vanish at its end. It does not appear
    on a robot that stands, nor right before one that drives, which no robot could stop for: it waits.

    One that yields and has stood for `PATIENCE_US` turns round, and vanishes where it came from. If it
    has to turn more often than `TURNS_MAX`, it leaves by a straight way between the robots. One that
    no way leads out is taken away.
    """
    gone_m, long_m = 0.0, _length_m(route)
    onward, turns, stood_at_us = 1, 0, None
    place, heading_rad = _on(route, 0.0)
    while not has_room(world, place, shape):
        yield now_us() + CONTROL_PERIOD_US
    number = _put(world, place, shape, heading_rad)
    while 0.0 <= gone_m < long_m:
        at_us = now_us()
        yield at_us + CONTROL_PERIOD_US
        next_m = gone_m + onward * speed_m_s * CONTROL_PERIOD_US / S
        next_place, next_rad = _on(route, next_m)
        if yields and (
            _in_the_way(world, place, next_place, shape)
            or (next_rad != heading_rad and _turns_into(world, next_place, next_rad, shape))
        ):
            stood_at_us = at_us if stood_at_us is None else stood_at_us
            if at_us - stood_at_us >= PATIENCE_US:
                onward, turns, stood_at_us = -onward, turns + 1, None
                if turns > TURNS_MAX + WAYS_OUT_MAX:
                    break
                if turns > TURNS_MAX:
                    route = _way_out(world, place, shape)
                    onward, gone_m, long_m = 1, 0.0, _length_m(route)
            continue
        stood_at_us = None
        world.remove_box(number)
        gone_m, place, heading_rad = next_m, next_place, next_rad
        number = _put(world, place, shape, heading_rad)
    now_us()
    world.remove_box(number)


def _length_m(route: list[Point]) -> float:
    return sum(dist(*leg) for leg in pairwise(route))


def _way_out(world: World, place: Point, shape: Shape) -> list[Point]:
    """A straight way from here, in the direction that passes the robots at the greatest distance."""
    bodies = [body.position for body in world.robots.values()]
    angles_rad = [2 * pi * k / DIRECTIONS for k in range(DIRECTIONS)]

    def room_m(angle_rad: float) -> tuple[bool, float, float]:
        """Whether it can turn there, the least distance on the way, and at its end if many ways begin
        beside the same robot."""
        ux, uy = cos(angle_rad), sin(angle_rad)
        gaps_m, ends_m = [], []
        for x_m, y_m in bodies:
            dx_m, dy_m = x_m - place[0], y_m - place[1]
            along_m = min(max(dx_m * ux + dy_m * uy, 0.0), LOOK_M)
            gaps_m.append(hypot(dx_m - along_m * ux, dy_m - along_m * uy))
            ends_m.append(hypot(dx_m - LOOK_M * ux, dy_m - LOOK_M * uy))
        return not _turns_into(world, place, angle_rad, shape), min(gaps_m), min(ends_m)

    best_rad = max(angles_rad, key=room_m)
    return [place, (place[0] + LEAVE_M * cos(best_rad), place[1] + LEAVE_M * sin(best_rad))]


def _on(route: list[Point], gone_m: float) -> tuple[Point, float]:
    """The place so far along a route, metres, and the direction of its leg, radians."""
    for begin, end in pairwise(route):
        leg_m = dist(begin, end)
        if gone_m <= leg_m or end is route[-1]:
            share = min(max(gone_m / leg_m, 0.0), 1.0) if leg_m > 0 else 1.0
            place = begin[0] + (end[0] - begin[0]) * share, begin[1] + (end[1] - begin[1]) * share
            return place, atan2(end[1] - begin[1], end[0] - begin[0])
        gone_m -= leg_m
    raise AssertionError("a route has a leg")


def has_room(world: World, place: Point, shape: Shape) -> bool:
    """Whether no robot stands there, or drives near."""
    return all(
        dist(place, body.position) - shape.reach_m - body.radius_m
        >= (ENTRY_M if body.speed_m_s > STANDS_M_S else CLEAR_M)
        for body in world.robots.values()
    )


def _put(world: World, place: Point, shape: Shape, heading_rad: float) -> int:
    if shape.wide_m:
        return world.add_box(*place, shape.long_m, shape.wide_m, heading_rad)
    return world.add_disc(*place, shape.long_m / 2)


def _in_the_way(world: World, place: Point, next_place: Point, shape: Shape) -> bool:
    """Whether the next step comes near to a robot; one that leads away from it does not."""
    return any(
        dist(next_place, body.position) < shape.reach_m + body.radius_m + CLEAR_M
        and dist(next_place, body.position) < dist(place, body.position)
        for body in world.robots.values()
    )


def _turns_into(world: World, place: Point, heading_rad: float, shape: Shape) -> bool:
    """Whether a vehicle that has turned there touches a robot. A robot that keeps off its long side may
    stand within the circle of its corners."""
    if not shape.wide_m:
        return False
    ux, uy = cos(heading_rad), sin(heading_rad)
    for body in world.robots.values():
        dx_m, dy_m = body.position[0] - place[0], body.position[1] - place[1]
        beyond_m = max(abs(dx_m * ux + dy_m * uy) - shape.long_m / 2, 0.0)
        beside_m = max(abs(dy_m * ux - dx_m * uy) - shape.wide_m / 2, 0.0)
        if hypot(beyond_m, beside_m) < body.radius_m + TURNS_BESIDE_M:
            return True
    return False
