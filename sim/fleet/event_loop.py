"""A plain event loop over a heap: the same runners, wire, scripts and order of events as with
asyncio.

A callback costs asyncio several microseconds; here it is a heap entry. The order is the same as in
`asyncio.BaseEventLoop` with `sim/fleet/virtual_clock.py`, step by step. Due timers run in the order
in which they were set, after what is ready; a runner that is woken takes its turn one round later.
So the same seed gives the same trace hash, and a test compares them.
"""

from collections.abc import Callable
from heapq import heappop, heappush
from math import ceil
from typing import Any, TypeVar

from agent.runtime.peer_runner import PeerRunner
from sim.fleet.batched_runner import BatchedRunner
from sim.fleet.scheduler import Script

T = TypeVar("T")
# Callback rounds in one instant. A wire delivers a few frames at one time, and a robot that
# unfreezes gets a full inbox in one round. More rounds mean that a robot keeps asking for a wake-up
# without acting.
ROUNDS_MAX = 10_000
Call = Callable[[], object]


class ScheduledCall:
    """A call that is due later."""

    __slots__ = ("call", "cancelled")

    def __init__(self, call: Call) -> None:
        self.call, self.cancelled = call, False

    def cancel(self) -> None:
        """Do not make the call. The entry stays in the heap until its time."""
        self.cancelled = True


class SimulatedRunner(BatchedRunner):
    """A runner that takes its turns from this event loop."""

    event_loop: "EventLoop"
    _over = False
    _nudged = False
    _base_at_us = 0
    _rate_set_at_us = 0
    _rate = 1.0

    def begin(self) -> None:
        """Do what the first step of `PeerRunner.run` does."""
        self.bus.subscribe(self._on_frame)
        self._arm()

    def end(self) -> None:
        """Take no more turns."""
        self._over = True

    def drift(self, ppm: float) -> None:
        """From now on this robot's clock runs faster by this many parts per million."""
        self._catch_up()
        self._base_at_us, self._rate_set_at_us = self.local_now_us(), self.event_loop.now_us()
        self._rate = 1.0 + ppm * 1e-6
        self._nudge()

    def jump(self, jump_for_s: float) -> None:
        """From now on this robot's clock shows this much more."""
        self._catch_up()
        self._base_at_us, self._rate_set_at_us = (
            self.local_now_us() + round(jump_for_s * 1e6),
            self.event_loop.now_us(),
        )
        self._nudge()

    def local_now_us(self) -> int:
        """The time on this robot's clock."""
        return self._shown_at(self.event_loop.reached_at_us)

    def _shown_at(self, t_us: int) -> int:
        if self._rate == 1.0:
            return self._base_at_us + t_us - self._rate_set_at_us
        return self._base_at_us + int((t_us - self._rate_set_at_us) * self._rate)

    @property
    def _local(self) -> Callable[[int], int] | None:
        same = self._rate == 1.0 and self._base_at_us == self._rate_set_at_us
        return None if same else self._shown_at

    def _at(self, local_now_us: int) -> int:
        """The time at which its clock will show that value."""
        if self._rate == 1.0:
            return local_now_us - self._base_at_us + self._rate_set_at_us
        t_us = self._rate_set_at_us + ceil((local_now_us - self._base_at_us) / self._rate)
        # Rounding may make this one microsecond too early; then the robot would be woken again and
        # again.
        return t_us if self._shown_at(t_us) >= local_now_us else t_us + 1

    def _arm(self) -> None:
        self._armed_at_us = self.peer.due_at_us
        self._listening = True
        self._timer = self.event_loop.at(self._at(self._armed_at_us), self._nudge)

    def _nudge(self) -> None:
        if self._listening and not self._nudged:
            self._nudged = True
            self.event_loop.soon(self._woken)

    def _woken(self) -> None:
        self._timer.cancel()
        if self._over:
            return
        if self._failure is not None:
            raise self._failure
        if self._freeze_ends_at_us:
            wake_at_us = self._at(self._freeze_ends_at_us)
            if wake_at_us <= self.event_loop.now_us():
                self.event_loop.soon(self._thawed)
            else:
                self.event_loop.at(wake_at_us, lambda: self.event_loop.soon(self._thawed))
            return
        self._turn_over()

    def _thawed(self) -> None:
        if not self._over:
            self.thaw()
            self._turn_over()

    def _turn_over(self) -> None:
        self.on_tick()
        self._nudged = False
        self._arm()


class RunnerHandle:
    """A runner that was started on the plain loop."""

    def __init__(self, runner: SimulatedRunner) -> None:
        self.runner, self._done = runner, False

    def begin(self) -> None:
        """Let the runner take its first turn, unless it was cancelled before."""
        if not self._done:
            self.runner.begin()

    def cancel(self) -> None:
        """End the runner."""
        self._done = True
        self.runner.end()

    def done(self) -> bool:
        """Whether it has ended."""
        return self._done

    def check(self) -> None:  # an exception here is not stored: it ends the run
        """Nothing: exceptions are raised where they happen."""


class ScriptHandle:
    """A script that is running; its result is in `value`."""

    def __init__(self, event_loop: "EventLoop", script: Script[Any]) -> None:
        self.event_loop, self.script = event_loop, script
        self.value: Any = None
        self._done = False
        event_loop.soon(self._step)

    def _step(self) -> None:
        if self._done:
            return
        try:
            wake_at_us = next(self.script)
            while wake_at_us <= self.event_loop.now_us():
                wake_at_us = next(self.script)
        except StopIteration as end:
            self._done, self.value = True, end.value
            return
        self.event_loop.at(wake_at_us, lambda: self.event_loop.soon(self._step))

    def cancel(self) -> None:
        """Close the script where it waits."""
        if not self._done:
            self._done = True
            self.script.close()

    def done(self) -> bool:
        """Whether it has ended."""
        return self._done

    def check(self) -> None:
        """Nothing: exceptions are raised where they happen."""


class EventLoop:
    """A clock in microseconds that jumps from timer to timer, and the calls that are ready now, in
    their order."""

    def __init__(self) -> None:
        self.reached_at_us = 0
        self._order = 0
        self._timers: list[tuple[int, int, ScheduledCall]] = []
        self._ready: list[Call] = []

    def now_us(self) -> int:
        """The present virtual time."""
        return self.reached_at_us

    def soon(self, call: Call) -> None:
        """Make a call in this instant, after those that wait already."""
        self._ready.append(call)

    def at(self, t_us: int, call: Call) -> ScheduledCall:
        """Make a call at `t_us`. Of calls at one instant the one that was asked for first comes
        first."""
        self._order += 1
        timer = ScheduledCall(call)
        heappush(self._timers, (t_us, self._order, timer))
        return timer

    def make_runner(self, *parts: Any) -> PeerRunner:
        """A runner of a peer, from the arguments of `PeerRunner`, which takes its time from this
        loop."""
        runner = SimulatedRunner(*parts)
        runner.event_loop, runner.clock = self, runner.local_now_us
        return runner

    def start(self, runner: PeerRunner) -> RunnerHandle:
        """Let a runner take its turns from now on."""
        assert isinstance(runner, SimulatedRunner)
        handle = RunnerHandle(runner)
        self.soon(handle.begin)
        return handle

    def spawn(self, script: Script[Any]) -> ScriptHandle:
        """Follow a script, which yields the instants at which it goes on."""
        return ScriptHandle(self, script)

    def run(self, main: Script[T]) -> T:
        """Run until the script ends. Time begins at 0."""
        handle = self.spawn(main)
        timers, rounds, round_at_us = self._timers, 0, 0
        while not handle.done():
            if not self._ready:
                while timers[0][2].cancelled:
                    heappop(timers)
                self.reached_at_us = max(self.reached_at_us, timers[0][0])
            if self.reached_at_us != round_at_us:
                rounds, round_at_us = 0, self.reached_at_us
            rounds += 1
            assert rounds < ROUNDS_MAX, f"time stands still at {round_at_us} us"
            while timers and timers[0][0] <= self.reached_at_us:
                timer = heappop(timers)[2]
                if not timer.cancelled:
                    self._ready.append(timer.call)
            ready, self._ready = self._ready, []
            for place, call in enumerate(ready):
                call()
                if handle.done():
                    self._ready[:0] = ready[place + 1 :]
                    break
        value: T = handle.value
        return value
