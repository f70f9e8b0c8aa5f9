"""One folder a run: no folder holds parts of two runs, and export gives away one run's work only."""

import json
from pathlib import Path

import pytest

from tests.tools.cli.test_commands import headland
from tools.common.run_folder import FolderError, folder_for, folders, link, numbered
from tools.run.export import export


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
    assert folder_for(mine, "x") == mine
    assert (mine / "report.json").exists(), "no run has been here"
    (mine / "scene.json").write_text("{}")
    (mine / "notes.txt").write_text("mine")
    folder_for(mine, "x")
    assert {p.name for p in mine.iterdir()} == {"notes.txt"}
    (mine / "robot0.sqlite").write_text("")
    with pytest.raises(FolderError):
        folder_for(mine, "x")


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
