"""A lowered implement is not drawn over people and boxes beside the body, and the work still ends."""

from pathlib import Path

import pytest

from sim.fleet.outcome import FieldOutcome
from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import Box, Person, load

YARD = """
name = "bar"
[field]
file = "FIELD"
implement_width_m = 8.0
[fleet]
robots = 1
radius_m = 0.6
drive = "DRIVE"
[run]
seed = 1
time_limit_s = 400.0
"""
RING = """{"type": "Polygon", "coordinates": [[[10.99973, 47.999901], [11.00027, 47.999901],
[11.00027, 48.000099], [10.99973, 48.000099], [10.99973, 47.999901]]]}"""


def played(
    folder: Path, fault: Box | Person, drive: str = "mecanum", robots: int = 1
) -> FieldOutcome:
    """A field of 40 by 22 m whose inner row is the line y = 0."""
    (folder / "field.geojson").write_text(RING)
    file = folder / "bar.toml"
    text = YARD.replace("FIELD", "field.geojson").replace("DRIVE", drive)
    file.write_text(text.replace("robots = 1", f"robots = {robots}"))
    scenario = load(str(file)).model_copy(update={"fault": [fault]})
    return FieldRun(FieldSetup(scenario.with_engine("contact_free"))).run()


def box(for_s: float) -> Box:
    return Box(at_s=0.5, kind="box", x_m=5.0, y_m=1.7, size_m=0.6, for_s=for_s)


@pytest.mark.parametrize("drive", ["mecanum", "ackermann"])
def test_the_bar_is_not_drawn_over_a_box_that_stays_beside_the_row(
    tmp_path: Path, drive: str
) -> None:
    outcome = played(tmp_path, box(600.0), drive)
    assert outcome.finished and outcome.contacts == 0 and outcome.things_under_bars == 0
    assert 0.97 < outcome.coverage < 0.999, "the ground beside the box is left, and no other"


def test_two_robots_end_the_work_beside_a_box_that_stays(tmp_path: Path) -> None:
    """One swerved for the other, towards the box, and asked about it for good. So did the other one
    after it, and a robot whose way to its parking place led through the box."""
    outcome = played(tmp_path, box(600.0), robots=2)
    assert outcome.finished and outcome.contacts == 0 and outcome.things_under_bars == 0
    assert 0.97 < outcome.coverage < 0.999, "the ground beside the box is left, and no other"


def test_what_a_box_kept_from_being_worked_is_worked_when_it_has_gone(tmp_path: Path) -> None:
    outcome = played(tmp_path, box(40.0))
    assert outcome.success and outcome.things_under_bars == 0


def test_a_person_who_walks_beside_the_row_holds_up_nothing_for_good(tmp_path: Path) -> None:
    way = [(-15.0, 2.6), (15.0, 2.6)] * 5
    person = Person.model_validate(
        {"at_s": 0.5, "kind": "person", "route": way, "speed_m_s": 1.0, "yields": False}
    )
    outcome = played(tmp_path, person)
    assert outcome.success and outcome.things_under_bars == 0
