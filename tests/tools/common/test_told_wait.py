"""A wait says what it is and how long, to people alone."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.common.child_process import module_command
from tools.common.told_wait import CLEAR, told_loading, told_wait


@pytest.mark.parametrize(
    ("terminal", "for_s", "told"), [(True, 5.0, True), (True, 2.0, False), (False, 5.0, False)]
)
def test_a_long_wait_is_told_at_a_terminal(
    terminal: bool, for_s: float, told: bool, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    with told_wait("until every robot confirms", for_s):
        said = capsys.readouterr().err
    after = capsys.readouterr().err
    assert said.startswith("until every robot confirms: up to 5 s; Ctrl-C ends it") is told
    assert bool(said) is told and after == (CLEAR if told else "")


def test_loading_is_told_at_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`headland run small` was silent for two seconds of CPU before its bar."""
    for terminal in (True, False):
        monkeypatch.setattr(sys.stderr, "isatty", lambda terminal=terminal: terminal)
        with told_loading():
            said = capsys.readouterr().err
        assert said.startswith("loading the simulator") is terminal
        assert capsys.readouterr().err == (CLEAR if terminal else "")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals on this system")
@pytest.mark.parametrize(
    "words", ["run x.map", "coverage drive x.map --robots 2", "mapf x.map --robots 2"]
)
def test_commands_that_load_the_simulator_say_so_at_a_real_terminal(
    tmp_path: Path, words: str
) -> None:
    """`mapf` and grids were silent for 2.7 s."""
    import pty

    rows = "\n".join(["." * 6] * 6)
    (tmp_path / "x.map").write_text(f"type octile\nheight 6\nwidth 6\nmap\n{rows}\n")
    ours, theirs = pty.openpty()
    command = [*module_command("tools.cli.headland"), *words.split()]
    with subprocess.Popen(command, cwd=tmp_path, stdout=theirs, stderr=theirs) as told:
        os.close(theirs)
        said = os.read(ours, 4096)
        while b"loading" not in said:
            said += os.read(ours, 4096)
        assert said.lstrip().startswith(b"loading the simulator"), said
        with contextlib.suppress(OSError):  # the terminal closes with the command
            while os.read(ours, 4096):
                pass
    os.close(ours)
    assert told.returncode == 0
