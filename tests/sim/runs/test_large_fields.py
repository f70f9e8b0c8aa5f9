"""A10: fields of kilometres are worked to their end, and all that a run writes is written."""

import json
from math import cos, radians, sin
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tools.cli.headland import app

DEGREE_M = 111_320.0
HOME = (52.0, 10.0)  # latitude and longitude of a corner, degrees


def strip(folder: Path, length_m: float, course_deg: float) -> Path:
    """A scenario with a field 60 m wide; wide implements, so that there is little to drive."""
    course = radians(course_deg)
    ring = [
        (
            HOME[1] + (x * cos(course) - y * sin(course)) / DEGREE_M / cos(radians(HOME[0])),
            HOME[0] + (x * sin(course) + y * cos(course)) / DEGREE_M,
        )
        for x, y in ((0, 0), (length_m, 0), (length_m, 60), (0, 60), (0, 0))
    ]
    shape = {"type": "Polygon", "coordinates": [ring]}
    (folder / "long.geojson").write_text(json.dumps(shape))
    path = folder / "long.toml"
    path.write_text(
        'name = "long"\n[field]\nfile = "long.geojson"\nimplement_width_m = 24.0\noverlap_m = 0.5\n'
        "section_length_m = 1000.0\n[fleet]\nrobots = 2\nspeed_m_s = 5.0\n"
    )
    return path


@pytest.mark.slow
@pytest.mark.parametrize(("length_m", "course_deg"), [(3000.0, 0.0), (6400.0, 0.0), (8900.0, 45.0)])
def test_a10_a_field_of_kilometres_is_finished_and_recorded(
    length_m: float, course_deg: float, tmp_path: Path
) -> None:
    """The last one is 6.3 km from west to east and from south to north, which is the limit."""
    out = tmp_path / "out"
    given = strip(tmp_path, length_m, course_deg)
    result = CliRunner().invoke(app, ["run", str(given), "--out", str(out), "--json"])
    assert result.exit_code == 0, result.output
    report = json.loads((out / "report.json").read_text())
    assert report["finished"] and report["coverage"] > 0.999 and report["contacts"] == 0
    for name in ("can.log", "run.mcap", "trace.jsonl", "work.geojson", "field.png"):
        assert (out / name).stat().st_size > 1000, name
    pytest.importorskip("isoxml", reason="the extra `isoxml` is not installed")
    task_data = tmp_path / "TASKDATA.zip"
    result = CliRunner().invoke(app, ["export", str(out), "--isoxml", str(task_data)])
    assert result.exit_code == 0 and task_data.stat().st_size > 1000, result.output
