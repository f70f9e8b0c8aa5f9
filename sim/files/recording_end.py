"""A recording that ends when the disk takes no more, and says so once.

What is recorded goes on: a recorder never raises into the wire, where it would lose the frame that is
being delivered.
"""

import logging
from collections.abc import Callable
from typing import Any

log = logging.getLogger(__name__)


def say(message: str) -> None:
    log.error("%s", message)


class Ending:
    """Calls what writes, until it fails."""

    def __init__(self, name: str, told: Callable[[str], None] = say) -> None:
        """`name`: of the file. `told`: the one line for a person, once."""
        self.name, self.told = name, told
        self.why = ""  # it ended; empty: it goes on
        self.lost = 0  # calls that were not made any more, or failed

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
        """Also of one that has ended: what it could not write before fails once more."""
        try:
            end()
        except OSError as problem:
            if not self.why:
                self.why = problem.strerror or str(problem)
                self.told(f"{self.name}: {self.why}: its end is not written")
