"""The tools of the bus work with the oldest packages that pyproject.toml allows."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.tools.launching import ROOT

LIMIT_S = 600.0
CALLS = {  # words, and the exit code in an empty folder
    "--version": 0, "dbc x.dbc": 0, "keys new keys": 0, "stop": 2, "say stop": 2, "inspect": 2, "map": 2,
    "lauch": 2,
}  # fmt: skip


def called(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        words, cwd=folder, capture_output=True, text=True, check=False, timeout=LIMIT_S,
        stdin=subprocess.DEVNULL,
    )  # fmt: skip


@pytest.mark.slow
def test_the_bus_tools_work_with_the_lower_bounds(tmp_path: Path) -> None:
    """typer was allowed from 0.12.5 on, and no command started with it: it knew no Literal."""
    folder = tmp_path / "env" / "bin"
    assert called(tmp_path, sys.executable, "-m", "venv", "env").returncode == 0
    if called(tmp_path, str(folder / "pip"), "install", "--quiet", "uv").returncode != 0:
        pytest.skip("no package index is reachable")
    python = str(folder / "python")
    done = called(
        tmp_path, str(folder / "uv"), "pip", "install", "--quiet", "--python", python,
        "--resolution", "lowest-direct", str(ROOT),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    for words, code in CALLS.items():
        done = called(tmp_path, str(folder / "headland"), *words.split())
        assert done.returncode == code, (words, done.stdout, done.stderr[-2000:])
        assert "Traceback" not in done.stderr, words
