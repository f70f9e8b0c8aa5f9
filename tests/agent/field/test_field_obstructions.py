"""Units beside an obstacle that a body cannot reach are left out, one after another, and no others."""

from types import SimpleNamespace
from typing import Any

from shapely.geometry import LineString
from shapely.geometry import Point as Spot

from agent.field.field_obstructions import FORGET_US, FieldObstructions
from agent.interface.config import S
from agent.interface.lifecycle import State
from agent.interface.observation import Neighbour, Observation
from protocol.frames.fleet_frames import Pose
from tests.agent.field.test_stopping_in_fields import PLAN


def test_only_a_unit_beside_body_and_obstacle_is_out_of_reach() -> None:
    """Three robots asked 30 times in 500 s, one after another, at a box of which they saw one side."""
    around = FieldObstructions(PLAN.route, 0.8, 1.4)
    section = PLAN.field.sections[0]
    (ax, ay), (bx, by) = section.unit_lines[5][0], section.unit_lines[5][-1]
    at = ((ax + bx) / 2, (ay + by) / 2)
    every = range(section.units)
    assert not around.out_of_reach(section, at, every), "no obstacle is known"
    around.things = frozenset({(at[0] + 2.0, at[1])})
    assert not around.out_of_reach(section, at, [20]), "it is far away"
    assert around.out_of_reach(section, at, every)
    assert around.units(section, things_too=True) >= {5}
    assert not around.units(section, things_too=False), "no operator ordered to leave anything out"
    around.things = frozenset()
    assert not around.units(section, things_too=True), "the obstacle is gone"


def test_i24_ways_and_units_go_round_a_live_robot_that_has_lost_its_place() -> None:
    """Found by `headland chaos`, profile all, seed 5000025: five robots passed three sections round for
    200 s, each one driving at the first units beside a robot that stood there with PLACE_LOST."""
    around = FieldObstructions(PLAN.route, 0.8, 1.4)
    section = PLAN.field.sections[0]
    (ax, ay), (bx, by) = section.unit_lines[5][0], section.unit_lines[5][-1]
    at = ((ax + bx) / 2, (ay + by) / 2)
    here = Observation(at[0] + 3.0, at[1], 0.0, 0.0, 0.0)
    lost = Neighbour(Pose(*at, 0.0, 0.0, State.WORKING, False, 255), 0)
    fleet = SimpleNamespace(
        slot=0, here=here, live=frozenset({0, 1}), neighbours={1: lost}, fell_silent_at_us={},
        things=frozenset(), leave_out=False, under_bar=frozenset(), now_us=10 * S,
    )  # fmt: skip
    view: Any = fleet
    around.observe(view)
    around.stand_before(view)
    assert 5 in around.units(section, things_too=True)
    assert 5 not in around.units(section, things_too=False), "they come last, and are not given up"
    assert 20 not in around.units(section, things_too=True)
    (sx, sy), (ex, ey) = section.unit_lines[0][0], section.unit_lines[20][0]
    assert LineString(around.way.path((sx, sy), (ex, ey))).distance(Spot(at)) > 1.6
    fleet.now_us += 10 * FORGET_US
    assert around.observe(view) == frozenset() and 5 in around.units(section, things_too=True)
    fleet.neighbours = {1: lost._replace(heard_at_us=fleet.now_us)}
    assert around.observe(view) is None, "it knows its place again, and may drive"
    assert 5 not in around.units(section, things_too=True)


def test_a_path_leads_round_places_that_have_kept_the_bar_up() -> None:
    """A robot without work parked behind a box that it had seen, drove straight at it, and asked."""
    around = FieldObstructions(PLAN.route, 0.8, 1.4)
    line = PLAN.field.sections[0].unit_lines[5]
    start, goal = line[0], line[-1]
    thing = (start[0] + goal[0]) / 2, (start[1] + goal[1]) / 2
    view: Any = SimpleNamespace(neighbours={}, now_us=0)
    assert LineString(around.path(start, goal, view)).distance(Spot(thing)) < 0.1
    around.under_bar = frozenset({thing})
    assert LineString(around.path(start, goal, view)).distance(Spot(thing)) >= 1.2
    around.under_bar = frozenset({(thing[0] + 30.0, thing[1] + 30.0)})
    assert LineString(around.path(start, goal, view)).distance(Spot(thing)) < 0.1
