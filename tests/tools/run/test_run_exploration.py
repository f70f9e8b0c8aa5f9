"""`headland run` from the outside."""

import json
import re
from pathlib import Path

import pytest

from sim.scenarios.scenario import ARENAS
from tools.common.exit_codes import WRONG
from tools.report.chapter import chapters
from tools.report.run_data import gather
from tools.run.run_exploration import explore


def test_a_run_leaves_a_report_and_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert explore("arena", 2, 1, tmp_path, True, True) == 0
    outcome = json.loads(capsys.readouterr().out)
    assert outcome["success"] and outcome["robots"] == 2
    for name in ("report.json", "fleet.md", "maps.png", "maps.gif", "can.log", "trace.jsonl"):
        assert (tmp_path / name).stat().st_size > 0, name
    told = (tmp_path / "fleet.md").read_text(encoding="utf-8")
    assert "## Fleet Status (2 robots)" in told and "### Active Tasks" in told
    line = r"- robot-\d: pos=\(-?\d+\.\d, -?\d+\.\d\) (idle|task: .*\)) \(\d+\.\d s ago\)"
    robots = [found for found in told.splitlines() if found.startswith("- robot-")]
    assert robots and all(re.fullmatch(line, found) for found in robots)


@pytest.mark.parametrize("at_s", [0.0, 4.0])
def test_i24_a_fleet_of_which_all_robots_die_is_told_in_words(
    at_s: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table told "inf s to 95 %" and "inf% of the area"."""
    path = tmp_path / "dead.toml"
    arena = (ARENAS / "arena.toml").read_text(encoding="utf-8")
    text = arena.replace("time_limit_s = 300", "time_limit_s = 10")
    deaths = [f'[[fault]]\nat_s = {at_s}\nkind = "crash"\nrobot = {k}\n' for k in range(2)]
    path.write_text(text + "".join(deaths), encoding="utf-8")
    assert explore(str(path), 2, 1, tmp_path / "out", False, True) == 1
    told = capsys.readouterr().out
    found = re.search(r"95 % were not seen, ([0-9.]+) s to the end", told)
    assert found and at_s < float(found[1]) < 10.0 and "inf" not in told, told


def test_i24_the_report_has_what_was_done_to_the_fleet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only runs of fields wrote it. The page said that only `headland run` writes it, and that nothing
    happened."""
    path = tmp_path / "dead.toml"
    arena = (ARENAS / "arena.toml").read_text(encoding="utf-8")
    death = '[[fault]]\nat_s = 4.0\nkind = "crash"\nrobot = 1\n'
    path.write_text(arena.replace("time_limit_s = 300", "time_limit_s = 5") + death, "utf-8")
    assert explore(str(path), 2, 1, tmp_path / "out", True, False) == 1
    for report in (capsys.readouterr().out, (tmp_path / "out" / "report.json").read_text("utf-8")):
        assert json.loads(report)["faults"] == [{"t_s": 4.0, "kind": "crash", "robot": 1}]
    evidence = gather(tmp_path / "out")
    assert "headland run writes it" not in str(list(chapters(evidence)))


@pytest.mark.parametrize("scenario", ["nowhere", "arena"])
def test_what_is_wrong_is_said_in_one_line(
    scenario: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert explore(scenario, 7, 1, tmp_path, False, False) == WRONG
    assert capsys.readouterr().err.startswith("headland: ")
