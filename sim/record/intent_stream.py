"""The intents of robot processes, forwarded to observers as messages beside the bus.

A robot sends its intent to the world's process five times a second. A map that sends a hello gets
copies for a while. Intents never reach another robot, and no process waits for them. An intent is
four bytes of `MAGIC_INTENT` and a MessagePack array of the values of `Intent.to_dict`, in its order.
"""

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from agent.interface.config import NEIGHBOURS_MAX, PEERS_MAX
from protocol.strict_msgpack import U8, StrictReader, finite, packed, unsigned
from sim.record.local_link import Link
from sim.record.robot_intent import POINTS_MAX, STRANGE_MAX, Intent, intent_of

if TYPE_CHECKING:
    from agent.peer.peer import Peer

TELL_S = 0.2
HELLO_S = 1.0
WATCH_S = 3.0  # a watcher that sends no new hello within this time is forgotten
WATCHERS_MAX = 8
BYTES_MAX = 4096  # of an intent; 48 points of a path are a quarter of it
HOLDS_MAX, CAUSE_BYTES_MAX = 32, 64  # causes for which a robot stands; bytes of the name of one
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


async def tell(peer: "Peer", send: Callable[[bytes], None]) -> None:
    """Send intents from a robot's process while it runs."""
    while True:
        await asyncio.sleep(TELL_S)
        intent = intent_of(peer)
        if intent is not None:
            data = intent_bytes(intent)
            if len(data) <= BYTES_MAX:
                send(data)


def intent_bytes(intent: Intent) -> bytes:
    """An intent as one message."""
    return MAGIC_INTENT + packed(list(intent.to_dict().values()))


def read_intent(data: bytes) -> dict[str, Any] | None:
    """Parse an intent, as `Intent.to_dict` gives it; None if the data is none."""
    if data[:4] != MAGIC_INTENT or len(data) > BYTES_MAX:
        return None
    reader = StrictReader(data[4:], array_max=PEERS_MAX, text_max=CAUSE_BYTES_MAX)
    try:
        if reader.count(13) != 13:
            return None
        (slot,) = reader.numbers((U8,))
        x, y, heading, vx, vy = finite([reader.value() for _ in range(5)])
        intent = {
            "slot": slot, "x": x, "y": y, "heading": heading, "vx": vx, "vy": vy,
            "wanted": _point(reader.value()), "path": _points(reader.value(), POINTS_MAX),
            "avoids": _slots(reader.value(), NEIGHBOURS_MAX), "hears": _slots(reader.value(), PEERS_MAX),
            "strange": _points(reader.value(), STRANGE_MAX), "holds": _names(reader.value()),
            "tool": reader.value(),
        }  # fmt: skip
        reader.end()
    except ValueError:
        return None
    return intent if type(intent["tool"]) is bool else None


def _array(value: object, most: int) -> tuple[Any, ...]:
    if type(value) is not tuple or len(value) > most:
        raise ValueError("array")
    return value


def _point(value: object) -> list[float]:
    x, y = finite(_array(value, 2))
    return [x, y]


def _points(value: object, most: int) -> list[list[float]]:
    return [_point(point) for point in _array(value, most)]


def _slots(value: object, most: int) -> list[int]:
    slots = _array(value, most)
    return unsigned(slots, (U8,) * len(slots))


def _names(value: object) -> list[str]:
    names = _array(value, HOLDS_MAX)
    if not all(type(name) is str for name in names):
        raise ValueError("names")
    return list(names)
