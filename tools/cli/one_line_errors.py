"""Errors that a person can cause and no command handles: one line on stderr, and an exit code."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper

from tools.common import extras
from tools.common.exit_codes import INTERRUPTED, code_of, wrong
from tools.common.verbosity import Verbosity


@contextmanager
def one_line_errors() -> Iterator[None]:
    """A missing package of an extra, a full disk, a folder that is none, Ctrl-C, a name that is no
    text."""
    _open_streams()
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")  # as stderr has it
    try:
        try:
            yield
        finally:
            sys.stdout.flush()  # what cannot be written shows here, and not when Python ends
    except KeyboardInterrupt:
        raise SystemExit(INTERRUPTED) from None
    except ImportError as problem:
        missing = extras.needed(problem)
        if missing is None:
            raise
        raise SystemExit(wrong(missing)) from None
    except OSError as problem:
        tell_origin()
        name = "" if problem.filename is None else f"{problem.filename}: "
        print(f"headland: {name}{problem.strerror or problem}", file=sys.stderr)
        _drop_output()
        raise SystemExit(code_of(problem)) from None


def _open_streams() -> None:
    """A stream that was closed before the start (`>&-`) is the null device.

    Python has None for it, which nothing can ask whether it is a terminal, and the next file that is
    opened would get its number.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):  # the lowest number first
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode, encoding="utf-8"))


def _drop_output() -> None:
    """What could not be written is not tried again when Python ends: that would be a second error."""
    try:
        sys.stdout.flush()
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def tell_origin() -> None:
    """With -v: where the error came from, before its one line."""
    if Verbosity.verbose:
        import traceback

        traceback.print_exc()
