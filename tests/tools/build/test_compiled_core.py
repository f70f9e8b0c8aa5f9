"""Simulated from machine code, a run is the same to the last effect; what is stale is never used."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from tools.build import compile as compiling
from tools.build import compiled_core
from tools.build.compile import ToolMissingError, build
from tools.build.compiled_core import Finder, place
from tools.common.fingerprint import ROOT

RUNS = [("protocol", 3), ("all", 1), ("stop", 2), ("crash", 5), ("tractors", 1)]
FEW = RUNS[:2]  # of a small core: these go through all of its modules
SMALL = {  # a minute to compile
    "crdt": "digest progress clock",
    "protocol": "frames.codec",
    "agent": "runtime.peer_runner",
    "sim": "fleet.batched_runner fleet.event_loop",
}
PLAY = """
import json, sys
from pathlib import Path
from tools.build.compiled_core import use
used = use(Path(sys.argv[1])) if len(sys.argv) > 1 else False
from sim.chaos.fault_profiles import draw
from sim.chaos.verdict import judge
from sim.scenarios.scenario import load
def played(profile, seed):
    if profile != "tractors":  # no profile draws them
        return judge(draw(seed, profile))
    verdict = judge(load("yard").changed(2, seed, drive="ackermann", time_limit_s=40.0))
    assert not [each for each in verdict.broken if each.rule == "S15"], verdict.broken
    return verdict
hashes = [played(profile, seed).trace_hash for profile, seed in json.loads(sys.stdin.read())]
import crdt.digest
print(json.dumps([used, crdt.digest.__file__, hashes]))
"""


def play(runs: list[tuple[str, int]], *folder: str) -> tuple[bool, str, list[str]]:
    done = subprocess.run(
        [sys.executable, "-c", PLAY, *folder], input=json.dumps(runs), text=True,
        capture_output=True, timeout=200,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    used, file, hashes = json.loads(done.stdout)
    return used, file, hashes


def made(folder: Path, group: dict[str, str]) -> Path:
    """A core that is quick to make: what C means is the same however well it is optimized, and its
    compiler is twice as quick without. Skips the test on a machine without a compiler."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiling, "LEVEL", "0")
        try:
            for _ in build(folder, group):
                pass
            return folder
        except ToolMissingError as problem:
            missing = str(problem)
    pytest.skip(missing)


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The one that `headland compile` has made of these sources, or a small one."""
    return place() if place().is_dir() else made(tmp_path_factory.mktemp("core") / "small", SMALL)


@pytest.mark.slow
def test_runs_of_the_whole_core_have_the_same_trace_hashes(tmp_path: Path) -> None:
    """`headland compile` made cores that did not run: a constant of three floats had no value."""
    folder = place() if place().is_dir() else made(tmp_path / "whole", compiling.GROUP)
    used, _, compiled = play(RUNS, str(folder))
    assert used
    _, _, interpreted = play(RUNS)
    assert compiled == interpreted, RUNS


@pytest.mark.slow
def test_compiled_and_interpreted_runs_have_the_same_trace_hashes(core: Path) -> None:
    used, file, compiled = play(FEW, str(core))
    assert used and Path(file).parent.parent == core
    used, file, interpreted = play(FEW)
    assert not used and file.endswith(".py")
    assert compiled == interpreted, FEW


def test_every_module_of_the_core_is_there() -> None:
    assert all((ROOT / file).is_file() for file in compiling.files(compiling.GROUP))


# Their classes are not extension classes, so anything may be derived from them.
PLAIN = {"Enum", "Exception", "Flag", "IntEnum", "NamedTuple", "Protocol", "ValueError"}
# What a campaign imports. Runs of one fleet never use a core.
OF_CAMPAIGNS = ("crdt", "protocol", "agent", "sim/chaos", "sim/fleet")


def test_what_is_derived_from_a_compiled_class_is_compiled() -> None:
    """A part that was not in the list made every campaign with a core end with a TypeError."""
    compiled = {
        file.removesuffix(".py").replace("/", ".") for file in compiling.files(compiling.GROUP)
    }
    native = {
        (module, node.name)
        for module in compiled
        for node in ast.parse((ROOT / f"{module.replace('.', '/')}.py").read_text()).body
        if isinstance(node, ast.ClassDef) and not {ast.unparse(base) for base in node.bases} & PLAIN
    }
    missing = []
    for file in (path for folder in OF_CAMPAIGNS for path in sorted((ROOT / folder).rglob("*.py"))):
        module = ".".join(file.relative_to(ROOT).with_suffix("").parts)
        nodes = list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
        names = {
            alias.asname or alias.name: (node.module, alias.name)
            for node in nodes
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        if module not in compiled and any(
            names.get(ast.unparse(base)) in native
            for node in nodes
            if isinstance(node, ast.ClassDef)
            for base in node.bases
        ):
            missing.append(module)
    assert not missing, "add them to tools/build/compile.py"


def test_changed_sources_have_no_core(monkeypatch: pytest.MonkeyPatch) -> None:
    before = place()
    monkeypatch.setattr(compiled_core, "fingerprint", lambda: "0" * 12)
    assert place() != before and not Finder(place()).files


@pytest.mark.slow
def test_a_process_that_has_begun_interpreted_goes_on_so(core: Path) -> None:
    import crdt.digest

    assert crdt.digest.__file__.endswith(".py")
    assert not compiled_core.use(core)
    assert not any(isinstance(finder, Finder) for finder in sys.meta_path)
