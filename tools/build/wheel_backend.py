"""The build backend of pyproject.toml: setuptools, and a wheel that installs one name.

In the tree the layers are folders of their own, in the wheel they are packages of `headland`. This
module moves them there when a wheel is built, and writes `from agent.peer` as `from
headland.agent.peer`. No line moves, so a traceback names the same line in both. Checkouts, editable
installs and source archives stay as they are.

It runs where nothing but setuptools is installed, and imports nothing of ours.
"""

import ast
import base64
import csv
import hashlib
import io
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from setuptools.build_meta import (
    build_editable,
    build_sdist,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    get_requires_for_build_wheel,
    prepare_metadata_for_build_editable,
)
from setuptools.build_meta import build_wheel as build_flat_wheel

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
]

PACKAGE = "headland"
LAYERS = ("crdt", "protocol", "agent", "sim", "tools")
# What only works on sources; a base install would be a fortieth larger with it.
ONLY_IN_A_CHECKOUT = (
    f"{PACKAGE}/checkout.py",
    "tools/bench/", "sim/rigs/",
    *(f"tools/build/{name}.py" for name in (
        "audit", "docstring_checker", "prose_checker", "release", "site_hooks", "wheel_backend",
    )),
    *(f"tools/cli/{name}.py" for name in (
        "api_page", "chart_pages", "doc_pages", "frame_pages", "route_pages", "state_pages",
    )),
)  # fmt: skip
FROM = re.compile(rb"from\s+")
DATE = (1980, 1, 1, 0, 0, 0)  # the earliest of the format: equal sources make equal wheels
READABLE = 0o644


class LayoutError(Exception):
    """A source or a file that the wheel would not work with. One line."""


class Edit(NamedTuple):
    """Where the package's name is put before that of a layer."""

    line: int  # from 0
    column: int  # in bytes


def build_wheel(
    wheel_directory: str,
    config_settings: Mapping[str, Any] | None = None,
    metadata_directory: str | None = None,
) -> str:
    """The wheel's file name, as PEP 517 asks. Raises LayoutError.

    setuptools works in a folder of its own: one in the tree would keep modules that are gone since.
    """
    with tempfile.TemporaryDirectory() as scratch:
        settings = Path(scratch, "build.cfg")
        settings.write_text(f"[build]\nbuild_base = {scratch}/build\n", encoding="utf-8")
        before = os.environ.get("DIST_EXTRA_CONFIG")
        os.environ["DIST_EXTRA_CONFIG"] = before or str(settings)
        try:
            name: str = build_flat_wheel(scratch, config_settings)
        finally:
            del os.environ["DIST_EXTRA_CONFIG"]
            if before is not None:
                os.environ["DIST_EXTRA_CONFIG"] = before
        with ZipFile(Path(scratch, name)) as flat:
            files = {entry: flat.read(entry) for entry in flat.namelist()}
        with ZipFile(Path(wheel_directory, name), "w", ZIP_DEFLATED) as wheel:
            for path, content in packed(files).items():
                entry = ZipInfo(path, DATE)
                entry.compress_type, entry.external_attr = ZIP_DEFLATED, READABLE << 16
                wheel.writestr(entry, content)
    return name


def packed(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The files of a wheel, by their path, with every layer inside the package. Raises LayoutError."""
    moved: dict[str, bytes] = {}
    record = ""
    for path, content in files.items():
        top, _, rest = path.partition("/")
        if path.startswith(ONLY_IN_A_CHECKOUT) or not rest:
            continue
        if top in LAYERS:
            path = f"{PACKAGE}/{path}"
        elif top != PACKAGE and not top.endswith(".dist-info"):
            raise LayoutError(f"{path}: a wheel may install {PACKAGE} only")
        if path.endswith(".dist-info/RECORD"):
            record = path
        elif path.endswith(".dist-info/top_level.txt"):
            moved[path] = f"{PACKAGE}\n".encode()
        else:
            moved[path] = renamed(content, path) if path.endswith(".py") else content
    moved[record] = _record(moved, record)
    return moved


def renamed(source: bytes, path: str = "source") -> bytes:
    """A module with its imports from layers as imports from the package. Raises LayoutError for
    `import agent.peer`: that binds the name `agent`, which the wheel does not have."""
    lines = source.split(b"\n")
    edits = sorted(set(_edits(ast.parse(source), lines, path)), reverse=True)
    for line, column in edits:
        text = lines[line]
        lines[line] = text[:column] + f"{PACKAGE}.".encode() + text[column:]
    return b"\n".join(lines)


def _edits(tree: ast.Module, lines: list[bytes], path: str) -> Iterator[Edit]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and _in_a_layer(node.module):
            found = FROM.match(lines[node.lineno - 1], node.col_offset)
            assert found is not None, f"{path}:{node.lineno}"
            yield Edit(node.lineno - 1, found.end())
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if _in_a_layer(alias.name):
                    if alias.asname is None:
                        raise LayoutError(f"{path}:{alias.lineno}: import {alias.name}: use `from`")
                    yield Edit(alias.lineno - 1, alias.col_offset)


def _in_a_layer(module: str | None) -> bool:
    return module is not None and module.split(".")[0] in LAYERS


def _record(files: Mapping[str, bytes], own: str) -> bytes:
    """The list of all files with their hashes, as the wheel format asks; its own row has none."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    for path, content in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        rows.writerow([path, f"sha256={digest}", len(content)])
    rows.writerow([own, "", ""])
    return text.getvalue().encode()
