"""Checks of the code itself: who may import whom, what the core may not touch, and names.

The rules are those of ARCHITECTURE.md, "Rules"; this file is what makes them true.
"""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAYERS = [
    "crdt",
    "protocol",
    "agent",
    "sim",
    "tools",
]  # each imports only those before it, and itself
CORE = LAYERS[:3]
EDGES = {"agent/runtime/peer_runner.py", "agent/runtime/engine.py", "agent/runtime/sqlite_journal.py", "protocol/links/bus.py",
         "protocol/links/zenoh_link.py", "protocol/links/socketcand_link.py"}  # fmt: skip
OUTSIDE = {
    "asyncio", "can", "multiprocessing", "os", "random", "secrets", "selectors", "socket",
    "sqlite3", "subprocess", "threading", "time", "uuid",
}  # fmt: skip
ALLOWED = {("random", "Random")}  # a seeded generator handed in is welcome
BANNED_NAMES = {"utils", "helpers", "manager", "base", "misc", "common"}

FILES = sorted(path for layer in LAYERS for path in (ROOT / layer).rglob("*.py"))


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def imports(tree: ast.AST) -> set[tuple[str, str]]:
    plain = {
        (n.name, "") for node in ast.walk(tree) if isinstance(node, ast.Import) for n in node.names
    }
    return plain | {
        (node.module or "", name.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_imports_go_one_way(path: Path) -> None:
    layer = path.relative_to(ROOT).parts[0]
    for module, name in imports(ast.parse(path.read_text())):
        top = module.split(".")[0]
        if top in LAYERS:
            assert LAYERS.index(top) <= LAYERS.index(layer), f"{layer} may not import {top}"
        if layer in CORE and name_of(path) not in EDGES and (module, name) not in ALLOWED:
            assert top not in OUTSIDE, f"the core takes {top} as an input, it does not import it"


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_a_file_is_named_by_its_noun(path: Path) -> None:
    assert path.stem not in BANNED_NAMES
    assert (
        path.stem == "__init__"
        or path.stem not in sys.stdlib_module_names
        or path.parent != ROOT / "tools"
    ), "a tool named like a standard module shadows it when run as a script"


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


def test_no_test_sleeps() -> None:
    """Time passes on the virtual clock (`sim.fleet.virtual_clock.elapse`), or something is waited for."""
    here = Path(__file__)
    for path in sorted(here.parent.rglob("*.py")):
        assert path == here or "sleep(" not in path.read_text(encoding="utf-8"), path
