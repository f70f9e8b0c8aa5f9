"""Every command that the documents and the help texts show, as it stands there."""

import re
import shlex
from pathlib import Path
from typing import NamedTuple

import typer

from tools.cli.headland import WRONG_WORDS, app

ROOT = Path(__file__).parents[2]
FENCE = re.compile(r"```(\w*)\n(.*?)```", re.S)
INLINE = re.compile(r"`([^`]+)`")
BEGINS = ("headland ", "python -m ")
# What stands for a reader's own choice, and one that the parser takes.
STANDS_FOR = {
    "SCENARIO": "small", "N": "2", "S": "1", "DIR": "out", "MAP": "floor.map", "K": "2", "ARENA": "ring",
    "OUT": "out", "PLAN": "vacuum_plan.json", "PORT": "29536", "STORY.toml": "story.toml",
    "HOST": "127.0.0.1", "TASKDATA/": "TASKDATA",
}  # fmt: skip


class Shown(NamedTuple):
    where: str  # file
    text: str
    whole: bool = True  # False: in a sentence, which may name a command without its arguments

    @property
    def words(self) -> list[str]:
        named = re.compile("|".join(rf"\b{re.escape(k)}(?![\w=])" for k in STANDS_FOR))
        words = shlex.split(self.text.split(" > ")[0], comments=True)
        return [named.sub(lambda m: STANDS_FOR[m[0]], word) for word in words]


def shown() -> list[Shown]:
    found: list[Shown] = []
    today = (
        path for path in sorted((ROOT / "docs").rglob("*.md")) if path.parent.name != "history"
    )
    for path in (ROOT / "README.md", *today):
        text = path.read_text()
        for language, block in FENCE.findall(text):
            if not language:
                found += [Shown(path.name, line) for line in lines_of(block)]
        inline = INLINE.findall(FENCE.sub("", text))
        found += [Shown(path.name, " ".join(code.split()), False) for code in inline]
    for path in sorted((ROOT / "tools").rglob("*.py")):
        for line in re.findall(r"Example: (headland .*)", path.read_text()):
            parts = re.split(r", (?:then[^:]*|or on a real bus): (?=headland )", line)
            found += [Shown(path.name, part) for part in parts]
    return list(dict.fromkeys(s for s in found if s.text.startswith(BEGINS)))


def lines_of(block: str) -> list[str]:
    """The lines of a block as a shell reads them: what a backslash continues is one line, and `$NAME`
    is what an earlier line of the block has set."""
    lines: list[str] = []
    values: dict[str, str] = {}
    for line in block.replace("\\\n", " ").splitlines():
        line = re.sub(r"\$([A-Z]+)", lambda m: values.get(m[1], m[0]), " ".join(line.split()))
        if (assigned := re.fullmatch(r"([A-Z]+)=\"?([^\"]*)\"?", line)) is not None:
            values[assigned[1]] = assigned[2]
        else:
            lines.append(line)
    return lines


def blocks(name: str) -> list[tuple[str, str]]:
    """Language and text of every block of a document."""
    return FENCE.findall((ROOT / "docs" / name).read_text())


def parse(words: list[str], whole: bool) -> None:
    """As the command line does, and no further. Raises click's UsageError."""
    try:
        _parse(words)
    except WRONG_WORDS as problem:
        if whole or type(problem).__name__ not in ("MissingParameter", "NoArgsIsHelpError"):
            raise


def _parse(words: list[str]) -> None:
    command = typer.main.get_command(app)
    context = command.make_context("headland", words[1:], resilient_parsing=False)
    while hasattr(command, "resolve_command"):
        rest = [*context._protected_args, *context.args]
        _, command, rest = command.resolve_command(context, rest)
        assert command is not None
        context = command.make_context(command.name, rest, parent=context)
