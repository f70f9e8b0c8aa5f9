"""`headland task add` on a live warehouse, tasks from files, and what people do wrong with them."""

import asyncio
import json
from pathlib import Path

import pytest

from sim.scenarios.delivery_scenario import TaskRow, read_tasks
from sim.scenarios.scenario import ScenarioError
from tests.tools.launching import call
from tests.tools.yard import CSV, KNOWN, play


@pytest.mark.slow
def test_tasks_that_are_added_while_running_are_known_and_carried(tmp_path: Path) -> None:
    told = play(tmp_path, "run", "yard.toml", "--live")
    assert (told.code, told.lines) == (0, KNOWN)
    assert told.report["delivered"] == told.report["tasks"] == 2
    assert told.report["success"]


def test_tasks_from_csv_and_json_lines_are_the_same(tmp_path: Path) -> None:
    keys = ("pickup_x_m", "pickup_y_m", "dropoff_x_m", "dropoff_y_m", "at_s")
    (tmp_path / "a.csv").write_text(CSV)
    lines = [
        dict(zip(keys, (1.5, 0.5, 3.5, 2.5), strict=False)),
        dict(zip(keys, (2.5, 0.5, 4.5, 1.5, 7.5), strict=True)),
    ]
    (tmp_path / "a.jsonl").write_text("\n".join(json.dumps(line) for line in lines))
    expected = [TaskRow((1.5, 0.5), (3.5, 2.5)), TaskRow((2.5, 0.5), (4.5, 1.5), 7.5)]
    assert read_tasks(tmp_path / "a.csv") == read_tasks(tmp_path / "a.jsonl") == expected


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.csv", "pickup_x_m,pickup_y_m,dropoff_x_m,dropoff_y_m\n1,2,three,4\n", "line 2: dropoff_x_m"),
        ("a.jsonl", '{"pickup_x_m": 1}\n', "line 1: pickup_y_m"),
        ("a.jsonl", "[1, 2]\n", "line 1: not an object"),
        ("a.jsonl", "{\n", "line 1: not JSON"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_said_by_line(
    tmp_path: Path, name: str, text: str, told: str
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ScenarioError, match=told):
        read_tasks(tmp_path / name)


@pytest.mark.slow
def test_a_place_without_floor_is_refused_in_one_line(tmp_path: Path) -> None:
    code, text = asyncio.run(call(tmp_path, "task", "add", "99,1", "1,1"))
    assert (code, text.count("\n")) == (2, 1) and "no floor" in text
