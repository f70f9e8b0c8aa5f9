"""The small field, worked with an implement twice as wide: half the swaths, and all that happens on one.

For what is to be seen on the way to a finished field, and not by how long it takes.
"""

from sim.scenarios.scenario import Scenario, load


def broad() -> Scenario:
    small = load("small")
    field = small.field.model_copy(
        update={"implement_width_m": 2.0 * small.field.implement_width_m}
    )
    return small.model_copy(update={"field": field})
