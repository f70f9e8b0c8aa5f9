"""The command as people use it: real processes, bad input, exit codes."""

import json
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import can
import pytest

from sim.runs.work_geojson import read_work_geojson
from tests.sim.runs.work_isoxml import read_work_isoxml
from tests.tools.complaint import Complaints

ROOT = Path(__file__).parents[3]


def headland(
    *words: str, folder: Path, timeout: float = 120.0
) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", *words], cwd=folder, capture_output=True, text=True,
        check=False, timeout=timeout, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip


@pytest.mark.slow
def test_run_leaves_report_picture_and_logs(tmp_path: Path) -> None:
    done = headland("run", "small", "--out", "out", "--json", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["success"] and report["coverage"] > 0.9999 and report["contacts"] == 0
    out = tmp_path / "out"
    assert json.loads((out / "report.json").read_text()) == report
    assert (out / "field.png").read_bytes()[:4] == b"\x89PNG"
    frames = sum(report["frames"].values())
    assert sum(1 for _ in can.LogReader(out / "can.log")) == frames, "python-can reads our log"

    seen = headland("inspect", "out", "--json", folder=tmp_path)
    robots = json.loads(seen.stdout)["robots"]
    assert [r["slot"] for r in robots] == [0, 1, 2]
    assert all(r["clock"] and r["transitions"] for r in robots)
    why = headland("inspect", "out", "--why", "S3", "--json", folder=tmp_path)
    phases = [step["phase"] for step in json.loads(why.stdout)]
    assert phases[:2] == ["CLAIMED", "STARTED"] and phases[-2:] == ["STARTED", "DONE"], phases
    done = headland("export", "out", "--isoxml", "T", "--geojson", "w.geojson", folder=tmp_path)
    assert done.returncode == 0 and "finished" in done.stdout, done.stderr
    work = read_work_geojson(tmp_path / "w.geojson")
    assert read_work_isoxml(tmp_path / "T") == work
    assert work.stopped <= datetime.now(UTC), "a run that is faster than its clock"
    assert headland("export", "nowhere", "--isoxml", "T", folder=tmp_path).returncode == 2
    (tmp_path / "file").touch()
    words = ("export", "out", "--isoxml", "T2", "--geojson", "file/w.geojson", "--json")
    partly = headland(*words, folder=tmp_path)  # a script reads what was written before it failed
    assert partly.returncode == 2 and json.loads(partly.stdout) == {"isoxml": "T2"}, partly
    table = headland("inspect", "out", folder=tmp_path)
    assert "path of" in table.stdout and table.returncode == 0


def test_mermaid_is_printed_from_the_table(tmp_path: Path) -> None:
    done = headland("inspect", "--mermaid", folder=tmp_path)
    assert "WORKING --> EMERGENCY_STOP: emergency" in done.stdout


BAD = {
    "unknown key": (
        'name = "x"\n[field]\nfile = "a"\n[fleet]\nrobotz = 3\n',
        "fleet.robotz", "did you mean 'robots'",
    ),
    "out of range": ('name = "x"\n[field]\nfile = "a"\n[fleet]\nrobots = 500\n', "fleet.robots", "500"),
    "missing": ('name = "x"\n', "field", "missing"),
    "not toml": ("name = ", "not TOML", ""),
    "no field file": ('name = "x"\n[field]\nfile = "nowhere.geojson"\n', "field.file", "cannot be read"),
    "a robot that is not": (
        'name = "x"\n[field]\nfile = "a"\n[[fault]]\nkind = "crash"\nat_s = 1\nrobot = 9\n',
        "fault.0.robot", "not one of 6",
    ),
}  # fmt: skip


@pytest.fixture
def wrong(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Complaints:
    return Complaints(monkeypatch, capfd)


@pytest.mark.slow
def test_what_is_wrong_is_one_line_of_a_process_too(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("name = ")
    done = headland("run", "bad.toml", folder=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("headland: ") and done.stderr.count("\n") == 1, done.stderr


@pytest.mark.parametrize("case", BAD)
def test_a_wrong_scenario_gets_one_line(case: str, wrong: Complaints, tmp_path: Path) -> None:
    text, key, why = BAD[case]
    (tmp_path / "bad.toml").write_text(text)
    said = wrong.of("run bad.toml", tmp_path)
    assert said.code == 2 and key in said.line and why in said.line


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"\xff\xfe\x00", "not a text file"),
        (b"{", "not JSON"),
        (b"[]", "not a GeoJSON object"),
        (b'{"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [[[0, 0]]]}}', "needs 4"),
        (b'{"type": "Polygon", "coordinates": [[[0,0],["a",1],[1,1],[0,0]]]}', "two numbers"),
        (b'{"type": "Polygon", "coordinates": [[[0,0],[0,1e-3],[1e-3,0],[1e-3,1e-3],[0,0]]]}', "repair"),
        (b'{"type": "Polygon", "coordinates": [[[900,0],[0,1],[1,1],[900,0]]]}', "degrees"),
    ],
)  # fmt: skip
def test_a_wrong_field_file_gets_one_line(
    content: bytes, why: str, wrong: Complaints, tmp_path: Path
) -> None:
    (tmp_path / "field.json").write_bytes(content)
    (tmp_path / "s.toml").write_text('name = "x"\n[field]\nfile = "field.json"\n')
    said = wrong.of("run s.toml", tmp_path)
    assert said.code == 2 and "field.json" in said.line and why in said.line


@pytest.mark.parametrize(
    "words",
    [
        "estop", "reset", "inspect", "inspect nowhere", "inspect --why 7x", "run no-such-scenario",
        "estop -i nonsense", "estop --reason BORED", "run small --robots 0", "order 1 dance",
        "order 1 set-goal here", "order 1 wait 1,2", "order 1 wait",
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_one_line(words: str, wrong: Complaints, tmp_path: Path) -> None:
    assert wrong.of(words, tmp_path).code == 2
