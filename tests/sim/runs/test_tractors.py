"""Fleets that steer finish a field as fleets that go sideways do: all of it, and nobody touched."""

import json
from itertools import combinations
from math import dist
from pathlib import Path

import pytest

from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import SPACING_RADII, STARTS_AS_M, FieldSetup
from sim.scenarios.scenario import Crash, ScenarioError, load
from tests.sim.drawn_fields import rectangle, scenario


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["ackermann", "differential"])
def test_m5_a_fleet_that_steers_finishes_a_field(drive: str) -> None:
    outcome = FieldRun(FieldSetup(load("small").changed(drive=drive))).run()
    assert outcome.success and outcome.units_twice == 0, outcome
    assert outcome.implement_contacts == 0, outcome


@pytest.mark.slow
def test_bodies_that_turn_on_the_spot_finish_a_field_of_narrow_overlaps() -> None:
    """Corners that they drove in one go did not count, and they worked them until the time limit."""
    scenario = load("small").changed(drive="differential")
    field = scenario.field.model_copy(update={"overlap_m": 0.15})
    outcome = FieldRun(FieldSetup(scenario.model_copy(update={"field": field}))).run()
    assert outcome.success and outcome.units_twice == 0, outcome


# Degrees east and north: two long sides that meet in corners of 14 degrees.
SLIVER = (
    (11.000001977897476, 47.99999885446771), (11.000413844994661, 48.000231677126955),
    (11.000848399227086, 48.000655871100534), (11.000283315096288, 48.00030727569325),
    (11.000001977897476, 47.99999885446771),
)  # fmt: skip


@pytest.mark.slow
def test_small_bodies_that_begin_in_an_acute_corner_part(tmp_path: Path) -> None:
    """They were 0.4 m apart, which is 0.05 m more than avoidance keeps."""
    outline = {"type": "Polygon", "coordinates": [SLIVER]}
    (tmp_path / "sliver.geojson").write_text(json.dumps(outline))
    (tmp_path / "sliver.toml").write_text(
        'name = "sliver"\n[field]\nfile = "sliver.geojson"\nimplement_width_m = 3.0\n'
        "overlap_m = 0.2\n[fleet]\nrobots = 2\nradius_m = 0.4\nspeed_m_s = 2.5\n"
        'drive = "differential"\n[run]\nseed = 500055\n'
    )
    setting = FieldSetup(load(str(tmp_path / "sliver.toml")))
    assert dist(*setting.starts) == pytest.approx(SPACING_RADII * STARTS_AS_M)
    outcome = FieldRun(setting).run()
    assert outcome.success and outcome.units_twice == 0, outcome


def test_small_bodies_begin_nearer_to_each_other_where_there_is_no_other_room(
    tmp_path: Path,
) -> None:
    drawn = scenario(tmp_path, rectangle(7.0, 7.0), 9, 1, implement_width_m=3.0)
    fleet = drawn.fleet.model_copy(update={"radius_m": 0.4})
    starts = FieldSetup(drawn.model_copy(update={"fleet": fleet})).starts
    nearest_m = min(dist(a, b) for a, b in combinations(starts, 2))
    assert len(starts) == 9 and nearest_m == pytest.approx(SPACING_RADII * 0.4)


def test_an_unknown_drive_is_one_line() -> None:
    with pytest.raises(
        ScenarioError,
        match=r"fleet\.drive: not 'tracks'; it is one of mecanum, differential, ackermann",
    ):
        load("small").changed(drive="tracks")


def test_chassis_keys_reach_the_wheels() -> None:
    scenario = load("small").changed(drive="ackermann")
    fleet = scenario.fleet.model_copy(update={"wheelbase_m": 2.4, "steer_deg": 45.0})
    setting = FieldSetup(scenario.model_copy(update={"fleet": fleet}))
    assert setting.chassis.turn_radius_m == pytest.approx(2.4)
    assert setting.turn_radius_m > 2.4
    assert FieldSetup(load("small")).turn_radius_m == 0.0


@pytest.mark.slow
def test_a_tractor_that_dies_is_gone_round() -> None:
    faults = [Crash(at_s=40.0, kind="crash", robot=1)]
    scenario = load("small").changed(drive="ackermann").model_copy(update={"fault": faults})
    outcome = FieldRun(FieldSetup(scenario)).run()
    assert outcome.finished and outcome.replicas_equal and outcome.contacts == 0, outcome
    assert outcome.coverage > 0.95, "all but the rows it stands on"
