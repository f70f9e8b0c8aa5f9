"""Steering and speed of a tractor by its bus: ISO 11783-7, guidance system command and machine speed.

| PGN | from | is |
|---|---|---|
| 44032 | the tractor | estimated curvature, lockout, readiness, engage switch |
| 44288 | us | commanded curvature, and whether we intend to steer |
| 64835 | us | machine selected speed command: set point, limit, direction |
| 65096, 65097 | the tractor | speed of wheels, speed over ground |

Sans I/O. Nothing is commanded before the tractor says within 0.5 s that nothing locks its steering, that
it is ready, and that its engage switch is on: that switch is beside the person on the tractor.
"""

from math import tan
from struct import pack, unpack_from
from typing import Final

from agent.interface.config import CONTROL_PERIOD_US, MS
from agent.motion.wheel_kinematics import WheelSpeeds
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS, Identifier

MACHINE_INFO, CURVATURE_COMMAND, SPEED_COMMAND = 0xAC00, 0xAD00, 0xFD43
WHEEL_SPEED, GROUND_SPEED = 0xFE48, 0xFE49
PRIORITY: Final = 3
COMMAND_US: Final = 100 * MS  # the rate of the standard; a halt is said at once
# Between two commands at least. Control periods come some milliseconds early or late.
COMMAND_GAP_US: Final = COMMAND_US - CONTROL_PERIOD_US // 2
INFO_AGE_MAX_US: Final = 500 * MS  # five messages of the tractor
SPEED_AGE_MAX_US: Final = 500 * MS  # the same of its speed
CURVATURE_STEP: Final = 0.25  # 1/km per bit
CURVATURE_OFFSET: Final = 8032.0  # 1/km
CURVATURE_BITS_MAX: Final = 0xFAFF
SPEED_BITS_MAX: Final = 0xFAFF  # of 1 mm/s
REVERSE, FORWARD = 0, 1
NOT_STEERING, STEERING = 0, 1
NOT_ACTIVE, YES = 0, 1  # two bits: lockout; readiness and switch
NO_LIMIT: Final = 0xFFFF


class GuidanceCommands:
    """What a tractor says of its steering and speed, and the commands for it."""

    def __init__(self, wheelbase_m: float, *, steering: bool, speed: bool) -> None:
        """`steering`, `speed`: whether these are commanded at all."""
        self.wheelbase_m, self.steering, self.speed = wheelbase_m, steering, speed
        self.source: int | None = None  # address of the tractor
        self._machine_speed: tuple[float, int] | None = None  # metres a second, signed, and when
        self._ready_at_us = -INFO_AGE_MAX_US - 1
        self._ready = False
        self._said_at_us = -COMMAND_US
        self._engaged = False  # we have commanded, and not yet let go

    def take(self, identifier: int, data: bytes, now_us: int) -> None:
        """Take a frame of the bus; others than those of the table are ignored."""
        frame = Identifier.unpack(identifier)
        if len(data) < 8:
            return
        if frame.pgn == MACHINE_INFO:
            heard = now_us - self._ready_at_us <= INFO_AGE_MAX_US
            if self.source not in (None, frame.source) and heard:
                return  # a second tractor on the bus is not ours, also while ours is not ready
            lockout, ready, switch = data[2] & 3, data[2] >> 2 & 3, data[4] >> 6 & 3
            self.source, self._ready_at_us = frame.source, now_us
            self._ready = lockout == NOT_ACTIVE and ready == YES and switch == YES
        elif frame.pgn in (WHEEL_SPEED, GROUND_SPEED):
            (speed,), direction = unpack_from("<H", data), data[7] & 3
            # A radar knows no direction: its speed is no velocity of a tractor that reverses.
            if speed <= SPEED_BITS_MAX and (direction in (REVERSE, FORWARD) or not speed):
                sign = -1.0 if direction == REVERSE else 1.0
                self._machine_speed = sign * speed / 1000, now_us

    def machine_speed_m_s(self, now_us: int) -> float | None:
        """The speed as the tractor measures it, metres a second, negative backwards; None if it has said
        none within 0.5 s."""
        told = self._machine_speed
        return None if told is None or now_us - told[1] > SPEED_AGE_MAX_US else told[0]

    def ready(self, now_us: int) -> bool:
        """Whether the tractor may be commanded now."""
        return self._ready and now_us - self._ready_at_us <= INFO_AGE_MAX_US

    def commands(
        self, wheels: WheelSpeeds, wheel_radius_m: float, address: int, now_us: int
    ) -> list[Frame]:
        """The frames for these wheels of an Ackermann body, from our source address.

        None while nothing may be commanded, but for one that lets go. `wheel_radius_m`: metres.
        """
        forward_m_s = wheels.wheels_rad_s[0] * wheel_radius_m
        halts = forward_m_s == 0.0
        if not self.ready(now_us):
            if not self._engaged:
                return []
            self._engaged = False
            return self._frames(0.0, 0.0, NOT_STEERING, address)
        if not halts and now_us - self._said_at_us < COMMAND_GAP_US:
            return []
        self._said_at_us, self._engaged = now_us, True
        # The standard counts curvature to the right of the driver, and our angles go to the left.
        curvature_1_km = -1000 * tan(wheels.steer_rad) / self.wheelbase_m
        return self._frames(curvature_1_km, forward_m_s, STEERING, address)

    def let_go(self, address: int) -> list[Frame]:
        """Stand, and do not steer any more."""
        if not self._engaged:
            return []
        self._engaged = False
        return self._frames(0.0, 0.0, NOT_STEERING, address)

    def _frames(
        self, curvature_1_km: float, forward_m_s: float, status: int, address: int
    ) -> list[Frame]:
        frames = []
        if self.steering:
            bits = round((curvature_1_km + CURVATURE_OFFSET) / CURVATURE_STEP)
            data = pack("<HB5s", min(max(bits, 0), CURVATURE_BITS_MAX), 0xFC | status, b"\xff" * 5)
            to = GLOBAL_ADDRESS if self.source is None else self.source
            frames.append(Frame(Identifier(PRIORITY, CURVATURE_COMMAND, to, address).pack(), data))
        if self.speed:
            bits = min(round(1000 * abs(forward_m_s)), SPEED_BITS_MAX)
            direction = REVERSE if forward_m_s < 0.0 else FORWARD
            data = pack("<HH3sB", bits, NO_LIMIT, b"\xff" * 3, 0xFC | direction)
            identifier = Identifier(PRIORITY, SPEED_COMMAND, GLOBAL_ADDRESS, address).pack()
            frames.append(Frame(identifier, data))
        return frames
