"""HTTP connections of the map: a limit on how many there are, and on how long one may say nothing.

uvicorn closes a connection that was used and is idle. One that never completes its first request it keeps
for ever, and another one after it. Then a page that wants to press a stop finds no free descriptor.
"""

import asyncio
from typing import Any, Final, cast

from uvicorn.protocols.http.h11_impl import H11Protocol

CONNECTIONS_MAX: Final = (
    64  # 16 pages, each with the six that a browser opens at most for its files
)
REQUEST_S: Final = 10.0  # for a whole request; the page's have less than a kilobyte


def seated(
    connections: int = CONNECTIONS_MAX, request_for_s: float = REQUEST_S
) -> type[asyncio.Protocol]:
    """A class of connections for one server of uvicorn. A newcomer beyond the limit takes the place of
    the oldest connection that waits for a request."""
    seats: list[Any] = []

    class Seated(H11Protocol):
        """One connection, until it becomes a web socket or ends."""

        def connection_made(self, transport: Any) -> None:
            """Take a seat (asyncio calls it)."""
            super().connection_made(transport)
            self.waits_at_s = self.loop.time()
            seats.append(self)
            waiting = [each for each in seats[:-1] if each.waits]
            if len(seats) > connections and waiting:
                waiting[0].transport.abort()
                seats.remove(waiting[0])
            self.timer = self.loop.call_later(request_for_s, self.look)

        @property
        def waits(self) -> bool:
            """Whether it has not sent a whole request since the last answer."""
            cycle = self.cycle
            return cycle is None or cycle.response_complete or cycle.more_body

        def look(self) -> None:
            """Close the connection if its request takes too long."""
            if self not in seats:
                return  # it is a web socket now, or gone
            left_s = self.waits_at_s + request_for_s - self.loop.time()
            if self.waits and left_s <= 0:
                self.transport.abort()
                return
            self.timer = self.loop.call_later(max(left_s, request_for_s / 10), self.look)

        def on_response_complete(self) -> None:
            """The next request has its whole time again (uvicorn calls it)."""
            self.waits_at_s = self.loop.time()
            super().on_response_complete()

        def handle_websocket_upgrade(self, event: Any) -> None:
            """Pages have limits of their own (uvicorn calls it)."""
            self.leave()
            super().handle_websocket_upgrade(event)

        def connection_lost(self, exc: Exception | None) -> None:
            """Give up the seat (asyncio calls it)."""
            self.leave()
            super().connection_lost(exc)

        def leave(self) -> None:
            """It counts no more."""
            self.timer.cancel()
            if self in seats:
                seats.remove(self)

    return cast(type[asyncio.Protocol], Seated)
