"""The entrance of `headland`: a robot on a machine starts without the command line's libraries.

`headland robot FILE` with the words of a service is read here, so that a robot loads neither typer nor
rich: less memory, and a tenth of its start. Every other word, a wrong one too, goes to the command line,
which reads the same options (`tools/cli/robot_commands.py`) and says what is wrong.
"""

import gc
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from tools.cli.one_line_errors import hung_up_as_terminated, one_line_errors
from tools.common.compiled_caches import guard
from tools.common.gc_collector import GC_YOUNG, not_taken_apart

NAMES: Final = {
    "--slot": "slot", "-i": "interface", "--interface": "interface", "-c": "channel",
    "--channel": "channel", "--body": "body",
}  # fmt: skip
# Plug-ins of pydantic are looked for in every installed package. Models of ours have none.
PYDANTIC_PLUGINS: Final = "PYDANTIC_DISABLE_PLUGINS"


class RobotWords(NamedTuple):
    """What `headland robot` was told."""

    file: Path
    slot: int | None = None
    interface: str | None = None
    channel: str | None = None
    body: str | None = None
    first_boot: bool = False
    dry: bool = False


def robot_words(words: Sequence[str]) -> RobotWords | None:
    """The words of a robot that is to run; None where the command line has to read them."""
    if not words or words[0] != "robot":
        return None
    files: list[str] = []
    values: dict[str, str] = {}
    switches: set[str] = set()
    rest = iter(words[1:])
    for word in rest:
        if word in NAMES:
            value = next(rest, "-")
            if value.startswith("-") or not value or NAMES[word] in values:
                return None
            values[NAMES[word]] = value
        elif word in ("--first-boot", "--dry"):
            switches.add(word)
        elif word.startswith("-") or not word:
            return None
        else:
            files.append(word)
    slot = values.pop("slot", None)
    if len(files) != 1 or not (slot is None or (slot.isascii() and slot.isdecimal())):
        return None
    return RobotWords(
        Path(files[0]), None if slot is None else int(slot), **values,
        first_boot="--first-boot" in switches, dry="--dry" in switches,
    )  # fmt: skip


def main() -> None:
    """The `headland` command."""
    not_taken_apart()
    words = robot_words(sys.argv[1:])
    if words is None:
        from tools.cli.headland import main as command_line

        command_line()
        return
    gc.set_threshold(GC_YOUNG)
    guard()
    os.environ.setdefault(PYDANTIC_PLUGINS, "__all__")
    with one_line_errors(), hung_up_as_terminated():
        from agent.runtime.ready_kernels import use_ready_kernels

        use_ready_kernels()  # before anything is imported that has kernels
        from agent.runtime.robot_file import Changes
        from tools.run.robot_command import robot

        changes = Changes(words.slot, words.interface, words.channel, words.body)
        raise SystemExit(robot(words.file, changes, first_boot=words.first_boot, dry=words.dry))


if __name__ == "__main__":
    main()
