"""What drives a simulated fleet: a clock, timers, and the turns of runners and scripts.

There are two hosts with one behaviour. One is asyncio on a virtual or real clock, which a robot
uses too. The other is a plain event loop over a heap (`sim/fleet/event_loop.py`), which is faster.
A script is a generator that yields the microsecond at which it continues, so both hosts can run the
same faults and the same checks.
"""

import asyncio
from collections.abc import Generator
from typing import Any, Protocol, TypeVar

from agent.runtime.peer_runner import PeerRunner
from sim.fleet.batched_runner import BatchedRunner

T = TypeVar("T")
Script = Generator[int, None, T]


class Handle(Protocol):
    """Something that was started."""

    def cancel(self) -> object:
        """End what was started."""

    def done(self) -> bool:
        """Whether it has ended."""

    def check(self) -> None:
        """Raise the exception that it has raised, if any."""
        ...


class Host(Protocol):
    """A clock, and runners and scripts on it: the asyncio loop or the plain one."""

    def now_us(self) -> int:
        """The present time of this host."""

    def make_runner(self, *parts: Any) -> PeerRunner:
        """A runner of a peer, from the arguments of `PeerRunner`."""

    def start(self, runner: PeerRunner) -> Handle:
        """Let a runner take its turns."""

    def spawn(self, script: Script[Any]) -> Handle:
        """Follow a script, which yields the instants at which it goes on."""


class TaskHandle:
    """The handle of something that runs as a task of asyncio."""

    def __init__(self, task: "asyncio.Task[Any]") -> None:
        self.task = task

    def cancel(self) -> None:
        """Ask the task to end."""
        self.task.cancel()

    def done(self) -> bool:
        """Whether it has ended."""
        return self.task.done()

    def check(self) -> None:
        """Raise the exception with which the task ended, if it did."""
        if self.task.done() and not self.task.cancelled():
            self.task.result()


class LoopHost:
    """The running asyncio loop."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[Any]] = set()

    def now_us(self) -> int:
        """The time of the asyncio loop."""
        return PeerRunner.now_us()

    def make_runner(self, *parts: Any) -> PeerRunner:
        """A runner of a peer that takes beacons in batches."""
        return BatchedRunner(*parts)

    def start(self, runner: PeerRunner) -> Handle:
        """Run a runner as a task."""
        return self._keep(asyncio.create_task(runner.run(), name=f"robot {runner.peer.slot}"))

    def spawn(self, script: Script[Any]) -> Handle:
        """Follow a script as a task."""
        return self._keep(asyncio.create_task(follow(script)))

    def _keep(self, task: "asyncio.Task[Any]") -> TaskHandle:
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return TaskHandle(task)

    async def close(self) -> None:
        """Cancel every task that is left and wait for their ends."""
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def follow(script: Script[T], zero_at_us: int = 0) -> T:
    """Run a script on the running loop's clock, or on a clock that was 0 at its `zero_at_us`."""
    loop = asyncio.get_running_loop()
    try:
        while True:
            wake_at_us = next(script)
            while wake_at_us + zero_at_us <= round(loop.time() * 1e6):
                wake_at_us = next(script)
            due = loop.create_future()
            loop.call_at((wake_at_us + zero_at_us) / 1e6, _reach, due)
            await due
    except StopIteration as end:
        result: T = end.value
        return result


def _reach(due: "asyncio.Future[None]") -> None:
    if not due.done():
        due.set_result(None)
