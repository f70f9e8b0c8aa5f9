"""`headland task add` on a live warehouse, tasks from files, and what people do wrong with them."""

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from sim.scenarios.delivery_scenario import TaskRow, read_tasks
from sim.scenarios.scenario import ScenarioError
from tests.tools.complaint import Complaints
from tests.tools.launching import call
from tests.tools.yard import CSV, KNOWN, SCENARIO, play
from tools.common.bus_address import LAUNCH
from tools.inspect import task_outcomes
from tools.inspect.task_outcomes import TaskListener, list_tasks
from tools.operate import transport_order


@pytest.mark.slow
def test_tasks_that_are_added_while_running_are_known_and_carried(tmp_path: Path) -> None:
    told = play(tmp_path, "run", "yard.toml", "--live")
    assert (told.code, told.known) == (0, KNOWN)
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


@pytest.mark.parametrize("known", [{}, {4: True}, {4: True, 5: False}])
def test_orders_are_one_document(
    tmp_path: Path, known: dict[int, bool], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Of several orders it was one for each."""

    async def ordered(*_: Any) -> dict[int, bool]:
        return known

    (tmp_path / "yard.toml").write_text(SCENARIO)
    monkeypatch.setattr(transport_order, "_order", ordered)
    bus = ("virtual", "one document", 250_000, "", 0)
    house = str(tmp_path / "yard.toml")
    code = transport_order.order("1.5,0.5", "3.5,2.5", None, house, bus, True)
    told = capsys.readouterr().out
    assert json.loads(told) == [{"task": task, "known": sure} for task, sure in known.items()]
    assert code == (0 if all(known.values()) else 1)


@pytest.mark.parametrize("known", [(), (0,), (0, 3)])
def test_the_list_of_tasks_is_one_document(
    known: tuple[int, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Heard(TaskListener):
        """A fleet that knows these tasks and has told no order."""

        async def learn(self, only: int | None = None) -> bool:
            self.known.update(known)
            return True

    monkeypatch.setattr(task_outcomes, "TaskListener", Heard)
    assert list_tasks(None, ("virtual", "one list", 250_000, "", 0), True) == 0
    told = json.loads(capsys.readouterr().out)
    assert [row["task"] for row in told] == list(known)


@pytest.mark.parametrize("words", ["task list", "task status 1", "task add 1,2 3,4"])
def test_a_launch_of_a_field_is_told_to_have_no_tasks(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    launch = tmp_path / LAUNCH
    launch.parent.mkdir(parents=True)
    launch.write_text(json.dumps({"host": "127.0.0.1", "port": 1, "scenario": "small"}))
    told = Complaints(monkeypatch, capfd).of(words, tmp_path)
    assert told.code == 2
    assert "the newest launch, small, is a field and has no tasks" in told.line
