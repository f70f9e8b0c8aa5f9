"""`headland task add` on a live warehouse, tasks from files, and what people do wrong with them."""

import asyncio
import json
import signal
from pathlib import Path

import pytest

from sim.scenario import ScenarioError
from sim.warehouse_scenario import TaskRow, read_tasks
from tests.tools.launching import WAIT_S, call, delivered, said, start

SCENARIO = """
name = "yard"
mission = "delivery"
[warehouse]
map = '''
........
........
........
'''
handle_s = 0.5
[fleet]
robots = 2
"""
CSV = "pickup_x_m,pickup_y_m,dropoff_x_m,dropoff_y_m,at_s\n1.5,0.5,6.5,2.5,\n2.5,0.5,5.5,1.5,7.5\n"


def test_tasks_that_are_added_while_running_are_known_and_carried(tmp_path: Path) -> None:
    (tmp_path / "yard.toml").write_text(SCENARIO)
    (tmp_path / "more.csv").write_text(CSV)

    async def play() -> tuple[int, str, dict[str, object]]:
        live = await start(tmp_path, "run", "yard.toml", "--live", "--out", "out")
        try:
            port = await said(live, r"socketcand \S+:(\d+)")
            added = await call(
                tmp_path, "task", "add", "--file", "more.csv", "--scenario", "yard.toml",
                "--port", port, "--json",
            )  # fmt: skip
            await delivered(int(port), 2)
            live.send_signal(signal.SIGINT)
            async with asyncio.timeout(WAIT_S):
                await live.communicate()
        finally:
            if live.returncode is None:
                live.send_signal(signal.SIGKILL)
                await live.wait()
        return *added, json.loads((tmp_path / "out" / "report.json").read_text())

    code, text, report = asyncio.run(play())
    print(text, report)
    assert code == 0
    assert [json.loads(line) for line in text.splitlines()] == [
        {"task": 0, "known": True}, {"task": 1, "known": True},
    ]  # fmt: skip
    assert report["delivered"] == report["tasks"] == 2
    assert report["success"]


def test_tasks_from_csv_and_json_lines_are_the_same(tmp_path: Path) -> None:
    keys = ("pickup_x_m", "pickup_y_m", "dropoff_x_m", "dropoff_y_m", "at_s")
    (tmp_path / "a.csv").write_text(CSV)
    lines = [
        dict(zip(keys, (1.5, 0.5, 6.5, 2.5), strict=False)),
        dict(zip(keys, (2.5, 0.5, 5.5, 1.5, 7.5), strict=True)),
    ]
    (tmp_path / "a.jsonl").write_text("\n".join(json.dumps(line) for line in lines))
    expected = [TaskRow((1.5, 0.5), (6.5, 2.5)), TaskRow((2.5, 0.5), (5.5, 1.5), 7.5)]
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


def test_a_place_without_floor_is_refused_in_one_line(tmp_path: Path) -> None:
    code, text = asyncio.run(call(tmp_path, "task", "add", "99,1", "1,1"))
    assert (code, text.count("\n")) == (2, 1) and "no floor" in text
