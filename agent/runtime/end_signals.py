"""Signals that end a process, Ctrl-C or the system's request, on POSIX and on Windows."""

import asyncio
import signal
from collections.abc import Callable

ENDS = (signal.SIGINT, signal.SIGTERM)


def on_end(
    loop: asyncio.AbstractEventLoop, end: Callable[[], object],
    numbers: tuple[signal.Signals, ...] = ENDS,
) -> None:  # fmt: skip
    """Call `end` in the loop when one of the signals comes. Only in the main thread (ValueError)."""
    for number in numbers:
        try:
            loop.add_signal_handler(number, end)
        except NotImplementedError:  # the loop of Windows has none
            signal.signal(number, lambda *_: loop.call_soon_threadsafe(end))
