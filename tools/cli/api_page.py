"""The page of the programming interface, printed from the sources: signatures, fields and docstrings.

The sources are parsed and never imported, so printing needs no kernel and no CAN library.
"""

import ast
from collections.abc import Iterator, Sequence
from inspect import cleandoc
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
Function = ast.FunctionDef | ast.AsyncFunctionDef
SHOWN = ("property", "classmethod", "staticmethod")  # decorators that change how a name is used
WIDTH = 96  # of a line of code on the page


class Surface(NamedTuple):
    """A chapter of the page."""

    title: str
    source: str  # a module, or the `__init__` of a package: then what it exports is shown
    only: frozenset[str] = frozenset()  # names that are shown; empty: every public one


SURFACES = (
    Surface("A robot in your own program", "agent/runtime/engine.py"),
    Surface("A robot as a process", "agent/runtime/robot_process.py", frozenset({"run_robot"})),
    Surface("The file of a robot", "agent/runtime/robot_file.py"),
    Surface("The body of a robot process", "agent/runtime/robot_body.py"),
    Surface("A CAN bus", "protocol/links/bus.py"),
    Surface("Missions, bodies, and what comes out of the core", "agent/interface/__init__.py"),
    Surface("The core", "agent/peer/peer.py", frozenset({"Peer"})),
    Surface("Frames as bytes", "protocol/frames/frame.py"),
    Surface("Frames as values", "protocol/frames/codec.py"),
    Surface("NAMEs", "protocol/name.py"),
    Surface("Keys and tags", "protocol/authentication.py", frozenset({"Keys", "Keyring"})),
    Surface("Replicated state", "crdt/__init__.py"),
)


def api(root: Path = ROOT) -> str:
    """The page in Markdown. FileNotFoundError where a module of `SURFACES` has moved."""
    lines = [
        "# Programming interface",
        "",
        "What a program may import. Everything else may change without a line in the changelog. Inside a "
        "checkout each module also has its name without `headland.`, which the texts below use. Words "
        "are in the [glossary](../glossary.md); [a real can0](can0.md) and [missions](missions.md) "
        "show how the parts are used.",
        "",
    ]
    for surface in SURFACES:
        module = surface.source.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        lines += [
            f"## {surface.title}: `headland.{module}`",
            "",
            *_prose(_tree(root / surface.source)),
        ]
        for node, source in _shown(surface, root):
            lines += _class(node, source) if isinstance(node, ast.ClassDef) else _function(node)
    return "\n".join(lines).rstrip("\n") + "\n"


def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _shown(surface: Surface, root: Path) -> Iterator[tuple[ast.ClassDef | Function, list[str]]]:
    """The classes and functions of a chapter, each with the lines of its source."""
    path = root / surface.source
    places = {path: surface.only}
    if path.name == "__init__.py":
        places = {}
        for node in _tree(path).body:
            if isinstance(node, ast.ImportFrom) and node.module is not None:
                module = root.joinpath(*node.module.split(".")).with_suffix(".py")
                places[module] = frozenset(alias.name for alias in node.names)
    for module, names in places.items():
        source = module.read_text(encoding="utf-8").splitlines()
        for node in _tree(module).body:
            if not isinstance(node, ast.ClassDef | Function) or node.name.startswith("_"):
                continue
            if not names or node.name in names:
                yield node, source


def _class(node: ast.ClassDef, source: Sequence[str]) -> list[str]:
    """Heading, constructor, fields with their comments, and every public method."""
    bases = ", ".join(ast.unparse(base) for base in node.bases)
    code = [f"class {node.name}({bases}):" if bases else f"class {node.name}:"]
    methods: list[Function] = []
    for part in node.body:
        if isinstance(part, Function):
            if part.name == "__init__":
                code += ["    " + line for line in _signature(part)]
            elif not part.name.startswith("_"):
                methods.append(part)
        elif isinstance(part, ast.AnnAssign | ast.Assign) and not _is_private(part):
            code += source[part.lineno - 1 : part.end_lineno]
    if len(code) == 1:
        code[0] += " ..."
    lines = [f"### {node.name}", "", "```python", *code, "```", "", *_prose(node)]
    for part in node.body:
        if isinstance(part, Function) and part.name == "__init__":
            lines += _prose(part)
    for method in methods:
        lines += ["```python", *_signature(method), "```", "", *_prose(method)]
    return lines


def _is_private(part: ast.AnnAssign | ast.Assign) -> bool:
    targets = [part.target] if isinstance(part, ast.AnnAssign) else part.targets
    return all(isinstance(t, ast.Name) and t.id.startswith("_") for t in targets)


def _function(node: Function) -> list[str]:
    return [f"### {node.name}", "", "```python", *_signature(node), "```", "", *_prose(node)]


def _signature(node: Function) -> list[str]:
    """The head of a function without `self`, one line where it fits, else one argument a line."""
    lines = [f"@{text}" for d in node.decorator_list if (text := ast.unparse(d)) in SHOWN]
    word = "async def" if isinstance(node, ast.AsyncFunctionDef) else "def"
    whole = ast.unparse(node.args)
    for own in ("self, ", "cls, ", "self", "cls"):
        if whole == own or (own.endswith(" ") and whole.startswith(own)):
            whole = whole.removeprefix(own)
            break
    back = "" if node.returns is None else f" -> {ast.unparse(node.returns)}"
    head = f"{word} {node.name}({whole}){back}"
    if len(head) <= WIDTH:
        return [*lines, head]
    parts = _split(whole)
    return [*lines, f"{word} {node.name}(", *(f"    {part}," for part in parts), f"){back}"]


def _split(arguments: str) -> list[str]:
    """Arguments, cut at the commas that stand outside of brackets."""
    parts, depth, begin = [], 0, 0
    for at, letter in enumerate(arguments):
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0:
            parts.append(arguments[begin:at].strip())
            begin = at + 1
    return [*parts, arguments[begin:].strip()]


def _prose(node: ast.Module | ast.ClassDef | Function) -> list[str]:
    text = ast.get_docstring(node, clean=False)
    return [] if text is None else [*cleandoc(text).splitlines(), ""]
