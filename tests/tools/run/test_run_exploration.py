"""`headland run` from the outside."""

import json
import re
from pathlib import Path

import pytest

from tools.common.exit_codes import WRONG
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


@pytest.mark.parametrize("scenario", ["nowhere", "arena"])
def test_what_is_wrong_is_said_in_one_line(
    scenario: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert explore(scenario, 7, 1, tmp_path, False, False) == WRONG
    assert capsys.readouterr().err.startswith("headland: ")
