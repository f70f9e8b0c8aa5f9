"""A robot that the entrance starts is told what the command line would tell it; all else goes there."""

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from agent.runtime import ready_kernels
from agent.runtime.robot_file import Changes
from tools.cli.entrance import NAMES, RobotWords, robot_words
from tools.cli.headland import app
from tools.run import robot_command

RUNS = [
    "robot fleet.toml",
    "robot fleet.toml --slot 3",
    "robot --slot 0 fleet.toml --first-boot",
    "robot a/b.toml --slot 07 -i socketcan -c can0 --body nmea --dry",
    "robot fleet.toml --interface socketcan --channel can0 --first-boot --dry",
    "robot fleet.toml -c 239.74.163.2",
]
FOR_THE_COMMAND_LINE = [
    "", "run oxted", "robot", "robot --help", "robot -h", "robot fleet.toml --check",
    "-v robot fleet.toml",
    "robot fleet.toml --check --json", "robot fleet.toml other.toml", "robot fleet.toml --slot",
    "robot fleet.toml --slot -1", "robot fleet.toml --slot two", "robot fleet.toml --slot=2",
    "robot fleet.toml --slot 1 --slot 2", "robot fleet.toml -q", "robot fleet.toml --wrong",
    "robot fleet.toml --metrics 0", "robot fleet.toml --foxglove 8765",
    "robot fleet.toml -ican0", "robot -- fleet.toml", "robot fleet.toml --slot ²",
]  # fmt: skip


@pytest.mark.parametrize("line", RUNS)
def test_both_ways_tell_a_robot_the_same(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Any] = []

    def robot(
        file: Path, changes: Changes, *, first_boot: bool, dry: bool, metrics: Any, foxglove: Any
    ) -> int:
        assert metrics is foxglove is None
        told.append(RobotWords(file, *changes, first_boot=first_boot, dry=dry))
        return 0

    monkeypatch.setattr(robot_command, "robot", robot)
    monkeypatch.setattr(ready_kernels, "use_ready_kernels", lambda: False)
    result = CliRunner().invoke(app, line.split(), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert [robot_words(line.split())] == told


@pytest.mark.parametrize("line", FOR_THE_COMMAND_LINE)
def test_what_is_not_plain_goes_to_the_command_line(line: str) -> None:
    assert robot_words(line.split()) is None


def test_a_word_without_letters_goes_to_the_command_line() -> None:
    assert robot_words(["robot", ""]) is None
    assert robot_words(["robot", "fleet.toml", "--body", ""]) is None


def test_the_entrance_knows_only_options_that_the_command_line_has() -> None:
    from typer.main import get_command

    robot: Any = get_command(app)
    options = {word for each in robot.commands["robot"].params for word in each.opts}
    assert {*NAMES, "--first-boot", "--dry"} <= options
