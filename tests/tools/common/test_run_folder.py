"""One folder a run: no folder holds parts of two runs, and export gives away one run's work only."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from sim.scenarios.field_setup import FieldSetup
from sim.scenarios.scenario import load
from tests.tools.cli.test_commands import headland
from tools.common.run_folder import FolderError, folder_for, folders, link, numbered
from tools.run.export import export
from tools.run.fleet_folder import fleet_folder

ROOT = Path(__file__).parents[3]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_b3_two_runs_have_two_folders_and_export_never_mixes_them(tmp_path: Path) -> None:
    for words in (("run", "small", "--json"), ("run", "corridor", "--json")):
        done = headland(*words, folder=tmp_path)
        assert done.returncode == 0, done.stderr
    assert {p.name for p in (tmp_path / "runs").iterdir()} == {"small-1", "corridor-1", "latest"}
    assert (tmp_path / "runs/latest").resolve() == tmp_path / "runs/corridor-1"
    done = headland("export", "runs/latest", "--isoxml", "T", folder=tmp_path)
    assert done.returncode == 2 and "work.geojson" in done.stderr and not (tmp_path / "T").exists()
    done = headland("export", "runs/small-1", "--isoxml", "T", folder=tmp_path)
    assert done.returncode == 0 and "finished" in done.stdout


def test_b3_parts_of_two_runs_are_not_exported(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    head: dict[str, object] = {
        "kind": "boundary",
        "name": "f",
        "started": "2026-01-01T00:00:00+00:00",
    }
    head |= {"finished": True, "width_mm": 4000}
    square = [[[0, 0], [0, 1e-3], [1e-3, 1e-3], [0, 0]]]
    feature = {"properties": head, "geometry": {"coordinates": square}}
    document = {"type": "FeatureCollection", "run": "a", "features": [feature]}
    (folder / "work.geojson").write_text(json.dumps(document))
    (folder / "report.json").write_text(json.dumps({"log_hash": "b"}))
    assert export(folder, folder / "T", None) == 2
    assert not (folder / "T").exists() and capsys.readouterr().err.count("\n") == 1


def test_b3_a_folder_that_is_named_is_emptied_of_runs_only(folder: Path) -> None:
    mine = folder / "mine"
    mine.mkdir()
    (mine / "report.json").write_text("of somebody")
    with folder_for(mine, "x") as held:
        assert held == mine
    assert (mine / "report.json").exists(), "no run has been here"
    (mine / "scene.json").write_text("{}")
    (mine / "notes.txt").write_text("mine")
    with folder_for(mine, "x"):
        assert {p.name for p in mine.iterdir()} == {"notes.txt", "lock"}
    (mine / "robot0.sqlite").write_text("")
    with pytest.raises(FolderError, match="journals"), folder_for(mine, "x"):
        pass


def test_the_film_and_the_report_of_an_earlier_run_do_not_stay(folder: Path) -> None:
    mine = folder / "mine"
    (mine / "report").mkdir(parents=True)
    for name in ("scene.json", "film.gif", "report.html", "report/stops.svg", "report/stops.csv"):
        (mine / name).write_text("of the first")
    with folder_for(mine, "x"):
        assert {p.name for p in mine.rglob("*") if p.is_file()} == {"lock"}


HOLDS = """
import sys
from pathlib import Path
from tools.common.run_folder import folder_for
with folder_for(Path(sys.argv[1]), "x") as folder:
    (folder / "scene.json").write_text("{}")
    (folder / "can.log").write_text("of the first")
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_second_run_in_a_folder_is_refused_and_leaves_its_files(tmp_path: Path) -> None:
    """Both wrote one can.log, and the second deleted what the first had written."""
    mine = tmp_path / "mine"
    with subprocess.Popen(
        [sys.executable, "-c", HOLDS, str(mine)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT
    ) as first:  # fmt: skip
        assert first.stdin is not None and first.stdout is not None
        assert first.stdout.readline() == b"held\n"
        second = headland("run", "small", "-o", str(mine), folder=tmp_path)
        assert (mine / "can.log").read_text() == "of the first"
        with pytest.raises(FolderError, match="another run or launch"):
            fleet_folder(mine, FieldSetup(load("small")), fresh=False)
        first.stdin.close()
    why = f"another run or launch writes into {mine}: end it, or choose another folder with --out"
    assert second.returncode == 2 and second.stderr == f"headland: {why}\n"
    with folder_for(mine, "x"):
        assert not (mine / "can.log").exists()


def test_a_folder_is_free_after_a_run_that_failed(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="broken"), folder_for(tmp_path, "x"):
        raise ValueError("broken")
    with folder_for(tmp_path, "x"):
        pass


def test_b3_numbers_go_up_and_links_follow(folder: Path) -> None:
    real = folder / "runs" / "launch"
    real.mkdir(parents=True)
    (real / "can.log").write_text("of an older version")
    made = [numbered(folder / "runs", "a b/c") for _ in range(11)]
    assert [p.name for p in made[-2:]] == ["a_b_c-10", "a_b_c-11"]
    made[10].rmdir()
    assert numbered(folder / "runs", "a b/c").name == "a_b_c-11"
    assert folders(folder / "runs", "a b/c")[-1][0] == 11
    link(real, made[0])
    assert real.is_symlink() and real.resolve() == made[0].resolve()
    assert (folder / "runs" / "launch-1" / "can.log").exists()
    link(real, made[1])
    assert real.resolve() == made[1].resolve()
