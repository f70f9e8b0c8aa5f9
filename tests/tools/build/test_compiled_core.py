"""Simulated from machine code, a run is the same to the last effect; what is stale is never used."""

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import IO

import pytest

from agent.runtime.files.file_lock import lock
from tools.build import compile as compiling
from tools.build import compiled_core
from tools.build.compile import ToolMissingError, build
from tools.build.compiled_core import Finder, place
from tools.common.fingerprint import ROOT

RUNS = [
    ("protocol", 3),
    ("all", 1),
    ("stop", 2),
    ("crash", 5),
    ("tractors", 1),
    ("mapf", 1),
    ("cover", 1),
]
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
def on_grid(profile, seed):
    from sim.files.grid_map import Instance, random_walls
    from sim.files.mapf_scenario import drawn_scenario
    from sim.runs.coverage_run import CoverageRun
    from sim.runs.mapf_run import MapfRun
    from sim.scenarios.coverage_setup import CoverageSetup
    from sim.scenarios.mapf_setup import MapfSetup
    from tools.run.mapf import crashes_of
    mapf = drawn_scenario("grid", random_walls(14, 14, 0.15, seed), 8, seed)
    faults = [fault.model_copy(update={"at_s": 6.0}) for fault in crashes_of(1, 8, seed)]
    if profile == "cover":
        instance = Instance(mapf.name, mapf.walls, mapf.starts)
        return CoverageRun(CoverageSetup.made(instance, seed=seed, faults=faults)).run()
    return MapfRun(MapfSetup.of(mapf, seed=seed, loss=0.02, faults=faults)).run()
def played(profile, seed):
    if profile in ("mapf", "cover"):
        outcome = on_grid(profile, seed)
        assert outcome.success, outcome
        return outcome
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
        capture_output=True, timeout=400,
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


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All of a core."""
    folder = tmp_path_factory.mktemp("core") / "whole"
    return place() if place().is_dir() else made(folder, compiling.GROUP)


@pytest.mark.slow
def test_runs_of_the_whole_core_have_the_same_trace_hashes(whole: Path) -> None:
    """`headland compile` made cores that did not run: a constant of three floats had no value."""
    used, _, compiled = play(RUNS, str(whole))
    assert used
    _, _, interpreted = play(RUNS)
    assert compiled == interpreted, RUNS


# One of each kind of run. Two ask an operator, whose answer a compiled robot did not survive.
SCENARIOS = ("small", "visitor", "bystander", "warehouse", "arena")
COMMAND = """
import sys
from pathlib import Path
from tools.build.compiled_core import use
core, *words = sys.argv[1:]
assert not core or use(Path(core))
sys.argv[1:] = words
from tools.cli.headland import main
main()
"""


@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_headland_run_has_the_same_hashes_with_a_core(
    scenario: str, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hashes = []
    for core in (str(whole), ""):
        monkeypatch.setenv("HEADLAND_INTERPRETED", "yes")
        if core:
            monkeypatch.delenv("HEADLAND_INTERPRETED")
        done = subprocess.run(
            [sys.executable, "-c", COMMAND, core, "run", scenario, "--json", "--out", str(tmp_path)],
            capture_output=True, text=True, timeout=400,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        said = json.loads(done.stdout)
        hashes.append((said["trace_hash"], said["log_hash"]))
    assert hashes[0] == hashes[1]


@pytest.mark.parametrize("words", ["run nowhere", "mapf nowhere.map", "chaos --profile nothing"])
def test_commands_that_simulate_look_for_a_core_first(
    words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from typer.testing import CliRunner

    from tools.cli.headland import app

    asked: list[bool] = []
    monkeypatch.setattr(compiled_core, "use", lambda: asked.append(True))
    assert CliRunner().invoke(app, words.split()).exit_code != 0
    assert asked


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
# What a simulated fleet imports.
OF_FLEETS = (
    "crdt", "protocol", "agent", "sim/chaos", "sim/fleet", "sim/runs", "sim/scenarios", "sim/world",
)  # fmt: skip


def test_no_module_of_the_core_has_a_cached_property() -> None:
    """mypyc computes its value at each look: all ways of a field, for each robot and plan."""
    texts = {file: (ROOT / file).read_text() for file in compiling.files(compiling.GROUP)}
    assert not [file for file, text in texts.items() if "import cached_property" in text]
    assert not [file for file, text in texts.items() if "functools.cached_property" in text]


def test_what_is_derived_from_a_compiled_class_is_compiled() -> None:
    """A part that was not in the list made every campaign with a core end with a TypeError, and
    fleets that were not in it ended `headland mapf` so, warehouses and explorations."""
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
    for file in sorted(path for folder in OF_FLEETS for path in (ROOT / folder).rglob("*.py")):
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


def test_a_changed_list_of_modules_has_no_core(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A core that another list had made was used, without the modules that were added."""
    before = place()
    for name in compiled_core.MADE_BY:
        (tmp_path / name).write_bytes(Path(compiling.__file__).with_name(name).read_bytes())
    monkeypatch.setattr(compiled_core, "__file__", str(tmp_path / "compiled_core.py"))
    assert place() == before
    for name in compiled_core.MADE_BY:
        (tmp_path / name).write_bytes(b"changed")
        assert place() != before
    (tmp_path / "inline_caches.h").unlink()
    assert place() != before  # as in a wheel


@pytest.mark.slow
def test_a_process_that_has_begun_interpreted_goes_on_so(core: Path) -> None:
    import crdt.digest

    assert crdt.digest.__file__.endswith(".py")
    assert not compiled_core.use(core)
    assert not any(isinstance(finder, Finder) for finder in sys.meta_path)


def test_a_missing_compiler_is_exit_code_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was 1, that of sources which cannot be compiled."""
    monkeypatch.setattr(compiling, "place", lambda: tmp_path / "core")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert compiling.compile_core(remove=False) == 2
    assert capsys.readouterr().err.startswith("headland: no C compiler")


def test_of_two_that_compile_one_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both made one folder, and each deleted the files of the other."""
    core, waits, made = tmp_path / "core", Event(), list[Path]()

    def make(folder: Path) -> Iterator[tuple[str, int, int]]:
        made.append(folder)
        folder.mkdir()
        yield "all", 1, 1

    def told(file: IO[str], wait: bool = True) -> bool:
        if wait:
            waits.set()
        return lock(file, wait)

    monkeypatch.setattr(compiling, "FOLDER", core)
    monkeypatch.setattr(compiling, "place", lambda: core / "these")
    monkeypatch.setattr(compiling, "build", make)
    monkeypatch.setattr(compiling, "lock", told)
    core.mkdir()
    with ThreadPoolExecutor() as pool:
        with (core / "lock").open("w") as file:
            assert lock(file)
            codes = [pool.submit(compiling.compile_core, False) for _ in range(2)]
            assert waits.wait(60.0) and not made
        assert [code.result(60.0) for code in codes] == [0, 0]
    assert made == [core / "these"]
    said = " ".join(capsys.readouterr().out.split())
    assert "is at work: waiting for it" in said and "there is one of these sources" in said
