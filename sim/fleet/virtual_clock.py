"""Virtual time for asyncio: when every task is blocked, jump to the next timer.

The idea is trio's autojump clock. Time is counted in whole microseconds. Timers that are due at one
instant fire in the order in which they were set, so a run has one order of events.
"""

import asyncio
import heapq
import selectors
from asyncio import events
from collections.abc import Callable, Coroutine
from contextvars import Context
from math import ceil
from typing import Any, TypeVar

T = TypeVar("T")
# After a day of virtual time, the error of floats of seconds is a thousandth of this.
FLOAT_US = 0.01


class _OrderedTimer(events.TimerHandle):
    """A timer that remembers when it was set."""

    __slots__ = ("order",)
    order: int

    def __lt__(self, other: object) -> bool:
        if isinstance(other, _OrderedTimer):
            return (self._when, self.order) < (other._when, other.order)  # type: ignore[attr-defined]
        return NotImplemented


class _Jump(selectors.DefaultSelector):
    now_us = 0

    def select(self, timeout: float | None = None) -> list[Any]:
        ready = super().select(0)
        if ready:
            return ready
        if timeout is None:
            raise RuntimeError("every task waits and no timer is set: the run can never continue")
        # Nothing can run before the next timer, so jump to it. Round up, so that the timer is due
        # then, but ignore the excess over a whole microsecond that floats add.
        self.now_us += max(0, ceil(timeout * 1_000_000 - FLOAT_US))
        return []


class VirtualLoop(asyncio.SelectorEventLoop):
    """An asyncio loop whose time stands while any task can run. Timers of one instant fire in the
    order of their making."""

    def __init__(self) -> None:
        self._jump = _Jump()
        self._orders = 0
        super().__init__(self._jump)
        self._clock_resolution = 5e-7  # half of the clock's step: a timer due now is due

    def time(self) -> float:
        """Virtual time in seconds since the loop began."""
        return self._jump.now_us / 1_000_000

    def call_at(  # type: ignore[override]
        self,
        when: float,
        callback: Callable[..., object],
        *args: Any,
        context: Context | None = None,
    ) -> events.TimerHandle:
        """Make a call when the virtual time is `when`, in seconds."""
        self._check_closed()  # type: ignore[attr-defined]
        timer = _OrderedTimer(when, callback, args, self, context)
        self._orders += 1
        timer.order = self._orders
        heapq.heappush(self._scheduled, timer)  # type: ignore[attr-defined]
        timer._scheduled = True  # type: ignore[attr-defined]
        return timer


class WallLoop(asyncio.SelectorEventLoop):
    """Real time that begins at 0, like virtual time."""

    def __init__(self) -> None:
        self._zero_at_s = 0.0
        super().__init__()
        self._zero_at_s = super().time()

    def time(self) -> float:
        """Seconds since this loop began."""
        return super().time() - self._zero_at_s


async def elapse(seconds: float) -> None:
    """Let virtual time pass. On any other loop this is an error, because no test may wait for real
    time."""
    assert isinstance(asyncio.get_running_loop(), VirtualLoop), "only on a virtual clock"
    await asyncio.sleep(seconds)


def run_virtual(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine to its end in virtual time, which begins at 0."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(main)
