"""People and vehicles of others in a field: where they are, and that robots do not touch them."""

from math import hypot
from pathlib import Path

import pytest
import shapely
from shapely.affinity import affine_transform

from agent.interface.config import CONTROL_PERIOD_US, S
from sim.fleet.dropped_box import drop
from sim.fleet.moving_obstacles import PATIENCE_US, Shape, walk
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import ScenarioError, load
from sim.world.walls import BOX, DISC

FIELD = """
name = "met"
[field]
file = "small.geojson"
implement_width_m = 4.0
section_length_m = 60.0
[fleet]
robots = 3
silence = "continue"
"""
WALK = """
[[fault]]
kind = "person"
at_s = 15.0
route = [[-30.0, -18.0], [30.0, 18.0], [-30.0, 18.0]]
[[fault]]
kind = "vehicle"
at_s = 60.0
route = [[-45.0, 0.0], [45.0, 3.0]]
"""


def setup_of(folder: Path, faults: str) -> FieldSetup:
    (folder / "met.toml").write_text(FIELD + faults)
    return FieldSetup(load(str(folder / "met.toml")))


def test_a_walker_stands_before_a_robot_and_turns_round(tmp_path: Path) -> None:
    world = setup_of(tmp_path, "").world()
    clock = {"now": 0}

    def now_us() -> int:
        return clock["now"]

    body = min(world.robots.values(), key=lambda each: each.position[0])
    at = body.position
    far = (at[0] - 6.0, at[1])
    seen = []
    for due_at_us in walk(world, now_us, Shape(0.5), [far, at], 1.0, yields=True):
        (row,) = [r for r in world.obstacles() if r[0] == DISC]
        seen.append(hypot(row[1] - at[0], row[2] - at[1]))
        clock["now"] = due_at_us
        assert due_at_us < 20 * S, "it does not give way"
    assert seen[0] == pytest.approx(6.0) and seen[20] == pytest.approx(5.0, abs=0.06)
    nearest_m = min(seen)
    assert body.radius_m + 0.25 + 0.5 < nearest_m < body.radius_m + 0.25 + 0.8, "it stands"
    stood_for_us = seen.count(nearest_m) * CONTROL_PERIOD_US
    assert PATIENCE_US <= stood_for_us <= PATIENCE_US + 3 * CONTROL_PERIOD_US
    assert seen[-1] == pytest.approx(6.0, abs=0.06), "it has gone back"
    assert not [r for r in world.obstacles() if r[0] == DISC]
    away = (far[0] - 2.0, far[1])
    rude = list(walk(world, now_us, Shape(4.5, 2.0), [far, away], 4.0, yields=False))
    assert len(rude) in (10, 11), "2 m at 4 m/s, in periods of 50 ms"
    assert not [r for r in world.obstacles() if r[0] == BOX], "gone at the end of its route"


def test_l5_a_mover_between_two_robots_that_stand_leaves_its_route(tmp_path: Path) -> None:
    """Chaos, profile traffic, seeds 8, 9 and 23: a vehicle that only turned round drove to and fro
    between two robots, which stood for it for ever."""
    world = setup_of(tmp_path, "").world()
    clock = {"now": 0}
    left, right, far = world.robots.values()
    begin, end, middle = (-6.0, 0.0), (6.0, 0.0), (0.0, 0.0)
    left.teleport(*begin)
    right.teleport(*end)
    far.teleport(30.0, 0.0)
    nearest_m = 99.0
    for due_at_us in walk(
        world, lambda: clock["now"], Shape(0.5), [middle, end, begin, end], 2.0, yields=True
    ):
        (row,) = [r for r in world.obstacles() if r[0] == DISC]
        for body in (left, right):
            gap_m = hypot(row[1] - body.position[0], row[2] - body.position[1])
            nearest_m = min(nearest_m, gap_m - 0.25 - body.radius_m)
        clock["now"] = due_at_us
        assert due_at_us < 60 * S, "it drives to and fro"
    assert nearest_m > 0.5
    assert not [r for r in world.obstacles() if r[0] == DISC]


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.slow
def test_robots_touch_neither_a_person_nor_a_vehicle(tmp_path: Path, seed: int) -> None:
    setup = setup_of(tmp_path, WALK)
    outcome = FieldRun(FieldSetup(setup.scenario.changed(3, seed))).run()
    assert outcome.contacts == 0, f"seed {seed}: headland run met.toml --seed {seed}"
    # A robot that had to stop beside its line may wait for an operator, whom this run does not have.
    assert outcome.coverage > 0.85, f"seed {seed}"


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ('kind = "person"\nat_s = 1.0\nroute = [[0.0, 0.0]]', "route"),
        ('kind = "person"\nat_s = 1.0\nroute = [[900.0, 0.0], [950.0, 3.0]]', "outside of the field"),
        ('kind = "person"\nat_s = 1.0', "route"),
        ('kind = "vehicle"\nat_s = 1.0\nroute = [[0.0, 0.0], [1.0, 0.0]]\nspeed_m_s = 90.0', "speed_m_s"),
        ('kind = "persn"\nat_s = 1.0\nroute = [[0.0, 0.0], [1.0, 0.0]]', "person"),
    ],
)  # fmt: skip
def test_a_wrong_route_is_one_line(tmp_path: Path, faults: str, words: str) -> None:
    with pytest.raises(ScenarioError) as told:
        setup_of(tmp_path, f"[[fault]]\n{faults}\n")
    assert words in str(told.value) and "\n" not in str(told.value)


def test_s17_a_vehicle_does_not_turn_into_a_robot_beside_it(tmp_path: Path) -> None:
    """Chaos, profile traffic, seed 9100066: a robot stood beside the long side of a vehicle, which then
    left its route. It turned on the spot, and its corner came 9 cm into the robot."""
    world = setup_of(tmp_path, "").world()
    clock = {"now": 0}
    beside, *others = world.robots.values()
    beside.teleport(-0.5, 20.0)
    for k, body in enumerate(others):
        body.teleport(30.0, 10.0 * k)
    shape, nearest_m = Shape(4.5, 2.0), 9.0
    corner = [(-6.0, 0.0), (0.0, 0.0), (4.0, 8.0)]
    for due_at_us in walk(world, lambda: clock["now"], shape, corner, 1.0, yields=True):
        for _, x_m, y_m, *half_m, cosine, sine in (r for r in world.obstacles() if r[0] == BOX):
            box = shapely.box(-half_m[0], -half_m[1], half_m[0], half_m[1])
            there = affine_transform(box, [cosine, -sine, sine, cosine, x_m, y_m])
            nearest_m = min(nearest_m, there.distance(shapely.Point(beside.position)))
            if x_m > -0.06 and beside.position[1] > 19.0:  # right before the corner of its route
                beside.teleport(-0.5, 1.0 + beside.radius_m + 0.2)
        clock["now"] = due_at_us
        if due_at_us > 60 * S:
            break
    assert beside.radius_m < nearest_m < beside.radius_m + 0.5


def test_a_box_does_not_fall_on_a_robot(tmp_path: Path) -> None:
    """Chaos, profile body, seed 20400417: a box pushed a robot that sensed nothing half a metre away. It
    could not tell this from a wrong place, and stood for ever."""
    world = setup_of(tmp_path, "").world()
    clock = {"now": 0}
    body, *others = world.robots.values()
    body.teleport(0.0, 1.0)
    for k, other in enumerate(others):
        other.teleport(30.0, 10.0 * k)
    stood_s = []
    for due_at_us in drop(world, lambda: clock["now"], (0.0, 0.0), 1.2, 10.0):
        if [r for r in world.obstacles() if r[0] == BOX]:
            stood_s.append(clock["now"] / S)
        elif clock["now"] >= 4 * S:
            body.teleport(0.0, 5.0)  # it has left
        else:
            assert body.position == pytest.approx((0.0, 1.0))
        clock["now"] = due_at_us
        world.advance(clock["now"])
    assert stood_s == [pytest.approx(4.05)]
    assert clock["now"] == 10 * S and not [r for r in world.obstacles() if r[0] == BOX]


def test_a_box_falls_beside_a_robot(tmp_path: Path) -> None:
    world = setup_of(tmp_path, "").world()
    body, *others = world.robots.values()
    body.teleport(0.0, 0.6 + body.radius_m + 0.01)
    for k, other in enumerate(others):
        other.teleport(30.0, 10.0 * k)
    next(drop(world, lambda: 0, (0.0, 0.0), 1.2, 10.0))
    assert [r for r in world.obstacles() if r[0] == BOX]
