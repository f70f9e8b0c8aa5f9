"""The collector of cyclic garbage, set up for the start of a command and for simulations.

Simulations make millions of tuples that are freed by reference counting, and one big cycle, a fleet, that
is garbage when its run is over.

With default settings it scans a fleet of a hundred robots several times a second, which takes a fifth
of the CPU time.
"""

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager

# For a command: imports make many objects and no garbage. 700 costs 20 ms.
GC_YOUNG = 10_000
YOUNG, MIDDLE, OLD = 50_000, 50, 1_000  # thresholds of `gc`; CPython's own are 700, 10, 10


@contextmanager
def patient() -> Iterator[None]:
    """While one run lasts. What was there before is not looked at; what it leaves is collected."""
    before = gc.get_threshold()
    gc.freeze()
    gc.set_threshold(YOUNG, MIDDLE, OLD)
    try:
        yield
    finally:
        gc.collect()
        gc.set_threshold(*before)


@contextmanager
def uncollected() -> Iterator[None]:
    """While a command makes many objects and keeps them: looking through them finds nothing."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def not_taken_apart() -> None:
    """From now on the end of this process leaves its objects to the operating system.

    Python looks through all of them when it ends. With the libraries of a simulation that is 0.5 s of
    CPU after the last line of a result; under load a command was seen to stay for 25 s.
    """
    atexit.register(_leave_all)


def _leave_all() -> None:
    gc.disable()
    gc.freeze()
