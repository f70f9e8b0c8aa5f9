"""A recording that ends when the disk accepts no more data, and reports this once.

The recorded run continues. A recorder never raises an exception into the wire, because the frame
that is being delivered would be lost.
"""

import logging
from collections.abc import Callable
from typing import Any

log = logging.getLogger(__name__)


def say(message: str) -> None:
    """Report the end of a recording to the log of the program, as an error."""
    log.error("%s", message)


class Ending:
    """Calls a write function until it fails."""

    def __init__(self, name: str, told: Callable[[str], None] = say) -> None:
        """`name`: of the file. `told`: gets the one line for the user, once."""
        self.name, self.told = name, told
        self.why = ""  # why it ended; empty while it continues
        self.lost = 0  # calls that failed or were not made any more

    def __call__(self, write: Callable[..., object], *what: Any) -> None:
        if self.why:
            self.lost += 1
            return
        try:
            write(*what)
        except OSError as problem:
            self.lost += 1
            self.why = problem.strerror or str(problem)
            self.told(f"{self.name}: {self.why}: recording ends, the fleet goes on")

    def close(self, end: Callable[[], object]) -> None:
        """Close, also after a failure: data that could not be written before fails once more."""
        try:
            end()
        except OSError as problem:
            if not self.why:
                self.why = problem.strerror or str(problem)
                self.told(f"{self.name}: {self.why}: its end is not written")
