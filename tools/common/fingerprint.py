"""Which code made a result: a hash of every source that can change it."""

import ast
from collections.abc import Iterable, Iterator
from functools import cache
from hashlib import sha256
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROBOTS = ("crdt", "protocol", "agent")
PACKAGES = (*ROBOTS, "sim")
JUDGED_FROM = "sim/chaos/verdict.py"  # imports all that takes part in a run of chaos


def fingerprint() -> str:
    """Twelve hexadecimal digits of all packages that a result comes from, equal wherever these are the
    same, byte for byte."""
    return _hashed(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


@cache
def robots_fingerprint() -> str:
    """The same of the robots in a run of chaos: the modules of `ROBOTS` that it imports, at once or
    later. A task controller, or a driver of a machine, takes no part in it."""
    return _hashed(path for path in _imported(ROOT / JUDGED_FROM) if _package(path) in ROBOTS)


def _hashed(paths: Iterable[Path]) -> str:
    total = sha256()
    for path in sorted(paths):
        total.update(f"{path.relative_to(ROOT).as_posix()}\0".encode() + path.read_bytes())
    return total.hexdigest()[:12]


def _imported(first: Path) -> set[Path]:
    """A module of ours and those that it imports, with the packages that they are in."""
    found, waiting = set[Path](), [first]
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.add(path)
        waiting += [
            file for name in _names(path) if name.split(".")[0] in PACKAGES for file in _files(name)
        ]
    return found


def _names(path: Path) -> Iterator[str]:
    """The dotted names that a module imports; of `from a import b` it is a.b, which may be a module."""
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _files(name: str) -> Iterator[Path]:
    """The module of a dotted name, if there is one, and each package around it."""
    place = ROOT
    for part in name.split("."):
        place /= part
        yield from (p for p in (place / "__init__.py", place.with_suffix(".py")) if p.exists())


def _package(path: Path) -> str:
    return path.relative_to(ROOT).parts[0]
