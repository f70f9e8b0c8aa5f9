"""The one place of the core that knows python-can: a `can.BusABC` as the `Bus` a shell needs."""

import asyncio
from collections.abc import Callable
from typing import Any

import can

from protocol.frame import Frame
from protocol.health import Health, told_by

ACTIVE = can.BusState.ACTIVE


class CanBus:
    """Any python-can bus. What cannot be used is counted, and nothing here raises while running."""

    def __init__(self, bus: can.BusABC) -> None:
        self.bus = bus
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
                self.bus.send(message, timeout=0)
                taken = True
            except (can.CanError, OSError, ValueError):
                taken = False
        self.refused += not taken
        return taken

    def shelve(self, shelf: Any) -> None:
        """See `agent.ports.Shelving`; where the interface cannot, everything is called back for."""
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

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        """Give every data frame to the callback, in the running loop's thread."""
        direct = getattr(self.bus, "subscribe", None)
        if direct is not None:
            direct(callback)
            return

        def heard(message: can.Message) -> None:
            if message.is_extended_id and not (message.is_error_frame or message.is_remote_frame):
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
        bus = can.Bus(interface=interface, channel=channel, bitrate=bitrate, **options)
    return CanBus(bus)
