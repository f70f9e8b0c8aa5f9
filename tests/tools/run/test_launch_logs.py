"""F11: a launch keeps the newest parts of its logs, says so once, and tools read all parts."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from sim.files.log_parts import parts_of
from tools.livemap.command import recorded

ROOT = Path(__file__).parents[3]
TINY = """
import sys
from sim.files.log_parts import Limit
from tools.run.launch import Launch
Launch.log_limit = Limit(part_bytes=8_000, parts=3)
from tools.cli.headland import main
sys.argv = ["headland", *sys.argv[1:]]
main()
"""
TIMEOUT_S = 180.0


def _call(folder: Path, *words: str) -> tuple[str, str]:
    ended = subprocess.run(
        [sys.executable, *words], cwd=folder, capture_output=True, text=True, timeout=TIMEOUT_S,
        check=False, env={"PYTHONPATH": str(ROOT), "PATH": ""},
    )  # fmt: skip
    return ended.stdout, ended.stderr


@pytest.mark.slow
def test_f11_a_launch_keeps_its_newest_parts_and_tools_read_them_all(tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="the extra `operator` is not installed")
    words = ["launch", "small", "--robots", "2", "--seconds", "25", "--port", "0"]
    said, errors = _call(tmp_path, "-c", TINY, *words)
    assert "Traceback" not in errors, errors
    plain = " ".join(said.split())
    assert len(re.findall(r"can\.log: its newest \d+ bytes are kept", plain)) == 1, said
    folder = tmp_path / "runs" / "launch"
    logs = parts_of(folder / "can.log")
    assert len(logs) == 3
    assert all(path.stat().st_size < 9_000 for path in logs)
    lines = sum(path.read_bytes().count(b"\n") for path in logs)
    told, errors = _call(tmp_path, "-m", "tools.cli.headland", "inspect", str(folder), "--json")
    assert sum(json.loads(told)["frames"].values()) == lines, errors
    assert recorded(folder, None).count == lines
    _call(tmp_path, "-m", "tools.cli.headland", "report", str(folder))
    assert (folder / "report.html").is_file()
