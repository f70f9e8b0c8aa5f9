"""`headland list`, `new`, `check` and `doctor`, and the kind of run that a name stands for."""

import json
from pathlib import Path

import pytest

from sim.scenarios.exploration_scenario import ExplorationSetup, load_arena
from sim.scenarios.scenario import ScenarioError
from sim.scenarios.scenario_kind import Kind, all_shipped, named
from tests.tools.complaint import Complaints
from tools.cli import scenario_check, scenario_files
from tools.cli.doctor import doctor
from tools.run.launch_setup import setting_of


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("oxted", Kind.FIELD), ("rooms", Kind.ERRANDS), ("warehouse", Kind.DELIVERY),
        ("ring", Kind.EXPLORATION), ("arenas/warehouse", Kind.EXPLORATION), ("floor.map", Kind.GRID),
        ("x.mcpp", Kind.GRID), ("field.geojson", Kind.FIELD), ("nowhere", Kind.FIELD),
    ],
)  # fmt: skip
def test_the_scenario_says_which_kind_it_is(name: str, kind: Kind) -> None:
    assert named(name).kind is kind


def test_the_pictures_of_a_report_do_not_hide_the_scenario_of_their_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`run.report("small.html")` of the page about Python makes a folder `small`."""
    monkeypatch.chdir(tmp_path)
    names = ["small", "rooms", "warehouse", "ring"]
    kinds = [named(name).kind for name in names]
    for name in names:
        (tmp_path / name).mkdir()
    assert [named(name).kind for name in names] == kinds
    assert scenario_check.check(names, False) == 0, capsys.readouterr().err
    (tmp_path / "small" / "TASKDATA.XML").write_text("<x/>")
    assert scenario_check.check(["small"], False) == 2, "the task data is a field of a person"


def test_everything_that_ships_is_listed_and_right(capsys: pytest.CaptureFixture[str]) -> None:
    assert scenario_files.list_shipped(True) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {row["name"] for row in rows} == set(all_shipped()) and all(row["about"] for row in rows)
    assert scenario_check.check([row["name"] for row in rows], True) == 0
    assert {row["kind"] for row in json.loads(capsys.readouterr().out)} == {
        "field", "errands", "delivery", "exploration",
    }  # fmt: skip


def test_a_name_that_no_file_system_takes_is_a_row_like_the_others(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """`headland check --json` printed nothing on stdout, and did not look at the other scenarios."""
    long = "n" * 300
    assert scenario_check.check([long, "small"], True) == 2
    first, second = json.loads(capsys.readouterr().out)
    assert not first["ok"] and "too long" in first["problem"] and first["scenario"] == long
    assert second["ok"]
    assert scenario_check.check([long, "small"], False) == 2
    said = capsys.readouterr()
    assert "too long" in said.err and "small: right" in said.out


@pytest.mark.parametrize("like", ["small", "rooms", "warehouse", "ring", "arenas/warehouse"])
def test_a_new_scenario_is_right_as_it_is_written(
    like: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert scenario_files.new(Path("own/mine.toml"), like, False) == 0
    assert "headland run own/mine.toml" in capsys.readouterr().out
    assert scenario_check.check(["own/mine.toml"], False) == 0
    assert scenario_files.new(Path("own/mine.toml"), like, False) == 2, "nothing is replaced"


def test_the_next_commands_of_a_name_with_a_space_can_be_pasted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert scenario_files.new(Path("my field.toml"), "small", False) == 0
    assert "headland run 'my field.toml'" in capsys.readouterr().out


@pytest.mark.parametrize("name", ['a"b.toml', r"a\1b.toml", r"a\qb.toml", "ä ö.toml"])
def test_a_new_scenario_may_have_any_name(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert scenario_files.new(Path(name), "small", False) == 0
    assert scenario_check.check([name], False) == 0


@pytest.mark.parametrize("name", ["a\udcff.toml", "b\udcff/a.toml"])
def test_a_new_scenario_has_no_name_that_is_no_utf_8(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Found: a name with a byte that is no UTF-8 ended in a traceback."""
    monkeypatch.chdir(tmp_path)
    assert scenario_files.new(Path(name), "small", False) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "is no UTF-8" in said and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("run oxtd", "did you mean 'oxted'"), ("run warehous", "did you mean 'warehouse'"),
        ("check smal", "did you mean 'small'"), ("runn", "Did you mean 'run'"), ("new x", ".toml"),
        ("new x.toml --like nothing", "is none of"), ("run no.map --film", "--film"),
        ("run ring --map", "an arena"), ("run no.map --robots 3", "no.map"),
        ("run small --robts 3", "--robots"), ("check", "scenarios"),
        ("launch rooms", "headland run rooms"), ("launch arena", "headland run arena"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line_with_what_was_meant(
    words: str, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    said = Complaints(monkeypatch, capfd).of(words, tmp_path)
    assert said.code == 2 and why in said.line


@pytest.mark.parametrize(
    ("place", "why"),
    [
        ("home = [1.0, 2.0]", "place 'home': is a word of the language"),
        ("Gate = [1.0, 2.0]", "places 'Gate' and 'gate' are said alike"),
        ("dock = [1.0, 20000.0]", "places.dock.1: needs name = [east, north]"),
    ],
)
def test_a_place_that_cannot_be_said_is_told_before_a_launch(
    place: str, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The fleet was launched, and `headland say stop` ended with this line."""
    shipped = (Path(__file__).parents[3] / "sim" / "scenarios" / "small.toml").read_text()
    path = tmp_path / "yard.toml"
    path.write_text(f"{shipped}\n[places]\n{place}\n")
    assert scenario_check.check([str(path)], False) == 2
    assert f"headland: small: {why}" in capsys.readouterr().err
    with pytest.raises(ScenarioError, match="place"):
        setting_of(str(path), None, None, None)


def test_the_doctor_names_what_it_looked_at(capsys: pytest.CaptureFixture[str]) -> None:
    assert doctor(True) == 0
    told = json.loads(capsys.readouterr().out)
    found = {row["what"]: row["ok"] for row in told["findings"]}
    assert told["ready"] and found["Python"] and found["loopback"] and "headland[operator]" in found
    assert doctor(False) == 0 and "headland[operator]" in capsys.readouterr().out


ARENA = """
name = "mine"
mission = "exploration"
[arena]
width_m = 6.0
height_m = 4.0
solid = [[-0.5, -0.5, 0.5, 0.5]]
starts = {starts}
[fleet]
robots = 2
"""


@pytest.mark.parametrize(
    ("starts", "told"),
    [
        ([[-2.0, 0.0], [0.6, 0.0]], "robot 1 at 0.6,0: it touches the solid rectangle"),
        ([[-2.0, 0.0], [2.9, 0.0]], "robot 1 at 2.9,0: with its radius of 0.15 m it is not inside"),
        ([[-2.0, 0.0], [-1.8, 0.0]], "robot 1 at -1.8,0: it touches robot 0"),
        ([[-2.0, 0.0], [2.0, 0.0]], None),
    ],
)
def test_a_start_in_a_wall_or_in_a_robot_is_told(
    starts: list[list[float]], told: str | None, tmp_path: Path
) -> None:
    """The documented arena had robots of a field's size, which stood in each other and in the walls."""
    (tmp_path / "mine.toml").write_text(ARENA.format(starts=starts))
    scenario = load_arena(str(tmp_path / "mine.toml"))
    assert scenario.fleet.radius_m == 0.15
    if told is None:
        assert len(ExplorationSetup(scenario).starts) == 2
        return
    with pytest.raises(ScenarioError, match=told) as found:
        ExplorationSetup(scenario)
    assert "\n" not in str(found.value)
