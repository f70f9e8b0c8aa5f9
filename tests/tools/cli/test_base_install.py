"""What is told where a package, a process or privacy is missing: one line (items 15 and G)."""

import json
import os
import subprocess
import sys
from collections.abc import Set as AbstractSet
from pathlib import Path

import pytest

from tests.tools.launching import ENVIRONMENT, ROOT
from tools.common import bus_address
from tools.common.bus_address import AttachError, address_of_launch
from tools.common.extras import EXTRA_OF
from tools.common.loopback_host import is_loopback
from tools.common.process_identity import identity, lives

BLOCK = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {names}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, package=None: (
    None if name.split(".")[0] in {names} else found(name, package))
"""


BUS_ONLY = set(EXTRA_OF)
WITH_SIM = {package for package, extra in EXTRA_OF.items() if extra not in ("sim", "frames")}


def headland(
    folder: Path, *words: str, absent: AbstractSet[str] = BUS_ONLY
) -> subprocess.CompletedProcess[str]:
    """In a process in which these packages cannot be imported; without a word: all of extras."""
    (folder / "sitecustomize.py").write_text(BLOCK.format(names=set(absent)))
    path = f"{folder}{os.pathsep}{ROOT}"
    return subprocess.run(
        [sys.executable, "-m", "tools.cli.headland", *words], cwd=folder, capture_output=True, text=True,
        env={**ENVIRONMENT, "PYTHONPATH": path}, stdin=subprocess.DEVNULL, check=False, timeout=120,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("words", "extra"),
    [
        ("inspect can.log --why S1", ""),
        ("dbc", ""),
        ("keys new", ""),
        ("doctor", ""),
        ("list", "sim"),
        ("run small", "sim"),
        ("launch small --robots 2", "sim"),
        ("plan small", "sim"),
        ("report can.log", "operator"),  # there is a run.mcap beside
        ("task add 1,1 2,2", "sim"),
        ("inspect run.mcap --plain", "operator"),
        ("inspect can.log --picture out.svg", "operator"),
        ("map run.mcap --page-port 0", "operator"),
        ("estop", ""),
        ("reset", ""),
        ("order 1 wait", ""),
        ("say stop", ""),
        ("map", ""),
        ("inspect can.log", ""),
    ],
)
def test_the_tools_of_the_bus_need_no_simulator(words: str, extra: str, tmp_path: Path) -> None:
    files(tmp_path)
    told(headland(tmp_path, *words.split()), extra)


@pytest.mark.parametrize(
    ("words", "extra"),
    [
        ("bridge --segment 1 --listen tcp/127.0.0.1:0", "backbone"),
        ("inspect can.log --picture out.svg", "operator"),
        ("launch small --metrics 0", "metrics"),
        ("launch small --foxglove 0", "foxglove"),
        ("inspect run.mcap --plain", "operator"),
        ("run task --robots 2", "isoxml"),
        ("export run --bag out", "ros"),
        ("chaos --help", ""),
        ("task add 1,1 2,2", ""),
    ],
)
def test_base_install_names_the_extra_in_one_line(words: str, extra: str, tmp_path: Path) -> None:
    files(tmp_path)
    told(headland(tmp_path, *words.split(), absent=WITH_SIM), extra)


def files(folder: Path) -> None:
    (folder / "can.log").write_text("(0.000000) can0 18EAFFFE#00EE00\n")
    (folder / "run.mcap").write_bytes(b"\x89MCAP0\r\n")
    (folder / "task").mkdir()
    (folder / "task" / "TASKDATA.XML").write_text("<ISO11783_TaskData/>")


def told(done: subprocess.CompletedProcess[str], extra: str) -> None:
    assert "Traceback" not in done.stderr, done.stderr
    if extra:
        assert done.returncode == 2 and f"headland[{extra}]" in done.stderr, done.stderr
        assert done.stderr.count("\n") == 1, done.stderr
    else:
        assert "pip install" not in done.stderr, done.stderr


def test_viewers_of_a_bus_need_no_more_than_their_extra(tmp_path: Path) -> None:
    """Found: the extra `foxglove` lacked pyproj, which only a field on earth needs."""
    pytest.importorskip("foxglove", reason="the extra `foxglove` is not installed")
    (tmp_path / "sitecustomize.py").write_text(
        BLOCK.format(names=set(EXTRA_OF) - {"foxglove", "numpy"})
    )
    done = subprocess.run(
        [sys.executable, "-c", "import tools.livemap.foxglove_live"], capture_output=True, text=True,
        env={**ENVIRONMENT, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_g_a_launch_that_was_killed_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody else may have its port by now, and would say that all have stopped."""
    monkeypatch.setattr(bus_address, "LAUNCH", tmp_path / "bus.json")
    where = {"host": "127.0.0.1", "port": 5, "channel": "can0"}
    (tmp_path / "bus.json").write_text(json.dumps({**where, **identity()}))
    assert address_of_launch() == ("127.0.0.1", 5, "can0")
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    for gone in ({"pid": dead.pid}, {"pid": os.getpid(), "started": "1"}):
        if "started" in gone and not Path("/proc/self/stat").exists():
            continue
        (tmp_path / "bus.json").write_text(json.dumps({**where, **gone}))
        with pytest.raises(AttachError, match=r"was killed.*--port 5"):
            address_of_launch()
    assert lives(os.getpid(), "") and lives(1, "")


def test_g_a_hub_that_the_network_reaches_warns() -> None:
    assert [is_loopback(h) for h in ("127.0.0.1", "127.9.9.9", "::1", "localhost")] == [True] * 4
    assert [is_loopback(h) for h in ("0.0.0.0", "192.168.1.2", "::", "farm.example")] == [False] * 4


def test_a_list_of_scenarios_loads_no_simulator(tmp_path: Path) -> None:
    """It took 1.4 s of CPU, nearly all of it for packages that only runs need."""
    absent = {"numba", "scipy", "shapely", "pyproj", "pymunk", "matplotlib", "pandas"}
    for words in (["list"], ["new", "mine.toml"]):
        told = headland(tmp_path, *words, absent=absent)
        assert told.returncode == 0, told.stderr


def test_a_log_is_reported_without_a_simulator(tmp_path: Path) -> None:
    """Its charts need no matplotlib; only planned ways, which are beside a log, need numpy."""
    files(tmp_path)
    (tmp_path / "run.mcap").unlink()
    told = headland(tmp_path, "report", "can.log")
    assert told.returncode == 0, told.stderr
    assert "<svg " in (tmp_path / "can.html").read_text()
