"""A tractor by its own bus: places from the receiver on it, steering and speed by commands on it.

    [body]
    plugin = "isobus"
    options = { channel = "can1", steering = true, speed = true }

Places are taken as the body `nmea` takes them on a CAN bus. Without `steering` and `speed`, which are
off by default, the body only listens. With them the tractor's own engage switch decides. The implement
is not moved: it has a task controller for that.

A tractor obeys a command for as long as its maker likes. So the body itself commands it to stand when the
robot has given no command for 100 ms. Only when this process dies, the tractor's own limit decides.
"""

import asyncio
import time
from math import cos, sin
from random import Random
from typing import Final

from agent.interface.config import ACTUATOR_TTL_US, MS, S
from agent.interface.effects import HALT, Drive, GatedDrive
from agent.interface.observation import Observation
from agent.interface.vehicle import DriveTrain
from agent.motion.wheel_kinematics import WheelBase, WheelDrive
from agent.runtime.bodies.bus_fixes import WHO_IS_THERE, BusFixes
from agent.runtime.bodies.guidance_commands import GuidanceCommands
from agent.runtime.bodies.nmea_body import FIRST_S, LATENCY_MS, LOOK_S, in_field
from agent.runtime.bodies.position_fixes import ReceiverClock
from agent.runtime.option_values import (
    LATENCY_MAX_MS,
    accuracy,
    antenna,
    flag,
    name_or_number,
    number,
    origin_or_none,
    text,
)
from agent.runtime.robot_body import DeclaredMachine, RobotBody
from protocol.address import AddressClaim, AddressMessage
from protocol.frames.codec import decode, encode
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS, Identifier
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import AddressClaimed, Request, refusal
from protocol.links.bus import CanBus, open_bus
from protocol.name import Name

PREFERRED: Final = 200  # address on the tractor's bus, away from the robots'
NO_FUNCTION: Final = 255  # of a NAME: not available
WHEEL_RADIUS_M: Final = (
    1.0  # of the wheels that we count with: any will do, as speeds are told in m/s
)
CLAIM_PGN: Final = GROUP_OF[AddressClaimed].pgn


class IsobusBody(RobotBody):
    """A body by the messages of one tractor."""

    def __init__(
        self,
        slot: int,
        channel: str,
        interface: str = "socketcan",
        steering: bool = False,
        speed: bool = False,
        antenna_ahead_m: float = 0.0,
        antenna_left_m: float = 0.0,
        latency_ms: float = LATENCY_MS,
        accuracy_m: float | None = None,
        origin: tuple[float, float] | None = None,
    ) -> None:
        """`interface`, `channel`: of python-can. `steering`, `speed`: whether they are commanded. The
        others are those of the body `nmea`. Raises ValueError."""
        self.slot = slot
        self.interface = text("interface", interface, "an interface of python-can")
        self.channel = name_or_number("channel", channel, "a channel of the interface")
        self.origin = origin_or_none(origin)
        self.wanted = (flag("steering", steering), flag("speed", speed))
        self.antenna_m = antenna(antenna_ahead_m, antenna_left_m)
        self.latency_us = round(number("latency_ms", latency_ms, 0.0, LATENCY_MAX_MS) * MS)
        self.accuracy_m = accuracy(accuracy_m)
        self.fixes: BusFixes | None = None
        self.guidance: GuidanceCommands | None = None
        self.claim: AddressClaim | None = None
        self._wheels: WheelDrive | None = None
        self._bus: CanBus | None = None
        self._newest: Observation | None = None
        self._expiry: asyncio.TimerHandle | None = None  # of the last command to move

    def declare(self, machine: DeclaredMachine) -> None:
        """Raises ValueError for another drive train than Ackermann, or without a place of (0, 0)."""
        origin = self.origin or machine.origin
        if origin is None:
            raise ValueError(
                "without a field, options.origin says latitude and longitude of (0, 0)"
            )
        if machine.vehicle.drive is not DriveTrain.ACKERMANN:
            raise ValueError('a tractor is steered: fleet.drive = "ackermann"')
        clock = ReceiverClock(self.latency_us)
        self.fixes = BusFixes(
            in_field(origin), self.antenna_m, clock.sensed_at_us, self.latency_us, self.accuracy_m
        )
        base = WheelBase.of(machine.vehicle, WHEEL_RADIUS_M)
        steering, speed = self.wanted
        self.guidance = GuidanceCommands(2 * base.half_base_m, steering=steering, speed=speed)
        self._wheels = WheelDrive(base)

    async def open(self) -> None:
        """Connect, and wait for the first place. Raises OSError."""
        assert self.fixes is not None, "`declare` comes before `open`"
        try:
            self._bus = open_bus(self.interface, self.channel)
        except Exception as problem:  # python-can interfaces raise what they like
            reason = str(problem).splitlines()[0] if str(problem) else type(problem).__name__
            raise OSError(f"{self.interface} {self.channel}: {reason}") from None
        self._newest = None
        if any(self.wanted):
            name = Name(self.slot + 1, function=NO_FUNCTION, device_class=0)
            self.claim = AddressClaim(name, PREFERRED, Random(self.slot), _now_us())
        self._bus.subscribe(self._heard)
        self._bus.send(WHO_IS_THERE)
        loop = asyncio.get_running_loop()
        ends_at_s = loop.time() + FIRST_S
        while self._newest is None:
            self._claims(_now_us())
            if loop.time() > ends_at_s:
                heard = ", ".join(f"{n} {kind}" for kind, n in self.fixes.counts.items())
                self.close()
                raise OSError(
                    f"{self.interface} {self.channel}: no place and heading in {FIRST_S:.0f} s "
                    f"(heard: {heard or 'nothing'})"
                )
            await asyncio.sleep(LOOK_S)

    def sense(self, now_us: int) -> Observation | None:
        """The newest place with a heading; with the tractor's speed where the receiver tells none.

        Raises OSError if the interface of the tractor's bus is gone."""
        if self._bus is not None and self._bus.lost is not None:
            raise OSError(f"{self.interface} {self.channel}: {self._bus.lost}")
        return self._newest

    def drive(self, command: GatedDrive, now_us: int) -> None:
        """Command steering and speed, as far as they are switched on, for the lifetime of a command."""
        self._forget_expiry()
        if command != HALT and self._bus is not None:
            loop = asyncio.get_running_loop()
            self._expiry = loop.call_later(ACTUATOR_TTL_US / S, self._expires)
        self._send(command, now_us)

    def close(self) -> None:
        """Let go, and free the interface."""
        self._forget_expiry()
        if self._bus is None:
            return
        if self.guidance is not None and self.claim is not None and self.claim.address is not None:
            for frame in self.guidance.let_go(self.claim.address):
                self._bus.send(frame)
        self._bus.close()
        self._bus = None

    # ---------------------------------------------------------------- inside

    def _expires(self) -> None:
        self._expiry = None
        self._send(HALT, _now_us())

    def _forget_expiry(self) -> None:
        if self._expiry is not None:
            self._expiry.cancel()
            self._expiry = None

    def _send(self, command: Drive, now_us: int) -> None:
        wheels, guidance = self._wheels, self.guidance
        assert wheels is not None and guidance is not None, "`declare` comes before `drive`"
        self._claims(now_us)
        if self.claim is None or self.claim.address is None or self._bus is None:
            return
        here = self._newest
        speeds = (
            wheels.still
            if here is None or command == HALT
            else wheels.speeds(command, here.heading_rad)
        )
        for frame in guidance.commands(speeds, WHEEL_RADIUS_M, self.claim.address, now_us):
            self._bus.send(frame)

    def _heard(self, frame: Frame) -> None:
        assert self.fixes is not None and self.guidance is not None
        now_us = _now_us()
        self.guidance.take(frame.identifier, frame.data, now_us)
        here = self.fixes.take(frame.identifier, frame.data, now_us)
        if here is not None:
            self._newest = self._with_speed(here, now_us)
        elif self.claim is not None:
            self._network(frame, now_us)

    def _with_speed(self, here: Observation, now_us: int) -> Observation:
        """The tractor's own speed, where the receiver tells none."""
        assert self.fixes is not None and self.guidance is not None
        speed_m_s = self.guidance.machine_speed_m_s(now_us)
        if self.fixes.fixes.knows_velocity(now_us) or speed_m_s is None:
            return here
        heading = here.heading_rad
        return here._replace(vx_m_s=speed_m_s * cos(heading), vy_m_s=speed_m_s * sin(heading))

    def _network(self, frame: Frame, now_us: int) -> None:
        """Keep our address on the tractor's bus."""
        assert self.claim is not None
        identifier = Identifier.unpack(frame.identifier)
        if identifier.pgn not in (CLAIM_PGN, GROUP_OF[Request].pgn):
            return
        source, message = decode(frame)
        if isinstance(message, AddressClaimed):
            self._say(self.claim.on_message(source, message, now_us))
        elif isinstance(message, Request) and message.pgn == CLAIM_PGN:
            everybody = identifier.destination == GLOBAL_ADDRESS
            if everybody or identifier.destination == self.claim.candidate:
                self._say(self.claim.on_request(everybody, now_us))
        elif isinstance(message, Request) and source < NULL_ADDRESS:
            address = self.claim.address
            if address is not None and identifier.destination == address:
                assert self._bus is not None
                self._bus.send(encode(refusal(source, message.pgn), address))

    def _claims(self, now_us: int) -> None:
        if self.claim is not None:
            self._say(self.claim.on_tick(now_us))

    def _say(self, claims: list[AddressMessage]) -> None:
        assert self._bus is not None
        for message, source, destination in claims:
            self._bus.send(encode(message, source, destination))


def _now_us() -> int:
    return time.monotonic_ns() // 1000
