"""Values that skip typer's validator are those that typer would have made of the same words."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from tests.tools.launching import ENVIRONMENT, ROOT
from tools.cli.headland import app
from tools.cli.plain_values import UNSURE, plain_value

WORDS = (
    None, "", "0", "7", "-3", "+5", "007", "65535", "65536", "-0", "1.5", "1.", ".5", "1e3", "nan", "inf",
    " 7", "7 ", "7_0", "٣", "true", "yes", "stop", "mecanum", "MECANUM", "a/b", ".", "no such file",
    str(2**70), "é", "mcap", True, False, 3, 2.5, Path("a"), (), ("a", "b"), ["1,2"],
)  # fmt: skip
TOOLS = (
    "--help", "--version", "estop --help", "estop", "release", "order 1 wait", "inspect", "say stop",
    "map", "dbc", "keys new",
)  # fmt: skip


def params(command: Any, words: str = "") -> Iterator[tuple[str, Any]]:
    for param in command.params:
        yield f"{words} {param.name}", param
    for name, own in getattr(command, "commands", {}).items():
        yield from params(own, f"{words} {name}")


def test_a_plain_value_is_what_typer_makes_of_it(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    command = typer.main.get_command(app)
    context: Any = command.context_class(command, info_name="headland")
    compared = 0
    for where, param in params(command):
        for word in WORDS:
            plain = plain_value(param, word)
            if plain is UNSURE:
                continue
            runtime = param.get_runtime_param()
            theirs = runtime.coerce(word, param=param, ctx=context)
            assert plain == theirs and type(plain) is type(theirs), f"{where}: {word!r}"
            compared += 1
    assert compared > 2_000


@pytest.mark.parametrize("words", TOOLS)
def test_no_tool_of_the_bus_imports_what_only_checks_words(words: str, tmp_path: Path) -> None:
    """Half of a tool's start was importing pydantic. `say` has models of what a person can want."""
    allowed = {"pydantic"} if words.startswith("say") else set()
    program = (
        "import sys, runpy, atexit\n"
        f"slow = {{'pydantic', 'rich', 'numpy'}} - {allowed!r}\n"
        "atexit.register(lambda: print('loaded:', *slow & set(sys.modules)))\n"
        f"sys.argv = ['headland', *{words.split()!r}]\n"
        "runpy.run_module('headland', run_name='__main__')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env={**ENVIRONMENT, "PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False, timeout=60,
    )  # fmt: skip
    assert done.stdout.splitlines()[-1].strip() == "loaded:", done.stdout + done.stderr
