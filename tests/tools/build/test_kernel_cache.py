"""A run or a launch that has to compile kernels first says so."""

from importlib import import_module, reload
from io import StringIO
from pathlib import Path
from threading import Event

import pytest
from rich.console import Console

from tools.build import kernel_cache
from tools.build.kernel_cache import (
    COMPILE,
    MORE,
    Compiling,
    is_kept,
    kernels_kept,
    told_compiling,
)


def test_an_empty_cache_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    numba = pytest.importorskip("numba", reason="the extra `robot` is not installed")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert kernels_kept() == 0
    (tmp_path / "agent").mkdir()
    (tmp_path / "agent" / "kernel.nbi").write_bytes(b"")
    assert kernels_kept() == 1


def test_a_kernel_is_kept_as_long_as_its_source_is_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("numba", reason="the extra `robot` is not installed")
    source = tmp_path / "kernel_of_a_test.py"
    source.write_text("import numba\n@numba.njit(cache=True)\ndef more(n):\n    return n + 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    module = import_module("kernel_of_a_test")
    assert not is_kept(module.more)
    assert module.more(1) == 2
    assert is_kept(module.more)
    source.write_text(source.read_text().replace("+ 1", "+ 22"))
    assert not is_kept(reload(module).more)
    assert is_kept(len), "plain Python is never compiled"


WAIT_S = 60.0  # for a thread to begin, on a busy machine


def test_a_wait_for_kernels_is_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A launch was silent for minutes where only a run had compiled kernels before."""
    event = pytest.importorskip("numba.core.event", reason="the extra `robot` is not installed")
    monkeypatch.setattr(kernel_cache, "TOLD_AFTER_S", 0.0)
    told: list[str] = []
    said = Event()

    def tell(line: str) -> None:
        told.append(line)
        said.set()

    with told_compiling(tell):
        assert not told
        for _ in range(2):
            event.start_event(COMPILE)
            event.start_event(COMPILE)  # a kernel that it calls
            assert said.wait(WAIT_S)
            event.end_event(COMPILE)
            event.end_event(COMPILE)
    assert told == [MORE]


def test_a_short_wait_for_kernels_needs_no_word() -> None:
    event = pytest.importorskip("numba.core.event", reason="the extra `robot` is not installed")
    told: list[str] = []
    with told_compiling(told.append):
        event.start_event(COMPILE)
        event.end_event(COMPILE)
    assert told == []


def test_without_a_terminal_each_part_that_took_long_is_a_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = iter([0.0, 0.0, 31.4, 31.5])
    monkeypatch.setattr(kernel_cache, "perf_counter", lambda: next(clock))
    console = Console(file=StringIO(), force_terminal=False, width=200)
    with Compiling(console) as compiling:
        for step in ((0, 3, "paths"), (1, 3, "plans"), (2, 3, "world")):
            compiling.step(*step)
    assert isinstance(console.file, StringIO)
    assert console.file.getvalue().strip() == "compiled paths in 31 s: 1 of 3"
