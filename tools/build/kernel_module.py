"""Makes what `agent/runtime/ready_kernels.py` loads: all kernels of robots in one extension module.

A rehearsal calls kernels as robots do, and notes the argument types of each call from Python. For each of
them numba compiles an entry ahead of time (`numba.pycc`). Behind the entries are the kernels that numba
compiles for a simulation, with the same options, so the results are equal bit for bit.

    python -m tools.build.kernel_module        # in a process that has imported no kernel before
"""

import ast
import json
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from types import CodeType
from typing import Any, NamedTuple

from agent.kernels.kernel import Entries, Kernel, Kinds, numba_knowing_kernels, take_from
from agent.runtime.ready_kernels import (
    ENTRIES,
    LAYERS,
    MODULE,
    SOURCES,
    TABLE,
    digest,
    extension_in,
    place,
)

FAILED = 1
KINDS = "agent/kernels/kernel.py"  # says how argument types are written in the table
OURS = ("crdt", "protocol", "agent")  # layers that kernels of robots are in


class NotedCall(NamedTuple):
    """A kernel that Python calls, and numba's types of the arguments."""

    kernel: Kernel
    types: tuple[Any, ...]


class Rehearsal:
    """A source of kernels without entries: numba runs them, and each call is noted."""

    def __init__(self) -> None:
        self.modules: set[str] = set()  # with kernels
        self.calls: dict[tuple[str, Kinds], NotedCall] = {}

    def entries(self, name: str) -> Entries:
        """None, so each call is noted."""
        self.modules.add(name.rpartition(".")[0])
        return {}

    def on_missing(self, kernel: Kernel, kinds: Kinds, values: tuple[Any, ...]) -> None:
        """Note the call."""
        if (kernel.name, kinds) not in self.calls:
            numba = numba_knowing_kernels()
            types = tuple(numba.typeof(value) for value in values)
            self.calls[kernel.name, kinds] = NotedCall(kernel, types)


def make(folder: Path, rehearse: Callable[[], None]) -> tuple[int, int]:
    """Make the extension and its table in a folder; returns the numbers of kernels and of entries.

    No module with a kernel may be imported before. Raises whatever the compilers raise.
    """
    rehearsal = Rehearsal()
    numba_knowing_kernels()
    take_from(rehearsal)
    try:
        rehearse()
    finally:
        take_from(None)
    entries: dict[str, list[tuple[Kinds, str]]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "pending deprecation", as it has been since 2022
        compiler: Any = import_module("numba.pycc").CC(MODULE, source_module=sys.modules[__name__])
    calls = sorted(rehearsal.calls.items(), key=lambda item: (item[0][0], repr(item[0][1])))
    for number, ((name, kinds), call) in enumerate(calls):
        function = f"entry{number}"
        compiler.export(function, call.types)(_entry(call.kernel, len(call.types)))
        entries.setdefault(name, []).append((kinds, function))
    files = sorted({KINDS, *sources_of(rehearsal.modules)})
    sources = {file: digest(LAYERS / file) for file in files}
    folder.mkdir(parents=True, exist_ok=True)
    target = extension_in(folder)
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        compiler.output_dir, compiler.output_file = scratch, target.name
        compiler.compile()
        (folder / TABLE).unlink(missing_ok=True)  # of another extension
        Path(scratch, target.name).replace(target)
        made = Path(scratch, TABLE)
        made.write_text(json.dumps({SOURCES: sources, ENTRIES: entries}))
        made.replace(folder / TABLE)
    return len(entries), len(calls)


def _entry(kernel: Kernel, count: int) -> Callable[..., Any]:
    """A function of `count` arguments that calls the kernel: so the kernel keeps its own options."""
    names = ", ".join(f"a{number}" for number in range(count))
    place: dict[str, Any] = {"kernel": kernel.dispatcher}
    exec(f"def entry({names}): return kernel({names})", place)
    made: Callable[..., Any] = place["entry"]
    return made


# ---------------------------------------------------------------- what kernels depend on


def sources_of(modules: Iterable[str]) -> set[str]:
    """The files, below the folder of the layers, that decide what kernels in these modules compute.

    A kernel may contain constants and kernels that its module imports, and their modules may compute
    these from what they import. The fields of a tuple that it takes are in another module, too. What
    a module imports for Python alone does not count.
    """
    found = {_file(module) for module in modules}
    for module in modules:
        place, used = vars(sys.modules[module]), _names_in_kernels(module)
        for name, file in _imported(_file(module)).items():
            value = place.get(name)
            if isinstance(value, type) and issubclass(value, tuple):
                found.add(file)
            elif name in used and file not in found:
                found |= _closure(file)
    return found


def _file(module: str) -> str:
    path = Path(*module.removeprefix("headland.").split("."))  # as it is called in a wheel
    whole = path.with_suffix(".py")
    return (whole if (LAYERS / whole).exists() else path / "__init__.py").as_posix()


@cache
def _imported(file: str) -> dict[str, str]:
    """Name -> the file of ours that it is imported from."""
    tree = ast.parse((LAYERS / file).read_text())
    return {
        alias.asname or alias.name: _file(node.module)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module
        if node.module.removeprefix("headland.").split(".")[0] in OURS
        for alias in node.names
    }


@cache
def _closure(file: str) -> frozenset[str]:
    """A file of ours and all that it imports."""
    found, waiting = set[str](), [file]
    while waiting:
        each = waiting.pop()
        if each not in found:
            found.add(each)
            waiting += _imported(each).values()
    return frozenset(found)


def _names_in_kernels(module: str) -> set[str]:
    """The global names that kernels of a module use."""
    kernels = [each for each in vars(sys.modules[module]).values() if isinstance(each, Kernel)]
    return {name for kernel in kernels for name in _names(kernel.__wrapped__.__code__)}


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _names(inner)


def main() -> int:
    """Make the ready module of these sources in its place; the exit code."""
    from tools.build.warmup import rehearse

    begun_s, folder = time.monotonic(), place()
    try:
        kernels, entries = make(folder, rehearse)
    except Exception as problem:  # compilers raise what they like
        why = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
        print(
            f"headland: no ready kernels for robots, which then start with numba: {why}. "
            "It needs g++, the headers of Python and setuptools", file=sys.stderr,
        )  # fmt: skip
        return FAILED
    size_mb = extension_in(folder).stat().st_size / 1e6
    print(
        f"{kernels} kernels of robots, {entries} entries, {size_mb:.1f} MB, "
        f"{time.monotonic() - begun_s:.0f} s: {folder}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
