"""The only module of robots and gateways that imports Eclipse Zenoh: a session with explicit endpoints,
and a bus on top.

Nothing is found by multicast; endpoints to connect to are named. Callbacks of the session come in
its own threads and are handed to the event loop here. Messages that the loop is too slow for are
dropped and counted. A stop is never dropped, because stops have a separate lane and there are few
of them.
"""

import asyncio
import json
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import zenoh

from protocol.controller_health import Health
from protocol.frames.frame import Frame

# A link that is silent this long is closed and opened again; Zenoh's default is 10 s.
LEASE_MS = 2_000
RETRY_MS = 500  # between attempts to reach an endpoint
OPEN_MS = 2_000  # for one attempt: a lost SYN is sent again after one second
# A link that takes no stop for this long is closed. The sender waits meanwhile, and with it the stops
# for all other links. Zenoh's default is 5 s.
BLOCK_MS = 1_000
# A client that has received nothing for this long opens another session. After a link that carried
# one way, Zenoh's router can refuse the old session for good; it knows a session by its identity.
SILENCE_S = 5 * LEASE_MS / 1e3
SILENCE_MAX_S = 60.0  # the time doubles up to this while nobody is there to be heard
WATCH_S = 0.5  # between looks at the silence
SESSIONS_MAX = 256  # with one program that listens: two gateways for each of 128 segments
PENDING_MAX = 64  # of them, that have not said who they are
MESSAGE_BYTES_MAX = 1 << 20  # a message of ours has 64 KiB at most; Zenoh's own limit is 1 GiB
INBOX_MAX = 4096  # messages on their way to the event loop
FRAME_BYTES = 4  # of the identifier before the data of a frame
IDENTIFIER_MAX = 1 << 29
assert BLOCK_MS < LEASE_MS, "a full link is noticed before a silent one"

Heard = Callable[[bytes], None]


class LinkError(Exception):
    """One line for the user: what is wrong and what to do."""


def configure(
    connect: Iterable[str], listen: Iterable[str], mode: str = "", file: Path | None = None
) -> zenoh.Config:
    """`file`: Zenoh's own configuration (JSON5), which contains TLS and access control.

    `mode`: peer, client or router. Default: router for a program that listens, because a router
    forwards messages between those that connect to it; client for a program that only connects (a
    router carries nothing between peers). Raises LinkError.
    """
    connect, listen = list(connect), list(listen)
    for endpoint in (*connect, *listen):
        if "/" not in endpoint:
            raise LinkError(f"{endpoint}: no endpoint; write tcp/HOST:PORT or tls/HOST:PORT")
    try:
        config = zenoh.Config() if file is None else zenoh.Config.from_file(str(file))
    except Exception as problem:  # the binding raises undocumented exceptions
        raise LinkError(f"{file} is not a configuration of Zenoh: {_first_line(problem)}") from None
    settings: dict[str, object] = {
        "mode": mode or ("router" if listen else "client"),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": BLOCK_MS * 1000,
        "transport/unicast/open_timeout": OPEN_MS,
        "transport/unicast/max_sessions": SESSIONS_MAX,
        "transport/unicast/accept_timeout": OPEN_MS,
        "transport/unicast/accept_pending": PENDING_MAX,
        "transport/link/rx/max_message_size": MESSAGE_BYTES_MAX,
        "connect/timeout_ms": -1,  # keep trying: a gateway may start before its backbone
        "connect/exit_on_failure": False,
        "connect/retry": {
            "period_init_ms": RETRY_MS, "period_max_ms": RETRY_MS, "period_increase_factor": 1,
        },
    }  # fmt: skip
    if connect:
        settings["connect/endpoints"] = connect
    if listen or file is None:
        settings["listen/endpoints"] = listen
    for key, value in settings.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except Exception as problem:
            raise LinkError(f"{key} = {value}: {_first_line(problem)}") from None
    return config


def _first_line(problem: Exception) -> str:
    return str(problem).splitlines()[0] if str(problem) else type(problem).__name__


class _Silence:
    """How long nothing was received, and how long is too long."""

    def __init__(self, first_for_s: float, now_s: float) -> None:
        self._first_for_s = self._limit_for_s = first_for_s
        self._heard_at_s = now_s

    def end(self, now_s: float) -> None:
        """A message was received."""
        self._heard_at_s, self._limit_for_s = now_s, self._first_for_s

    def begin(self, now_s: float) -> None:
        """Another session is open."""
        self._heard_at_s = now_s

    def too_long(self, now_s: float) -> bool:
        """Whether the session has to be replaced. If so, the next one gets twice the time."""
        if now_s - self._heard_at_s < self._limit_for_s:
            return False
        self._limit_for_s = min(2 * self._limit_for_s, SILENCE_MAX_S)
        return True


class ZenohLink:
    """A session of one program. Raises LinkError if it cannot listen on an endpoint.

    A program that only connects may start before its backbone. So the session is opened in a thread
    that keeps trying, and nothing is sent until it is open. A client that receives nothing for
    `silence_for_s` seconds opens another session and closes the old one afterwards.
    """

    def __init__(
        self,
        config: zenoh.Config,
        loop: asyncio.AbstractEventLoop,
        silence_for_s: float = SILENCE_S,
    ) -> None:
        self._loop, self._config = loop, config
        self.dropped = 0  # messages dropped because the inbox was full
        self.renewed = 0  # sessions that took the place of a silent one
        self.session: zenoh.Session | None = None
        self.refusal = ""  # why it does not open
        self._waiting = 0
        self._open = True
        self._silence = _Silence(silence_for_s, loop.time())
        self._patterns: list[tuple[str, Callable[[zenoh.Sample], None]]] = []
        self._subscribers: list[Any] = []
        if config.get_json("mode") == '"client"':
            self._start_connecting()
            return
        try:
            self.session = zenoh.open(config)
        except Exception as problem:
            raise LinkError(f"the backbone does not open: {_first_line(problem)}") from None

    def _start_connecting(self) -> None:
        threading.Thread(target=self._connect, daemon=True).start()

    def _connect(self) -> None:
        """Open a session, in a separate thread because that may take forever."""
        while self._open:
            try:
                session = zenoh.open(self._config)
            except Exception as problem:
                self.refusal = _first_line(problem)
                continue
            try:
                self._loop.call_soon_threadsafe(self._opened, session)
            except RuntimeError:
                session.close()
            return

    def _opened(self, session: zenoh.Session) -> None:
        if not self._open:
            session.close()
            return
        if self.session is not None:
            self.renewed += 1
            # To close a broken session takes seconds. The end of the program waits for it.
            threading.Thread(target=self.session.close).start()
        self.session, self._subscribers = session, []
        for pattern, arrived in self._patterns:
            self._declare(pattern, arrived)
        self._silence.begin(self._loop.time())
        self._loop.call_later(WATCH_S, self._watch)

    def _watch(self) -> None:
        """Open another session if this one has been silent for too long."""
        if not self._open:
            return
        if self._patterns and self._silence.too_long(self._loop.time()):
            self._start_connecting()
        else:
            self._loop.call_later(WATCH_S, self._watch)

    def put(self, key: str, data: bytes, urgent: bool = False) -> None:
        """Send. Urgent messages overtake all others, are not batched, and are not dropped."""
        if self.session is None or not self._open:
            return
        if urgent:
            self.session.put(
                key, data, priority=zenoh.Priority.REAL_TIME, express=True,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )  # fmt: skip
        else:
            self.session.put(
                key, data, priority=zenoh.Priority.DATA, express=True,
                congestion_control=zenoh.CongestionControl.DROP,
            )  # fmt: skip

    def subscribe(self, pattern: str, heard: Heard, keep: bool = False) -> None:
        """Call back in the loop's thread for messages of others. `keep`: drop none."""

        def arrived(sample: zenoh.Sample) -> None:
            if not keep and self._waiting >= INBOX_MAX:
                self.dropped += 1
                return
            self._waiting += 1
            data = bytes(sample.payload)
            try:
                self._loop.call_soon_threadsafe(deliver, data)
            except RuntimeError:  # the loop has ended before the session
                self._open = False

        def deliver(data: bytes) -> None:
            self._waiting -= 1
            self._silence.end(self._loop.time())
            if self._open:
                heard(data)

        self._patterns.append((pattern, arrived))
        if self.session is not None:
            self._declare(pattern, arrived)

    def _declare(self, pattern: str, arrived: Callable[[zenoh.Sample], None]) -> None:
        assert self.session is not None
        self._subscribers.append(
            self.session.declare_subscriber(pattern, arrived, allowed_origin=zenoh.Locality.REMOTE)
        )

    @property
    def links(self) -> int:
        """Other programs that this one is connected to."""
        if self.session is None:
            return 0
        return len(list(self.session.info.transports()))

    def close(self) -> None:
        """Close the session; later messages are neither sent nor delivered."""
        if self._open:
            self._open = False
            if self.session is not None:
                self.session.close()


class ZenohBus:
    """A segment without a cable: robots on Wi-Fi that share a key, with the same frames and `Bus`.

    There is no arbitration. Frames of priority 0 and 1, stops and resets, take the urgent lane.
    """

    def __init__(self, link: ZenohLink, key: str) -> None:
        self._link, self._key = link, key
        self.refused = 0  # messages that are no frame

    def send(self, frame: Frame) -> bool:
        """Publish a frame to all that share the key. True always: nothing tells whether it was
        received."""
        data = frame.identifier.to_bytes(FRAME_BYTES, "little") + frame.data
        urgent = frame.identifier >> 26 < 2
        self._link.put(f"{self._key}/{'urgent' if urgent else 'frames'}", data, urgent)
        return True

    @property
    def health(self) -> Health:
        """There is no controller to confine; without a session no frame of ours is received."""
        return Health.OFF if self._link.session is None else Health.ACTIVE

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        """Pass every frame of others to the callback, in the loop's thread. What is no frame is
        counted in `refused`."""

        def heard(data: bytes) -> None:
            identifier = int.from_bytes(data[:FRAME_BYTES], "little")
            if not FRAME_BYTES <= len(data) <= FRAME_BYTES + 8 or identifier >= IDENTIFIER_MAX:
                self.refused += 1
                return
            callback(Frame(identifier, data[FRAME_BYTES:]))

        self._link.subscribe(f"{self._key}/urgent", heard, keep=True)
        self._link.subscribe(f"{self._key}/frames", heard)

    def close(self) -> None:
        """Close the link, and with it every other bus over the same link."""
        self._link.close()
