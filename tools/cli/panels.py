"""How the command line is presented: five panels, old names that still work, and defaults of python-can.

A command names its panel where it is registered: `@app.command(rich_help_panel=LOOK)`. One without a
panel is printed last, under "Commands". A command that only keeps an old name alive is `hidden=True`.
"""

import configparser
import os
import re
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from copy import copy
from math import isfinite
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command_name
from typer.models import CommandInfo

from tools.cli.one_line_errors import interrupted_imports
from tools.cli.plain_values import take_plain_values
from tools.common.verbosity import Verbosity, taken_from

PLAY, LOOK, OPERATE, SET_UP, DEVELOP = "Play", "Look", "Operate", "Set up", "Develop"
PANELS = (PLAY, LOOK, OPERATE, SET_UP, DEVELOP)
# Options that were renamed: an old name is obeyed where a command has only the new one.
RENAMED = {"--agents": "--robots", "--operator-key": "--keys", "--animate": "--film"}
# The files that python-can reads, later ones first (its documentation, "Configuration file").
CAN_FILES = ("can.ini", "~/.canrc", "~/.can", "/etc/can.conf", "~/can.conf")
CAN_KEYS = ("interface", "channel", "bitrate")
# Options whose number is never negative: spans of time, and a factor of it.
SPANS = {"--seconds", "--timeout", "--wait", "--delay", "--since", "--speed"}
POSITIVE = {"--limit"}  # of these 0 would be no time at all
# As `SEED_MAX` of sim/scenarios/scenario.py, whose import takes a second; a test compares them.
SEED_MAX = 2**63 - 1
SHOWN_MAX = 40  # characters of a wrong number
# How a help says what a value is: typer's names of types, which differ by its version, and ours.
KINDS = {
    r"<(?:list\[)?(?:int|float)(?: range)?\]?>": "<number>", r"<(?:list\[)?str\]?>": "<text>",
    r"<(?:list\[)?[Pp]ath\]?>": "<path>",
}  # fmt: skip
RANGES = {
    r"([\d.]+)<=x<=([\d.]+)": r"\1 to \2", r"x>=([\d.]+)": r"\1 or more", r"x<=([\d.]+)": r"at most \1",
}  # fmt: skip
COMPLETION = "_HEADLAND_COMPLETE"  # set by a shell that asks for completion
SHORT_MAX = 200  # characters of a command in the list: its first sentence, wrapped
SETTINGS: dict[str, Any] = {
    "help_option_names": ["-h", "--help"],
    "max_content_width": 200,  # a terminal that is wider is hard to read
}


class Panels(TyperGroup):
    """A group of commands that prints them by panel and obeys old names of options."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """One section for each panel, in the order of `PANELS`."""
        shown = [(n, c) for n, c in self.commands.items() if not c.hidden]
        panel = {name: getattr(command, "rich_help_panel", None) or "" for name, command in shown}
        for title in (*PANELS, *sorted(set(panel.values()) - set(PANELS))):
            rows = [(n, c.get_short_help_str(SHORT_MAX)) for n, c in shown if panel[n] == title]
            if rows:
                with formatter.section(title or "Commands"):
                    formatter.write_dl(rows)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Words of verbosity may stand anywhere."""
        take_plain_values(self.get_params(ctx))
        return super().parse_args(ctx, taken_from(args) if ctx.parent is None else args)

    def invoke(self, ctx: Any) -> Any:
        """With -q, what a command would print for people goes nowhere."""
        if ctx.parent is not None:
            return super().invoke(ctx)
        with interrupted_imports():  # again, because typer has set a hook of its own
            return self._invoke(ctx)

    def _invoke(self, ctx: Any) -> Any:
        if not Verbosity.quiet or "--json" in ctx.args:
            return super().invoke(ctx)
        with Path(os.devnull).open("w", encoding="utf-8") as nowhere, redirect_stdout(nowhere):
            return super().invoke(ctx)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command of the first word, and the rest with the names that it knows."""
        name, command, rest = super().resolve_command(ctx, args)
        if command is None:
            return name, command, rest
        known = {option for param in command.params for option in param.opts}
        if command.help and "\b" not in command.help:  # an example has a line of its own
            command.help = command.help.replace("\nExample:", "\n\nExample:")
        for param in command.params:
            if not isinstance(param.callback, _Number):  # a second call in the same process
                param.callback = _Number(param.callback)
                setattr(param, "get_help_record", _PlainRecord(param.get_help_record))  # noqa: B010
            if param.name == "interface" and param.default == "socketcand":
                ctx.default_map = {name: can_defaults()}
        take_plain_values(command.get_params(ctx))
        return name, command, [_renamed(word, known) for word in rest]


def only_asked(app: typer.Typer, words: Sequence[str]) -> typer.Typer:
    """The application with the one command that `words` ask for, or the whole one where none is found.

    Typer makes all commands with all their options before it runs one, which takes as long as a tool of
    the bus. Help, suggestions and completion need all of them.
    """
    name = next((word for word in words if not word.startswith("-")), "")
    command = _command_called(name, app)
    group = next((each for each in app.registered_groups if each.name == name), None)
    if (command is None and group is None) or COMPLETION in os.environ:
        return app
    asked = copy(app)
    asked.registered_commands = [] if command is None else [command]
    asked.registered_groups = [] if group is None else [group]
    return asked


def _command_called(name: str, app: typer.Typer) -> CommandInfo | None:
    """Of the application, or of those that were added to it without a name of their own."""
    for each in app.registered_commands:
        function = each.callback
        if name == (each.name or (function and get_command_name(function.__name__))):
            return each
    inner = (each.typer_instance for each in app.registered_groups if not each.name)
    found = (_command_called(name, each) for each in inner if each is not None)
    return next((each for each in found if each is not None), None)


class _Number:
    """The callback of an option: what is no number of any use is refused before the command begins."""

    def __init__(self, before: Callable[[Any, Any, Any], Any] | None) -> None:
        self.before = before

    def __call__(self, ctx: Any, param: Any, value: Any) -> Any:
        if self.before is not None:
            value = self.before(ctx, param, value)
        if isinstance(value, float) and not isfinite(value):
            raise typer.BadParameter(f"{value} is not a finite number", ctx, param)
        if isinstance(value, float) and value < 0 and not SPANS.isdisjoint(param.opts):
            raise typer.BadParameter(f"{value:g} is negative; it needs 0 or more", ctx, param)
        if isinstance(value, float) and value <= 0 and not POSITIVE.isdisjoint(param.opts):
            raise typer.BadParameter(f"{value:g} is too short; it needs more than 0", ctx, param)
        if isinstance(value, int) and "--seed" in param.opts and not 0 <= value <= SEED_MAX:
            raise typer.BadParameter(f"{_short(value)}: a seed is 0 to {SEED_MAX}", ctx, param)
        return value


def _short(value: int) -> str:
    """A number as it was written, or that it is too long for a line."""
    text = str(value) if value.bit_length() < 4096 else "a longer number"  # `str` refuses those
    return text if len(text) <= SHOWN_MAX else f"{text[:SHOWN_MAX]}..."


class _PlainRecord:
    """The `get_help_record` of one parameter, with words for people instead of names of types.

    >>> _PlainRecord(lambda ctx: ("--port <int range>", "Of the bus.  [default: 0; 0<=x<=9]"))(None)
    ('--port <number>', 'Of the bus.  [default: 0; 0 to 9]')
    >>> _PlainRecord(lambda ctx: ("--log <list[Path]>", "[x>=1.0]"))(None)
    ('--log <path>', '[1.0 or more]')
    """

    def __init__(self, by_typer: Callable[[Any], Any]) -> None:
        self.by_typer = by_typer

    def __call__(self, ctx: Any) -> Any:
        record = self.by_typer(ctx)
        if record is None:  # a hidden parameter
            return None
        names, told = record
        for kind, plain in KINDS.items():
            names = re.sub(kind, plain, names)
        for span, plain in RANGES.items():
            told = re.sub(span, plain, told)
        return names, told


def _renamed(word: str, known: set[str]) -> str:
    option, equals, value = word.partition("=")
    new = RENAMED.get(option)
    if new is None or option in known or new not in known:
        return word
    return f"{new}{equals}{value}"


def can_defaults(files: Sequence[str] = CAN_FILES) -> dict[str, str]:
    """Interface, channel and bit rate from the configuration file of python-can, where there is one.

    `CAN_INTERFACE`, `CAN_CHANNEL` and `CAN_BITRATE` come before the file, options of the command line
    before both. A file that cannot be read counts as none, as for python-can.
    """
    found = configparser.ConfigParser(interpolation=None)
    paths = [str(Path(name).expanduser()) for name in reversed(files)]
    try:
        found.read(paths, encoding="utf-8")
        values = found["default"] if "default" in found else found.defaults()
        return {key: values[key] for key in CAN_KEYS if key in values}
    except (configparser.Error, UnicodeDecodeError):
        return {}


def version_text() -> str:
    """Name and version, as `--version` prints them."""
    from importlib.metadata import PackageNotFoundError, version  # slow, and needed for this alone

    try:
        return f"headland {version('headland')}"
    except PackageNotFoundError:
        return "headland (not installed)"


def show_version(asked: bool) -> None:
    """Print the version and end, where it is asked for."""
    if asked:
        typer.echo(version_text())
        raise typer.Exit
