"""What commands and notebooks hand to other programs: strict JSON, real numbers, one answer."""

import csv
import json
import os
import subprocess
import sys
from math import inf, nan
from pathlib import Path
from typing import Any

import pytest

from protocol.frames.codec import encode
from protocol.frames.fleet_frames import Heartbeat, Member
from protocol.frames.work_frames import WorkProgress
from sim.files.strict_json import dumps
from tools.inspect.inspector import Inspector
from tools.inspect.robot_table import table_of
from tools.run.notebook import Run, play

ROOT = Path(__file__).parents[3]
NUMBERS = {"t_s", "x_m", "y_m", "speed_m_s", "off_m", "from_s", "until_s", "RMSE, m", "all", "worst, m",
           "implement down, m", "implement up, m", "echo_s", "stopped_s", "stands_s"}  # fmt: skip
WAIT_S = 120


def strict(text: str) -> Any:
    """As a parser that keeps to the standard reads it."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture(scope="module")
def run() -> Run:
    return play(
        "small", robots=3, time_limit_s=40.0, faults=[{"kind": "estop", "at_s": 20, "robot": 1}]
    )


@pytest.mark.slow
def test_b9_a_table_has_numbers_where_its_columns_are_numbers(run: Run) -> None:
    found: set[str] = set()
    for name in run.chapters:
        for row in run.table(name):
            for column in NUMBERS & row.keys():
                found.add(column)
                assert row[column] is None or isinstance(row[column], int | float), (name, column)
    assert found == NUMBERS
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    for name, column in (("tracks", "x_m"), ("stops", "stands_s"), ("planned", "RMSE, m")):
        assert pandas.DataFrame(run.table(name))[column].dtype.kind == "f"


def test_the_files_of_a_report_have_the_same_numbers(run: Run, tmp_path: Path) -> None:
    run.report(tmp_path / "one.html")
    named = [run.report(tmp_path / name).name for name in ("field", "field.v1", "field.v2")]
    assert named == ["field.html", "field.v1.html", "field.v2.html"], "each is another page"
    with (tmp_path / "one" / "tracks.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["x_m"]) for row in rows] == [row["x_m"] for row in run.table("tracks")]


def test_b10_replicas_that_agree_are_shown_in_step() -> None:
    """Digests differed in the table because one heartbeat was sent before the last work was heard."""
    heard = Inspector()
    beat = Heartbeat(0, 3, False, False, True, False, 1.0, 9, 0x50D8DF)

    def says(t_s: float, slot: int, message: Any) -> None:
        heard.hear(t_s, encode(message, 0x80 + slot))

    def shown() -> list[str]:
        return [robot["replica"] for robot in heard.to_dict()["robots"]]

    for slot in (0, 1):
        says(0.1, slot, Member(slot, 1, 0))
        says(0.5, slot, beat)
    assert shown() == ["in step", "in step"]
    says(0.6, 0, WorkProgress(7, 0, 0b111))
    assert shown() == ["before the last change"] * 2
    says(0.9, 0, beat._replace(digest=0x739490))
    assert shown() == ["in step", "before the last change"]
    says(1.0, 1, beat._replace(digest=0x739490))
    assert shown() == ["in step", "in step"]
    says(1.4, 1, beat._replace(digest=1))
    assert shown() == ["differs", "differs"]
    words = [str(cell) for column in table_of(heard.to_dict()).columns for cell in column.cells]
    assert "differs: 739490" in words and "differs: 000001" in words


def test_what_is_not_finite_is_null() -> None:
    value = {"a": inf, "b": [nan, 1.5, (-inf,)], "c": {"d": True, "e": 7}, 3: None}
    assert strict(dumps(value)) == {
        "a": None, "b": [None, 1.5, [None]], "c": {"d": True, "e": 7}, "3": None,
    }  # fmt: skip
    with pytest.raises(TypeError):
        dumps({"a": object()})


@pytest.mark.slow
def test_a_lone_robot_comes_near_to_nobody_and_that_is_json(tmp_path: Path) -> None:
    """`closest_m` was Infinity."""
    said = command(tmp_path, "run", "small", "--robots", "1", "--json", "--out", "lone")
    assert strict(said)["closest_m"] is None
    assert strict((tmp_path / "lone" / "report.json").read_text())["closest_m"] is None
    for words in (("inspect", "lone"), ("replay", "lone"), ("report", "lone")):
        strict(command(tmp_path, *words, "--json"))


@pytest.mark.slow
@pytest.mark.parametrize("words", ["coverage solve --agents 3", "bench durability --quick"])
def test_quick_commands_answer_in_json(tmp_path: Path, words: str) -> None:
    for line in command(tmp_path, *words.split(), "--json").splitlines():
        strict(line)


FIGURES = (
    "run/run_mission",
    "run/run_delivery",
    "run/launch",
    "chaos/chaos",
    "chaos/planted_bug_hunt",
    "run/replay",
    "bench/figure",
    "inspect/inspection",
    "run/coverage_drive",
    "run/coverage_report",
    "report/command",
    "bench/command",
)


@pytest.mark.parametrize("name", FIGURES)
def test_reports_of_runs_are_written_by_the_strict_door(name: str) -> None:
    text = (ROOT / "tools" / f"{name}.py").read_text(encoding="utf-8")
    assert "json.dumps(" not in text and "strict_json" in text


def command(folder: Path, *words: str) -> str:
    """What it prints."""
    done = subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", *words], cwd=folder, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=WAIT_S, check=False,
    )  # fmt: skip
    assert done.stdout and "Traceback" not in done.stderr, done.stderr
    return done.stdout


def test_f_no_command_prints_json_that_is_not_strict() -> None:
    """`json.dumps` prints Infinity and NaN, which other readers refuse, unless `allow_nan=False`."""
    tools = Path(__file__).parents[3] / "tools"
    loose = [
        f"{path.name}: {line.strip()}"
        for path in tools.rglob("*.py")
        for line in path.read_text().splitlines()
        if "print(json.dumps(" in line and "allow_nan=False" not in line
    ]
    assert not loose


def test_a_log_of_one_frame_does_not_load_the_bus_many_times_over() -> None:
    """It was told as 64 million per cent, because the span of one frame is nothing."""
    inspector = Inspector()
    inspector.hear(1.0, encode(Member(0, 1, 0), 0x80))
    assert inspector.to_dict()["bus_load_worst_case"] == 1.0
    inspector.hear(2.0, encode(Member(0, 1, 0), 0x80))
    assert inspector.to_dict()["bus_load_worst_case"] < 0.01
