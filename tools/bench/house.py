"""What can be counted of the sources: cycles, names, ignored types, docstrings, lines.

`tests/test_architecture.py` and `tests/test_docstrings.py` refuse what these figures would miss. Benches
are not part of the product and are not counted.
"""

import ast
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

from tools.bench.figure import Figure
from tools.build.docstring_checker import check

ROOT = Path(__file__).parents[2]
LAYERS = ("crdt", "protocol", "agent", "sim", "tools")
DOCSTRING_SHARES = {"crdt": 1.0, "protocol": 1.0, "agent": 1.0, "sim": 0.9, "tools": 0.9}
IGNORES_MAX = 20
OF_KERNELS = ("untyped-decorator", "no-untyped-def")  # what mypy says of numba's kernels


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Every figure; they are the same in a quick run, and chance has no part in them."""
    files = {
        module_of(path): path
        for layer in LAYERS
        for path in sorted((ROOT / layer).rglob("*.py"))
        if not path.is_relative_to(ROOT / "tools/bench")
    }
    texts = {module: path.read_text(encoding="utf-8") for module, path in files.items()}
    trees = {module: ast.parse(text) for module, text in texts.items()}
    scope = f"{len(files)} modules of crdt, protocol, agent, sim and tools, without benches"
    cycles = modules_in_cycles(
        {module: imports(tree, set(files)) for module, tree in trees.items()}
    )
    yield _count("modules in an import cycle", cycles, 0, f"{scope}; under TYPE_CHECKING, too")
    yield _count("class names twice in a package", twice(trees), 0, scope)
    ignored = sum(
        "# type: ignore" in line and not any(kind in line for kind in OF_KERNELS)
        for text in texts.values()
        for line in text.splitlines()
    )
    yield _count("types ignored outside kernels", ignored, IGNORES_MAX, scope)
    for layer, least in DOCSTRING_SHARES.items():
        result = check(layer)
        yield Figure(
            f"public names of {layer} with a whole docstring", result.share, "share",
            f">= {least:g}", result.share >= least, "",
            f"{result.checked} functions, methods and classes: shapes, units, errors",
        )  # fmt: skip
    lines = sum(text.count("\n") for text in texts.values())
    code = sum(lines_of_code(text) for text in texts.values())
    yield Figure("lines", float(lines), "", "", None, "", scope)
    yield Figure(
        "lines without comments, docstrings and blanks", float(code), "", "", None, "", scope
    )


def _count(name: str, value: int, most: int, scope: str) -> Figure:
    return Figure(name, float(value), "", f"<= {most}", value <= most, "", scope)


def module_of(path: Path) -> str:
    """The dotted name of a source file; a package for its `__init__`."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree: ast.AST, known: set[str]) -> set[str]:
    """The modules in `known` that a module imports anywhere in it."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= inner & known or {node.module}
    return found & known


def modules_in_cycles(graph: Mapping[str, set[str]]) -> int:
    """Number of modules from which imports lead back to themselves. `graph`: module -> imported ones.

    Modules without a way on are removed until none is left to remove, in both directions.
    """
    left = {module: set(to) for module, to in graph.items()}
    while True:
        imported = {module for to in left.values() for module in to}
        ends = {module for module, to in left.items() if not to or module not in imported}
        if not ends:
            return len(left)
        left = {module: to - ends for module, to in left.items() if module not in ends}


def twice(trees: Mapping[str, ast.Module]) -> int:
    """Number of class names that two modules of one package define."""
    names = Counter(
        (module.rpartition(".")[0], node.name)
        for module, tree in trees.items()
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    )
    return sum(count > 1 for count in names.values())


def lines_of_code(text: str) -> int:
    """Number of lines that hold a part of a statement other than a docstring."""
    held: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node, ast.stmt) and not is_text:
            last = node.end_lineno or node.lineno
            inner = getattr(node, "body", None)
            held.update(range(node.lineno, (inner[0].lineno if inner else last + 1)))
    return len(held)
