"""What ends a process: signals, Ctrl-C or the system's request, and a closed input. On POSIX and on
Windows."""

import asyncio
import contextlib
import os
import signal
import sys
from collections.abc import Callable
from threading import Thread

ENDS = (signal.SIGINT, signal.SIGTERM)
HANG_UP = getattr(signal, "SIGHUP", None)  # a terminal that is closed; Windows has none


def on_end(
    loop: asyncio.AbstractEventLoop, end: Callable[[], object],
    numbers: tuple[signal.Signals, ...] = ENDS,
) -> None:  # fmt: skip
    """Call `end` in the loop when one of the signals comes. Only in the main thread (ValueError).

    With SIGTERM also when the terminal is closed (SIGHUP), unless that is ignored, as with `nohup`, or
    there is a handler for it already."""
    ends = list(numbers)
    if (
        HANG_UP is not None
        and signal.SIGTERM in numbers
        and signal.getsignal(HANG_UP) == signal.SIG_DFL
    ):
        ends.append(HANG_UP)
    for number in ends:
        try:
            loop.add_signal_handler(number, end)
        except NotImplementedError:  # the loop of Windows has none
            signal.signal(number, lambda *_: loop.call_soon_threadsafe(end))


def on_closed_input(loop: asyncio.AbstractEventLoop, end: Callable[[], object]) -> None:
    """Call `end` when the process that started this one closes the pipe of its input, or is gone.

    It writes no more, so a readable pipe is a closed one. This is also how a robot is asked to leave
    where no signal can ask: to terminate a process is to kill it on Windows."""
    try:
        loop.add_reader(sys.stdin, end)
    except NotImplementedError:  # the loop of Windows reads no pipes

        def wait() -> None:
            os.read(sys.stdin.fileno(), 1)
            with contextlib.suppress(RuntimeError):  # the loop is closed: the robot has ended
                loop.call_soon_threadsafe(end)

        Thread(target=wait, daemon=True).start()
