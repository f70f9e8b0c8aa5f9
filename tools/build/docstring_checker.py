"""Checks the docstrings of public classes, functions, methods and properties, from their syntax trees.

What is public has no leading underscore and is not nested. Dunder methods are exempt, and so is an
override whose base class has a documented method of that name. The rules:

    exists   there is a docstring, and it says more than the name does
    shape    it states the shape of every array that goes in or comes out
    unit     it states the unit of every float, and what an integer counts or numbers
    raises   it names what the function raises
    source   a module of `SOURCED` cites a paper, a standard or a library

A plain docstring of one or two sentences passes. A name may state the unit instead (`speed_m_s`), or
say what an integer is (`slot`, `frames`). The comment of a type alias counts wherever the alias is
used: `Point = tuple[float, float]  # metres`. So does the docstring of a module that describes the
array `links` (cells, 2) in backticks, or has a paragraph that begins with `Units:`. A property
needs only a line.
"""

import argparse
import ast
import json
import re
import tokenize
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from tools.common.fingerprint import ROOT

LAYERS = ("crdt", "protocol", "agent", "sim", "tools")
# Modules of a published algorithm or of a standard: each cites its source.
SOURCED = tuple(
    re.findall(
        r"\S+",
        """crdt/hybrid_clock.py protocol/address.py protocol/authentication.py protocol/name.py
    protocol/transport.py protocol/frames/identifier.py agent/avoidance/half_planes.py
    agent/avoidance/linear_program.py agent/avoidance/orca.py agent/avoidance/orca_kernel.py
    agent/coverage/cell_links.py agent/coverage/walk_shortening.py
    agent/delivery/routing_kernels.py agent/mapf/lacam.py agent/mapf/linear_assignment.py
    agent/mapf/lns.py agent/mapf/pibt.py agent/mapf/plan_schedule.py
    agent/runtime/files/isoxml_reader.py
    agent/paths/any_angle_planner.py agent/paths/corner_graph.py agent/paths/dubins.py
    agent/paths/hybrid_a_star.py agent/paths/nav_mesh.py agent/paths/theta_star.py
    sim/can/frame_timing.py sim/can/can_wire.py
    sim/runs/isoxml_writer.py sim/runs/isoxml_time_log.py sim/chaos/shrink.py""",
    )
)
CITATION = re.compile(
    r"\b(?:19[5-9]\d|20[0-2]\d)\b|\bISO \d|\bRFC \d|\bSAE J|\bJ1939|\bNIST|\bRVO2\b|\bAUTOSAR"
)

KERNELS = {"njit", "jit", "kernel"}  # decorators of functions that may leave parameters untyped
UNIT_PARTS = frozenset(
    re.findall(
        r"\S+",
        """m m2 mm cm km s ms us ns rad deg hz mhz khz kg g v w wh j n nm px bit bits byte bytes mb kb
    kib mib ha percent seconds minutes hours days share shares ratio factor fraction probability
    weight scale cells units turns version steps confidence efficiency gain load""",
    )
)
UNIT = re.compile(
    r"""\b(?:m|m²|m/s|m/s²|rad/s|s|ms|µs|us|ns|rad|kg|Hz|kHz|MHz|N|V|W|kW|kWh|ha|px|bit/s|kbit/s|mm|km|km/h
    |met(?:re|er)s?|(?:milli|micro|nano)?seconds?|minutes?|hours?|days?|radians?|degrees?|hertz|pixels?
    |hectares?|percent|bits?|bytes?|cells?|points?|units?|shares?|fractions?|ratios?|factors?
    |probabilit(?:y|ies)|dimensionless|weights?|confidence|logarithms?|ln
    |number\ of|how\ many|how\ much\ of|times\ the|0\ to\ 1|between\ 0\ and\ 1|virtual\ time
    |coordinates|square\ met(?:re|er)s)\b|%|[mM]illiseconds""",
    re.VERBOSE,
)
# What an integer may be called by the last part of its name, or by the words of a docstring.
KINDS = frozenset(
    re.findall(
        r"\S+",
        """slot section segment unit cell node robot member row column col index count number id seed
    size total owner replica counter epoch bid lamport term incarnation address pgn source
    destination sender priority port key digest level version bit block k i j n r c a b code pid
    width height length depth capacity limit first last start end stop low high rank order place
    position part bucket time mask identifier identity function group value tag token reason
    operator channel year month line item task step patch observer target winner leader edge
    corner vertex piece label scope span most least bitrate peer round master hour sequence
    nonce""",
    )
)
KIND = re.compile(
    r"\b(?:numbers?|counts?|index|indices|how many|slots?|sections?|keys?|bits?|bytes?|digests?|hash|"
    r"cost|address(?:es)?|identifier|PGN|priority|epoch|Lamport|lamport|level|version|"
    r"sum|total|row|column|cells?|units?|order|code|codes|time|rank|place|seed|word|crc|checksum|length|"
    r"size|exit|Exit|field|value|bid|hexadecimal|counter|term|port|member|robot|-1|0|1)\b"
)
SHAPE = re.compile(
    r"\([\w.+*\- ]+,[\w.+*\-, ]*\)|\bshape\b|\bgrid\b|\bvector\b|\bscalar\b|\blength\b|\bflat\b"
    r"|\b(?:a|one|an?)\b[\w ]{0,24}\b(?:a|each|per|for each)\b"
    r"|\brows?\b|\bcolumns?\b|\bentries\b|\belements?\b|\bn by \w+"
)
WEAK = frozenset(
    re.findall(
        r"\S+",
        """a an the of to and or is are be it its this that these with for from in on at by as into
    what which how one has have not get return returns given new""",
    )
)
QUIET = {"NotImplementedError", "AssertionError", "SystemExit", "Exit", "StopIteration", "Abort"}


class Failure(NamedTuple):
    """A docstring that breaks rules."""

    file: str
    line: int
    name: str  # with the class before it
    reasons: tuple[str, ...]


class LayerResult(NamedTuple):
    """What came of one layer or one package."""

    package: str
    checked: int
    failures: tuple[Failure, ...]

    @property
    def passing(self) -> int:
        """Number of docstrings that break no rule."""
        return self.checked - len(self.failures)

    @property
    def share(self) -> float:
        """Passing docstrings as a share of 0 to 1; 1 where there is nothing to check."""
        return self.passing / self.checked if self.checked else 1.0


class Alias(NamedTuple):
    """A name for a type on the level of a module."""

    value: ast.expr
    words: str  # its comment


class ParsedFile:
    """One parsed file: its comments, its type aliases, its classes, and where its names come from."""

    def __init__(self, path: Path) -> None:
        self.file = path.relative_to(ROOT).as_posix()
        self.tree = ast.parse(path.read_bytes())
        self.comments: dict[int, str] = {}
        self.alone: set[int] = set()  # lines that are nothing but a comment
        with path.open("rb") as lines:
            for token in tokenize.tokenize(lines.readline):
                if token.type == tokenize.COMMENT:
                    self.comments[token.start[0]] = token.string.lstrip("# ")
                    if not token.line[: token.start[1]].strip():
                        self.alone.add(token.start[0])
        self.words = ast.get_docstring(self.tree) or ""
        self.imported: dict[str, tuple[str, str]] = {}
        self.aliases: dict[str, Alias] = {}
        self.classes: dict[str, ast.ClassDef] = {}
        for node in self.tree.body:
            if isinstance(node, ast.ImportFrom) and node.module:
                for name in node.names:
                    self.imported[name.asname or name.name] = (node.module, name.name)
            elif isinstance(node, ast.ClassDef):
                self.classes[node.name] = node
            elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                name_of_alias = node.targets[0].id
                if name_of_alias[:1].isupper() and isinstance(
                    node.value, ast.Subscript | ast.BinOp
                ):
                    self.aliases[name_of_alias] = Alias(node.value, self.beside(node))

    def beside(self, node: ast.stmt) -> str:
        """The comments on the lines of a statement, and one that stands alone on the line before it."""
        first = node.lineno - (node.lineno - 1 in self.alone)
        lines = range(first, (node.end_lineno or node.lineno) + 1)
        return " ".join(self.comments.get(line, "") for line in lines)

    def cites(self) -> bool:
        """Whether any docstring or comment of the file names a paper, a standard or a library."""
        documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
        nodes = (node for node in ast.walk(self.tree) if isinstance(node, documented))
        return any(
            CITATION.search(text or "")
            for text in (*map(ast.get_docstring, nodes), *self.comments.values())
        )


@cache
def source_of(module: str) -> ParsedFile | None:
    """The parsed module of a dotted name; None where it is not one of the project's own."""
    path = ROOT / (module.replace(".", "/") + ".py")
    if not path.exists():
        path = ROOT / module.replace(".", "/") / "__init__.py"
    return ParsedFile(path) if path.exists() else None


class AnnotationKind(NamedTuple):
    """What an annotation is made of."""

    array: bool
    real: bool
    whole: bool
    words: str  # comments of aliases, and texts in the annotation: the help of an option


def kind_of(source: ParsedFile, annotation: ast.expr | None) -> AnnotationKind:
    """Looks through aliases, unions and containers. A `Callable` or a `type` holds no value."""
    array = real = whole = False
    words = []
    stack: list[tuple[ParsedFile, ast.expr, bool]] = (
        [(source, annotation, True)] if annotation else []
    )
    while stack:
        here, node, bare = stack.pop()
        if isinstance(node, ast.Constant):
            if isinstance(node.value, str):
                words.append(node.value)
                if node.value.isidentifier():
                    stack.append((here, ast.Name(node.value), bare))
        elif isinstance(node, ast.BinOp):
            stack += [(here, node.left, bare), (here, node.right, bare)]
        elif isinstance(node, ast.Attribute | ast.Name):
            name = node.id if isinstance(node, ast.Name) else node.attr
            array |= name in ("NDArray", "ndarray", "ArrayLike")
            real |= name == "float"
            whole |= name == "int" and bare
            found = _alias(here, name) if isinstance(node, ast.Name) else None
            if found:
                words.append(found[1].words)
                stack.append((found[0], found[1].value, bare))
        elif isinstance(node, ast.Subscript):
            name = ast.unparse(node.value).rpartition(".")[2]
            if name == "NDArray":
                array = True
            elif name == "Annotated" and isinstance(node.slice, ast.Tuple):
                stack.append((here, node.slice.elts[0], bare))
                words += [
                    text.value
                    for text in ast.walk(node.slice)
                    if isinstance(text, ast.Constant) and isinstance(text.value, str)
                ]
            elif name not in ("Callable", "type", "Literal"):
                inner = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
                stack += [(here, part, False) for part in inner]
    return AnnotationKind(array, real, whole, " ".join(words))


def _alias(source: ParsedFile, name: str) -> tuple[ParsedFile, Alias] | None:
    if name in source.aliases:
        return source, source.aliases[name]
    module, original = source.imported.get(name, ("", ""))
    other = source_of(module) if module else None
    return (other, other.aliases[original]) if other and original in other.aliases else None


def words_of(text: str) -> list[str]:
    """The words of a name or a sentence, in lower case: `FieldMap.is_free` has four."""
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", text)
    return [word.lower() for word in re.findall(r"[^\W_]+", parted)]


def restates(name: str, doc: str, least: int = 2) -> bool:
    """Whether a docstring has fewer than `least` words that the name does not have."""
    known = {word[:5] for word in words_of(name)}
    words = set(words_of(doc)) - WEAK
    return sum(word[:5] not in known for word in words) < least


def _has_unit(name: str) -> bool:
    return words_of(name)[-1:] != [] and any(part in UNIT_PARTS for part in words_of(name)[-2:])


def _is_counted(name: str) -> bool:
    """Whether a name says what its integer is: a kind, a plural, or a unit."""
    last = (words_of(name) or [""])[-1]
    plural = last.endswith("s") and not last.endswith("ss") and len(last) > 3
    return last in KINDS or plural or _has_unit(name)


def _mentions(text: str, name: str) -> bool:
    return re.search(rf"(?<![\w.]){re.escape(name)}(?!\w)", text) is not None


def _paragraphs(text: str) -> list[str]:
    return [paragraph.strip() for paragraph in re.split(r"\n\s*\n", text)]


def _module_describes(source: ParsedFile, name: str) -> bool:
    """Whether the docstring of the module has a paragraph with `name` in backticks and a shape."""
    return any(
        f"`{name}`" in paragraph or f"`{name}[" in paragraph
        for paragraph in _paragraphs(source.words)
        if SHAPE.search(paragraph)
    )


def _states_units(source: ParsedFile) -> bool:
    return any(text.startswith("Units:") for text in _paragraphs(source.words))


class Parameter(NamedTuple):
    """A parameter, or the result, whose name is empty."""

    name: str
    kind: AnnotationKind


def parameters(
    source: ParsedFile, function: ast.FunctionDef | ast.AsyncFunctionDef
) -> list[Parameter]:
    """All but self and cls. One without a type is an array if the function subscripts it."""
    arguments = function.args
    given = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    subscripted = {
        node.value.id
        for node in ast.walk(function)
        if isinstance(node, ast.Subscript | ast.Attribute) and isinstance(node.value, ast.Name)
    }
    kernel = any(_decorator(node) in KERNELS for node in function.decorator_list)
    found = []
    for argument in given:
        if argument.arg in ("self", "cls") or argument.arg.startswith("_"):
            continue
        if argument.annotation is None and kernel:
            array = argument.arg in subscripted
            kind = AnnotationKind(array, False, not array, "")
        else:
            kind = kind_of(source, argument.annotation)
        found.append(Parameter(argument.arg, kind))
    return found


def _decorator(node: ast.expr) -> str:
    call = node.func if isinstance(node, ast.Call) else node
    return ast.unparse(call).rpartition(".")[2]


def _raised(function: ast.AST) -> Iterator[str]:
    """The names of exceptions that the body raises itself; a bare `raise` passes one on."""
    stack = list(ast.iter_child_nodes(function))
    while stack:
        node = stack.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda | ast.ClassDef):
            continue
        if isinstance(node, ast.Raise) and node.exc is not None:
            name = _decorator(node.exc)
            if name not in QUIET and name[:1].isupper():
                yield name
        stack += ast.iter_child_nodes(node)


def judge(
    source: ParsedFile,
    function: ast.FunctionDef | ast.AsyncFunctionDef,
    name: str,
    around: str = "",
) -> list[str]:
    """The reasons why a function's docstring fails, most important first.

    `around` is the docstring of its class: what it says of a parameter need not be said again.
    """
    doc = ast.get_docstring(function) or ""
    reasons = []
    decorators = {_decorator(node) for node in function.decorator_list}
    a_property = bool(decorators & {"property", "cached_property"})
    if not doc:
        reasons.append("exists: no docstring")
    elif restates(name, doc, 1 if a_property else 2):
        reasons.append("exists: only restates the name")
    if a_property:
        return reasons
    signature = " ".join(
        source.comments.get(line, "") for line in range(function.lineno, function.body[0].lineno)
    )
    text = f"{doc} {signature} {around}"
    given = parameters(source, function)
    result = Parameter("", kind_of(source, function.returns))
    reasons += _shapes(source, [*given, result], text)
    reasons += _units(source, given, text)
    if not _has_unit(function.name):
        seen = f"{text} {result.kind.words}"
        if result.kind.real and not UNIT.search(seen) and not _states_units(source):
            reasons.append("unit: of the result")
        elif result.kind.whole and not _is_counted(function.name) and not KIND.search(seen):
            reasons.append("unit: what the result counts or numbers")
    missing = sorted({error for error in _raised(function) if not _mentions(text, error)})
    if missing and not re.search(r"\b[Rr]aises?\b", text):
        reasons.append(f"raises: {', '.join(missing)}")
    return reasons


def _shapes(source: ParsedFile, values: list[Parameter], text: str) -> Iterator[str]:
    arrays = [value for value in values if value.kind.array]
    for name, kind in arrays:
        if SHAPE.search(kind.words) or (name and _module_describes(source, name)):
            continue
        if SHAPE.search(text) and (len(arrays) == 1 or not name or _mentions(text, name)):
            continue
        yield f"shape: of {name or 'the result'}"


def _units(source: ParsedFile, given: list[Parameter], text: str) -> Iterator[str]:
    for name, kind in given:
        if kind.real and not _has_unit(name):
            if not UNIT.search(f"{text} {kind.words}") and not _states_units(source):
                yield f"unit: of {name}"
        elif kind.whole and not _is_counted(name):
            described = _mentions(f"{text} {source.words}", name) or KIND.search(kind.words)
            if not described:
                yield f"unit: what {name} counts or numbers"


def _bases(source: ParsedFile, node: ast.ClassDef) -> Iterator[tuple[ParsedFile, ast.ClassDef]]:
    for base in node.bases:
        name = ast.unparse(base).partition("[")[0]
        here: ParsedFile | None = source
        if name in source.imported:
            module, name = source.imported[name]
            here = source_of(module)
        if here and name in here.classes and here.classes[name] is not node:
            yield here, here.classes[name]
            yield from _bases(here, here.classes[name])


def _inherits_docstring(source: ParsedFile, node: ast.ClassDef, name: str) -> bool:
    return any(
        isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef)
        and item.name == name
        and ast.get_docstring(item)
        for _, base in _bases(source, node)
        for item in base.body
    )


def failures_in(source: ParsedFile) -> tuple[int, list[Failure]]:
    """How many docstrings of a file were checked, and those that fail."""
    checked, failures = 0, []

    def note(node: ast.AST, name: str, reasons: Iterable[str]) -> None:
        nonlocal checked
        checked += 1
        if reasons := tuple(reasons):
            failures.append(Failure(source.file, getattr(node, "lineno", 1), name, reasons))

    if source.file in SOURCED:
        note(source.tree, "(module)", [] if source.cites() else ["source: none is cited"])
    for node in source.tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            if not node.name.startswith("_"):
                note(node, node.name, judge(source, node, node.name))
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            _judge_class(source, node, note)
    return checked, failures


def _judge_class(
    source: ParsedFile,
    node: ast.ClassDef,
    note: Callable[[ast.AST, str, Iterable[str]], None],
) -> None:
    doc = ast.get_docstring(node) or ""
    reasons = []
    if not doc:
        reasons.append("exists: no docstring")
    elif restates(node.name, doc):
        reasons.append("exists: only restates the name")
    note(node, node.name, reasons)
    for item in node.body:
        if not isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        decorators = {_decorator(decorator) for decorator in item.decorator_list}
        if item.name.startswith("_") or decorators & {"overload", "setter", "deleter", "override"}:
            continue
        if not ast.get_docstring(item) and _inherits_docstring(source, node, item.name):
            continue
        note(item, f"{node.name}.{item.name}", judge(source, item, f"{node.name}.{item.name}", doc))


def check(package: str) -> LayerResult:
    """Checks all files below a package or a single module: `crdt`, `agent/paths`, `protocol/name.py`.

    Raises FileNotFoundError where there is none of that name.
    """
    place = ROOT / package
    if not place.exists():
        raise FileNotFoundError(package)
    total, failures = 0, []
    for path in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
        source = source_of(path.relative_to(ROOT).with_suffix("").as_posix().replace("/", "."))
        assert source is not None
        checked, found = failures_in(source)
        total += checked
        failures += found
    return LayerResult(package, total, tuple(failures))


def as_json(results: Iterable[LayerResult]) -> str:
    """The results as a JSON array of objects, one for each package."""
    return json.dumps(
        [
            {
                "package": result.package,
                "checked": result.checked,
                "passing": result.passing,
                "share": round(result.share, 4),
                "failures": [failure._asdict() for failure in result.failures],
            }
            for result in results
        ],
        indent=1,
    )


def main(words: list[str] | None = None) -> int:
    """Prints the failures and a line for each package; the exit code is 1 where any docstring fails."""
    parser = argparse.ArgumentParser(prog="python -m tools.build.docstring_checker")
    parser.add_argument(
        "packages", nargs="*", default=LAYERS, help="crdt, agent/paths, ... (none: all)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of text")
    options = parser.parse_args(words)
    results = [check(package) for package in options.packages]
    if options.json:
        print(as_json(results))
    else:
        for result in results:
            for failure in result.failures:
                print(
                    f"{failure.file}:{failure.line}: {failure.name}: {'; '.join(failure.reasons)}"
                )
        for result in results:
            print(
                f"{result.package}: {result.passing} of {result.checked} pass, {result.share:.1%}"
            )
    return int(any(result.failures for result in results))


if __name__ == "__main__":
    raise SystemExit(main())
