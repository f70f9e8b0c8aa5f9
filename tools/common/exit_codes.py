"""Exit codes that all commands share; `docs/use/command_line.md` says what each code means."""

import sys
from typing import Final

WRONG: Final = 2  # nothing was done: a wrong word, file or value, or a missing package
INTERRUPTED: Final = 130  # ended by Ctrl-C; shells have 128 and the number of the signal


def wrong(problem: object) -> int:
    """Print what is wrong as one line; returns the exit code."""
    print(f"headland: {problem}", file=sys.stderr)
    return WRONG
