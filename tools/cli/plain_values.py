"""Values of the command line that are plainly right, without the validator of typer.

typer checks each value by pydantic, and importing pydantic takes longer than anything else that a tool
of the bus does at its start. Most values need no validator: an absent one, a default, a word, a whole
number. All others still go to typer, so what is accepted and what an error says stay as typer has them.
"""

import os
import re
from pathlib import Path
from typing import Any, Final, Literal, get_args, get_origin

import typer

UNSURE: Final = object()  # for typer to decide
INT: Final = re.compile(r"[+-]?[0-9]{1,18}")
FLOAT: Final = re.compile(r"[+-]?[0-9]{1,15}(\.[0-9]{1,15})?")
NUMBERS: Final = {"number": "not a number", "integer": "not a whole number"}  # kind: what to say
# What a command may ask of a path beyond its name; all of them are false where it does not.
PATH_CHECKS: Final = ("exists", "writable", "resolve_path", "allow_dash")


class PlainValue:
    """The `process_value` of one parameter (click's name for it)."""

    def __init__(self, param: Any) -> None:
        self.param = param
        self.by_typer = param.process_value

    def __call__(self, ctx: Any, value: Any) -> Any:
        """The value for the command; whatever `process_value` of typer raises if it cannot be one."""
        plain = plain_value(self.param, value)
        if plain is UNSURE:
            try:
                return self.by_typer(ctx, value)
            except typer.BadParameter as problem:
                if not isinstance(value, str):
                    raise
                raise typer.BadParameter(plainly(problem.message, value), ctx, self.param) from None
        callback = self.param.callback
        return plain if callback is None else callback(ctx, self.param, plain)


def plainly(message: str, value: str) -> str:
    """What the validator says of one word, in words for people, with the word itself.

    >>> plainly("Input should be a valid number, unable to parse string as a number", "5min")
    "'5min' is not a number; write it in digits, without a unit"
    >>> plainly("Input should be less than or equal to 65535", "70000")
    "'70000' should be less than or equal to 65535"
    """
    for kind, told in NUMBERS.items():
        if message.startswith(f"Input should be a valid {kind}"):
            return f"'{value}' is {told}; write it in digits, without a unit"
    if message.startswith("Input should be "):
        return f"'{value}' {message.removeprefix('Input ')}"
    return message.removeprefix("Value error, ")


def take_plain_values(params: list[Any]) -> None:
    """From now on the plain values of these parameters reach their command without pydantic."""
    for param in params:
        # Older typers have no descriptor of types, and check by click, which is loaded anyway.
        if hasattr(param, "type_descriptor") and not isinstance(param.process_value, PlainValue):
            param.process_value = PlainValue(param)


def plain_value(param: Any, value: Any) -> Any:
    """What typer would make of `value`, or UNSURE."""
    info = param.type_descriptor.parameter_info
    kind = param.type_descriptor.annotation
    if info.parser is not None or (param.required and not value):
        return UNSURE
    if get_origin(kind) is not list:
        return None if value is None and param.nargs == 1 else _one(kind, value, info)
    if value is None:
        return ()
    if not isinstance(value, (list, tuple)):
        return UNSURE
    values = [_one(get_args(kind)[0], each, info) for each in value]
    return UNSURE if any(each is UNSURE for each in values) else values


def _one(kind: Any, value: Any, info: Any) -> Any:
    if kind is bool or kind is str:
        return value if type(value) is kind else UNSURE
    if kind is int or kind is float:
        return _number(kind, value, info)
    if kind is Path:
        return _path(value, info)
    if get_origin(kind) is Literal and isinstance(value, str) and value in get_args(kind):
        return value
    return UNSURE


def _path(value: Any, info: Any) -> Any:
    if any(getattr(info, name) for name in PATH_CHECKS) or info.path_type is not None:
        return UNSURE
    if not (info.file_okay and info.dir_okay and isinstance(value, (str, Path))):
        return UNSURE
    path = Path(value)
    return path if os.access(path, os.R_OK) or not os.path.lexists(path) else UNSURE


def _number(kind: type, value: Any, info: Any) -> Any:
    if isinstance(value, str) and (INT if kind is int else FLOAT).fullmatch(value):
        value = kind(value)
    if type(value) is not kind or info.clamp:
        return UNSURE
    if (info.min is not None and value < info.min) or (info.max is not None and value > info.max):
        return UNSURE
    return value
