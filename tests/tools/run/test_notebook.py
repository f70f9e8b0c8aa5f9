"""Python instead of a command: the examples run, and a run in Python is the run of the command."""

import ast
import json
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import headland as hl
from sim.scenarios.scenario import ScenarioError
from tests.tools.launching import ROOT
from tools.report.chapter import COLUMNS
from tools.run.notebook import Picture, Run, play
from tools.run.run_field import run as run_command

EXAMPLES = Path(__file__).parents[3] / "examples"
SVG = b"<svg "
DEPOT = """
name = "depot"
mission = "delivery"
[warehouse]
map = "floor.map"
random_tasks = 2
[fleet]
robots = 2
"""


@pytest.mark.slow
def test_ten_lines_are_ten_and_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = EXAMPLES / "ten_lines.py"
    body = ast.parse(path.read_text()).body[1:]  # without its docstring
    assert sum((node.end_lineno or 0) - node.lineno + 1 for node in body) == 10
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path))
    said = capsys.readouterr().out
    assert " 0 contacts" in said and "PERSON_IN_FIELD" in said
    assert (tmp_path / "sections.svg").read_bytes().startswith(SVG)
    assert "PERSON_IN_FIELD" in (tmp_path / "ten_lines.html").read_text()


@pytest.mark.slow
def test_the_notebook_runs_from_top_to_bottom() -> None:
    notebook = json.loads((EXAMPLES / "ten_lines.ipynb").read_text())
    assert notebook["nbformat"] == 4
    cells = ["".join(c["source"]) for c in notebook["cells"] if c["cell_type"] == "code"]
    assert all(not c.get("outputs") for c in notebook["cells"]), "outputs do not belong into git"
    names: dict[str, object] = {}
    shown = []
    for cell in cells:
        *first, last = ast.parse(cell).body
        exec(compile(ast.Module(first, []), "cell", "exec"), names)
        assert isinstance(last, ast.Expr)
        shown.append(eval(compile(ast.Expression(last.value), "cell", "eval"), names))
    run, tracks, sections, rmse_m, stops = shown
    assert isinstance(run, Run) and "<td>coverage</td>" in run._repr_html_()
    for picture in (tracks, sections):
        assert isinstance(picture, Picture) and picture._repr_svg_().startswith("<svg ")
    assert isinstance(rmse_m, dict) and set(rmse_m) == set(range(4))
    assert isinstance(stops, list) and {row["robot"] for row in stops} == {0, 1, 3}


@pytest.mark.slow
def test_it_is_the_run_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command("small", 2, 5, tmp_path, True) == 0
    told = json.loads(capsys.readouterr().out)
    run = play("small", 2, 5)
    assert (run.trace_hash, run.log_hash) == (told["trace_hash"], told["log_hash"])
    assert run.success and run.tracks[0].shape[1] == 3 and run.tracks[0][-1, 0] <= run.simulated_s
    with pytest.raises(AttributeError, match="it has"):
        _ = run.coverge
    with pytest.raises(ValueError, match="choose one of"):
        run.picture("gantt")
    with pytest.raises(ValueError, match="Nobody pressed a stop"):
        run.picture("stops")
    for name, begin in (("t.svg", SVG), ("t.png", b"\x89PNG"), ("t.pdf", b"%PDF")):
        run.picture("tracks").save(tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(begin)
    with pytest.raises(ValueError, match="not supported"):
        run.picture("tracks").save(tmp_path / "tracks.txt")


@pytest.mark.slow
def test_errands_in_a_building() -> None:
    run = play("corridor", robots=4, seed=2, time_limit_s=200.0)
    assert run.finished and max(run.rmse_m.values()) < 0.5


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ({"scenario": "nowhere"}, "no such file"),
        ({"scenario": "warehouse", "drive": "ackermann"}, "of the robots of a field"),
        ({"scenario": "ring", "mission": object}, "needs a field"),
        ({"scenario": "small", "mission": lambda site: None}, "made a NoneType, not a Mission"),
        ({"scenario": "none.map", "robots": 2}, "none.map"),
        ({"scenario": "small", "faults": [{"kind": "estop", "at_s": 1, "robot": 9}]}, "robot 9"),
        ({"scenario": "small", "faults": [{"kind": "flood", "at_s": 1}]}, "fault"),
        ({"scenario": "small", "time_limit_s": -1.0}, "time_limit_s"),
    ],
)
def test_what_cannot_be_is_one_line(words: dict[str, object], why: str) -> None:
    with pytest.raises(ScenarioError, match=why) as found:
        play(**words)  # type: ignore[arg-type]
    assert "\n" not in str(found.value)


@pytest.mark.slow
def test_the_face_has_what_it_says_and_imports_it_when_asked() -> None:
    asked = (
        "import sys, headland as hl; "
        "early = [m for m in sys.modules if m.split('.')[0] in ('tools', 'sim', 'agent')]; "
        "assert not early, early; "
        "assert set(hl.__all__) == {n for n in dir(hl) if n[0] != '_'}; "
        "assert all(getattr(hl, name).__doc__ for name in hl.__all__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", asked],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    with pytest.raises(AttributeError, match="no attribute 'fly'"):
        getattr(hl, "fly")  # noqa: B009


@pytest.mark.slow
def test_a_sweep_has_a_row_for_each_run() -> None:
    pytest.importorskip("pandas", reason="the extra frames is not installed")
    frame = hl.sweep("small", robots=(2, 3), seeds=(1,), progress=False)
    assert list(frame["robots"]) == [2, 3] and list(frame["seed"]) == [1, 1]
    alone = hl.play("small", robots=3, seed=1)
    assert frame["log_hash"][1] == alone.log_hash, "a row is the run of `play`"
    stops = alone.frame("sections")
    assert len(stops) == len(alone.table("sections"))
    assert list(alone.frame("stops")) == [
        "dot", "t_s", "by", "reason", "robot", "echo_s", "stopped_s", "stands_s",
    ], "nobody pressed one, and a program that asks for the slowest is the same"  # fmt: skip
    for chapter, columns in COLUMNS.items():
        if alone.table(chapter):
            assert tuple(alone.table(chapter)[0]) == columns, chapter
    axes = alone.plot()
    assert len(axes.lines) == 2 + 3 and axes.get_xlabel() == "m east"


FLOOR = "type octile\nheight 3\nwidth 6\nmap\n......\n..@@..\n......\n"
SMALL: dict[str, dict[str, Any]] = {
    "small": {"robots": 2}, "corridor": {"robots": 2, "seed": 2}, "depot.toml": {},
    "arena": {"robots": 3, "time_limit_s": 20.0}, "floor.map": {"robots": 2},
}  # fmt: skip


@pytest.mark.sampled(2)
@pytest.mark.parametrize("scenario", SMALL)
def test_every_mission_is_played_and_drawn(
    scenario: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pandas", reason="the extra frames is not installed")
    from matplotlib import pyplot

    monkeypatch.chdir(tmp_path)
    (tmp_path / "floor.map").write_text(FLOOR)
    (tmp_path / "depot.toml").write_text(DEPOT)
    run = hl.play(scenario, **SMALL[scenario])
    assert run.finished or "time_limit_s" in SMALL[scenario]
    assert len(run.robots) == run.figures["robots"]
    for robot in run.robots:
        assert list(robot.track) == ["t_s", "x_m", "y_m"] and len(robot.track) > 2
        assert robot.driven_m > 1.0, robot
    for chapter in ("sections", "load", "states"):
        frame = run.frame(chapter)
        assert len(frame) and all(name.isidentifier() for name in frame)
    for what in ("tracks", "sections", "states", "load"):
        _, ax = pyplot.subplots()
        assert run.plot(what, ax=ax) is ax and (ax.lines or ax.patches), what
        pyplot.close()
    assert {"robots", "plot", "trace_hash"} <= {*dir(run)}
    with pytest.raises(ValueError, match="choose one of tracks"):
        run.plot("gantt")


@pytest.mark.slow
def test_units_are_in_the_names_of_columns() -> None:
    pytest.importorskip("pandas", reason="the extra frames is not installed")
    planned = hl.play("small", robots=2).frame("planned")
    assert {"rmse_m", "implement_down_m", "worst_m"} <= {*planned}
    assert planned["rmse_m"].dtype == float


def test_a_mission_of_ones_own_is_a_fleet_s() -> None:
    pytest.importorskip("pandas", reason="the extra frames is not installed")
    example = runpy.run_path(str(EXAMPLES / "posts.py"))
    fleet = hl.Fleet("small", robots=3, mission=example["SoilSamples"])
    run = fleet.play(seed=2)
    assert run.success and run.sections == len(example["POSTS"])
    assert sorted(s for robot in run.robots for s in robot.sections) == [f"S{k}" for k in range(6)]
    for number, (x_m, y_m) in enumerate(example["POSTS"]):
        owner = next(robot for robot in run.robots if f"S{number}" in robot.sections)
        near = owner.track[(owner.track.x_m - x_m) ** 2 + (owner.track.y_m - y_m) ** 2 < 0.09]
        assert near.t_s.max() - near.t_s.min() > 2.5, "it truly stood at the post"


@pytest.mark.slow
def test_a_fleet_sweeps_its_seeds() -> None:
    pytest.importorskip("pandas", reason="the extra frames is not installed")
    example = runpy.run_path(str(EXAMPLES / "posts.py"))
    frame = hl.Fleet("small", robots=3, mission=example["SoilSamples"]).sweep(
        range(1, 9), progress=False
    )
    assert len(frame) == 8 and frame["finished"].all() and not frame["contacts"].any()
