"""What a tool of the bus imports before it knows whether there is a bus, and what it builds."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.tools.launching import ENVIRONMENT
from tools.cli.headland import app
from tools.cli.panels import only_asked

SLOW = {"asyncio", "cryptography", "can", "pydantic", "lark", "rich", "numpy", "tomllib"}


def imported(folder: Path, *words: str) -> tuple[set[str], str]:
    """The packages that a command imports, and its last line on standard error."""
    command = [sys.executable, "-X", "importtime", "-m", "headland", *words]
    run = subprocess.run(
        command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, check=False
    )  # fmt: skip
    lines = run.stderr.splitlines()
    names = (line.rpartition("|")[2].strip() for line in lines if line.startswith("import time:"))
    said = [line for line in lines if not line.startswith("import time:")]
    return {name.partition(".")[0] for name in names}, said[-1] if said else ""


@pytest.mark.parametrize("tool", ["stop", "release", "say stop", "inspect", "map"])
def test_a_tool_that_finds_no_launch_has_imported_nothing_of_a_bus(
    tool: str, tmp_path: Path
) -> None:
    names, said = imported(tmp_path, *tool.split())
    assert said.startswith(
        "headland: no bus given and no launch found in runs/launch: start one with"
    )
    assert not names & SLOW


def test_dbc_imports_neither_ciphers_nor_a_loop(tmp_path: Path) -> None:
    names, said = imported(tmp_path, "dbc", "all.dbc")
    assert said == "" and (tmp_path / "all.dbc").stat().st_size > 10_000
    assert not names & SLOW


@pytest.mark.parametrize(
    ("words", "commands", "groups"),
    [
        ("estop --timeout 3", 1, 0),
        ("-q dbc", 1, 0),
        ("task add 1,2 3,4", 0, 1),
        ("--help", None, None),
        ("estopp", None, None),  # for its suggestions
        ("", None, None),
    ],
)
def test_only_the_command_that_is_asked_for_is_built(
    words: str, commands: int | None, groups: int | None
) -> None:
    asked = only_asked(app, words.split())
    if commands is None:
        assert asked is app
    else:
        assert len(asked.registered_commands) == commands
        assert len(asked.registered_groups) == groups


def test_a_shell_that_completes_words_gets_all_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("_HEADLAND_COMPLETE", "complete_bash")
    assert only_asked(app, ["estop"]) is app
