"""Errors that a person can cause and no command handles: one line on stderr, and an exit code."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from typing import Any

from tools.common import extras
from tools.common.exit_codes import INTERRUPTED, code_of, wrong
from tools.common.verbosity import Verbosity

STRICT = ("strict", "surrogateescape")  # the second in the C locale; neither writes any letter


@contextmanager
def one_line_errors() -> Iterator[None]:
    """A missing package of an extra, a full disk, a folder that is none, Ctrl-C, a name that is no
    text."""
    _open_streams()
    for size in ("COLUMNS", "LINES"):  # 0 says that it is unknown; rich would print nothing
        if os.environ.get(size, "").strip(" 0") == "":
            os.environ.pop(size, None)
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors in STRICT:
        sys.stdout.reconfigure(errors="backslashreplace")  # as stderr has it
    if isinstance(sys.stdin, TextIOWrapper) and sys.stdin.errors in STRICT:
        # A byte that is no text would end the thread that reads what a person types.
        sys.stdin.reconfigure(errors="backslashreplace")
    try:
        try:
            with interrupted_imports():
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
        code = wrong(f"{name}{problem.strerror or problem}", code_of(problem))
        _drop_output()
        raise SystemExit(code) from None


@contextmanager
def interrupted_imports() -> Iterator[None]:
    """Ctrl-C in an import ends a command as it does later.

    numpy's C interface, by which shapely and others import it, prints the KeyboardInterrupt that it
    meets, and raises an ImportError in its place.
    """
    before, interrupts = sys.excepthook, []

    def unprinted(kind: type[BaseException], problem: BaseException, trace: Any) -> None:
        if isinstance(problem, KeyboardInterrupt):
            interrupts.append(problem)
        else:
            before(kind, problem, trace)

    sys.excepthook = unprinted
    try:
        yield
    except Exception:
        if interrupts:
            raise KeyboardInterrupt from None
        raise
    finally:
        if sys.excepthook is unprinted:
            sys.excepthook = before


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """The system's request to end (SIGTERM) ends a command as Ctrl-C does: its files are whole, its
    processes end too, and its exit code is the same.

    A signal that is ignored stays so. A process that was forked meanwhile ends by the signal."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    command = os.getpid()

    def interrupt(number: int, frame: object) -> None:
        if os.getpid() == command:
            raise KeyboardInterrupt
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)

    before = signal.getsignal(signal.SIGTERM)
    if before == signal.SIG_DFL:
        signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        if before == signal.SIG_DFL:
            signal.signal(signal.SIGTERM, before)


@contextmanager
def hung_up_as_terminated() -> Iterator[None]:
    """A terminal that is closed (SIGHUP) ends a command as SIGTERM does. A signal that is ignored, as
    with `nohup`, stays so."""
    hang_up = getattr(signal, "SIGHUP", None)  # Windows has none
    main_thread = threading.current_thread() is threading.main_thread()
    if hang_up is None or not main_thread or signal.getsignal(hang_up) != signal.SIG_DFL:
        yield
        return
    terminals = [number for number in (0, 1, 2) if os.isatty(number)]

    def terminate(number: int, frame: object) -> None:
        for terminal in terminals:
            if not os.isatty(terminal):  # a line for a terminal that is gone would be an error
                nowhere = os.open(os.devnull, os.O_RDWR)
                os.dup2(nowhere, terminal)
                os.close(nowhere)
        os.kill(os.getpid(), signal.SIGTERM)

    signal.signal(hang_up, terminate)
    try:
        yield
    finally:
        signal.signal(hang_up, signal.SIG_DFL)


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
