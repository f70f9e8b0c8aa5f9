"""What compiled code remembers between two uses is what Python would find now."""

import importlib.util
import sys
from types import ModuleType
from typing import NamedTuple

import pytest

from tools.build import compile as compiling
from tools.build.compile import ToolMissingError
from tools.build.compiled_core import SUFFIX

SOURCE = """
from math import hypot
from typing import Any, NamedTuple

class Pair(NamedTuple):
    first: int
    second: int = 7

class Animal:
    def __init__(self) -> None:
        self.legs = 4

class Dog(Animal):
    pass

class Puppy(Dog):
    pass

class Cat(Animal):  # a cast to a class with few others below it compares with each
    pass

class Fox(Animal):
    pass

class Owl(Animal):
    pass

limit: Any = 1

def change(value: Any) -> None:
    global limit
    limit = value

def read() -> Any:
    return limit

def looked_up(items: dict[str, int], key: str) -> int:
    return items[key]

def length(x: float, y: float) -> float:
    return hypot(x, y)

def pair(first: int, second: int) -> Pair:
    return Pair(first, second)

def half(first: int) -> Pair:
    return Pair(first)

def named(first: int, second: int) -> Pair:
    return Pair(second=second, first=first)

def of(kind: Any, values: Any) -> Any:
    return tuple.__new__(kind, values)

def one(kind: Any, first: Any) -> Any:
    return kind(first)

def call(kind: Any, first: Any, second: Any) -> Any:
    return kind(first, second)

def cast(animals: list[Animal]) -> int:
    legs = 0
    for animal in animals:
        legs += animal.legs
    return legs
"""


class Needs(NamedTuple):
    """Without a default."""

    first: int
    second: int


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    mypyc = pytest.importorskip("mypyc.build", reason="mypyc is not installed")
    folder = tmp_path_factory.mktemp("caches")
    (folder / "remembers.py").write_text(SOURCE)
    try:
        compiler = compiling._compiler()
    except ToolMissingError as problem:
        pytest.skip(str(problem))
    modules = compiling._translated(mypyc.mypycify, [str(folder / "remembers.py")], folder / "c")
    for _ in compiling._machine_code(compiler, modules, folder):
        pass
    sys.path.insert(0, str(folder / "core"))
    try:
        spec = importlib.util.spec_from_file_location(
            "remembers", folder / "core" / f"remembers{SUFFIX}"
        )
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules["remembers"] = module
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(folder / "core"))
    return module


@pytest.mark.slow
def test_a_changed_global_is_found(compiled: ModuleType) -> None:
    for value in (1, 2, 2, "three", None):
        compiled.change(value)
        assert compiled.read() == compiled.read() == value
    compiled.__dict__["limit"] = 4  # by somebody outside
    assert compiled.read() == 4
    del compiled.__dict__["limit"]
    with pytest.raises(KeyError):  # what mypyc raises
        compiled.read()
    compiled.change(5)
    assert compiled.read() == 5


@pytest.mark.slow
def test_a_replaced_function_is_called(
    compiled: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert compiled.length(3.0, 4.0) == 5.0
    monkeypatch.setitem(compiled.__dict__, "hypot", lambda x, y: x + y)
    assert compiled.length(3.0, 4.0) == 7.0
    monkeypatch.undo()
    assert compiled.length(3.0, 4.0) == 5.0


@pytest.mark.slow
def test_items_are_those_of_the_dictionary_that_is_asked(compiled: ModuleType) -> None:
    one, two = {"a": 1, "b": 2}, {"a": 3}
    assert [compiled.looked_up(one, key) for key in "abab"] == [1, 2, 1, 2]
    assert [compiled.looked_up(each, "a") for each in (one, two, one)] == [1, 3, 1]
    with pytest.raises(KeyError):
        compiled.looked_up(two, "b")
    one["a"] = 9
    assert compiled.looked_up(one, "a") == 9
    for k in range(100):  # each may lie where the one before did
        assert compiled.looked_up({"a": k}, "a") == k


@pytest.mark.slow
def test_named_tuples_are_those_that_python_makes(compiled: ModuleType) -> None:
    pair = compiled.Pair
    for _ in range(3):
        assert compiled.pair(1, 2) == pair(1, 2) and type(compiled.pair(1, 2)) is pair
        assert compiled.half(1) == pair(1) == (1, 7) and compiled.one(pair, 1) == (1, 7)
        assert compiled.named(1, 2) == pair(1, 2)
        assert type(compiled.of(pair, (3, 4))) is pair and compiled.of(pair, (3, 4)).second == 4
    assert compiled.pair(1, 2)._replace(first=5) == (5, 2)
    assert compiled.of(tuple, (1, 2)) == (1, 2)
    assert compiled.of(pair, [3, 4]) == (3, 4)  # from a list, as Python does
    assert compiled.of(pair, (1, 2, 3)) == (1, 2, 3)  # which Python does not forbid
    assert len(compiled.of(pair, (1,))) == 1  # so has no default
    with pytest.raises(TypeError):
        compiled.of(int, (1, 2))
    assert compiled.call(Needs, 1, 2) == (1, 2)
    with pytest.raises(TypeError, match="second"):
        compiled.one(Needs, 1)


@pytest.mark.slow
def test_other_callables_are_called(compiled: ModuleType) -> None:
    class Strange(compiled.Pair):  # type: ignore[misc, name-defined]
        __slots__ = ()

        def __new__(cls, first: int, second: int) -> "Strange":
            made: Strange = super().__new__(cls, second, first)
            return made

    kinds = [compiled.Pair, Strange, complex, max, lambda a, b: a - b, compiled.Pair]
    for _ in range(3):
        found = [compiled.call(kind, 1, 2) for kind in kinds]
        assert found == [(1, 2), (2, 1), 1 + 2j, 2, -1, (1, 2)]
    with pytest.raises(TypeError):
        compiled.call(list, 1, 2)


@pytest.mark.slow
def test_instances_of_derived_classes_pass_and_others_do_not(compiled: ModuleType) -> None:
    animals = [compiled.Animal(), compiled.Dog(), compiled.Puppy()] * 2
    assert compiled.cast(animals) == 24
    with pytest.raises(TypeError):
        compiled.cast([*animals, 3])
