"""The only module that imports python-can here: wraps a `can.BusABC` as the `Bus` of a runner.

python-can looks for plug-ins in every installed package when it is imported, which is a third of the
start of a tool. So it is imported with the first bus, and not by a tool that finds none, or reads a log.
"""

import asyncio
import logging
import os
import secrets
import socket
import string
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from errno import ENETDOWN, ENODEV, ENXIO
from typing import TYPE_CHECKING, Any, Final

from protocol.controller_health import Health, told_by
from protocol.frames.frame import Frame

if TYPE_CHECKING:
    import can

# Interfaces that return an own frame when it has been sent, and mark it. SocketCAN does so by the
# echo of the driver, the others by the receipt of the controller. `virtual` is a queue in this
# process, so a frame is sent as soon as it is queued.
CONFIRMING: Final = frozenset({"socketcan", "kvaser", "pcan", "vector", "virtual"})
# Interfaces whose file can be read as long as a frame waits. Others may keep frames in a buffer of their
# own, where no reader looks before the next one comes, or wait for the rest of a frame.
BY_FILE: Final = frozenset({"socketcan", "udp_multicast", "slcan"})
# Own frames that wait for their return; above this number the oldest is dropped.
UNRETURNED_MAX: Final = 512
MARK_SIZE: Final = 12  # letters, so that two of a fleet are never equal
# Options of Linux that no module of Python names (linux/in.h, linux/in6.h).
IP_MULTICAST_ALL: Final = 49
IPV6_MULTICAST_ALL: Final = 29
# Errors of an interface that is gone. When its adapter comes back, it is another one, and an open socket
# stays without. A link that is down (ENETDOWN) comes back by itself.
GONE: Final = frozenset({ENODEV, ENXIO})
AWAY: Final = GONE | {ENETDOWN}  # errors after which frames of others were missed
LOST_S: Final = (
    3.0  # errors for this long, and no frame: the interface does not come back by itself
)
ERROR_GAP_S: Final = 1.0  # errors that are further apart are not the same one
# A multicast group is joined again after this long in which frames are sent and none of them comes back.
# The kernel returns a frame within a millisecond.
DEAF_S: Final = 2.0
QUIET_S: Final = 3.0  # a socket that sends nothing is joined again after this long without a frame
TELL_EVERY_S: Final = 10.0  # between two lines about errors of reception
RETRY_S: Final = 0.05  # a thread waits for this long after an error, so that it does not spin

log = logging.getLogger(__name__)


class InterfaceErrors:
    """The errors of an interface: counted, told now and then, and whether it is lost."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock`: seconds."""
        self.clock = clock
        self.count = 0  # of reception
        self.newest = ""
        self.returns = 0  # times at which frames came again from an interface that had been away
        self._away = False
        self._run_at_s: float | None = None  # since when there are errors of reception and no frame
        self._gone_at_s: float | None = None  # since when the interface is gone
        self._at_s = 0.0  # when the newest error of reception was
        self._told_at_s: float | None = None

    def received(self) -> None:
        """A frame came: the interface is there."""
        self.returns += self._away
        self._away = False
        self._run_at_s = self._gone_at_s = None

    def add(self, problem: Exception) -> None:
        """Reception failed."""
        now_s = self.clock()
        self.count += 1
        self.newest = (str(problem).splitlines() or [""])[0] or type(problem).__name__
        if self._run_at_s is None or now_s - self._at_s > ERROR_GAP_S:
            self._run_at_s = now_s
        self._at_s = now_s
        self.add_code(problem)
        if self._told_at_s is None or now_s - self._told_at_s >= TELL_EVERY_S:
            self._told_at_s = now_s
            log.warning("bus: cannot receive (error %d): %s", self.count, self.newest)

    def add_code(self, problem: Exception) -> None:
        """Reception or sending failed: its number says whether the interface is gone."""
        code = getattr(problem, "error_code", None) or getattr(problem, "errno", None)
        self._away = self._away or code in AWAY
        if code in GONE and self._gone_at_s is None:
            self._gone_at_s = self.clock()
            self.newest = (str(problem).splitlines() or [""])[0] or os.strerror(int(code))

    @property
    def lost(self) -> str | None:
        """Why the interface does not come back by itself; None: it is there, or may come back."""
        now_s, run_at_s = self.clock(), self._run_at_s
        if self._gone_at_s is not None and now_s - self._gone_at_s >= LOST_S:
            return f"the interface is gone: {self.newest}"
        if run_at_s is not None and self._at_s - run_at_s >= LOST_S:
            return f"cannot receive: {self.newest}"
        return None


class Loopback:
    """Own frames that an interface returns without a mark of its own, as UDP multicast does.

    Each carries a mark of this bus as its channel, and is expected back once. So a frame of another
    device is heard, also if it has our address and equal data. The kernel returns a frame before it
    leaves the machine, and also if no cable is plugged in. So a return confirms nothing
    (`agent.interface.ports.Confirming`). But frames that are sent and do not come back say that the
    socket is no member of its group any more. It loses that with the network interface, and an interface
    that comes back is another one.
    """

    def __init__(
        self, opened: "Callable[[], can.BusABC]", clock: Callable[[], float] = time.monotonic
    ) -> None:
        """`opened`: opens the interface and joins the group. `clock`: seconds."""
        self.opened, self.clock = opened, clock
        # Letters alone: loggers of python-can take digits at the end of a channel for its number.
        self.mark = "".join(secrets.choice(string.ascii_lowercase) for _ in range(MARK_SIZE))
        self._unreturned: deque[Frame] = deque(maxlen=UNRETURNED_MAX)
        self._returns = False  # else this system returns none, and that says nothing
        self._run_at_s: float | None = None  # since when frames are sent and none comes back
        self._sent_at_s = 0.0  # when the newest frame was sent
        self._heard_at_s: float | None = None  # when the newest frame came; None: none has
        self._told_at_s: float | None = None

    def sent(self, frame: Frame) -> None:
        """The interface has taken a frame of ours."""
        now_s = self.clock()
        # Returned frames of a process that was frozen may still wait to be read.
        if self._run_at_s is None or now_s - self._sent_at_s > ERROR_GAP_S:
            self._run_at_s = now_s
        self._sent_at_s = now_s
        self._unreturned.append(frame)

    def is_own(self, message: "can.Message") -> bool:
        """Whether this is our own frame returned. Another one of the same is not."""
        if message.channel != self.mark:
            return False
        if not _taken(Frame(message.arbitration_id, bytes(message.data)), self._unreturned):
            return False
        self._returns, self._run_at_s = True, None
        return True

    @property
    def deaf(self) -> bool:
        """Whether frames were sent for `DEAF_S` and none came back."""
        run_at_s = self._run_at_s
        return self._returns and run_at_s is not None and self._sent_at_s - run_at_s >= DEAF_S

    def received(self) -> None:
        """A frame came: the socket is a member of its group."""
        self._heard_at_s = self.clock()

    @property
    def quiet(self) -> bool:
        """Whether frames came, and for `QUIET_S` none came or was sent: no device speaks, or the socket
        has lost its group."""
        heard_at_s = self._heard_at_s
        if heard_at_s is None:
            return False
        return self.clock() - max(heard_at_s, self._sent_at_s) >= QUIET_S

    def joined_again(self, *, tells: bool = True) -> "can.BusABC | None":
        """The interface, opened once more; None if that fails. `deaf` is true `DEAF_S` later at the
        earliest, and `quiet` `QUIET_S` later. `tells`: a line is logged now and then."""
        import can

        self._run_at_s = None
        if self._heard_at_s is not None:
            self._heard_at_s = self.clock()
        bus, done = None, "joined the group again"
        try:
            bus = self.opened()
            self._unreturned.clear()
        except (can.CanError, OSError) as problem:
            done = f"cannot join the group again: {problem}"
        now_s = self.clock()
        if tells and (self._told_at_s is None or now_s - self._told_at_s >= TELL_EVERY_S):
            self._told_at_s = now_s
            log.warning("bus: own frames do not come back: %s", done)
        return bus


def _taken(frame: Frame, waiting: deque[Frame]) -> bool:
    """Take a returned frame out of those that wait; False if it is none of them. Those before it are
    not returned any more."""
    if frame not in waiting:
        return False
    while waiting.popleft() != frame:
        pass
    return True


class CanBus:
    """Any python-can bus. Frames that cannot be used are counted; nothing here raises while
    running."""

    def __init__(
        self,
        bus: "can.BusABC",
        confirms: bool = False,
        loopback: Loopback | None = None,
        by_file: bool = True,
    ) -> None:
        """`confirms`: whether the bus was opened with `receive_own_messages`. `loopback`: how own frames
        are recognised that the interface returns unmarked; None: it returns none. `by_file`: whether
        its file, if it has one, can be read as long as a frame waits; else a thread receives."""
        import can

        # Without a type, mypyc takes the attribute for a name of the module, and makes none.
        self._can: Any = can
        self.bus = bus
        self._direct_sent = hasattr(bus, "sent")
        self._confirmed: int | None = 0 if confirms else None
        self._unconfirmed: deque[Frame] = deque(maxlen=UNRETURNED_MAX)
        self._loopback, self._by_file = loopback, by_file
        self.ignored = 0  # error, remote and 11-bit frames, and those without a whole identifier
        self.refused = 0  # frames that the driver did not accept
        self._told = Health.ACTIVE  # health as reported by error frames
        self._returns = 0  # of the controller from bus-off, and of the socket into its group
        self.errors = InterfaceErrors()
        self._notifier: can.Notifier | None = None
        # Loop, the file that it reads, and what it calls then.
        self._read: tuple[asyncio.AbstractEventLoop, int, Callable[[], None]] | None = None
        self._look: asyncio.TimerHandle | None = None  # the next look whether the group is lost
        self._submit: Callable[[Frame], bool] | None = getattr(bus, "submit", None)

    def send(self, frame: Frame) -> bool:
        """Hand a frame to the driver without waiting; False if the driver did not accept it."""
        if self._submit is not None:
            taken = self._submit(frame)
        else:
            loopback = self._loopback
            message = self._can.Message(
                arbitration_id=frame.identifier, data=frame.data, is_extended_id=True, check=False,
                channel=None if loopback is None else loopback.mark,
            )  # fmt: skip
            try:
                if self._confirmed is not None:
                    self._unconfirmed.append(frame)
                self.bus.send(message, timeout=0)
                taken = True
                if loopback is not None:
                    loopback.sent(frame)
                    if loopback.deaf:
                        self._join_again(loopback)
            except Exception as problem:  # python-can interfaces raise what they like
                taken = False
                self.errors.add_code(problem)
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

    @property
    def connections(self) -> int:
        """How often it began to hear others: once, and after each time at which it had heard none. Its
        link was down then, its controller off the bus, or its socket out of its group."""
        return 1 + self.errors.returns + self._returns

    def _is_own(self, message: "can.Message") -> bool:
        """Whether this is our own frame returned. SocketCAN marks frames of other local programs
        too."""
        if self._loopback is not None:
            return self._loopback.is_own(message)
        if message.is_rx or self._confirmed is None:
            return False
        frame = Frame(message.arbitration_id, bytes(message.data))
        if not _taken(frame, self._unconfirmed):
            return False
        self._confirmed += 1
        return True

    def subscribe(self, callback: Callable[[Frame], None]) -> None:
        """Pass every data frame to the callback, in the running loop's thread. An earlier callback hears
        nothing more."""
        direct = getattr(self.bus, "subscribe", None)
        if direct is not None:
            direct(callback)
            return

        def heard(message: "can.Message") -> None:
            self.errors.received()
            if self._loopback is not None:
                self._loopback.received()
            # What is sent by UDP is of any kind: some languages have only numbers with a fraction.
            if type(message.arbitration_id) is not int:
                self.ignored += 1
                return
            if message.is_extended_id and not (message.is_error_frame or message.is_remote_frame):
                if self._is_own(message):
                    return
                callback(Frame(message.arbitration_id, bytes(message.data)))
                return
            self.ignored += 1
            if message.is_error_frame:
                was = self._told
                self._told = told_by(message.arbitration_id, bytes(message.data), was)
                self._returns += was is Health.OFF and self._told is not Health.OFF

        loop = asyncio.get_running_loop()
        try:
            file = self.bus.fileno() if self._by_file else -1
        except NotImplementedError:
            file = -1
        if file < 0:  # read by a thread
            # Of an engine that was restarted: python-can refuses a second one.
            if self._notifier is not None:
                self._notifier.stop()
            self._notifier = self._can.Notifier(
                self.bus, [Passed(heard, self.errors, loop, self.bus)]
            )
            return

        def readable() -> None:
            try:
                message = self.bus.recv(0)
            except Exception as problem:  # python-can interfaces raise what they like
                _forget_garbage(self.bus, problem)
                self.errors.add(problem)
                return
            if message is not None:
                heard(message)

        loop.add_reader(file, readable)
        self._read = loop, file, readable
        if self._loopback is not None:
            self._look_at_group(self._loopback, loop)

    def _look_at_group(self, loopback: Loopback, loop: asyncio.AbstractEventLoop) -> None:
        """A program that only listens has no frame of its own that could come back."""
        if self._look is not None:
            self._look.cancel()
        if loopback.quiet:
            self._join_again(loopback, tells=False)
        self._look = loop.call_later(DEAF_S, self._look_at_group, loopback, loop)

    def _join_again(self, loopback: Loopback, *, tells: bool = True) -> None:
        """Receive by a new socket, which is a member of its group."""
        bus = loopback.joined_again(tells=tells)
        if bus is None:
            return
        read = self._read
        self._returns += 1
        self._end_read()
        self.bus.shutdown()
        self.bus = bus
        if read is not None:
            loop, _, readable = read
            self._read = loop, bus.fileno(), readable
            loop.add_reader(bus.fileno(), readable)

    def _end_read(self) -> None:
        if self._read is not None:
            loop, file, _ = self._read
            loop.remove_reader(file)
            self._read = None

    @property
    def lost(self) -> str | None:
        """Why the interface does not come back by itself: it has to be reopened. None: it is there,
        or its link is down and may come up again."""
        return self.errors.lost

    def close(self) -> None:
        """Stop receiving and close the interface; the bus cannot be used afterwards."""
        if self._notifier is not None:
            self._notifier.stop()
            self._notifier = None
        if self._look is not None:
            self._look.cancel()
            self._look = None
        self._end_read()
        try:
            self.bus.shutdown()
        except Exception as problem:  # of an adapter that is gone, to which nothing can be said
            log.warning("bus: cannot close: %s", str(problem) or type(problem).__name__)


class Passed:
    """What a thread receives is passed to the loop, and so are its errors. After an error it goes on."""

    def __init__(
        self,
        heard: "Callable[[can.Message], None]",
        errors: InterfaceErrors,
        loop: asyncio.AbstractEventLoop,
        bus: "can.BusABC",
    ) -> None:
        self.heard, self.errors, self.loop, self.bus = heard, errors, loop, bus
        self._ended = threading.Event()

    def __call__(self, message: "can.Message") -> None:
        """A frame, in the thread."""
        self.loop.call_soon_threadsafe(self.heard, message)

    def on_error(self, problem: Exception) -> None:
        """An error, in the thread: also that the loop has ended, which ends the thread."""
        _forget_garbage(self.bus, problem)
        self.loop.call_soon_threadsafe(self.errors.add, problem)
        self._ended.wait(RETRY_S)

    def stop(self) -> None:
        """End the wait; the notifier calls it."""
        self._ended.set()


def open_bus(interface: str, channel: str, bitrate: int = 250_000, **options: Any) -> CanBus:
    """Open a bus by python-can's own options, at `bitrate` bit/s where the interface has one;
    raises the interface's exceptions."""
    import can

    if interface == "udp_multicast":

        def opened() -> "can.BusABC":
            bus = can.Bus(interface=interface, channel=channel, bitrate=bitrate, **options)
            _hear_own_group_alone(bus)
            return bus

        return CanBus(opened(), loopback=Loopback(opened))
    # The interface has no bit rate of its own. Without tcp_tune, TCP delays small frames.
    if interface == "socketcand":
        bus = can.Bus(interface=interface, channel=channel, tcp_tune=True, **options)
    else:
        if interface in CONFIRMING:
            options.setdefault("receive_own_messages", True)
        bus = can.Bus(interface=interface, channel=channel, bitrate=bitrate, **options)
    confirms = bool(options.get("receive_own_messages")) and interface in CONFIRMING
    return CanBus(bus, confirms, by_file=interface in BY_FILE)


def _forget_garbage(bus: "can.BusABC", problem: Exception) -> None:
    """`slcan` of python-can keeps a line with a byte that is no text, so each later line is an error.
    Its `flush` would lose the frames that wait."""
    kept: object = getattr(bus, "_buffer", None)
    kinds = type(problem), type(problem.__cause__)
    if UnicodeDecodeError in kinds and isinstance(kept, bytearray):
        kept.clear()


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
