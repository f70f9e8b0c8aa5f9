"""Each tutorial is carried out as it stands, block by block, in an empty folder.

A block behind "Write `NAME`" is that file. A block without a language is typed into a shell. A block that
begins with a command that runs until it is ended stays running, as in a terminal of its own.
"""

import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.tools.launching import ENVIRONMENT, ROOT

TUTORIALS = ROOT / "docs" / "use" / "tutorials"
WAIT_S = 600.0  # for one command, on a busy machine
STAYS = {  # commands that run until they are ended, and what they say when they are ready
    "headland launch": r"(?:\d:\w+ *)+$", "headland hub": r"socketcand", "headland robot": r"is up",
}  # fmt: skip
COLUMNS = 80  # wide enough for the narrowest page


class Block(NamedTuple):
    """One code block of a page."""

    file: str  # it is the text of this file; empty: commands, or output
    language: str
    text: str


def blocks(page: Path) -> Iterator[Block]:
    text = page.read_text()
    end = 0
    for found in re.finditer(r"```(\w*)\n(.*?)```", text, re.S):
        before = text[end : found.start()].rstrip().rsplit("\n\n", 1)[-1]
        named = re.match(r"(?:.*\s)?Write `([\w.]+)`", before, re.S)
        yield Block(named[1] if named else "", found[1], found[2])
        end = found.end()


class Terminals:
    """The commands of a tutorial, in one folder; those that stay are ended at the end."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.open: list[subprocess.Popen[str]] = []

    def type(self, line: str) -> None:
        command = ["-m", "tools.cli.headland"] if line.startswith("headland ") else []
        words = [sys.executable, *command, *shlex.split(line, comments=True)[1:]]
        environment = {**ENVIRONMENT, "PYTHONPATH": f"{self.folder}:{ROOT}"}
        ready = next((said for begin, said in STAYS.items() if line.startswith(begin)), None)
        if ready is not None and "--check" not in line:
            self._stay(words, ready, environment)
            return
        done = subprocess.run(
            words, cwd=self.folder, capture_output=True, text=True, check=False, timeout=WAIT_S,
            env=environment, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        assert done.returncode == 0, (line, done.stdout[-2000:], done.stderr[-2000:])
        assert "Traceback" not in done.stderr, (line, done.stderr)

    def _stay(self, words: list[str], ready: str, environment: dict[str, str]) -> None:
        process = subprocess.Popen(
            words, cwd=self.folder, env=environment, text=True, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        self.open.append(process)
        assert process.stdout is not None
        said, end_s = "", time.monotonic() + WAIT_S
        for line in process.stdout:
            said += line
            if re.search(ready, line.strip()):
                return
            assert time.monotonic() < end_s, said
        raise AssertionError((words, said))

    def end(self) -> None:
        """Ctrl-C in each terminal, the newest first."""
        for process in reversed(self.open):
            process.send_signal(signal.SIGINT)
            try:
                process.communicate(timeout=WAIT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(page.stem for page in TUTORIALS.glob("*.md")))
def test_a_tutorial_works_as_it_stands(name: str, tmp_path: Path) -> None:
    terminals = Terminals(tmp_path)
    typed = 0
    try:
        for block in blocks(TUTORIALS / f"{name}.md"):
            if block.file:
                (tmp_path / block.file).write_text(block.text)
            elif not block.language:
                for line in filter(None, map(str.strip, block.text.splitlines())):
                    terminals.type(line)
                    typed += 1
    finally:
        terminals.end()
    assert typed >= 2, "a block was not found"


@pytest.mark.parametrize("page", sorted(TUTORIALS.glob("*.md")), ids=lambda page: page.stem)
def test_a_tutorial_has_blocks_of_a_narrow_page(page: Path) -> None:
    for block in blocks(page):
        assert block.language in ("", "toml", "python", "text", "json"), block
        assert block.file or block.language != "toml", (
            f"{page.name}: which file is this? {block.text}"
        )
        for line in block.text.splitlines():
            assert len(line) <= COLUMNS, f"{page.name}: {line}"


def test_there_is_a_tutorial_for_each_thing_that_people_begin_with() -> None:
    assert {page.stem for page in TUTORIALS.glob("*.md")} == {
        "warehouse", "exploration", "grid", "stop", "chaos", "robot", "mission",
    }  # fmt: skip


def test_the_mission_of_the_tutorial_is_the_example() -> None:
    found = {block.file: block.text for block in blocks(TUTORIALS / "mission.md")}
    assert found["posts.py"] == (ROOT / "examples" / "posts.py").read_text()
