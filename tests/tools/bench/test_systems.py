"""A door whose counterpart is not here is one figure without a value, and says why."""

import sys
from collections.abc import Iterator
from types import ModuleType

import pytest

from tools.bench import systems
from tools.bench.figure import Figure
from tools.bench.systems import DOORS, CounterpartAbsent


def test_every_door_has_figures() -> None:
    for module in DOORS.values():
        __import__(module)
        assert callable(sys.modules[module].figures), module


def test_a_door_without_its_counterpart_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(quick: bool) -> Iterator[Figure]:
        raise CounterpartAbsent("promtool is not installed")
        yield

    def here(quick: bool) -> Iterator[Figure]:
        yield Figure("works", 1.0, "", "", None, "", "")

    for name, found in (("absent_door", absent), ("door_that_works", here)):
        module = ModuleType(name)
        module.__dict__["figures"] = found
        monkeypatch.setitem(sys.modules, f"{name}", module)
    names = {"A": "absent_door", "B": "no_such_package", "C": "door_that_works"}
    monkeypatch.setattr(systems, "DOORS", names)
    told = list(systems.figures(quick=True))
    assert [(f.figure, f.holds, f.scope) for f in told] == [
        ("A: not measured", None, "promtool is not installed"),
        ("B: not measured", None, "no_such_package is not installed"),
        ("works", None, ""),
    ]
