"""A kernel with entries calls the one of its argument types, and numba's where there is none."""

from typing import Any, NamedTuple

import numpy as np
import pytest

from agent.kernels import kernel as module
from agent.kernels.kernel import UNKNOWN, Kernel, Kinds, kind_of


class Pair(NamedTuple):
    first: float
    second: int


class Table:
    """A source with one entry, for two floats."""

    def __init__(self) -> None:
        self.missed: list[Kinds] = []

    def entries(self, name: str) -> Any:
        return {("float", "float"): lambda a, b: ("entry", a + b)}

    def on_missing(self, kernel: Kernel, kinds: Kinds, values: tuple[Any, ...]) -> None:
        self.missed.append(kinds)


def plus(a: Any, b: Any) -> Any:
    return a + b


def test_a_call_goes_to_the_entry_of_its_types_and_else_to_numba() -> None:
    table = Table()
    kernel = Kernel(plus, {"cache": False}, table)
    assert kernel(1.5, np.float64(2.0)) == ("entry", 3.5) and not table.missed
    assert kernel(1, 2) == 3 and table.missed == [("int", "int")]


def test_kernels_are_numbas_own_where_nothing_else_is_chosen() -> None:
    numba = module.numba_knowing_kernels()
    assert isinstance(module.njit()(plus), numba.core.dispatcher.Dispatcher)


def first(a: Any) -> Any:
    return a[0]


@pytest.mark.parametrize("source", [None, Table()])
def test_an_inlined_kernel_counts_no_references(source: Table | None) -> None:
    module.take_from(source)
    try:
        made: Any = module.njit(inlined=True)(first)
    finally:
        module.take_from(None)
    inner = made if source is None else made.dispatcher
    assert inner(np.ones(2)) == 1.0
    assert inner.targetoptions["forceinline"]
    assert not any("call void @NRT_" in code for code in inner.inspect_llvm().values())


def test_numba_compiles_a_kernel_with_entries_inside_of_another() -> None:
    numba = module.numba_knowing_kernels()
    inner = Kernel(plus, {"cache": False}, Table())

    @numba.njit  # type: ignore[untyped-decorator]
    def outer(a: Any) -> Any:
        return inner(a, a)

    assert outer(2.0) == 4.0


ARRAYS = [
    np.zeros((2, 3)),
    np.zeros((2, 3), order="F"),
    np.zeros((4, 6))[::2, ::2],
    np.zeros(3),
    np.zeros(3, dtype=np.float32),
    np.zeros(3, dtype=np.bool_),
    np.frombuffer(bytes(16), dtype=np.int64),  # not writable
]


@pytest.mark.parametrize("a", range(len(ARRAYS)))
def test_kinds_are_equal_where_numbas_types_are(a: int) -> None:
    numba = module.numba_knowing_kernels()
    others: list[Any] = [*ARRAYS, np.ones((5, 2)), np.zeros((1, 3)), np.arange(3.0), 1.0, 1, True,
                         np.float64(1), np.int64(1), np.bool_(True), np.int32(1),
                         Pair(1.0, 2), (1.0, 2), (1.0, 2, 3), None]  # fmt: skip
    for other in others:
        same = numba.typeof(other) == numba.typeof(ARRAYS[a])
        assert (kind_of(other) == kind_of(ARRAYS[a])) is same, other
    scalars = others[len(ARRAYS) + 3 :]
    for one in scalars:
        for other in scalars:
            same = numba.typeof(one) == numba.typeof(other)
            assert (kind_of(one) == kind_of(other)) is same, (one, other)


def test_arrays_of_records_or_of_foreign_bytes_have_no_entry() -> None:
    assert kind_of(np.zeros(2, dtype=">f8")) == UNKNOWN
    assert kind_of(np.zeros(2, dtype=[("a", "f8")])) == UNKNOWN
