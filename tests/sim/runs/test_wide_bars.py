"""Fleets with bars that are wide for their field end the work."""

from pathlib import Path

from sim.runs.field_run import FieldRun
from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load

SLANTED = """{"type": "Polygon", "coordinates": [[[10.999709825, 47.999862527],
[11.00034976, 47.999862527], [11.000290175, 48.000137473], [10.99965024, 48.000137473],
[10.999709825, 47.999862527]]]}"""
WIDE = """
name = "wide"
[field]
file = "field.geojson"
implement_width_m = 8.0
[fleet]
robots = 4
radius_m = 0.6
[run]
seed = 306
time_limit_s = 200.0
"""


def test_a_parked_robot_keeps_no_bar_up_at_a_corner(tmp_path: Path) -> None:
    """The fleet passed the last two units round for good: one robot was parked where the bar swung."""
    (tmp_path / "field.geojson").write_text(SLANTED)
    file = tmp_path / "wide.toml"
    file.write_text(WIDE)
    outcome = FieldRun(FieldSetup(load(str(file)).with_engine("contact_free"))).run()
    assert outcome.success and outcome.makespan_s < 150.0
