"""The commands that a run names at its end can be called with what is installed."""

from importlib.machinery import ModuleSpec
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from tools.livemap.command import recorded
from tools.run import run_field
from tools.run.coverage import drive_grid
from tools.run.run_field import work_export
from tools.run.run_mission import next_commands, tell_next


def test_task_data_is_offered_only_where_its_package_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """From `headland[sim,operator]`, as the README installs it, the named export failed."""
    monkeypatch.setattr(run_field, "find_spec", lambda name: None)
    assert "--geojson" in work_export()[0]
    monkeypatch.setattr(run_field, "find_spec", lambda name: ModuleSpec(name, None))
    assert "--isoxml" in work_export()[0]


def test_a_run_on_a_grid_leaves_what_the_map_shows(tmp_path: Path) -> None:
    """`headland map` was named as a next command, and had neither a scene nor a run.mcap."""
    (tmp_path / "four.map").write_text(
        "type octile\nheight 4\nwidth 4\nmap\n....\n.@..\n....\n....\n"
    )
    out = tmp_path / "run"
    assert drive_grid(tmp_path / "four.map", 2, 1, out, True) == 0
    recording = recorded(out, None)
    assert recording.scene is not None and recording.scene["kind"] == "grid"
    assert recording.count > 100 and (out / "run.mcap").exists()


def test_a_folder_with_a_space_is_quoted() -> None:
    """`headland report my runs/one` was named, and is two arguments."""
    assert "headland report 'my runs/one' " in next_commands(Path("my runs/one"))
    assert "headland report runs/one " in next_commands(Path("runs/one"))


def test_a_comment_stays_on_the_line_of_its_command() -> None:
    """At 80 columns comments were wrapped, and where the lines were pasted their ends were commands."""
    console = Console(file=StringIO(), width=80)
    folder = Path("runs/2026-11-30T07-08-20-a-scenario-with-a-long-name")
    tell_next(console, next_commands(folder))
    assert isinstance(console.file, StringIO)
    lines = console.file.getvalue().splitlines()
    assert lines[0] == "next:" and len(lines) > 3
    assert all(line.startswith("  headland ") and "  # " in line for line in lines[1:]), lines
