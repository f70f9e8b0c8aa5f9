"""A machine with a GNSS receiver, two antennas, and a controller of its wheels.

The receiver is at a serial port or a socket (`line_port.py`, `nmea_fixes.py`), or on a CAN bus: with
`gnss = "can:socketcan:can0"` the messages of `bus_fixes.py` are taken.

    [body]
    plugin = "nmea"
    options = { gnss = "tcp://10.0.0.5:2947", wheels = "serial:/dev/ttyUSB0@115200" }

The receiver sends NMEA 0183, at 20 Hz: a place older than 100 ms stops the robot. `nmea_fixes.py` says
which sentences. The controller takes the sentences of `wheel_sentences.py`.
"""

import asyncio
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from pyproj import Transformer

from agent.interface.config import ACTUATOR_TTL_US, MS
from agent.interface.effects import HALT, Drive, GatedDrive
from agent.interface.observation import Observation
from agent.motion.wheel_kinematics import WheelBase, WheelDrive
from agent.runtime.bodies.bus_fixes import WHO_IS_THERE, BusFixes
from agent.runtime.bodies.line_port import FORMS, LinePort
from agent.runtime.bodies.position_fixes import ReceiverClock
from agent.runtime.bodies.wheel_sentences import NUMBERS, WheelSentence, pack
from agent.runtime.files.field_file import plane
from agent.runtime.option_values import (
    LATENCY_MAX_MS,
    WHEEL_RADIUS_M,
    accuracy,
    antenna,
    number,
    origin_or_none,
    text,
)
from agent.runtime.robot_body import DeclaredMachine, RobotBody
from protocol.frames.frame import Frame
from protocol.links.bus import CanBus, open_bus

if TYPE_CHECKING:
    from agent.runtime.bodies.nmea_fixes import NmeaFixes

FIRST_S: Final = 5.0  # for the first fix; a receiver that is warm needs less
LOOK_S: Final = 0.02
BUS: Final = "can:"
LATENCY_MS: Final = 20.0  # typical of RTK receivers at 20 Hz


def in_field(origin: tuple[float, float]) -> Callable[[float, float], tuple[float, float]]:
    """Longitude and latitude to metres east and north of an origin (latitude, longitude)."""
    transform = Transformer.from_crs("EPSG:4326", plane(origin), always_xy=True).transform
    return lambda longitude, latitude: transform(longitude, latitude)


class BusReceiver:
    """The frames of a receiver on a CAN bus, by an interface of its own."""

    def __init__(self, address: str, heard: Callable[[Frame], None]) -> None:
        """`address`: "can:INTERFACE:CHANNEL" of python-can. Raises ValueError."""
        self.address, self.heard = address, heard
        _, self.interface, self.channel = (*address.split(":", 2), "", "")[:3]
        if not self.interface or not self.channel:
            raise ValueError(f"{address!r} is not can:INTERFACE:CHANNEL")
        self._bus: CanBus | None = None

    def open(self) -> None:
        """Begin to receive, on the running asyncio loop. Raises OSError."""
        try:
            self._bus = open_bus(self.interface, self.channel)
        except Exception as problem:  # python-can interfaces raise what they like
            reason = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
            raise OSError(f"{self.address}: {reason}") from None
        self._bus.subscribe(self.heard)
        self._bus.send(WHO_IS_THERE)

    def check(self) -> None:
        """Raises OSError if the interface is gone and does not come back by itself."""
        if self._bus is not None and self._bus.lost is not None:
            raise OSError(f"{self.address}: {self._bus.lost}")

    def close(self) -> None:
        """End the reception, so that the interface is free for others."""
        if self._bus is not None:
            self._bus.close()
            self._bus = None


class NmeaBody(RobotBody):
    """A body by two lines of text: sentences in, wheel speeds out."""

    def __init__(
        self,
        slot: int,
        gnss: str,
        wheels: str,
        wheel_radius_m: float = 0.1,
        antenna_ahead_m: float = 0.0,
        antenna_left_m: float = 0.0,
        latency_ms: float = LATENCY_MS,
        accuracy_m: float | None = None,
        origin: tuple[float, float] | None = None,
    ) -> None:
        """`gnss`, `wheels`: addresses of `LinePort`; `gnss` also "can:INTERFACE:CHANNEL". The antenna
        is this far ahead and left of the middle. `latency_ms`: from the time of a place to its arrival.
        `accuracy_m`: of places whose receiver says none; none: they are not believed. `origin`:
        latitude and longitude of (0, 0), if there is no field. Raises ValueError."""
        self.slot, self.origin = slot, origin_or_none(origin)
        self.wheel_radius_m = number("wheel_radius_m", wheel_radius_m, *WHEEL_RADIUS_M)
        self.antenna_m = antenna(antenna_ahead_m, antenna_left_m)
        self.latency_us = round(number("latency_ms", latency_ms, 0.0, LATENCY_MAX_MS) * MS)
        self.accuracy_m = accuracy(accuracy_m)
        gnss = text("gnss", gnss, f"{FORMS}, or can:INTERFACE:CHANNEL")
        wheels = text("wheels", wheels, FORMS)
        try:
            self.gnss = (
                BusReceiver(gnss, self._heard)
                if gnss.startswith(BUS)
                else LinePort(gnss, self._take, receives=True)
            )
        except ValueError as problem:
            raise ValueError(f"options.gnss: {problem}") from None
        try:
            self.wheels = LinePort(wheels, lambda line, at_us: None)
        except ValueError as problem:
            raise ValueError(f"options.wheels: {problem}") from None
        self.fixes: NmeaFixes | None = None
        self.frames: BusFixes | None = None
        self.wheel_drive: WheelDrive | None = None
        self._newest: Observation | None = None
        self._number = 0

    def declare(self, machine: DeclaredMachine) -> None:
        """Raises ValueError if neither the field nor the options say where (0, 0) is."""
        origin = self.origin or machine.origin
        if origin is None:
            raise ValueError(
                "without a field, options.origin says latitude and longitude of (0, 0)"
            )
        to_metres, clock = in_field(origin), ReceiverClock(self.latency_us)
        if isinstance(self.gnss, BusReceiver):
            self.frames = BusFixes(
                to_metres, self.antenna_m, clock.sensed_at_us, self.latency_us, self.accuracy_m
            )
        else:
            try:
                from agent.runtime.bodies import nmea_fixes
            except ImportError as problem:
                raise ValueError(str(problem)) from None
            self.fixes = nmea_fixes.NmeaFixes(
                to_metres, self.antenna_m, clock.sensed_at_us, self.accuracy_m
            )
        self.wheel_drive = WheelDrive(WheelBase.of(machine.vehicle, self.wheel_radius_m))

    async def open(self) -> None:
        """Connect, and wait for the first place. Raises OSError."""
        taken = self.frames or self.fixes
        assert taken is not None, "`declare` comes before `open`"
        self._newest = None
        self.wheels.open()
        try:
            self.gnss.open()
        except OSError:
            self.wheels.close()
            raise
        loop = asyncio.get_running_loop()
        ends_at_s = loop.time() + FIRST_S
        while self._newest is None:
            if loop.time() > ends_at_s:
                heard = ", ".join(f"{count} {kind}" for kind, count in taken.counts.items())
                self.close()
                raise OSError(
                    f"{self.gnss.address}: no place and heading in {FIRST_S:.0f} s "
                    f"(heard: {heard or 'nothing'})"
                )
            await asyncio.sleep(LOOK_S)

    def _heard(self, frame: Frame) -> None:
        assert self.frames is not None
        at_us = time.monotonic_ns() // 1000
        self._newest = self.frames.take(frame.identifier, frame.data, at_us) or self._newest

    def _take(self, line: bytes, at_us: int) -> None:
        assert self.fixes is not None
        self._newest = self.fixes.take(line, at_us) or self._newest

    def sense(self, now_us: int) -> Observation | None:
        """The newest place with a heading. Raises OSError if the receiver's interface is gone."""
        if isinstance(self.gnss, BusReceiver):
            self.gnss.check()
        return self._newest

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """Send wheel speeds that last for the lifetime of a command."""
        self._send(command)

    def _send(self, command: Drive) -> None:
        here, drive = self._newest, self.wheel_drive
        assert drive is not None, "`declare` comes before `drive`"
        speeds = drive.still if here is None else drive.speeds(command, here.heading_rad)
        self._number = (self._number + 1) % NUMBERS
        life_for_ms = ACTUATOR_TTL_US // MS
        self.wheels.write(pack(WheelSentence(self._number, life_for_ms, command.tool_on, speeds)))

    def close(self) -> None:
        """Stand, and free both ports."""
        self._send(HALT)
        self.wheels.close()
        self.gnss.close()
