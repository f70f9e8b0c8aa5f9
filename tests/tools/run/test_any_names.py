"""Names and folders have any letters: no formula, no markup and no order to a terminal comes of them."""

import warnings
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import ScenarioError, load
from tools.cli.fields import fields
from tools.common.result_table import fact_table
from tools.run.mapf_picture import draw_ways
from tools.run.picture import draw_field

NAMES = ("$\\frac$ of a field", "a $ b", "北の畑", "[bold]x[/red]", "{}%s<b>")
FIELD = 'name = "{}"\n[field]\nfile = "small.geojson"\n'
SQUARE = "[[[0,0],[0.002,0],[0.002,0.002],[0,0.002],[0,0]]]"


@pytest.mark.parametrize("name", NAMES)
def test_a_picture_has_any_title(tmp_path: Path, name: str) -> None:
    """`$...$` was read as a formula, and a traceback at the end of the run; letters that the font does
    not have were warnings with a path of this source."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        draw_field(
            FieldSetup(load("small")).field, {0: [(0.0, 0.0, True)]}, name, tmp_path / "a.png"
        )
    assert (tmp_path / "a.png").stat().st_size > 1000


def test_a_picture_of_ways_has_any_title(tmp_path: Path) -> None:
    import numpy as np

    draw_ways(tmp_path / "a.png", np.zeros((2, 2), bool), [[(0, 0)], [(0, 1)]], [(0, 1)], NAMES[0])
    assert (tmp_path / "a.png").is_file()


@pytest.mark.parametrize("name", NAMES)
def test_a_table_has_any_title(name: str) -> None:
    """`[/red]` was a traceback instead of the table of a run."""
    said = StringIO()
    Console(file=said, width=100).print(
        fact_table(name, [("one", "[red]a fact that is long[/red]")])
    )
    assert name in said.getvalue()


@pytest.mark.parametrize("letter", ["\\u001b", "\\u0007", "\\n", "\\u009b"])
def test_a_scenario_has_no_control_character_in_its_name(tmp_path: Path, letter: str) -> None:
    file = tmp_path / "s.toml"
    file.write_text(FIELD.format(f"a{letter}[2J"))
    with pytest.raises(ScenarioError, match=r"s\.toml: name: a control character"):
        load(str(file))


@pytest.mark.parametrize("name", ["مزرعه\u200cها", "北の畑", "a/b", "x'y"])
def test_a_scenario_has_any_letters_in_its_name(tmp_path: Path, name: str) -> None:
    (file := tmp_path / "s.toml").write_text(FIELD.format(name), encoding="utf-8")
    assert load(str(file)).name == name


def test_a_field_file_does_not_steer_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (file := tmp_path / "a.geojson").write_text(
        '{"type": "Feature", "properties": {"name": "a\\u001b[2J\\nb: 9 ha"},'
        f' "geometry": {{"type": "Polygon", "coordinates": {SQUARE}}}}}'
    )
    assert fields(file, as_json=False) == 0
    assert capsys.readouterr().out == "a [2J b: 9 ha: 4.92 ha, 5 points\n"
