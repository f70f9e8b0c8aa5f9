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

T = TypeVar("T")
Script = Generator[int, None, T]


class Handle(Protocol):
    """Something that was started."""

    def cancel(self) -> object: ...
    def done(self) -> bool: ...
    def check(self) -> None:
        """Raise the exception that it has raised, if any."""
        ...


class Host(Protocol):
    def now_us(self) -> int: ...
    def shell(self, *parts: Any) -> PeerRunner: ...
    def start(self, shell: PeerRunner) -> Handle: ...
    def spawn(self, script: Script[Any]) -> Handle: ...


class TaskHandle:
    """An asyncio task."""

    def __init__(self, task: "asyncio.Task[Any]") -> None:
        self.task = task

    def cancel(self) -> None:
        self.task.cancel()

    def done(self) -> bool:
        return self.task.done()

    def check(self) -> None:
        if self.task.done() and not self.task.cancelled():
            self.task.result()


class LoopHost:
    """The running asyncio loop."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[Any]] = set()

    def now_us(self) -> int:
        return PeerRunner.now_us()

    def shell(self, *parts: Any) -> PeerRunner:
        return PeerRunner(*parts)

    def start(self, shell: PeerRunner) -> Handle:
        return self._keep(asyncio.create_task(shell.run(), name=f"robot {shell.peer.slot}"))

    def spawn(self, script: Script[Any]) -> Handle:
        return self._keep(asyncio.create_task(follow(script)))

    def _keep(self, task: "asyncio.Task[Any]") -> TaskHandle:
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return TaskHandle(task)

    async def close(self) -> None:
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def follow(script: Script[T], zero_us: int = 0) -> T:
    """Run a script on the running loop's clock, or on a clock that was 0 at its `zero_us`."""
    loop = asyncio.get_running_loop()
    try:
        while True:
            until_us = next(script)
            while until_us + zero_us <= round(loop.time() * 1e6):
                until_us = next(script)
            due = loop.create_future()
            loop.call_at((until_us + zero_us) / 1e6, _reach, due)
            await due
    except StopIteration as end:
        return end.value  # type: ignore[no-any-return]


def _reach(due: "asyncio.Future[None]") -> None:
    if not due.done():
        due.set_result(None)
