"""The only module that imports python-can here: wraps a `can.BusABC` as the `Bus` of a runner.

python-can looks for plug-ins in every installed package when it is imported, which is a third of the
start of a tool. So it is imported with the first bus, and not by a tool that finds none, or reads a log.
"""

import asyncio
import os
import socket
import sys
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from protocol.controller_health import Health, told_by
from protocol.frames.frame import Frame

if TYPE_CHECKING:
    import can

# Interfaces that return an own frame when it has been sent, and mark it. SocketCAN does so by the
# echo of the driver, the others by the receipt of the controller. `virtual` is a queue in this
# process, so a frame is sent as soon as it is queued.
CONFIRMING: Final = frozenset({"socketcan", "kvaser", "pcan", "vector", "virtual"})
# Own frames that wait for their confirmation; above this number the oldest is dropped.
UNCONFIRMED_MAX: Final = 512
# Options of Linux that no module of Python names (linux/in.h, linux/in6.h).
IP_MULTICAST_ALL: Final = 49
IPV6_MULTICAST_ALL: Final = 29


class CanBus:
    """Any python-can bus. Frames that cannot be used are counted; nothing here raises while
    running."""

    def __init__(self, bus: "can.BusABC", confirms: bool = False) -> None:
        """`confirms`: whether the bus was opened with `receive_own_messages`."""
        import can

        # Without a type, mypyc takes the attribute for a name of the module, and makes none.
        self._can: Any = can
        self.bus = bus
        self._direct_sent = hasattr(bus, "sent")
        self._confirmed: int | None = 0 if confirms else None
        self._unconfirmed: deque[Frame] = deque(maxlen=UNCONFIRMED_MAX)
        self.ignored = 0  # error, remote and 11-bit frames
        self.refused = 0  # frames that the driver did not accept
        self._told = Health.ACTIVE  # health as reported by error frames
        self._notifier: can.Notifier | None = None
        self._submit: Callable[[Frame], bool] | None = getattr(bus, "submit", None)

    def send(self, frame: Frame) -> bool:
        """Hand a frame to the driver without waiting; False if the driver did not accept it."""
        if self._submit is not None:
            taken = self._submit(frame)
        else:
            message = self._can.Message(
                arbitration_id=frame.identifier, data=frame.data, is_extended_id=True, check=False
            )
            try:
                if self._confirmed is not None:
                    self._unconfirmed.append(frame)
                self.bus.send(message, timeout=0)
                taken = True
            except (self._can.CanError, OSError, ValueError):
                taken = False
                if self._unconfirmed:
                    self._unconfirmed.pop()
        self.refused += not taken
        return taken

    @property
    def health(self) -> Health:
        """Health of the controller, from the interface or else from its error frames."""
        states = self._can.BusState
        try:
            state = self.bus.state
        except (NotImplementedError, self._can.CanError, OSError):
            return self._told
        if state is states.ACTIVE:
            return self._told
        return Health.OFF if state is states.ERROR else Health.PASSIVE

    @property
    def sent(self) -> int | None:
        """Frames of ours that have left; see `agent.interface.ports.Confirming`."""
        if self._direct_sent:
            told: int = getattr(self.bus, "sent", 0)
            return told
        return self._confirmed

    def _is_own(self, message: "can.Message") -> bool:
        """Whether this is our own frame returned. SocketCAN marks frames of other local programs
        too."""
        if message.is_rx or self._confirmed is None:
            return False
        frame = Frame(message.arbitration_id, bytes(message.data))
        if frame not in self._unconfirmed:
            return False
        while self._unconfirmed.popleft() != frame:
            pass  # the driver did not confirm those
        self._confirmed += 1
        return True

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        """Pass every data frame to the callback, in the running loop's thread."""
        direct = getattr(self.bus, "subscribe", None)
        if direct is not None:
            direct(callback)
            return

        def heard(message: "can.Message") -> None:
            if message.is_extended_id and not (message.is_error_frame or message.is_remote_frame):
                if self._is_own(message):
                    return
                callback(Frame(message.arbitration_id, bytes(message.data)))
                return
            self.ignored += 1
            if message.is_error_frame:
                self._told = told_by(message.arbitration_id, bytes(message.data), self._told)

        self._notifier = self._can.Notifier(self.bus, [heard], loop=asyncio.get_running_loop())

    def close(self) -> None:
        """Stop receiving and close the interface; the bus cannot be used afterwards."""
        if self._notifier is not None:
            self._notifier.stop()
            self._notifier = None
        self.bus.shutdown()


def open_bus(interface: str, channel: str, bitrate: int = 250_000, **options: Any) -> CanBus:
    """Open a bus by python-can's own options, at `bitrate` bit/s where the interface has one;
    raises the interface's exceptions."""
    import can

    # The interface has no bit rate of its own. Without tcp_tune, TCP delays small frames.
    if interface == "socketcand":
        bus = can.Bus(interface=interface, channel=channel, tcp_tune=True, **options)
    else:
        if interface in CONFIRMING:
            options.setdefault("receive_own_messages", True)
        bus = can.Bus(interface=interface, channel=channel, bitrate=bitrate, **options)
    if interface == "udp_multicast":
        _hear_own_group_alone(bus)
    return CanBus(bus, bool(options.get("receive_own_messages")) and interface in CONFIRMING)


def _hear_own_group_alone(bus: "can.BusABC") -> None:
    """Linux gives a socket the messages of every group that any program of the machine has joined. Two
    fleets on one machine would hear each other, with equal addresses, stops and all."""
    if sys.platform != "linux":
        return
    with socket.socket(fileno=os.dup(bus.fileno())) as same:
        if same.family == socket.AF_INET6:
            same.setsockopt(socket.IPPROTO_IPV6, IPV6_MULTICAST_ALL, 0)
        else:
            same.setsockopt(socket.IPPROTO_IP, IP_MULTICAST_ALL, 0)
