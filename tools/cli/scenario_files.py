"""`headland list` and `new`: which scenario files there are, and a copy to begin with.

Nothing here loads what runs need, which would take most of the time.
"""

import json
import re
from pathlib import Path
from shlex import quote

from rich.console import Console
from rich.markup import escape

from agent.runtime.files.given_file import SCENARIO_BYTES_MAX, read_text
from sim.files.strict_json import dumps
from sim.files.whole_file import write_whole
from sim.scenarios.scenario import SHIPPED, ScenarioError
from sim.scenarios.scenario_kind import Kind, all_shipped, named
from tools.common.exit_codes import code_of, wrong

FILE_KEY = re.compile(r'^(?:file|map|tasks) = "([^"\n]+)"', re.M)


def list_shipped(as_json: bool) -> int:
    """The exit code of `headland list`, which is 0."""
    rows = [
        {"name": name, "kind": named(name).kind.value, "about": _about(path), "file": str(path)}
        for name, path in all_shipped().items()
    ]
    if as_json:
        print(dumps(rows))
        return 0
    console = Console(highlight=False)
    width = max(len(row["name"]) for row in rows)
    for kind in Kind:
        own = [row for row in rows if row["kind"] == kind.value]
        if own:
            console.print(f"[bold]{kind.value}[/bold]")
            for row in own:
                console.print(f"  {row['name']:<{width}}  {escape(row['about'])}", soft_wrap=True)
    console.print("[bold]grid[/bold]\n  any .map (Moving AI) or .mcpp file", highlight=False)
    return 0


def _about(path: Path) -> str:
    """The first sentence of the comment with which a scenario begins."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.removeprefix("#").strip())
    first = re.match(r".*?[.](?= |$)", " ".join(lines))
    return first[0] if first else " ".join(lines)


def new(file: Path, like: str, as_json: bool) -> int:
    """The exit code of `headland new`: 2 or 75 where nothing was written."""
    ships = all_shipped()
    try:
        if like not in ships:
            raise ScenarioError(f"--like {like}: is none of {', '.join(sorted(ships))}")
        if file.suffix != ".toml":
            raise ScenarioError(f"{file}: a scenario file ends in .toml")
        if any("\ud800" <= letter <= "\udfff" for letter in str(file)):  # bytes that are no UTF-8
            raise ScenarioError(f"{str(file)!a}: is no UTF-8; choose another name")
        source = ships[like]
        text = read_text(source, SCENARIO_BYTES_MAX)
        line = f"name = {json.dumps(file.stem[:64], ensure_ascii=False)}"  # escaped as in TOML
        text = re.sub(r'^name = ".*"', lambda _: line, text, count=1, flags=re.M)
        beside = [
            name for name in FILE_KEY.findall(text) if not (SHIPPED / name).exists()
        ]  # what ships with fields is found anyway
        written = [file, *(file.parent / name for name in beside)]
        for path in written:
            if path.exists():
                raise ScenarioError(f"{path} is there already: choose another name")
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            for name in beside:
                write_whole(file.parent / name, (source.parent / name).read_bytes())
            write_whole(file, text)
        except BaseException:
            for path in written:
                path.unlink(missing_ok=True)  # none was there before
            raise
    except ScenarioError as problem:
        return wrong(problem)
    except OSError as problem:
        why = f"cannot be written: {problem.strerror}; choose another folder"
        return wrong(f"{file}: {why}", code_of(problem))
    if as_json:
        print(dumps({"written": [str(path) for path in written], "like": like}))
    else:
        print(f"{', '.join(map(str, written))}: a copy of {like}; its keys: docs/use/scenario.md")
        words = quote(str(file))  # as a shell reads it
        print(f"next:\n  headland check {words}\n  headland run {words}")
    return 0
