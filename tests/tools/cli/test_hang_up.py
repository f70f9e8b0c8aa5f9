"""A terminal that is closed ends a command as the system's request does."""

import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.tools.launching import ENVIRONMENT
from tools.cli.one_line_errors import hung_up_as_terminated

LIMIT_S = 60
FILE = 'name = "try"\n[fleet]\nrobots = 1\n[bus]\ninterface = "virtual"\nchannel = "try"\n'
ROBOT = ("robot", "fleet.toml", "--slot", "0", "--first-boot")


def heed() -> None:
    """The tests may run under `nohup`."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def begin(folder: Path, *words: str) -> "subprocess.Popen[str]":
    (folder / "fleet.toml").write_text(FILE)
    return subprocess.Popen(
        [sys.executable, "-m", "headland", *words], cwd=folder, env=ENVIRONMENT, preexec_fn=heed,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


@pytest.mark.parametrize("words", [ROBOT, ("hub", "--port", "0", "--json")], ids=["robot", "hub"])
def test_a_hang_up_ends_a_command_as_sigterm_does(words: tuple[str, ...], tmp_path: Path) -> None:
    """It ended by the signal: a robot without a farewell, a launch without its report."""
    codes = []
    for number in (signal.SIGTERM, signal.SIGHUP):
        process = begin(tmp_path, *words)
        assert process.stdout is not None and process.stdout.readline()
        process.send_signal(number)
        _, told = process.communicate(timeout=LIMIT_S)
        assert "Traceback" not in told, told
        codes.append(process.returncode)
    assert codes[0] == codes[1] >= 0, codes


def test_what_is_told_after_the_terminal_is_gone_is_no_error(tmp_path: Path) -> None:
    """The report of a launch is written before its last line, and that line had nowhere to go."""
    master, terminal = pty.openpty()
    told = (
        "import signal\n"
        "from tools.cli.one_line_errors import *\n"
        "with one_line_errors(), terminated_as_interrupted(), hung_up_as_terminated():\n"
        "    try:\n"
        "        print('ready', flush=True)\n"
        "        signal.pause()\n"
        "    except KeyboardInterrupt:\n"
        "        print('a last line', flush=True)\n"
        "        open('ended', 'w').close()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", told], cwd=tmp_path, env=ENVIRONMENT, preexec_fn=heed,
        stdin=terminal, stdout=terminal, stderr=terminal, start_new_session=True,
    )  # fmt: skip
    os.close(terminal)
    assert b"ready" in os.read(master, 100)
    os.close(master)
    process.send_signal(signal.SIGHUP)  # as a shell passes it on
    assert process.wait(LIMIT_S) == 0 and (tmp_path / "ended").exists()


ROBOT_IMPORT = "from tools.cli.one_line_errors import *\nwith one_line_errors(): import shapely"
COMMAND_IMPORT = (
    "import sys, tools.cli.headland as each; sys.argv = ['headland', 'list']\n"
    "each.app.command(name='list')(lambda: __import__('shapely'))\n"
    "each.main()"
)


@pytest.mark.parametrize("code", [ROBOT_IMPORT, COMMAND_IMPORT], ids=["robot", "command"])
def test_an_interrupt_where_shapely_imports_numpy_is_no_traceback(
    code: str, tmp_path: Path
) -> None:
    """Ctrl-C in the first second of a command printed two tracebacks, and its exit code was 1."""
    (tmp_path / "numpy.py").write_text("import os, signal; os.kill(os.getpid(), signal.SIGINT)\n")
    process = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, '.')\n{code}"], cwd=tmp_path,
        env=ENVIRONMENT, capture_output=True, text=True, check=False, timeout=LIMIT_S,
    )  # fmt: skip
    assert (process.returncode, process.stderr) == (130, "")


def test_a_hang_up_that_is_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with hung_up_as_terminated():
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        with hung_up_as_terminated():
            assert callable(signal.getsignal(signal.SIGHUP))
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)
