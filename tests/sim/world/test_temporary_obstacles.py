"""Boxes come and go by the seed, and never on top of a robot."""

from math import hypot

import pytest
from shapely.geometry import Point, Polygon, box

from agent.interface.effects import Drive
from sim.world.drive_trains import Chassis
from sim.world.temporary_obstacles import random_temporary_obstacle_generator, schedule
from sim.world.world import World

AREA = box(0.0, 0.0, 30.0, 20.0).difference(box(10.0, 5.0, 15.0, 15.0))


def test_the_seed_says_where_and_when() -> None:
    a = list(random_temporary_obstacle_generator(1, AREA, mean_period_s=5.0, end_at_s=200.0))
    assert a == list(
        random_temporary_obstacle_generator(1, AREA, mean_period_s=5.0, end_at_s=200.0)
    )
    assert a != list(
        random_temporary_obstacle_generator(2, AREA, mean_period_s=5.0, end_at_s=200.0)
    )
    assert 20 <= len(a) <= 60
    assert [o.birth_at_us for o in a] == sorted(o.birth_at_us for o in a)
    for obstacle in a:
        assert 5_000_000 <= obstacle.expiry_at_us - obstacle.birth_at_us <= 40_000_000
        assert all(AREA.contains(Point(spot).buffer(0.75)) for spot in obstacle.places)


def test_an_area_without_room_is_refused() -> None:
    with pytest.raises(ValueError, match="no room"):
        next(random_temporary_obstacle_generator(1, Polygon([(0, 0), (50, 0), (50, 0.5)])))


@pytest.mark.parametrize("seed", range(3))
def test_they_appear_away_from_robots_and_leave(seed: int) -> None:
    world = World([list(box(0, 0, 30, 20).exterior.coords)], seed)
    for slot in range(4):
        world.add_robot(slot, (3.0 + 6.0 * slot, 3.0), 0.5, Chassis())
    plan = random_temporary_obstacle_generator(
        seed, AREA, mean_period_s=1.0, lasts_for_s=(2.0, 6.0), end_at_s=40.0
    )
    appeared = schedule(world, plan, clearance_m=1.0)
    standing: list[int] = []
    before = 0
    for t_us in range(0, 50_000_000, 50_000):
        northward = 0.3 if t_us % 20_000_000 < 10_000_000 else -0.3
        for slot in range(4):
            world.body(slot).drive(Drive(0.0, northward), t_us)
        world.advance(t_us)
        for obstacle in appeared[before:]:
            (spot,) = obstacle.places
            for robot in world.robots.values():
                gap_m = hypot(robot.position[0] - spot[0], robot.position[1] - spot[1])
                assert gap_m > obstacle.radius_m + robot.radius_m + 0.9, f"seed {seed}"
        before = len(appeared)
        standing.append(len(world._shapes))
    assert len(appeared) > 15 and max(standing) >= 2
    assert standing[-1] == 0, "all have left"
    alive = sum(o.expiry_at_us - o.birth_at_us for o in appeared) / 50_000
    assert sum(standing) == pytest.approx(alive, rel=0.02)
