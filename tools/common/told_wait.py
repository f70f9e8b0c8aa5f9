"""What a command waits for, and how long at most, on a line of a terminal that goes after the wait.

Pipes and `--json` get nothing of it: nobody waits there, and standard error has one line for an error.
"""

import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

from tools.common.verbosity import Verbosity

TOLD_ABOVE_S = 2.0  # shorter waits need no word
CLEAR = "\r\x1b[K"


@contextmanager
def told_wait(what: str, for_s: float) -> Iterator[None]:
    """A line while the block runs: `what`, and that it takes up to `for_s` seconds."""
    line = f"{what}: up to {for_s:.0f} s; Ctrl-C ends it ..."
    with _shown(line if for_s > TOLD_ABOVE_S else ""):
        yield


def told_loading() -> AbstractContextManager[None]:
    """The same while a command imports what simulations need: two seconds of CPU."""
    return _shown("loading the simulator: a few seconds ...")


@contextmanager
def _shown(line: str) -> Iterator[None]:
    shown = bool(line) and sys.stderr.isatty() and not Verbosity.quiet
    if shown:
        print(line, end="", file=sys.stderr, flush=True)
    try:
        yield
    finally:
        if shown:
            print(CLEAR, end="", file=sys.stderr, flush=True)


def tell_meanwhile(line: str) -> None:
    """Print a line to stderr in place of the one that is shown."""
    print(f"{CLEAR if sys.stderr.isatty() else ''}{line}", file=sys.stderr, flush=True)
