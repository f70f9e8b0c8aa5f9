"""Exit codes that all commands share; `docs/use/command_line.md` says what each code means."""

import sys
from errno import EDQUOT, EIO, ENOSPC
from typing import Final

WRONG: Final = 2  # nothing was done: a wrong word, file or value, or a missing package
TRY_AGAIN: Final = 75  # EX_TEMPFAIL of sysexits.h: the same command may succeed later
NO_ROOM: Final = (ENOSPC, EDQUOT, EIO)  # of a disk that is full or does not answer
INTERRUPTED: Final = 130  # ended by Ctrl-C; shells have 128 and the number of the signal


def wrong(problem: object, code: int | None = None) -> int:
    """Print what is wrong as one line; returns the exit code. `code`: None for that of the problem."""
    # A name or a value may have line ends in it, and programs read one line.
    print("headland:", " ".join(str(problem).splitlines()), file=sys.stderr)
    if code is not None:
        return code
    return code_of(problem) if isinstance(problem, Exception) else WRONG


def code_of(problem: Exception) -> int:
    """The exit code of what ended a command: 75 where a disk takes no more data, else 2.

    An error of our own may tell of a disk, which is then the error that was handled meanwhile.
    """
    cause: BaseException | None = problem
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in NO_ROOM:
            return TRY_AGAIN
        cause = cause.__context__
    return WRONG
