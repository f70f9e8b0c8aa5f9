"""Bus tools, runs and launches on systems without POSIX: what Linux alone has is hidden, and they work.

Hidden are `fcntl`, `resource`, `pwd` and `termios`, the numbers of users, `fork`, niceness, `eventfd`,
the signals that Windows lacks, and the signal handlers and readers of the event loop.
"""

import ast
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.tools.launching import ENVIRONMENT, ROOT
from tools.build.wheel_backend import ONLY_IN_A_CHECKOUT

HIDE = """
import asyncio, os, signal, socket, sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name in ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "_posixsubprocess"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Absent())
for name in ("getuid", "geteuid", "fork", "eventfd", "getpgid", "killpg", "sched_getaffinity",
             "sysconf", "getloadavg", "nice"):
    if hasattr(os, name):
        delattr(os, name)
killed = signal.SIGKILL
for name in ("SIGKILL", "SIGHUP", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGWINCH", "SIGPIPE"):
    if hasattr(signal, name):
        delattr(signal, name)
for name in ("SO_PEERCRED", "SO_REUSEPORT"):
    if hasattr(socket, name):
        delattr(socket, name)

def none(*_):
    raise NotImplementedError

import asyncio.unix_events
asyncio.unix_events._UnixSelectorEventLoop.add_signal_handler = none
asyncio.unix_events._UnixSelectorEventLoop.add_reader = none

import subprocess
begin = subprocess.Popen.__init__

def begin_as_on_windows(self, *words, **named):
    if named.get("preexec_fn") is not None:
        raise ValueError("preexec_fn is not supported on Windows platforms")
    begin(self, *words, **named)

subprocess.Popen.__init__ = begin_as_on_windows

def end_as_on_windows(self):  # TerminateProcess: nothing of the process runs after it
    self.send_signal(killed)

subprocess.Popen.terminate = subprocess.Popen.kill = end_as_on_windows
"""


def environment(folder: Path) -> dict[str, str]:
    (folder / "sitecustomize.py").write_text(HIDE)
    return {**ENVIRONMENT, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}


def headland(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "headland", *words], cwd=folder, capture_output=True, text=True,
        env=environment(folder), stdin=subprocess.DEVNULL, check=False, timeout=240,
    )  # fmt: skip


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("list", 0), ("check small", 0), ("dbc out.dbc", 0), ("keys new keys", 0), ("new mine.toml", 0),
        ("inspect can.log", 0), ("fuzz --help", 0),
        ("stop", 2), ("release", 2), ("say stop", 2), ("map", 2),
    ],
)  # fmt: skip
def test_a_command_does_not_need_posix(words: str, code: int, tmp_path: Path) -> None:
    (tmp_path / "can.log").write_text("(0.000000) can0 18EAFFFE#00EE00\n")
    done = headland(tmp_path, *words.split())
    assert "Traceback" not in done.stderr and done.returncode == code, done.stderr


def test_a_bus_is_served_heard_and_ended_without_posix(tmp_path: Path) -> None:
    hub = subprocess.Popen(
        [sys.executable, "-m", "headland", "hub", "--json", "--port", "0"], cwd=tmp_path,
        stdout=subprocess.PIPE, text=True, env=environment(tmp_path),
    )  # fmt: skip
    try:
        assert hub.stdout is not None
        port = json.loads(hub.stdout.readline())["port"]
        heard = headland(tmp_path, "inspect", "--port", str(port), "--seconds", "0.5", "--json")
        assert heard.returncode == 0, heard.stderr
        assert json.loads(heard.stdout)["robots"] == []
        said = headland(tmp_path, "stop", "--port", str(port), "--keys", str(keys(tmp_path)))
        assert "Traceback" not in said.stderr, said.stderr
    finally:
        hub.send_signal(signal.SIGINT)
        assert hub.wait(timeout=30) == 130, "as a shell says of Ctrl-C"


def keys(folder: Path) -> Path:
    assert headland(folder, "keys", "new", "fleet").returncode == 0
    return folder / "fleet"


@pytest.mark.slow
def test_a_run_does_not_need_posix(tmp_path: Path) -> None:
    done = headland(tmp_path, "run", "yard", "--robots", "2", "--json")
    assert "Traceback" not in done.stderr and done.returncode in (0, 1), done.stderr
    assert json.loads(done.stdout)["coverage"] > 0.9


@pytest.mark.slow
def test_a_launch_does_not_need_posix(tmp_path: Path) -> None:
    """Its robots asked the loop for handlers of signals and a reader of a pipe, its map for niceness."""
    words = ("launch", "yard", "--robots", "2", "--seconds", "12", "--out", "fleet", "--map")
    done = headland(tmp_path, *words, "--page-port", "0")
    assert "Traceback" not in done.stderr and done.returncode == 1, (done.stdout, done.stderr)
    assert "has ended" not in done.stdout, done.stdout
    for slot in range(2):
        log = (tmp_path / "fleet" / f"robot{slot}.log").read_text()
        assert "is up" in log and "Error" not in log, log
    seen = json.loads(headland(tmp_path, "inspect", "fleet", "--json").stdout)
    assert [robot["left"] for robot in seen["robots"]] == [True, True], "each has said farewell"


def test_a_module_of_the_wheel_imports_nothing_of_posix_at_its_top() -> None:
    """`headland fuzz` imported `resource` there, and could not even say its help on Windows."""
    posix = {"fcntl", "resource", "pwd", "grp", "termios", "tty", "pty"}
    for layer in ("crdt", "protocol", "agent", "sim", "tools", "headland"):
        for path in (ROOT / layer).rglob("*.py"):
            name = str(path.relative_to(ROOT))
            if name.startswith(ONLY_IN_A_CHECKOUT):
                continue
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                found = {
                    each.name for each in getattr(node, "names", ()) if isinstance(node, ast.Import)
                }
                found |= {node.module} if isinstance(node, ast.ImportFrom) else set()
                assert not found & posix, name
