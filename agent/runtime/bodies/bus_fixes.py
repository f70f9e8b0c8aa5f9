"""Observations from the messages of a receiver on a CAN bus: NMEA 2000, and those of J1939.

| PGN | gives |
|---|---|
| 129025 | place |
| 129026 | velocity |
| 129029 | kind of fix, time, and the place where no other message has it |
| 127250 | heading |
| 65267 | place |
| 65256 | speed, and the heading where nobody has sent 127250 |

Only the first sender of places is believed, and the first of 127250: two receivers are metres apart. Who
says that it has no place, or no heading from true north, is no such sender. Each is followed to another
address, where it was heard to claim one (ISO 11783-5).
129025 and 65267 have no time. Their age is that of their arrival, and what is late does not show.
"""

from collections import Counter
from collections.abc import Callable
from math import cos, degrees, inf, sin
from struct import unpack_from
from typing import Final

from agent.interface.config import S
from agent.interface.observation import Observation
from agent.runtime.bodies.position_fixes import ACCURACY_M, PositionFixes, course_rad
from protocol.frames.codec import encode
from protocol.frames.identifier import NULL_ADDRESS, Identifier
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import AddressClaimed, Request

CLAIM_PGN: Final = GROUP_OF[AddressClaimed].pgn
# Sent once when a device begins to listen, because most others claimed their addresses long before. The
# first claim of the receiver's address could otherwise be that of another device, which takes it.
WHO_IS_THERE: Final = encode(Request(CLAIM_PGN), NULL_ADDRESS)
POSITION, COURSE_SPEED, GNSS, HEADING = 129025, 129026, 129029, 127250  # NMEA 2000
VEHICLE_POSITION, DIRECTION_SPEED = 65267, 65256  # J1939-71
FAST_MAX: Final = 223  # bytes of a fast packet: 6 and 31 times 7
RAPID_FOR_US: Final = S  # 129029 is no place while others came within this time
COMPASS_FOR_US: Final = S  # a device that sends 127250 is heard within this time; 10 Hz is usual
TRUE_NORTH: Final = 0
KMH_M_S: Final = 1 / 3.6


class FastPackets:
    """Puts together the fast packets of NMEA 2000 from one sender, one PGN at a time."""

    def __init__(self) -> None:
        # PGN: counter, length, bytes so far.
        self._parts: dict[int, tuple[int, int, bytearray]] = {}
        self._next: dict[int, int] = {}  # PGN: number of the next frame

    def take(self, pgn: int, data: bytes) -> bytes | None:
        """The whole message that this frame completes; None while one is missing."""
        if len(data) < 2:
            return None
        counter, number = data[0] >> 5, data[0] & 0x1F
        if number == 0:
            self._parts[pgn], self._next[pgn] = (counter, data[1], bytearray(data[2:])), 1
        elif pgn not in self._parts or (counter, number) != (self._parts[pgn][0], self._next[pgn]):
            self._parts.pop(pgn, None)
            return None
        else:
            self._parts[pgn][2].extend(data[1:])
            self._next[pgn] = number + 1
        _, length, so_far = self._parts[pgn]
        if length > FAST_MAX or len(so_far) < length:
            return None
        del self._parts[pgn]
        return bytes(so_far[:length])


class _Sender:
    """The one device that is believed. It is known by its NAME, once it was heard to claim an address."""

    def __init__(self) -> None:
        self.address: int | None = None  # None: no device is believed yet
        self.name: int | None = None

    def claimed(self, address: int, name: int) -> None:
        """A device with this NAME claims an address: ours has moved, or another one has its place."""
        if self.name == name:
            self.address = address
        elif self.address == address and self.name is None:
            self.name = name
        elif self.address == address:
            self.address = NULL_ADDRESS  # until ours claims the next one


class BusFixes:
    """Takes the frames of one receiver among those of a bus."""

    def __init__(
        self,
        to_metres: Callable[[float, float], tuple[float, float]],
        antenna_m: tuple[float, float],
        sensed_at_us: Callable[[int, int], int],
        latency_us: int,
        accuracy_m: float = inf,
    ) -> None:
        """The first three are those of `NmeaFixes`. `latency_us`: of places without a time.
        `accuracy_m`: of a receiver that does not send 129029; inf: its places are not believed.
        """
        self.fixes = PositionFixes(to_metres, antenna_m, accuracy_m)
        self.sensed_at_us, self.latency_us = sensed_at_us, latency_us
        self.receiver, self.compass = _Sender(), _Sender()  # the compass sends headings by 127250
        self._names: dict[int, int] = {}  # address -> NAME of the device that has claimed it last
        self.counts: Counter[str] = Counter()  # messages by PGN, and "malformed", "another device"
        self._fast: dict[int, FastPackets] = {}  # by sender, until the receiver is known
        self._rapid_at_us = -RAPID_FOR_US
        self._utc_at_us = -1
        self._began_at_us: int | None = None  # arrival of the first frame

    def take(self, identifier: int, data: bytes, arrived_at_us: int) -> Observation | None:
        """The observation that a frame with a 29-bit identifier completes; None if it completes
        none.
        """
        frame = Identifier.unpack(identifier)
        if self._began_at_us is None:
            self._began_at_us = arrived_at_us
        if frame.pgn == CLAIM_PGN and len(data) == 8:
            name = int.from_bytes(data, "little")
            self._names[frame.source] = name
            for sender in (self.receiver, self.compass):
                sender.claimed(frame.source, name)
            return None
        read = READERS.get(frame.pgn)
        if read is None:
            return None
        sender = self.compass if frame.pgn == HEADING else self.receiver
        unknown = sender.address is None
        may_be = unknown and frame.pgn in (HEADING, POSITION, VEHICLE_POSITION, GNSS)
        if frame.source != sender.address and not may_be:
            self.counts["another device"] += 1
            return None
        if frame.pgn == GNSS:
            whole = self._fast.setdefault(frame.source, FastPackets()).take(GNSS, data)
            if whole is None:
                return None
            data = whole
        self.counts[str(frame.pgn)] += 1
        if not read(self, data, arrived_at_us):
            self.counts["malformed"] += 1
            return None
        if unknown and (frame.pgn != GNSS or self._utc_at_us >= 0):
            sender.address, sender.name = frame.source, self._names.get(frame.source)
            if sender is self.receiver:
                self._fast = {}
        return self.fixes.whole(arrived_at_us)

    def _position(self, data: bytes, arrived_at_us: int) -> bool:
        if len(data) < 8:
            return False
        latitude, longitude = (each * 1e-7 for each in unpack_from("<ii", data))
        return self._rapid(longitude, latitude, arrived_at_us)

    def _vehicle_position(self, data: bytes, arrived_at_us: int) -> bool:
        if len(data) < 8:
            return False
        latitude, longitude = (each * 1e-7 - 210.0 for each in unpack_from("<II", data))
        return self._rapid(longitude, latitude, arrived_at_us)

    def _rapid(self, longitude: float, latitude: float, arrived_at_us: int) -> bool:
        if not _is_place(longitude, latitude):
            return False
        self._rapid_at_us = arrived_at_us
        self.fixes.take_place(longitude, latitude, arrived_at_us - self.latency_us)
        return True

    def _gnss(self, data: bytes, arrived_at_us: int) -> bool:
        if len(data) < 33:
            return False
        ticks, latitude, longitude = unpack_from("<xxxIqq", data)
        kind = data[31] >> 4
        self.fixes.take_kind(kind, arrived_at_us)
        if kind not in ACCURACY_M:
            return True
        latitude, longitude = latitude * 1e-16, longitude * 1e-16
        if ticks >= 86_401 * 10_000 or not _is_place(longitude, latitude):
            return False
        utc_at_us = ticks * 100
        if utc_at_us == self._utc_at_us:
            return True
        self._utc_at_us = utc_at_us
        at_us = self.sensed_at_us(utc_at_us, arrived_at_us)
        if arrived_at_us - self._rapid_at_us >= RAPID_FOR_US:
            self.fixes.take_place(longitude, latitude, at_us)
        return True

    def _course_speed(self, data: bytes, arrived_at_us: int) -> bool:
        if len(data) < 6:
            return False
        reference = data[1] & 0x03
        course, speed = unpack_from("<HH", data, 2)
        if reference != TRUE_NORTH or course > 0xFFFC or speed > 0xFFFC:
            return False
        return self._velocity(degrees(course * 1e-4), speed * 0.01, arrived_at_us)

    def _heading(self, data: bytes, arrived_at_us: int) -> bool:
        if len(data) < 8:
            return False
        (bearing,) = unpack_from("<H", data, 1)
        if data[7] & 0x03 != TRUE_NORTH or bearing > 0xFFFC:
            return False
        self.fixes.take_heading(course_rad(degrees(bearing * 1e-4)), arrived_at_us)
        return True

    def _direction_speed(self, data: bytes, arrived_at_us: int) -> bool:
        if len(data) < 4:
            return False
        bearing, speed = unpack_from("<HH", data)
        if bearing > 0xFAFF:
            return False
        assert self._began_at_us is not None
        listened_for_us = arrived_at_us - self._began_at_us
        # Beside 127250 the bearing may be the course, which is no heading of a body that reverses.
        if self.compass.address is None and listened_for_us >= COMPASS_FOR_US:
            self.fixes.take_heading(course_rad(bearing / 128), arrived_at_us)
        return speed > 0xFAFF or self._velocity(bearing / 128, speed / 256 * KMH_M_S, arrived_at_us)

    def _velocity(self, bearing: float, speed_m_s: float, arrived_at_us: int) -> bool:
        to_rad = course_rad(bearing)
        self.fixes.take_velocity(speed_m_s * cos(to_rad), speed_m_s * sin(to_rad), arrived_at_us)
        return True


def _is_place(longitude: float, latitude: float) -> bool:
    return -180.0 <= longitude <= 180.0 and -90.0 <= latitude <= 90.0


READERS: Final[dict[int, Callable[[BusFixes, bytes, int], bool]]] = {
    POSITION: BusFixes._position,
    COURSE_SPEED: BusFixes._course_speed,
    GNSS: BusFixes._gnss,
    HEADING: BusFixes._heading,
    VEHICLE_POSITION: BusFixes._vehicle_position,
    DIRECTION_SPEED: BusFixes._direction_speed,
}
