"""The intents of robot processes, forwarded to observers as messages beside the bus.

A robot sends its intent to the world's process five times a second. A map that sends a hello gets
copies for a while. Intents never reach another robot, and no process waits for them.
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
WATCH_S = 3.0  # a watcher that sends no new hello within this time is forgotten
WATCHERS_MAX = 8
BYTES_MAX = 4096  # of an intent; 48 points of a path are a quarter of it
MAGIC_INTENT, MAGIC_WATCH = b"HLIn", b"HLWa"


class IntentRelay:
    """Runs in the world's process, beside the bodies."""

    def __init__(self) -> None:
        self.watchers: dict[Link, float] = {}  # watcher -> until when
        # Called for each intent, for a recording.
        self.keep: Callable[[dict[str, Any]], None] | None = None
        self.malformed = 0

    def take(self, data: bytes, link: Link) -> bool:
        """Handle a message; False if it is not one of ours."""
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
    """Runs in the map's process."""

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
        """Ask robots for their intents again and again, until the task is cancelled."""
        while True:
            self.send(MAGIC_WATCH)
            await asyncio.sleep(HELLO_S)


async def tell(peer: Peer, send: Callable[[bytes], None]) -> None:
    """Send intents from a robot's process while it runs."""
    while True:
        await asyncio.sleep(TELL_S)
        intent = intent_of(peer)
        if intent is not None:
            data = MAGIC_INTENT + json.dumps(intent.to_dict(), separators=(",", ":")).encode()
            if len(data) <= BYTES_MAX:
                send(data)


def read_intent(data: bytes) -> dict[str, Any] | None:
    """Parse an intent; None if the data is none."""
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
