"""The world: one history for every caller, commands that expire, contacts seen, faults applied."""

from functools import partial
from math import cos, hypot, inf, pi, sin
from random import Random

import numpy as np
import pytest
from shapely.geometry import LineString, Point, Polygon, box

from agent.interface.config import ACTUATOR_TTL_US, SPEED_MAX_M_S
from agent.interface.effects import Drive
from agent.interface.observation import Observation
from agent.interface.ports import Body
from agent.interface.vehicle import DriveTrain
from sim.world.drive_trains import STEP_US, TRACTOR, Chassis
from sim.world.lidar import Lidar
from sim.world.walls import Grid
from sim.world.world import World

ROOM = [(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)]
PILLAR = [(4.0, -1.0), (6.0, -1.0), (6.0, 1.0), (4.0, 1.0)]


def crowd(seed: int, robots: int, chop: Random, seconds: float = 6.0) -> World:
    """Robots that drive about and collide; `chop` draws when somebody looks at the world."""
    world = World([ROOM, PILLAR], seed, Lidar(8, 5.0))
    kinds = (Chassis(), Chassis(kind=DriveTrain.DIFFERENTIAL), TRACTOR)
    for slot in range(robots):
        world.add_robot(slot, (slot % 5 * 3.0 - 8.0, slot // 5 * 3.0 - 8.0), 0.8, kinds[slot % 3])
    world.at(1_000_000, lambda: world.remove_box(world.add_box(0.0, 0.0, 1.0)))
    world.at(2_000_000, lambda: world.body(1).push(0.5, 0.5))
    plan = Random(seed)
    for t_us in range(0, round(seconds * 1e6), 50_000):
        for slot in range(robots):
            course = plan.uniform(-pi, pi)
            tool_on = plan.random() < 0.5
            command = Drive(2 * cos(course), 2 * sin(course), plan.uniform(-1, 1), tool_on)
            world.body(slot).drive(command, t_us)
        looks = sorted(t_us + chop.randrange(50_000) for _ in range(chop.randrange(6)))
        for look_us in looks:
            world.body(chop.randrange(robots)).sense(look_us)
            world.advance(look_us)
    world.advance(round(seconds * 1e6))
    return world


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_one_history_whoever_asks_and_however_often(seed: int) -> None:
    a, b = crowd(seed, 9, Random("a")), crowd(seed, 9, Random("b"))
    assert a.motion.tobytes() == b.motion.tobytes(), f"seed {seed}"
    assert a.rows.tobytes() == b.rows.tobytes(), f"seed {seed}"
    assert a.contacts == b.contacts and a.closest_m == b.closest_m
    assert all(a.body(s).track.points == b.body(s).track.points for s in a.robots)
    other = crowd(seed + 100, 9, Random("a"))
    assert other.motion.tobytes() != a.motion.tobytes()


def test_what_a_body_senses_has_every_field_of_an_observation() -> None:
    world = World([], 1)
    world.add_robot(0, (0.0, 0.0), 0.5, Chassis())
    seen = world.body(0).sense(1_000)
    assert seen == Observation(**seen._asdict()) and len(seen) == len(Observation._fields)


def test_slip_of_one_robot_does_not_depend_on_the_others() -> None:
    def way(slots: list[int]) -> list[float]:
        world = World([], 7)
        for slot in slots:
            world.add_robot(slot, (slot * 50.0, 0.0), 0.5, Chassis())
        for t_us in range(0, 3_000_000, 50_000):
            for slot in slots:
                world.body(slot).drive(Drive(1.0, 0.5), t_us)
        world.advance(3_000_000)
        places: list[float] = world.motion[slots.index(3), :3].tolist()
        return places

    assert way([3]) == way([1, 3]) == way([5, 3, 0])


def test_bodies_satisfy_the_port_and_sense_what_is_true() -> None:
    world = World([ROOM], 1, Lidar(4, 30.0))
    port: Body = world.add_robot(0, (1.0, 2.0), 0.5, Chassis(), heading_rad=pi / 2)
    seen = port.sense(0)
    assert seen is not None
    assert (seen.x_m, seen.y_m, seen.heading_rad) == (1.0, 2.0, pi / 2)
    assert seen.ranges_m == pytest.approx((18.0, 21.0, 22.0, 19.0))  # north, west, south, east


def test_a_command_expires_and_the_wheels_brake_to_zero() -> None:
    chassis = Chassis(slip=0.02)
    world = World([], 1)
    body = world.add_robot(0, (0.0, 0.0), 0.5, chassis)
    for t_us in range(0, 2_000_000, 50_000):
        body.drive(Drive(2.5, 0.0, 0.0, True), t_us)
    given_us = 1_950_000
    world.advance(given_us + ACTUATOR_TTL_US)
    assert body.commanded(given_us + ACTUATOR_TTL_US - 1) == Drive(2.5, 0.0, 0.0, True)
    assert body.commanded(given_us + ACTUATOR_TTL_US) == Drive(0.0, 0.0)
    assert world.motion[0, 3] > 2.3 and body.tool_on
    world.advance(given_us + ACTUATOR_TTL_US + STEP_US)
    assert not body.tool_on, "the implement rises with the command that held it down"
    world.advance(given_us + ACTUATOR_TTL_US + round(chassis.stopping_for_s * 1e6))
    assert hypot(*world.motion[0, 3:5]) < 1e-9
    there = body.position
    world.advance(10_000_000)
    assert body.position == pytest.approx(there, abs=1e-9)


def test_a_frozen_actuator_hears_nothing() -> None:
    world = World([], 1)
    body = world.add_robot(0, (0.0, 0.0), 0.5, Chassis())
    body.frozen = True
    body.drive(Drive(1.0, 0.0), 0)
    world.advance(1_000_000)
    assert body.position == (0.0, 0.0)


@pytest.mark.parametrize("kind", DriveTrain)
@pytest.mark.parametrize("speed", [0.05, 0.5, 2.5])
def test_pushed_against_a_wall_it_touches_and_stays_out(kind: DriveTrain, speed: float) -> None:
    world = World([ROOM], 1)
    body = world.add_robot(0, (18.9, 0.0), 0.5, Chassis(kind=kind))
    for t_us in range(0, 15_000_000, 50_000):
        body.drive(Drive(speed, 0.0), t_us)
    world.advance(15_000_000)
    assert [(c.first, c.second, c.against) for c in world.contacts] == [(0, None, "fence")]
    assert 0.0 < world.contacts[0].depth_m < 0.06
    assert world.contacts[0].last_at_us == pytest.approx(15_000_000, abs=200_000)
    assert body.position[0] == pytest.approx(19.5, abs=0.003)


@pytest.mark.parametrize("radius_m", [0.2, 0.8])
def test_nobody_gets_through_a_wall_at_the_highest_speed(radius_m: float) -> None:
    fast = Chassis(speed_m_s=SPEED_MAX_M_S, acceleration_m_s2=20.0, slip=0.05)
    for course in (0.0, 0.3, pi / 4, 2.0, 4.0):
        command = Drive(2 * SPEED_MAX_M_S * cos(course), 2 * SPEED_MAX_M_S * sin(course))
        world = World([ROOM], 1)
        body = world.add_robot(0, (0.0, 0.0), radius_m, fast)
        for t_us in range(0, 6_000_000, 50_000):
            body.drive(command, t_us)
        world.advance(6_000_000)
        assert all(abs(v) < 20.0 for v in body.position), f"course {course}"
        assert {c.against for c in world.contacts} == {"fence"}


def test_two_robots_touch_once_and_neither_passes_through() -> None:
    world = World([ROOM], 1)
    for slot, x in enumerate((-3.0, 3.0)):
        world.add_robot(slot, (x, 0.0), 0.8, Chassis(slip=0.0))
    for t_us in range(0, 3_000_000, 50_000):
        world.body(0).drive(Drive(2.0, 0.0), t_us)
        world.body(1).drive(Drive(-2.0, 0.0), t_us)
    world.advance(3_000_000)
    (contact,) = world.contacts
    assert (contact.first, contact.second) == (0, 1) and contact.depth_m < 0.05
    assert world.body(0).position[0] < world.body(1).position[0] - 1.59
    assert world.closest_m == pytest.approx(-contact.depth_m)


@pytest.mark.parametrize("seed", range(4))
def test_contacts_agree_with_shapely(seed: int) -> None:
    """Every touch that geometry shows at a step is in the list, and no other."""
    world = World([ROOM, PILLAR], seed)
    rng = Random(seed)
    solid = [LineString([*ring, ring[0]]) for ring in (ROOM, PILLAR)]
    for slot in range(8):
        world.add_robot(slot, (slot % 4 * 3.0 - 8.0, slot // 4 * 3.0), 0.8, Chassis())
    world.add_box(0.0, 8.0, 2.0, 1.0, 0.5)
    solid.append(Polygon([(cos(0.5) * u - sin(0.5) * v, 8 + sin(0.5) * u + cos(0.5) * v)
                          for u, v in ((-1, -.5), (1, -.5), (1, .5), (-1, .5))]))  # fmt: skip
    world.add_disc(-5.0, 8.0, 1.0)
    solid.append(Point(-5.0, 8.0).buffer(1.0, quad_segs=256))
    closest = inf
    touched: set[tuple[int, int | None]] = set()
    for t_us in range(0, 8_000_000, STEP_US):
        if t_us % 500_000 == 0:
            courses = [rng.uniform(-pi, pi) for _ in range(8)]
        for slot in range(8):
            course = Drive(2 * cos(courses[slot]), 2 * sin(courses[slot]))
            world.body(slot).drive(course, t_us)
        world.advance(t_us + STEP_US)
        places = [Point(world.body(slot).position) for slot in range(8)]
        for a in range(8):
            if min(s.distance(places[a]) for s in solid) < 0.8 - 1e-4:
                touched.add((a, None))
            for b in range(a + 1, 8):
                gap = places[a].distance(places[b]) - 1.6
                closest = min(closest, gap)
                if gap < 0.0:
                    touched.add((a, b))
    seen = {(c.first, c.second) for c in world.contacts if c.second is not None or c.depth_m > 1e-4}
    assert seen == touched, f"seed {seed}"
    assert world.closest_m == pytest.approx(closest, abs=1e-12)
    assert any(b is None for _, b in touched) and any(b is not None for _, b in touched)


def test_a_box_stops_a_robot_until_it_is_taken_away() -> None:
    world = World([ROOM], 1)
    body = world.add_robot(0, (0.0, 0.0), 0.5, Chassis(slip=0.0))
    number = world.add_box(3.0, 0.0, 1.0)
    for t_us in range(0, 4_000_000, 50_000):
        body.drive(Drive(1.0, 0.0), t_us)
    assert body.position[0] == pytest.approx(2.0, abs=0.01)
    assert world.contacts[0].against == f"box {number}"
    world.remove_box(number)
    world.remove_box(number)  # gone is gone
    for t_us in range(4_000_000, 8_000_000, 50_000):
        body.drive(Drive(1.0, 0.0), t_us)
    assert body.position[0] > 4.5


def test_carried_over_a_fence_is_seen() -> None:
    world = World([ROOM, PILLAR], 1)
    world.add_robot(0, (0.0, 0.0), 0.3, Chassis()).teleport(5.0, 0.0)
    world.advance(200_000)
    assert [c.against for c in world.contacts] == ["outside"]


def test_blocked_cells_are_walls() -> None:
    blocked = np.zeros((40, 40), dtype=np.bool_)
    blocked[:, 30] = True
    world = World([], 1, Lidar(4, 60.0), Grid(blocked, -20.0, -20.0, 1.0))
    body = world.add_robot(0, (0.0, 0.5), 0.5, Chassis(slip=0.0))
    for t_us in range(0, 10_000_000, 50_000):
        body.drive(Drive(2.0, 0.0), t_us)
    assert body.position[0] == pytest.approx(9.5, abs=0.005)
    assert body.sense(10_000_000).ranges_m[0] == pytest.approx(0.5, abs=0.005)
    body.teleport(10.5, 0.5)
    world.advance(10_200_000)
    assert world.contacts[-1].against == "outside"


def test_grid_edges_enclose_exactly_the_blocked_cells() -> None:
    rng = np.random.default_rng(5)
    blocked = rng.random((12, 17)) < 0.4
    grid = Grid(blocked, 3.0, -2.0, 0.5)
    edges = sum(LineString(edge).length for edge in grid.edges())
    cells = [box(3 + c * 0.5, -2 + r * 0.5, 3.5 + c * 0.5, -1.5 + r * 0.5)
             for r, c in np.argwhere(blocked)]  # fmt: skip
    union = cells[0]
    for cell in cells[1:]:
        union = union.union(cell)
    assert edges == pytest.approx(union.boundary.length)


def test_tracks_hold_ten_points_a_second_and_each_switch() -> None:
    world = World([], 1)
    body = world.add_robot(0, (0.0, 0.0), 0.5, Chassis(slip=0.0))
    for t_us in range(0, 1_000_000, 10_000):
        body.drive(Drive(1.0, 0.0, 0.0, 340_000 <= t_us < 660_000), t_us)
    world.advance(1_000_000)
    points = body.track.points
    assert [t for t, *_ in points if t % 100_000 == 0] == [k * 100_000 for k in range(11)]
    switches = [(t, tool) for t, _, _, tool in points if t % 100_000]
    assert switches == [(340_000, True), (660_000, False)]
    assert body.track.driven_m == pytest.approx(body.position[0])


def test_wheels_push_with_the_grip_of_tyres_only() -> None:
    """A heavy robot on its brakes is shoved, but not as if it were not there."""
    world = World([], 1)
    for slot, x in enumerate((0.0, 1.05)):
        world.add_robot(slot, (x, 0.0), 0.5, Chassis(slip=0.0))
    for t_us in range(0, 3_000_000, 50_000):
        world.body(0).drive(Drive(2.0, 0.0), t_us)
    assert world.body(1).position[0] - world.body(0).position[0] > 0.99
    assert world.body(0).position[0] < 0.5 * 2.0 * 3.0


@pytest.mark.parametrize("seed", range(6))
def test_gliding_bodies_move_as_the_engine_moves_them(seed: int) -> None:
    """To the last bit before the first touch, through walls, boxes, each other, and being carried about.

    After it only nearly: in which order the engine takes several touches depends on all it saw before.
    """
    yard = [(-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0)]
    worlds = World([yard], seed, engine="contact_free"), World([yard], seed)
    for world in worlds:
        rng, wanted = Random(seed), dict[int, Drive]()
        for slot in range(4):
            world.add_robot(slot, (slot * 2.0 - 3.0, rng.uniform(-3.0, 3.0)), 0.5, Chassis())
        world.at(2_500_000, partial(world.add_disc, 0.0, 4.0, 0.3))
        for t_us in range(0, 20_000_000, 50_000):
            for slot in range(4):
                if t_us % 1_000_000 == 0:
                    vx, vy, turn = (rng.uniform(-2.0, 2.0) for _ in range(3))
                    wanted[slot] = Drive(vx, vy, turn, rng.random() < 0.5)
                world.body(slot).drive(wanted[slot], t_us)
                if rng.random() < 0.002:
                    world.body(slot).push(rng.uniform(-1.0, 1.0), 0.3)
        world.advance(20_000_000)
    glided, engine = worlds
    touched_us = glided.contacts[0].t_us
    assert [(c.t_us, c.first, c.against) for c in glided.contacts] == [
        (c.t_us, c.first, c.against) for c in engine.contacts
    ]
    for slot in range(4):
        a, b = (world.body(slot).track.to_array() for world in worlds)
        before = a[:, 0] < touched_us
        np.testing.assert_array_equal(a[before], b[before])
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(glided.motion, engine.motion, rtol=0.0, atol=1e-6)


def test_an_implement_that_a_late_command_raised_between_two_looks_is_sensed_up() -> None:
    """The strip that a body rolls over meanwhile is not worked, and it is down again when it is looked
    at."""
    world = World([], 1)
    body = world.add_robot(0, (0.0, 0.0), 0.5, Chassis())
    for t_us in range(0, 1_000_000, 50_000):
        assert body.sense(t_us).implement_down is (t_us > 0)
        body.drive(Drive(2.0, 0.0, 0.0, True), t_us)
    late_at_us = t_us + ACTUATOR_TTL_US + 20_000
    body.drive(Drive(2.0, 0.0, 0.0, True), late_at_us)
    world.advance(late_at_us + 20_000)
    assert body.tool_on
    assert body.sense(late_at_us + 20_000).implement_down is False
    assert body.sense(late_at_us + 40_000).implement_down is True
