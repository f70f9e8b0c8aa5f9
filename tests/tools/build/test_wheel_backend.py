"""A wheel installs `headland` and nothing else; works beside strangers of our folders' names."""

import ast
import csv
import json
import os
import subprocess
import sys
import sysconfig
import tomllib
from importlib import import_module
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from zipfile import ZipFile

import pytest

from agent.runtime import robot_body
from tools.build.wheel_backend import LAYERS, LayoutError, packed, renamed
from tools.run.needed_kernels import MOTION, NEEDED, TURNS

ROOT = Path(__file__).parents[3]
SETUPTOOLS_MIN = 77  # reads `license = "Apache-2.0"`


def test_imports_of_layers_are_renamed_and_no_line_moves() -> None:
    before = b"""\
import os, agent.peer.peer as peer
from agent.interface import (
    effects,  # stays
)
from agent import field; from simple import agent
from . import agent
if TYPE_CHECKING: from crdt.stops import StopSet
def f():
    '''from agent.peer import Peer'''
    from  sim.can import simulated_bus
"""
    after = b"""\
import os, headland.agent.peer.peer as peer
from headland.agent.interface import (
    effects,  # stays
)
from headland.agent import field; from simple import agent
from . import agent
if TYPE_CHECKING: from headland.crdt.stops import StopSet
def f():
    '''from agent.peer import Peer'''
    from  headland.sim.can import simulated_bus
"""
    assert renamed(before).decode() == after.decode()


def test_bytes_before_an_import_count_as_bytes() -> None:
    assert renamed("a = 'ä'; import sim.can as c".encode()) == (
        "a = 'ä'; import headland.sim.can as c".encode()
    )


def test_an_import_that_binds_the_name_of_a_layer_is_refused() -> None:
    with pytest.raises(LayoutError, match=r"peer\.py:2: import agent\.peer: use `from`"):
        renamed(b"import os\nimport agent.peer\n", "peer.py")


def test_a_file_outside_of_the_layers_is_refused() -> None:
    with pytest.raises(LayoutError, match="tests/conftest"):
        packed({"tests/conftest.py": b"", "headland-1.dist-info/RECORD": b""})


def test_the_record_has_every_file_and_its_size() -> None:
    files = packed({
        "crdt/stops.py": b"from crdt import stops\n", "agent/py.typed": b"",
        "headland/__init__.py": b"", "headland/checkout.py": b"",
        "headland-1.dist-info/RECORD": b"old", "headland-1.dist-info/top_level.txt": b"agent\n",
    })  # fmt: skip
    rows = list(csv.reader(files["headland-1.dist-info/RECORD"].decode().splitlines()))
    assert {row[0] for row in rows} == set(files)
    assert "headland/checkout.py" not in files
    assert files["headland-1.dist-info/top_level.txt"] == b"headland\n"
    (row,) = [row for row in rows if row[0] == "headland/crdt/stops.py"]
    assert int(row[2]) == len(b"from headland.crdt import stops\n")


def sources() -> list[Path]:
    return sorted(path for layer in LAYERS for path in (ROOT / layer).rglob("*.py"))


def test_every_source_can_be_renamed() -> None:
    """And what comes out has no import of a layer by its name in the tree."""
    for path in sources():
        for node in ast.walk(ast.parse(renamed(path.read_bytes(), str(path)))):
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                assert (node.module or "").split(".")[0] not in LAYERS, path


# Modules that are named in strings, which a wheel does not rename. `called` and `module_command` put
# the package's name before them, and so does `named`.
NAMED = {
    "agent.runtime.robot_body:StandingBody", "sim.record.remote_body:WorldBody", "tools.run.robot",
    "tools.cli.headland", "tools.chaos.fuzz_atheris", "agent.runtime.robot_body",
    "tools.common.child_process", "agent.peer.durable_records", "agent.safety.stop_controller",
    "agent.peer.peer", "agent.peer.membership", "agent.runtime.bodies.nmea_body:NmeaBody",
    "agent.runtime.bodies.replay_body:ReplayBody", "agent.runtime.bodies.ros2_body:Ros2Body",
    "agent.runtime.bodies.vda5050_body:Vda5050Body", "agent.runtime.bodies.isobus_body:IsobusBody",
    "tools.bench.vda5050.figures", "tools.bench.mapf", "tools.bench.systems",
    "tools.bench.vda5050.many_robots", "tools.bench.ros2_door", "tools.bench.foxglove_door",
    "tools.bench.prometheus_door", "tools.build.warmup", "tools.build.kernel_module",
    "tools.bench.bag_door", "tools.bench.ros2_field", "tools.cli.entrance",
    "tools.run.robot_viewers", "tools.bench.watched_launch",
    *MOTION, *TURNS, *chain.from_iterable(NEEDED.values()),
}  # fmt: skip


def test_no_other_module_is_named_in_a_string() -> None:
    modules = {".".join(path.relative_to(ROOT).with_suffix("").parts) for path in sources()}
    found = {
        node.value
        for path in sources()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        if node.value.split(":")[0] in modules
    }
    assert found == NAMED


# Imports of what a wheel leaves out. Each is guarded, and says so or does without.
GUARDED = {
    ("tools/cli/test_commands.py", "tools.bench.command"),
    ("tools/build/warmup.py", "tools.bench.kernels.agent_table"),
    ("tools/build/warmup.py", "tools.bench.kernels.occupancy_fleet"),
    ("tools/build/warmup.py", "tools.bench.kernels.orca_fleet"),
}


def test_a_wheel_imports_nothing_that_it_leaves_out() -> None:
    files = {str(path.relative_to(ROOT)): path.read_bytes() for path in sources()}
    kept = packed({**files, "headland-1.dist-info/RECORD": b""})
    left = {path for path in files if f"headland/{path}" not in kept}
    assert "tools/bench/people.py" in left and "tools/build/warmup.py" not in left
    gone = {
        path.removesuffix("/__init__.py").removesuffix(".py").replace("/", ".") for path in left
    }
    found = {
        (path, name)
        for path in set(files) - left
        for node in ast.walk(ast.parse(files[path]))
        if isinstance(node, ast.ImportFrom)
        for name in (node.module or "", *(f"{node.module}.{each.name}" for each in node.names))
        if name in gone
    }
    assert found == GUARDED


def test_in_a_checkout_a_module_has_two_names_and_is_one() -> None:
    assert import_module("headland.agent.runtime.robot_body") is robot_body
    assert robot_body.__spec__ is not None and robot_body.__spec__.name == robot_body.__name__
    source = Path(robot_body.__file__ or "").read_text(encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "headland.agent.runtime.robot_process", "--help"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "headland.agent.runtime.robot_process" in done.stdout and "class RobotBody" in source


STRANGER = "raise SystemExit(f'a stranger was imported: {__name__}')\n"
IN_PYTHON = """
import pickle, can, headland
from headland.agent.runtime.robot_body import StandingBody, called
from headland.crdt.stops import StopSet
body = called("agent.runtime.robot_body:StandingBody", 3, x_m=1.5)
assert type(body) is StandingBody and type(body).__module__.startswith("headland.agent.")
assert type(called("my_tractor:Tractor", 1)).__module__ == "my_tractor"
assert pickle.loads(pickle.dumps(StopSet)) is StopSet
bus = can.Bus(interface="fieldbus", channel="here")
assert type(bus).__module__ == "headland.sim.can.simulated_bus"
bus.shutdown()
print("good")
"""


@pytest.mark.slow
def test_a_wheel_works_beside_strangers(tmp_path: Path) -> None:
    """In an environment and a folder that have packages called agent, tools, sim, protocol and crdt."""
    if int(version("setuptools").split(".")[0]) < SETUPTOOLS_MIN:
        pytest.skip(f"setuptools {SETUPTOOLS_MIN} is needed to build without an index")
    wheel = build(tmp_path)
    with ZipFile(wheel) as opened:
        assert {name.split("/")[0] for name in opened.namelist()} == {"headland", dist_info()}
    site = install(wheel, tmp_path / "env")
    assert {path.name for path in site.iterdir()} == {"headland", dist_info(), "borrowed.pth"}

    folder = tmp_path / "work"
    for place in (site, folder):  # as of other distributions, and a person's own
        for layer in LAYERS:
            (place / layer).mkdir(parents=True)
            (place / layer / "__init__.py").write_text(STRANGER)
    (folder / "my_tractor.py").write_text(
        "from headland.agent.runtime.robot_body import StandingBody\n"
        "class Tractor(StandingBody):\n    pass\n"
    )
    command = str(tmp_path / "env" / "bin" / "headland")
    python = str(tmp_path / "env" / "bin" / "python")
    assert run([command, "--version"], folder).startswith(f"headland {own_version()}")
    assert "oxted" in run([command, "list"], folder)
    said = run([command, "bench", "wire"], folder, 2, errors=True)
    assert said == "headland: the benches are in a checkout (git clone), not in a wheel\n"
    assert run([python, "-m", "headland", "--version"], folder).startswith("headland")
    assert run([python, "-c", IN_PYTHON], folder) == "good\n"
    assert "robot_process" in run(
        [python, "-m", "headland.agent.runtime.robot_process", "-h"], folder
    )
    report = json.loads(run([command, "run", "small", "--robots", "2", "--json"], folder))
    assert report["coverage"] == 1.0
    assert list((site / "headland").rglob("*.nbi")), "compiled kernels are kept"
    # Two processes that get scenarios and give verdicts, and three that talk over a bus.
    run([command, "chaos", "--seeds", "0:2", "--profile", "protocol", "--jobs", "2"], folder)
    said = run(
        [command, "launch", "small", "--robots", "2", "--seconds", "3", "--out", "launch"],
        folder,
        1,
    )
    assert "robot 1: process" in said
    log = (folder / "launch" / "robot1.log").read_text()
    assert "stranger" not in log and "Error" not in log, log


def build(folder: Path) -> Path:
    """The wheel, made by pip as a person would make it, with the setuptools that is here."""
    words = ["wheel", str(ROOT), "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder)]
    run([sys.executable, "-m", "pip", *words], folder)
    (wheel,) = folder.glob("*.whl")
    return wheel


def install(wheel: Path, folder: Path) -> Path:
    """The `site-packages` of a new environment with this wheel. Other packages are borrowed from
    this one: the .pth files of a folder that a .pth file names are ignored, so the checkout is not
    found through them."""
    run([sys.executable, "-m", "venv", "--without-pip", str(folder)], wheel.parent)
    paths = {"base": str(folder), "platbase": str(folder)}
    site = Path(sysconfig.get_path("purelib", "venv", vars=paths))
    borrowed = sysconfig.get_path("purelib")
    (site / "borrowed.pth").write_text(f"{borrowed}\n")
    words = ["--python", str(folder), "install", "--no-deps", str(wheel)]
    run([sys.executable, "-m", "pip", *words], wheel.parent)
    return site


def run(words: list[str], folder: Path, code: int = 0, *, errors: bool = False) -> str:
    own = {
        key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "NUMBA"))
    }
    done = subprocess.run(
        words, cwd=folder, env=own, capture_output=True, text=True, check=False, timeout=400
    )
    assert done.returncode == code, f"{words}: {done.stdout}\n{done.stderr}"
    return done.stderr if errors else done.stdout


def own_version() -> str:
    with (ROOT / "pyproject.toml").open("rb") as file:
        return str(tomllib.load(file)["project"]["version"])


def dist_info() -> str:
    return f"headland-{own_version()}.dist-info"
