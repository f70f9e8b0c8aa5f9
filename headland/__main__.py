"""The `headland` command, also as `python -m headland`."""

import signal
import sys
import threading
from _thread import interrupt_main
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

INTERRUPTED = 130
AGAIN_S = 0.01  # after a Ctrl-C that was dropped; what dropped it takes microseconds


def main() -> None:
    """The command. Ctrl-C while its modules are loaded, a second on a small machine, is no traceback,
    nor is it one after the last line of the result."""
    try:
        with interrupts_again():
            from tools.cli.entrance import main as entrance

            entrance()
    except KeyboardInterrupt:
        raise SystemExit(INTERRUPTED) from None
    finally:
        # From now on Ctrl-C is the end, as for any tool.
        signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def interrupts_again() -> Iterator[None]:
    """A Ctrl-C that Python drops comes again.

    Where it meets a callback of a weak reference or of C, or a destructor, Python prints it and goes on.
    Each import of a module ends with such a callback. numba compiles with callbacks of C, and fails
    where one has done nothing.
    """
    before = sys.unraisablehook
    drops: list[int] = []

    def dropped(problem: "UnraisableHookArgs") -> None:
        if not issubclass(problem.exc_type, KeyboardInterrupt):
            before(problem)
            return
        # Where Ctrl-C is ignored it was the system's request to end.
        pressed = callable(signal.getsignal(signal.SIGINT))
        number = signal.SIGINT if pressed else signal.SIGTERM
        drops.append(number)
        again = threading.Timer(AGAIN_S, interrupt_main, (number,))
        again.daemon = True
        again.start()

    sys.unraisablehook = dropped
    try:
        yield
    except Exception:
        if drops:
            raise KeyboardInterrupt from None
        raise
    finally:
        sys.unraisablehook = before


if __name__ == "__main__":
    main()
