"""Public docstrings say what their rules ask for (`tools/build/docstring_checker.py`)."""

import json
from pathlib import Path

import pytest

from tools.build import docstring_checker
from tools.build.docstring_checker import LAYERS, SOURCED, ParsedFile, check, failures_in, restates
from tools.common.fingerprint import ROOT

# Percent of the docstrings of each package that must pass. Raise a floor with its package.
FLOORS = {
    "crdt": 100,
    "protocol": 100,
    "protocol/frames": 100,
    "protocol/links": 100,
    "protocol/sync": 100,
    "agent/avoidance": 100,
    "agent/claims": 100,
    "agent/coverage": 100,
    "agent/pathfinding": 100,
    "agent/delivery": 100,
    "agent/exploration": 100,
    "agent/field": 100,
    "agent/implements": 85,
    "agent/interface": 100,
    "agent/kernels": 88,  # a kind of an argument has no unit
    "agent/mapf": 100,
    "agent/mapping": 100,
    "agent/motion": 100,
    "agent/navigation": 100,
    "agent/paths": 100,
    "agent/peer": 100,
    "agent/runtime": 100,
    "agent/safety": 100,
    "agent/segments": 100,
    "sim/can": 95,
    "sim/chaos": 95,
    "sim/files": 95,
    "sim/fleet": 95,
    "sim/machines": 95,
    "sim/record": 95,
    "sim/rigs": 95,
    "sim/runs": 94,
    "sim/scenarios": 94,
    "sim/world": 95,
    "tools/bench": 95,
    "tools/build": 95,
    "tools/chaos": 95,
    "tools/cli": 91,
    "tools/common": 95,
    "tools/inspect": 95,
    "tools/language": 95,
    "tools/livemap": 95,
    "tools/operate": 95,
    "tools/report": 95,
    "tools/ros2": 100,
    "tools/run": 94,
    "tools/vda5050": 95,
}


@pytest.mark.parametrize("package", FLOORS)
def test_docstrings_of_a_package(package: str) -> None:
    """At least the share of the table passes; `python -m tools.build.docstring_checker` lists them."""
    result = check(package)
    lines = [f"{f.file}:{f.line}: {f.name}: {'; '.join(f.reasons)}" for f in result.failures]
    assert 100 * result.share >= FLOORS[package], "\n".join(lines)


def test_every_package_has_a_floor() -> None:
    packages = {
        path.parent.relative_to(ROOT).as_posix()
        for layer in LAYERS
        for path in (ROOT / layer).glob("*/*.py")
    }
    assert packages | {"crdt", "protocol"} == set(FLOORS)


def test_modules_that_must_cite_are_there() -> None:
    assert [name for name in SOURCED if not (ROOT / name).exists()] == []


def reasons(monkeypatch: pytest.MonkeyPatch, folder: Path, text: str) -> dict[str, tuple[str, ...]]:
    """What fails in a file with this text, by name."""
    monkeypatch.setattr(docstring_checker, "ROOT", folder)
    path = folder / "module.py"
    path.write_text(text, encoding="utf-8")
    return {failure.name: failure.reasons for failure in failures_in(ParsedFile(path))[1]}


PLAIN = '''
from numpy.typing import NDArray
Point = tuple[float, float]  # metres (east, north)
Plain = tuple[float, float]
class Field:
    """The ground that the fleet works, with its border."""
    def __init__(self, width: float) -> None: ...
    @property
    def area_m2(self) -> float:
        """Within the border."""
    def free(self, at: Point, slot: int) -> bool:
        """Whether nothing that stands for long is there."""
    def distances(self, points: NDArray) -> NDArray:
        """Metres to the border from each row of `points`, (n, 2)."""
    def load(self) -> None:
        """Reads the border again; raises ValueError where it crosses itself."""
        raise ValueError
class Meadow(Field):
    """A field where nothing is sown, so that all of it is free."""
    def free(self, at: Point, slot: int) -> bool: ...
def _hidden(): ...
'''


def test_plain_docstrings_pass(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert reasons(monkeypatch, tmp_path, PLAIN) == {}


@pytest.mark.parametrize(
    ("written", "instead", "name", "rule"),
    [
        ('        """Within the border."""', "        return 1", "Field.area_m2", "exists"),
        ("The ground that the fleet works, with its border.", "A field.", "Field", "exists"),
        (
            "at: Point, slot: int) -> bool:\n",
            "at: Plain, slot: int) -> bool:\n",
            "Field.free",
            "unit",
        ),
        (
            "at: Point, slot: int) -> bool:\n",
            "at: Point, zoo: int) -> bool:\n",
            "Field.free",
            "unit",
        ),
        (" from each row of `points`, (n, 2)", "", "Field.distances", "shape"),
        ("Metres to the border", "What lies", "Field.distances", ""),
        ("; raises ValueError where it crosses itself", "", "Field.load", "raises"),
    ],
)
def test_a_rule_that_is_broken_is_found(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    written: str,
    instead: str,
    name: str,
    rule: str,
) -> None:
    assert written in PLAIN
    found = reasons(monkeypatch, tmp_path, PLAIN.replace(written, instead))
    assert {reason.split(":")[0] for reason in found.get(name, ())} == ({rule} if rule else set())


def test_a_docstring_that_restates_its_name() -> None:
    assert restates("FieldMap.is_free", "Whether the field map is free.", 2)
    assert not restates("FieldMap.is_free", "Whether a robot can stand there.", 2)


def test_the_results_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    code = docstring_checker.main(["crdt/claim_register.py", "--json"])
    (result,) = json.loads(capsys.readouterr().out)
    assert result["package"] == "crdt/claim_register.py"
    assert code == int(result["passing"] < result["checked"])
