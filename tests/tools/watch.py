"""What the robots of a fleet of processes say they do, beside the bus: datagrams five times a second."""

import asyncio
from collections.abc import Callable
from typing import Any

from tests.tools.launching import WAIT_S

STANDING_M_S = 0.02  # wheels never quite rest


class Watch:
    def __init__(self, robots: int) -> None:
        self.robots = robots
        self.now: dict[int, dict[str, Any]] = {}  # slot -> its last datagram
        self.news = asyncio.Event()

    def told(self, intent: dict[str, Any]) -> None:
        self.now[intent["slot"]] = intent
        self.news.set()

    async def until(self, what: str, holds: Callable[[], bool], limit_s: float = WAIT_S) -> None:
        """Asked after every datagram, once all robots have sent one."""
        try:
            async with asyncio.timeout(limit_s):
                while len(self.now) < self.robots or not holds():
                    self.news.clear()
                    await self.news.wait()
        except TimeoutError:
            raise AssertionError(f"{what}: {self}") from None

    async def for_s(self, seconds: float) -> None:
        loop = asyncio.get_running_loop()
        end_s = loop.time() + seconds
        await self.until("time passes", lambda: loop.time() >= end_s)

    def work(self) -> bool:
        """Nobody is held, and everybody hears everybody."""
        return all(not i["holds"] and len(i["hears"]) == self.robots for i in self.now.values())

    def __str__(self) -> str:
        return str(self.now)
