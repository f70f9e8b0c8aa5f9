"""The README: its example runs, its figures are those that were measured, its pictures are there."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.tools.documented import ROOT
from tools.chaos.chaos_report import survived
from tools.cli.chart_pages import RUNS

README = (ROOT / "README.md").read_text(encoding="utf-8")
PICTURE = re.compile(r"!\[[^\]]+\]\(([^)]+)\)")
LINES_MAX = 10  # of the example, without the import and empty lines


@pytest.mark.slow
def test_the_example_runs_as_it_stands_in_an_empty_folder(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", README, re.S)
    assert len([line for line in code.splitlines() if line and "import" not in line]) <= LINES_MAX
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False,
        env={"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "HOME": str(tmp_path)}, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    assert "% covered" in done.stdout and (tmp_path / "tracks.png").exists()


def test_its_best_figure_was_measured() -> None:
    found = survived(RUNS)
    (hours,) = re.findall(r"^## ([\d,]+) robot-hours", README, re.M)
    assert int(hours.replace(",", "")) == round(found.robot_hours)
    assert not found.broken, "the heading would be a lie"


def test_its_pictures_are_there_and_have_words() -> None:
    shown = PICTURE.findall(README)
    assert len(shown) >= 3
    for path in shown:
        assert (ROOT / path).is_file(), path
