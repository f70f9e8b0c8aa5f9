"""Checks of the code itself: who may import whom, what the core may not touch, and names.

The rules are those of ARCHITECTURE.md, "Rules"; this file is what makes them true.
"""

import ast
import importlib
import subprocess
import sys
from collections.abc import Iterator, Mapping
from fnmatch import fnmatch
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAYERS = [
    "crdt",
    "protocol",
    "agent",
    "sim",
    "tools",
    "headland",
]  # each imports those before it, and itself
CORE = LAYERS[:3]
ALLOWED: dict[str, str] = {
    "protocol": "frames",  # its own modules, which stand for themselves
    "protocol.frames": "",
    "protocol.links": "frames",
    "protocol.sync": "frames",
    "agent.interface": "",
    "agent.kernels": "",
    "agent.safety": "interface",
    "agent.paths": "interface kernels",
    "agent.avoidance": "interface kernels",
    "agent.mapf": "interface kernels",
    "agent.motion": "interface kernels avoidance paths",
    "agent.implements": "interface",
    "agent.claims": "interface",
    "agent.mapping": "interface kernels paths mapf motion",
    "agent.peer": "interface safety",
    "agent.field": "interface kernels claims paths mapf motion",
    "agent.navigation": "interface paths mapf motion mapping",
    "agent.exploration": "interface kernels claims paths mapf motion mapping",
    "agent.delivery": "interface kernels claims paths mapf motion mapping navigation",
    "agent.coverage": "interface kernels mapf",
    "agent.pathfinding": "interface mapf coverage",
    "agent.segments": "interface safety peer",
    "agent.runtime.files": "interface",
    "agent.runtime.vda5050": "interface delivery",
    "agent.runtime": "interface kernels safety peer segments runtime.files paths mapf motion mapping "
    "field navigation exploration delivery coverage pathfinding",
    "agent.runtime.bodies": "interface motion delivery peer runtime runtime.files runtime.vda5050",
    "sim.files": "",
    "sim.machines": "",
    "sim.can": "files",
    "sim.world": "files",
    "sim.scenarios": "files world",
    "sim.fleet": "files can world scenarios",
    "sim.record": "files can world scenarios fleet",
    "sim.runs": "files can world scenarios fleet record",
    "sim.chaos": "files can world scenarios fleet record runs",
    "sim.rigs": "files can world scenarios fleet record runs chaos",
    "tools.common": "",
    "tools.operate": "common",
    "tools.inspect": "common operate",
    "tools.language": "common operate inspect",
    "tools.build": "common bench.kernels",
    "tools.livemap": "common operate inspect",
    "tools.report": "common inspect livemap",
    "tools.run": "common operate inspect language build livemap report",
    "tools.vda5050": "common operate inspect",
    "tools.ros2": "common operate inspect livemap",
    "tools.chaos": "common",
    "tools.bench.kernels": "",
    "tools.bench.vda5050": "bench common operate run",
    "tools.bench": "bench.kernels bench.vda5050 common operate inspect language build livemap report "
    "run chaos",
    "tools.cli": "common operate inspect language build livemap report run vda5050 ros2 chaos bench",
}  # fmt: skip
# The only modules of the core that may use clocks, sockets, threads and files.
EDGES = ("agent/runtime/", "protocol/links/")
RIGS = ("sim/rigs/", "tools/bench/", "tests/")  # only these may import the rigs
OUTSIDE = {
    "asyncio", "can", "multiprocessing", "os", "random", "secrets", "selectors", "socket",
    "sqlite3", "subprocess", "threading", "time", "uuid",
}  # fmt: skip
WELCOME = {("random", "Random")}  # a seeded generator handed in
BANNED_NAMES = {"utils", "helpers", "manager", "base", "misc", "common"}

FILES = sorted(path for layer in LAYERS for path in (ROOT / layer).rglob("*.py"))


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def module_of(path: Path) -> str:
    return name_of(path).removesuffix(".py").removesuffix("/__init__").replace("/", ".")


MODULES = {module_of(path): path for path in FILES}


@cache
def imports(path: Path) -> set[tuple[str, str]]:
    """Everywhere in the file: also in functions, and what only types need."""
    tree = ast.parse(path.read_text())
    plain = {
        (n.name, "") for node in ast.walk(tree) if isinstance(node, ast.Import) for n in node.names
    }
    return plain | {
        (node.module or "", name.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }


def own_imports(path: Path) -> Iterator[str]:
    """The modules of ours that a file imports."""
    for module, name in imports(path):
        whole = f"{module}.{name}"
        if whole in MODULES:
            yield whole
        elif module in MODULES:
            yield module


def package_of(module: str) -> str:
    """The row of `ALLOWED` that a module is under; a module of a layer's own folder is its layer's."""
    parts = module.split(".")
    inside = [".".join(parts[:n]) for n in range(len(parts), 0, -1)]
    return next(
        (each for each in inside if each in ALLOWED or MODULES[each].name == "__init__.py"),
        parts[0],
    )


def test_imports_go_one_way() -> None:
    broken = [
        f"{name_of(path)}: {reason}"
        for path in FILES
        for module, name in imports(path)
        if (reason := against_layers(path, module, name))
    ]
    assert broken == []


def against_layers(path: Path, module: str, name: str) -> str:
    """Why a file may not import this; empty: it may."""
    layer = path.relative_to(ROOT).parts[0]
    top = module.split(".")[0]
    if top in LAYERS and LAYERS.index(top) > LAYERS.index(layer):
        return f"{layer} may not import {top}"
    in_core = layer in CORE and not name_of(path).startswith(EDGES)
    if in_core and top in OUTSIDE and (module, name) not in WELCOME:
        return f"the core takes {top} as an input, it does not import it"
    return ""


def test_packages_import_what_the_table_allows() -> None:
    broken = [
        f"{name_of(path)}: {reason}"
        for path in FILES
        for module in own_imports(path)
        if (reason := against_table(path, module))
    ]
    assert broken == []


def against_table(path: Path, module: str) -> str:
    """Why a file may not import this module of ours; empty: it may."""
    own, other = package_of(module_of(path)), package_of(module)
    layer = own.split(".")[0]
    if module.startswith("sim.rigs") and not name_of(path).startswith(RIGS):
        return "rigs are for benches and tests"
    allowed = {own, layer} | {f"{layer}.{each}" for each in ALLOWED.get(own, "").split()}
    if other.split(".")[0] == layer and other not in allowed:
        return f"{own} may not import {other} ({module})"
    return ""


def test_the_checks_of_imports_find_what_is_forbidden() -> None:
    core, motion = ROOT / "agent/peer/peer.py", ROOT / "agent/motion/path_tracker.py"
    assert "sim" in against_layers(core, "sim.world.world", "World")
    assert "time" in against_layers(core, "time", "")
    assert against_layers(core, "agent.interface.config", "S") == ""
    assert against_layers(core, "random", "Random") == ""
    assert "agent.peer" in against_table(motion, "agent.peer.peer")
    assert against_table(motion, "agent.interface.config") == ""
    assert "rigs" in against_table(ROOT / "sim/runs/run.py", "sim.rigs.bridged_processes")


def test_every_package_is_in_the_table() -> None:
    packages = {module for module, path in MODULES.items() if path.name == "__init__.py"}
    assert packages - {"crdt", "agent", "sim", "tools", "headland"} == set(ALLOWED)


def cycle(graph: Mapping[str, set[str]]) -> list[str]:
    """Modules that import each other in a circle, the first also last; empty: none do."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as found:
        return list(found.args[1])
    return []


def test_no_import_cycle() -> None:
    assert (
        cycle({module: set(own_imports(path)) - {module} for module, path in MODULES.items()}) == []
    )


def test_the_check_of_cycles_finds_one() -> None:
    assert set(cycle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}})) == {"a", "b", "c"}
    assert cycle({"a": {"b"}, "b": {"c"}, "d": {"a"}}) == []


def test_one_place_makes_peers() -> None:
    """A second builder would be a peer that differs from those of robots."""
    makers = {"Peer", "PeerParts"}
    for path in [*FILES, *sorted((ROOT / "tests").rglob("*.py"))]:
        calls = (
            node.func
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Call)
        )
        made = {func.id for func in calls if isinstance(func, ast.Name)} & makers
        assert not made or name_of(path) == "agent/runtime/peer_factory.py", path


def test_a_file_is_named_by_its_noun() -> None:
    assert [name_of(path) for path in FILES if path.stem in BANNED_NAMES] == []
    # A tool named like a standard module shadows it when run as a script.
    tools = [path for path in FILES if path.parent == ROOT / "tools" and path.stem != "__init__"]
    assert [name_of(path) for path in tools if path.stem in sys.stdlib_module_names] == []


@pytest.mark.parametrize(
    "path", [path for path in FILES if path.name == "__init__.py"], ids=name_of
)
def test_a_package_says_what_is_in_it(path: Path) -> None:
    """A few lines, and every module that it names is there."""
    words = ast.get_docstring(ast.parse(path.read_text())) or ""
    assert words and len(words.splitlines()) <= 9
    there = {file.stem for file in path.parent.glob("*.py")} | {
        folder.name for folder in path.parent.iterdir() if folder.is_dir()
    }
    for word in words.split("`")[1::2]:
        if word.replace("_", "").islower() and word.isidentifier():
            assert word in there, f"{word} is not in {name_of(path)}"


def test_what_a_package_exports_is_there() -> None:
    """Names in `__all__`, so that `from package import *` and the printed interface do not fail."""
    exporting = 0
    for module, path in MODULES.items():
        if path.name == "__init__.py" and module.split(".")[0] in CORE:
            package = importlib.import_module(module)
            names = getattr(package, "__all__", [])
            exporting += bool(names)
            assert len(set(names)) == len(names)
            assert all(hasattr(package, name) for name in names), module
    assert exporting


# What a program of one's own imports first, and what that may not bring along.
LIGHT = {
    "agent, protocol, crdt": "numba scipy shapely pydantic can",
    "agent.interface.mission, agent.interface.ports": "numba scipy shapely pydantic can",
    "agent.runtime.engine": "numba scipy shapely pydantic",
    "agent.runtime.robot_process": "pymunk sim tools",
}


@pytest.mark.parametrize("modules", LIGHT)
def test_an_import_brings_no_weight_along(modules: str) -> None:
    program = f"import sys, {modules}; print(*{{name.split('.')[0] for name in sys.modules}})"
    done = subprocess.run(
        [sys.executable, "-P", "-c", program], capture_output=True, text=True, check=True
    )
    assert not set(done.stdout.split()) & set(LIGHT[modules].split())


@pytest.mark.parametrize("layer", LAYERS)
def test_no_intruder(layer: str) -> None:
    """Our package names are plain words: a distribution with the same name must not be what we import."""
    module = importlib.import_module(layer)
    assert module.__file__ is not None
    assert Path(module.__file__).resolve().is_relative_to(ROOT)


def test_no_unseeded_chance_anywhere() -> None:
    """`random.random()` and friends draw from a global generator: no run could be replayed."""
    pattern = r"\brandom\.(random|randint|choice|shuffle|uniform|seed)\("
    found = subprocess.run(
        ["git", "grep", "-nE", pattern, "--", *LAYERS],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert found.stdout == ""


def test_points_and_cells_are_defined_once() -> None:
    """The same pair of floats was (x, y) in one module and (row, column) in another, by one name."""
    defined: dict[str, list[str]] = {"Point": [], "Cell": [], "GridPoint": [], "XY": []}
    for path in FILES:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                defined.get(node.targets[0].id, []).append(name_of(path))
    once = ["agent/interface/geometry.py"]
    assert defined == {"Point": once, "Cell": once, "GridPoint": once, "XY": []}


IGNORES_MAX = 20
# Of mypy, about numba's decorator and what a kernel takes and returns.
OF_KERNELS = ("untyped-decorator", "no-untyped-def")


def test_types_are_ignored_seldom() -> None:
    """Benches are not in the product. A type that cannot be said is a reason to write it otherwise."""
    found = [
        f"{name_of(path)}:{number}"
        for path in FILES
        if not name_of(path).startswith("tools/bench/")
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if "# type: ignore" in line and not any(kind in line for kind in OF_KERNELS)
    ]
    assert len(found) <= IGNORES_MAX, found


def test_no_test_sleeps() -> None:
    """Time passes on the virtual clock (`sim.fleet.virtual_clock.elapse`), or something is waited for."""
    here = Path(__file__)
    for path in sorted(here.parent.rglob("*.py")):
        assert path == here or "sleep(" not in path.read_text(encoding="utf-8"), path


def test_pytest_looks_into_every_folder_of_tests(pytestconfig: pytest.Config) -> None:
    """Its own list of folders to leave out has "build", so that tests/tools/build never ran."""
    left_out = pytestconfig.getini("norecursedirs")
    folders = {path.parent for path in (ROOT / "tests").rglob("test_*.py")}
    names = {part for folder in folders for part in folder.relative_to(ROOT).parts}
    assert not {name for name in names for pattern in left_out if fnmatch(name, pattern)}
