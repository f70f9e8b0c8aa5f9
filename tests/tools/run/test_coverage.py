"""`headland coverage` as people use it: solve, replay, export; bad input is one line and exit 2."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from sim.files.coverage_plan_file import Plan, read_plan
from sim.files.grid_map import GridFileError, Instance, read_instance, write_instance
from sim.files.palette import rgb_of
from sim.scenarios.scenario import ScenarioError
from sim.world.plan_judge import PlanJudge, judge
from tools.run.coverage import GRID_ROBOTS, app, instance_of
from tools.run.coverage_report import drawing
from tools.run.scenario_run import run_of

FOUR = Instance("four", np.zeros((4, 4), dtype=bool), [(0, 0), (3, 3)])  # cells a side


def call(*words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def test_the_missions_own_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = call("solve", "--H", 32, "--W", 32, "--robots", 20, "--wall-prob", "0.20", "--seed", 1)
    assert done.exit_code == 0 and "makespan" in done.stdout
    plan = json.loads((tmp_path / "vacuum_plan.json").read_text())
    assert (plan["H"], plan["W"], plan["n_agents"]) == (32, 32, 20)
    assert all(len(line) == plan["makespan"] for line in plan["per_agent_actions"])
    again = call("replay", "--plan", "vacuum_plan.json", "--delay", "0.03", "--stop-on-done")
    assert again.exit_code == 0 and "0 to cover" in again.stdout
    drawn = again.stdout.split("\nstep ")[0]
    assert len(re.findall(r"\d", drawn)) == 20, "every robot, by the last digit of its number"


def test_equal_seeds_give_equal_plans(tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert call("solve", "--robots", 5, "--seed", 3, "--out", tmp_path / name).exit_code == 0
    assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text()


def test_an_export_is_solved_as_the_original(tmp_path: Path) -> None:
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    export = tmp_path / "x.mcpp"
    call("solve", "--robots", 7, "--seed", 2, "--out", first, "--export", export)
    assert len(read_instance(export).starts) == 7
    assert call("solve", export, "--out", second, "--json").exit_code == 0
    assert first.read_text() == second.read_text()
    third = call("solve", export, "--robots", 3, "--out", second, "--json")
    assert json.loads(third.stdout)["robots"] == 3
    fourth = call("solve", export.with_suffix(".map"), "--robots", 3, "--gate", "--out", second)
    assert fourth.exit_code == 0


@pytest.mark.parametrize("name", ["four.map", "four.mcpp"])
def test_no_robots_on_a_grid_are_refused_and_not_played_as_six(name: str, tmp_path: Path) -> None:
    write_instance(tmp_path / name, FOUR)
    with pytest.raises(GridFileError, match="robots"):
        instance_of(tmp_path / name, 0, 1)
    with pytest.raises(ScenarioError, match="robots"):
        run_of(str(tmp_path / name), robots=0)


def test_a_run_of_an_mcpp_has_the_robots_of_the_file(tmp_path: Path) -> None:
    write_instance(tmp_path / "four.mcpp", FOUR)
    assert instance_of(tmp_path / "four.mcpp", None, 1).starts == FOUR.starts
    assert run_of(str(tmp_path / "four.mcpp")).setting.instance.starts == FOUR.starts
    write_instance(tmp_path / "four.map", FOUR)
    assert len(instance_of(tmp_path / "four.map", None, 1).starts) == GRID_ROBOTS


@pytest.mark.parametrize("word", ["--H", "--W", "--wall-prob"])
@pytest.mark.parametrize("command", ["solve", "drive"])
def test_words_of_a_random_map_are_refused_beside_a_map(
    command: str, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_instance(tmp_path / "four.map", FOUR)
    done = call(command, "four.map", "--robots", 2, word, 1)
    assert done.exit_code == 2 and "random map" in done.stderr and "four.map" in done.stderr


def test_deaths_and_joins_are_in_the_plan(tmp_path: Path) -> None:
    out = tmp_path / "plan.json"
    words = ["--H", 24, "--W", 24, "--wall-prob", 0, "--robots", 4, "--out", out, "--json"]
    done = call("solve", *words, "--die", "2@40", "--join", "23,23@60")
    report = json.loads(done.stdout)
    assert done.exit_code == 0 and report["ok"] and report["robots"] == 5
    plan = read_plan(out)
    assert plan.died == [-1, -1, 40, -1, -1] and plan.joined == [0, 0, 0, 0, 60]
    assert judge(plan).ok and call("replay", out).exit_code == 0


@pytest.mark.parametrize("command", ["solve", "drive"])
def test_a_robot_that_joins_does_not_beat_the_lower_bound(command: str, tmp_path: Path) -> None:
    aisle = tmp_path / "aisle.map"
    write_instance(aisle, Instance("aisle", np.zeros((1, 60), dtype=bool), [(0, 0)]))
    words = {
        "solve": ["--robots", 1, "--join", "0,1@3", "--out", tmp_path / "plan.json"],
        "drive": ["--robots", 2, "--join", "1@3"],
    }
    report = json.loads(call(command, aisle, *words[command], "--seed", 3, "--json").stdout)
    assert report["ratio"] >= 1.0, report


def test_a_plan_with_faults_is_not_exit_0(tmp_path: Path) -> None:
    out = tmp_path / "plan.json"
    call("solve", "--robots", 4, "--out", out)
    document = json.loads(out.read_text())
    document["per_agent_actions"][0] = []
    out.write_text(json.dumps(document))
    done = call("replay", out, "--json")
    assert done.exit_code == 1 and not json.loads(done.stdout)["ok"]


@pytest.mark.parametrize("words", [
    ["solve"], ["solve", "--robots", "0"], ["solve", "--robots", "9999"],
    ["solve", "--robots", "3", "--wall-prob", "2"], ["solve", "--robots", "3", "--H", "0"],
    ["solve", "none.map", "--robots", "3"], ["solve", "none.mcpp"], ["replay", "none.json"],
    ["solve", "--robots", "3", "--die", "3@1"], ["solve", "--robots", "3", "--die", "x"],
    ["solve", "--robots", "3", "--join", "0,99@1"], ["solve", "--robots", "3", "--turn-cost", "-1"],
    ["solve", "--robots", "3", "--export", "x.txt"], ["replay", "none.json", "--delay", "-1"],
    ["solve", "--robots", "9", "--H", "2000", "--W", "3000"],
    ["replay", "none.json", "--turn-cost", "nan"], ["replay", "none.json", "--turn-cost", "-1"],
])  # fmt: skip
def test_bad_input_is_one_line(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = call(*words)
    assert done.exit_code == 2 and "Traceback" not in done.output
    assert done.output.strip().count("\n") == 0 and "headland:" in done.output


def test_i24_a_map_of_too_many_cells_is_refused_as_such() -> None:
    """It was told that --H and --W are 1 or more, which they were."""
    done = call("solve", "--robots", "1", "--H", "3000", "--W", "3000")
    assert done.exit_code == 2 and "--H times --W is more than" in done.output


@pytest.mark.parametrize("change", [
    {"H": -2, "W": -2}, {"starts": []}, {"starts": [[9, 0]]},
    {"per_agent_actions": [[5]]}, {"died": [0.5]}, {"walls": [[0, 0], [0, 2]]}, None,
])  # fmt: skip
def test_a_bad_plan_is_one_line(change: dict[str, object] | None, tmp_path: Path) -> None:
    good = {"H": 2, "W": 2, "walls": [[0, 0], [0, 0]], "starts": [[0, 0]]}
    good |= {"per_agent_actions": [[4, 2, 3]]}
    plan = tmp_path / "plan.json"
    plan.write_text(json.dumps(good))
    assert call("replay", plan).exit_code == 0
    plan.write_text(json.dumps([] if change is None else {**good, **change}))
    done = call("replay", plan)
    assert done.exit_code == 2 and done.output.strip().count("\n") == 0


def test_a_drawing_tells_which_robot_is_where_and_in_its_colour(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every robot was a green `o`, on cells that were twice as high as wide."""
    walls = np.zeros((2, 12), dtype=np.bool_)
    walls[1, 11] = True
    starts = [(0, column) for column in range(12)]
    court = PlanJudge(Plan(walls, starts, [[] for _ in starts], ~walls))
    plain = drawing(court, court.wanted(), False).splitlines()
    assert plain[:2] == ["012345678901", "·" * 11 + "█"]
    size = os.terminal_size((80, 24))
    monkeypatch.setattr("shutil.get_terminal_size", lambda: size)
    shown = drawing(court, court.wanted(), True).splitlines()
    for number, start in enumerate(starts):
        red, green, blue = (round(255 * part) for part in rgb_of(number))
        assert f"\x1b[38;2;{red};{green};{blue}m{number:>2}\x1b[0m" in shown[0], start
    assert shown[1].endswith("██")
    size = os.terminal_size((6, 24))  # two cells a mark, and none to spare
    coarse = re.sub(r"\x1b\[[\d;]*m", "", drawing(court, court.wanted(), True)).splitlines()
    assert coarse[0] == "024680"
