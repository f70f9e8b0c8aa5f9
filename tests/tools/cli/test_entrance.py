"""A robot that the entrance starts is told what the command line would tell it; all else goes there."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from agent.runtime import ready_kernels
from agent.runtime.robot_file import Changes
from tests.tools.launching import ROOT
from tools.cli.entrance import NAMES, RobotWords, robot_words
from tools.cli.headland import app
from tools.run import robot_command

MODULES_MAKE = 10_000  # objects that the modules of any command make
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


AT_THE_END = """
import atexit, gc, os, sys
atexit.register(lambda: os.write(2, b"%d\\n" % gc.get_freeze_count()))  # after all that follow
sys.argv = ["headland", "--version"]
from headland.__main__ import main
main()
"""


def test_a_process_that_ends_leaves_its_objects_to_the_system() -> None:
    """`headland check small` was seen to stay for 25 s after its result on a machine under load. What
    it still did was to look through all objects. Now they are set aside before."""
    told = subprocess.run(
        [sys.executable, "-c", AT_THE_END], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert told.stdout.startswith("headland ")
    assert int(told.stderr.split()[-1]) > MODULES_MAKE


INTERRUPTED_AT = """
import signal, sys
class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            signal.raise_signal(signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background ignore it
sys.meta_path.insert(0, Interrupts())
sys.argv = ["headland", "list"]
from headland.__main__ import main
main()
"""


@pytest.mark.parametrize(
    "name", ["tools.cli.entrance", "tools.cli.headland", "typer", "tools.cli.scenario_files"]
)
def test_ctrl_c_while_modules_are_loaded_says_nothing(name: str) -> None:
    told = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_AT.format(name=name)],
        capture_output=True, text=True, check=False, cwd=ROOT,
    )  # fmt: skip
    assert (told.returncode, told.stdout, told.stderr) == (130, "", "")


DROPPED_AT = """
import signal, sys, weakref
class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            gone = Interrupts()
            reference = weakref.ref(gone, lambda _: signal.raise_signal({number}))
            del gone
            {then}
signal.signal(signal.SIGINT, {handler})
sys.meta_path.insert(0, Interrupts())
sys.argv = ["headland", "check", "small"]
from headland.__main__ import main
main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals are not of POSIX there")
@pytest.mark.parametrize(
    ("number", "handler"),
    [("signal.SIGINT", "signal.default_int_handler"), ("signal.SIGTERM", "signal.SIG_IGN")],
)
@pytest.mark.parametrize("then", ["pass", "raise RuntimeError('no compiled object yet')"])
def test_ctrl_c_that_meets_a_callback_ends_the_command(
    number: str, handler: str, then: str
) -> None:
    """Python drops an exception of a callback. A launch went on for good after its Ctrl-C, and numba,
    whose callback had done nothing, failed with a hundred lines."""
    program = DROPPED_AT.format(number=number, handler=handler, then=then)
    told = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert (told.returncode, told.stdout, told.stderr) == (130, "", "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
@pytest.mark.parametrize("words", [["dbc"], ["--help"], ["list"], ["--version"]])
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_output_that_cannot_be_written_is_one_line(words: list[str], unbuffered: str) -> None:
    """Where the environment has no PYTHONUNBUFFERED, Python wrote once more at its end: three lines."""
    with Path("/dev/full").open("w") as full:
        told = subprocess.run(
            [sys.executable, "-m", "headland", *words], stdout=full, stderr=subprocess.PIPE, text=True,
            check=False, cwd=ROOT, env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        )  # fmt: skip
    assert told.returncode == 75 and told.stderr.count("\n") == 1
    assert "No space left on device" in told.stderr and "None" not in told.stderr


INTERRUPTED_AT_THE_END = """
import signal, sys, threading
signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background ignore it
threading._register_atexit(lambda: signal.raise_signal(signal.SIGINT))
sys.argv = ["headland", "--version"]
from headland.__main__ import main
main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="a signal is no exit code there")
def test_ctrl_c_after_the_result_says_nothing() -> None:
    told = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_AT_THE_END], capture_output=True, text=True, check=False,
        cwd=ROOT,
    )  # fmt: skip
    assert (told.returncode, told.stderr) == (-signal.SIGINT, "")


@pytest.mark.skipif(os.name == "nt", reason="a shell of POSIX closes streams so")
@pytest.mark.parametrize("closed", ["2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_a_closed_stream_is_no_second_error(closed: str) -> None:
    """With a closed standard error each command that loads the simulator failed with an AttributeError:
    exit code 1, and 2 with it open."""
    told = subprocess.run(
        ["/bin/sh", "-c", f'"$0" -m headland check nowhere.toml {closed}', sys.executable],
        check=False, cwd=ROOT,
    )  # fmt: skip
    assert told.returncode == 2
