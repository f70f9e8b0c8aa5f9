"""The one place of the core that knows python-can: a `can.BusABC` as the `Bus` a shell needs."""

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any, Final

import can

from protocol.controller_health import Health, told_by
from protocol.frames.frame import Frame

ACTIVE = can.BusState.ACTIVE


# Interfaces that hand an own frame back when it has been sent, and mark it: SocketCAN by the echo of the
# driver, the others by the receipt of the controller. `virtual` is a queue in this process: sent is sent.
CONFIRMING: Final = frozenset({"socketcan", "kvaser", "pcan", "vector", "virtual"})
UNCONFIRMED_MAX: Final = (
    512  # own frames whose confirmation is waited for; beyond it the oldest is not
)


class CanBus:
    """Any python-can bus. What cannot be used is counted, and nothing here raises while running."""

    def __init__(self, bus: can.BusABC, confirms: bool = False) -> None:
        """`confirms`: it was opened with `receive_own_messages`."""
        self.bus = bus
        self._direct_sent = hasattr(bus, "sent")
        self._confirmed: int | None = 0 if confirms else None
        self._unconfirmed: deque[Frame] = deque(maxlen=UNCONFIRMED_MAX)
        self.ignored = 0  # error, remote and 11-bit frames
        self.refused = 0  # frames the driver did not take
        self._told = Health.ACTIVE  # by error frames
        self._notifier: can.Notifier | None = None
        self._shelve: Callable[[Any], None] | None = getattr(bus, "shelve", None)
        self._submit: Callable[[Frame], bool] | None = getattr(bus, "submit", None)

    def send(self, frame: Frame) -> bool:
        if self._submit is not None:
            taken = self._submit(frame)
        else:
            message = can.Message(
                arbitration_id=frame.identifier, data=frame.data, is_extended_id=True, check=False
            )
            try:
                if self._confirmed is not None:
                    self._unconfirmed.append(frame)
                self.bus.send(message, timeout=0)
                taken = True
            except (can.CanError, OSError, ValueError):
                taken = False
                if self._unconfirmed:
                    self._unconfirmed.pop()
        self.refused += not taken
        return taken

    def shelve(self, shelf: Any) -> None:
        """See `agent.interface.ports.Shelving`; where the interface cannot, everything is called
        back for."""
        if self._shelve is not None:
            self._shelve(shelf)

    @property
    def health(self) -> Health:
        """Of the controller: what the interface says, or else its error frames."""
        try:
            state = self.bus.state
        except (NotImplementedError, can.CanError, OSError):
            return self._told
        if state is ACTIVE:
            return self._told
        return Health.OFF if state is can.BusState.ERROR else Health.PASSIVE

    @property
    def sent(self) -> int | None:
        """Frames of ours that have left; see `agent.interface.ports.Confirming`."""
        if self._direct_sent:
            told: int = self.bus.sent  # type: ignore[attr-defined]
            return told
        return self._confirmed

    def _is_own(self, message: can.Message) -> bool:
        """A frame of ours that comes back. SocketCAN marks those of other programs here as well."""
        if message.is_rx or self._confirmed is None:
            return False
        frame = Frame(message.arbitration_id, bytes(message.data))
        if frame not in self._unconfirmed:
            return False
        while self._unconfirmed.popleft() != frame:
            pass  # the driver has told nothing about those
        self._confirmed += 1
        return True

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        """Give every data frame to the callback, in the running loop's thread."""
        direct = getattr(self.bus, "subscribe", None)
        if direct is not None:
            direct(callback)
            return

        def heard(message: can.Message) -> None:
            if message.is_extended_id and not (message.is_error_frame or message.is_remote_frame):
                if self._is_own(message):
                    return
                callback(Frame(message.arbitration_id, bytes(message.data)))
                return
            self.ignored += 1
            if message.is_error_frame:
                self._told = told_by(message.arbitration_id, bytes(message.data), self._told)

        self._notifier = can.Notifier(self.bus, [heard], loop=asyncio.get_running_loop())

    def close(self) -> None:
        if self._notifier is not None:
            self._notifier.stop()
            self._notifier = None
        self.bus.shutdown()


def open_bus(interface: str, channel: str, bitrate: int = 250_000, **options: Any) -> CanBus:
    """Open by python-can's own options; raises what the interface raises."""
    if (
        interface == "socketcand"
    ):  # no bit rate of its own; without tcp_tune frames wait for company
        bus = can.Bus(interface=interface, channel=channel, tcp_tune=True, **options)
    else:
        if interface in CONFIRMING:
            options.setdefault("receive_own_messages", True)
        bus = can.Bus(interface=interface, channel=channel, bitrate=bitrate, **options)
    return CanBus(bus, bool(options.get("receive_own_messages")) and interface in CONFIRMING)
