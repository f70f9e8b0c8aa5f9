"""Units beside an obstacle that a body cannot reach are left out, one after another, and no others."""

from agent.field.field_obstructions import FieldObstructions
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
