"""How long a fleet may take, where nobody says it."""

from pathlib import Path

import pytest

from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tests.sim.drawn_fields import rectangle, scenario


@pytest.mark.parametrize("name", ["curitiba", "oxted", "small"])
def test_m6_one_robot_may_take_as_long_as_it_needs(name: str) -> None:
    alone, pair = FieldSetup(load(name).changed(1)), FieldSetup(load(name).changed(2))
    swaths_s = alone.field.work_m / alone.scenario.fleet.speed_m_s
    assert alone.time_limit_s > 3.0 * swaths_s, "one robot took 1.4 times as long as its swaths"
    assert pair.time_limit_s < alone.time_limit_s


def test_m6_a_limit_that_a_scenario_says_is_kept(tmp_path: Path) -> None:
    said = FieldSetup(scenario(tmp_path, rectangle(30.0, 30.0), 1, 1, time_limit_s=12.0))
    assert said.time_limit_s == 12.0
    assert FieldRun(said).run().simulated_s < 15.0


def test_m6_trouble_extends_the_limit() -> None:
    plain = load("small")
    crash = plain.changed(faults=[{"kind": "crash", "robot": 0, "at_s": 300.0}])
    assert FieldSetup(crash).time_limit_s > FieldSetup(plain).time_limit_s + 300.0
