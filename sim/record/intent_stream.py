"""What robot processes mean to do, passed on to whoever watches: messages beside the bus.

A robot tells its world's process five times a second; a map that says hello gets copies for a while.
Nothing of it reaches another robot, and nothing waits for it.
"""

import asyncio
import json
from collections.abc import Callable
from typing import Any

from agent.peer.peer import Peer
from sim.record.local_link import Link
from sim.record.robot_intent import intent_of

TELL_S = 0.2
HELLO_S = 1.0
WATCH_S = 3.0  # a watcher that does not say hello again is forgotten
WATCHERS_MAX = 8
BYTES_MAX = 4096  # of an intent: 48 points of a path are a quarter of it
MAGIC_INTENT, MAGIC_WATCH = b"HLIn", b"HLWa"


class IntentRelay:
    """In the world's process, beside the bodies."""

    def __init__(self) -> None:
        self.watchers: dict[Link, float] = {}  # until when
        self.keep: Callable[[dict[str, Any]], None] | None = None  # also for a recording
        self.malformed = 0

    def take(self, data: bytes, link: Link) -> bool:
        """True where the message is ours."""
        now_s = asyncio.get_running_loop().time()
        if data == MAGIC_WATCH:
            if link in self.watchers or len(self.watchers) < WATCHERS_MAX:
                self.watchers[link] = now_s + WATCH_S
            return True
        if data[:4] != MAGIC_INTENT:
            return False
        for watcher in [w for w, until_s in self.watchers.items() if until_s < now_s]:
            del self.watchers[watcher]
        for watcher in self.watchers:
            watcher.send(data)
        if self.keep is not None:
            intent = read_intent(data)
            if intent is None:
                self.malformed += 1
            else:
                self.keep(intent)
        return True


class IntentListener(Link):
    """In the map's process."""

    def __init__(self, heard: Callable[[dict[str, Any]], None]) -> None:
        super().__init__()
        self.heard = heard

    def take(self, message: bytes) -> None:
        intent = read_intent(message)
        if intent is None:
            self.malformed += 1
        else:
            self.heard(intent)

    async def run(self) -> None:
        while True:
            self.send(MAGIC_WATCH)
            await asyncio.sleep(HELLO_S)


async def tell(peer: Peer, send: Callable[[bytes], None]) -> None:
    """In a robot's process, as long as it runs."""
    while True:
        await asyncio.sleep(TELL_S)
        intent = intent_of(peer)
        if intent is not None:
            data = MAGIC_INTENT + json.dumps(intent.to_dict(), separators=(",", ":")).encode()
            if len(data) <= BYTES_MAX:
                send(data)


def read_intent(data: bytes) -> dict[str, Any] | None:
    """None for what is none."""
    if data[:4] != MAGIC_INTENT or len(data) > BYTES_MAX:
        return None
    try:
        intent = json.loads(data[4:])
        numbers = [intent[name] for name in ("slot", "x", "y", "heading", "vx", "vy")]
        lists = [intent[name] for name in ("wanted", "path", "avoids", "hears", "strange", "holds")]
    except (ValueError, KeyError, TypeError):
        return None
    valid = all(isinstance(n, int | float) for n in numbers) and all(
        isinstance(each, list) for each in lists
    )
    return intent if valid else None
