"""A simulated machine: a GNSS receiver that sends NMEA 0183, and a controller that takes wheel sentences.

It has three TCP ports: the receiver, the controller, and one on which a test or a person orders faults
and asks for the truth, a line each:

    muted 3                 nothing is sent for 3 s
    frozen 3                the same place with new times
    jumped 2.0 0.0 3        the place is wrong by 2 m east
    late 0.5 3              everything is sent half a second later
    inaccurate 3            the receiver has lost its corrections: RTK float
    deaf 3                  the controller takes no sentence
    where                   the truth, as JSON

Its integrator and its sentences are its own code: nothing is shared with the drivers that it tries.
"""

import asyncio
import json
import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial, reduce
from math import atan2, cos, degrees, hypot, inf, isfinite, pi, sin, tan
from operator import xor
from random import Random
from typing import Any, Final, NamedTuple

from pyproj import Geod

STEP_S: Final = 0.005  # of the integrator: 12 mm at 2.5 m/s
LATENCY_S: Final = 0.02  # from a place to its sentence
FIX_RTK, FIX_FLOAT = 4, 5
STD_M: Final = {FIX_RTK: 0.012, FIX_FLOAT: 0.4}
EARTH: Final = Geod(ellps="WGS84")
LINE_MAX: Final = 1024  # bytes
CLIENTS_MAX: Final = 8  # of one port: its robot, one that restarts, and people who look
SKIPPED_BYTES: Final = 4096  # read at once from a client of the receiver, which has nothing to say
LATE_MAX: Final = 4096  # sentences on their way: 50 s
WHEELS: Final = {"mecanum": 4, "differential": 2, "ackermann": 1}


Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Coroutine[Any, Any, None]]


class Dimensions(NamedTuple):
    """Of a machine; metres, seconds, radians."""

    drive: str = "differential"  # or mecanum, ackermann
    wheel_radius_m: float = 0.1
    wheelbase_m: float = 1.2
    track_m: float = 1.0
    acceleration_m_s2: float = 1.5
    braking_m_s2: float = 3.0
    steer_rad_s: float = 0.8
    rate_hz: float = 20.0  # of the receiver
    noise_m: float = 0.01  # of a place, standard deviation
    life_max_for_s: float = 0.1  # the controller lets no sentence live longer


class Fault(NamedTuple):
    """What is wrong until a time."""

    ends_at_s: float = -inf
    values: tuple[float, ...] = ()


class Truth(NamedTuple):
    """Where the machine is, and what it does."""

    x_m: float
    y_m: float
    heading_rad: float
    ahead_m_s: float
    left_m_s: float
    turn_rad_s: float
    implement: bool
    driven_m: float  # since the start
    is_told_to_move: bool  # by a sentence in force


class ReceivedPlace(NamedTuple):
    """What a receiver with two antennas knows. Angles clockwise from north."""

    latitude_deg: float
    longitude_deg: float
    bearing_deg: float  # of the body
    course_deg: float  # of its motion
    speed_m_s: float
    kind: int  # of fix, as in GGA
    utc: datetime


class WheeledBody:
    """The machine without its ports: wheels that follow what they were told, and a place."""

    def __init__(self, dimensions: Dimensions, x_m: float, y_m: float, heading_rad: float) -> None:
        self.dimensions = dimensions
        self.x_m, self.y_m, self.heading_rad = x_m, y_m, heading_rad
        self.wheels_m_s = [0.0] * WHEELS[dimensions.drive]
        self.steer_rad = 0.0
        self.told_m_s, self.told_rad = list(self.wheels_m_s), 0.0
        self.implement = self.told_implement = False
        self.told_ends_at_s = -inf  # the sentence in force
        self.driven_m = 0.0
        self.velocity = (0.0, 0.0, 0.0)

    def tell(
        self, wheels_rad_s: list[float], steer_rad: float, implement: bool, ends_at_s: float
    ) -> None:
        """A sentence is in force until then."""
        self.told_m_s = [each * self.dimensions.wheel_radius_m for each in wheels_rad_s]
        self.told_rad, self.told_implement, self.told_ends_at_s = steer_rad, implement, ends_at_s

    def is_told_to_move(self, now_s: float) -> bool:
        """Whether a sentence with a speed is in force; `now_s` in seconds."""
        return now_s < self.told_ends_at_s and any(self.told_m_s)

    def step(self, now_s: float, for_s: float) -> None:
        """Wheels follow the sentence in force, and the place follows the wheels."""
        size = self.dimensions
        live = now_s < self.told_ends_at_s
        told = self.told_m_s if live else [0.0] * len(self.wheels_m_s)
        self.implement = live and self.told_implement
        for index, goal_m_s in enumerate(told):
            is_m_s = self.wheels_m_s[index]
            slower = abs(goal_m_s) < abs(is_m_s) or goal_m_s * is_m_s < 0
            most_m_s = for_s * (size.braking_m_s2 if slower else size.acceleration_m_s2)
            self.wheels_m_s[index] += min(max(goal_m_s - is_m_s, -most_m_s), most_m_s)
        if live:
            most_rad = for_s * size.steer_rad_s
            self.steer_rad += min(max(self.told_rad - self.steer_rad, -most_rad), most_rad)
        self.velocity = ahead_m_s, left_m_s, turn_rad_s = self._velocity()
        middle_rad = self.heading_rad + turn_rad_s * for_s / 2
        east = ahead_m_s * cos(middle_rad) - left_m_s * sin(middle_rad)
        north = ahead_m_s * sin(middle_rad) + left_m_s * cos(middle_rad)
        self.x_m, self.y_m = self.x_m + east * for_s, self.y_m + north * for_s
        self.heading_rad = (self.heading_rad + turn_rad_s * for_s + pi) % (2 * pi) - pi
        self.driven_m += hypot(east, north) * for_s

    def _velocity(self) -> tuple[float, float, float]:
        size, wheels = self.dimensions, self.wheels_m_s
        if size.drive == "mecanum":
            front_left, front_right, rear_left, rear_right = wheels
            arm_m = (size.wheelbase_m + size.track_m) / 2
            return (
                sum(wheels) / 4,
                (front_right - front_left + rear_left - rear_right) / 4,
                (front_right + rear_right - front_left - rear_left) / 4 / arm_m,
            )
        if size.drive == "differential":
            left, right = wheels
            return (left + right) / 2, 0.0, (right - left) / size.track_m
        return wheels[0], 0.0, wheels[0] * tan(self.steer_rad) / size.wheelbase_m


class NmeaMachine:
    """A body with its receiver, its controller, and its faults."""

    def __init__(
        self,
        body: WheeledBody,
        origin: tuple[float, float],
        seed: int = 1,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`origin`: latitude and longitude of (0, 0), degrees."""
        self.body, self.origin, self.clock = body, origin, clock
        self.faults: dict[str, Fault] = {}
        self.sentences = self.refused = 0  # that the controller took, and did not
        self._rng = Random(seed)
        self._began_at_s = clock()
        self._utc_start_at_s = time.time()
        self._stepped_at_s = self._began_at_s
        self._receivers: set[asyncio.StreamWriter] = set()
        self._frozen: tuple[float, float, float] | None = None
        self._servers: list[asyncio.Server] = []
        self._tasks: list[asyncio.Task[None]] = []

    async def start(self, host: str, gnss: int, wheels: int, control: int) -> tuple[int, int, int]:
        """Serve the TCP ports `gnss`, `wheels` and `control` (0: any free one); returns them.

        Raises OSError."""
        one = await self._serve(self._receiver, host, gnss)
        two = await self._serve(self._controller, host, wheels)
        three = await self._serve(self._orders, host, control)
        loop = asyncio.get_running_loop()
        self._tasks = [loop.create_task(self._moves()), loop.create_task(self._sends())]
        return one, two, three

    async def _serve(self, serve: Serve, host: str, port: int) -> int:
        """Open a port with the limits of all ports of machines; returns its number."""
        server = await asyncio.start_server(self._seated(serve), host, port, limit=LINE_MAX)
        self._servers.append(server)
        number: int = server.sockets[0].getsockname()[1]
        return number

    async def stop(self) -> None:
        """Close the ports."""
        for task in self._tasks:
            task.cancel()
        for server in self._servers:
            server.close()
        for writer in self._receivers:
            writer.close()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def truth(self) -> Truth:
        """Where it is now."""
        body = self.body
        self.move()
        return Truth(
            body.x_m,
            body.y_m,
            body.heading_rad,
            *body.velocity,
            body.implement,
            body.driven_m,
            body.is_told_to_move(self.clock()),
        )

    def move(self) -> None:
        """Integrate up to now."""
        now_s = self.clock()
        while self._stepped_at_s + STEP_S <= now_s:
            self.body.step(self._stepped_at_s, STEP_S)
            self._stepped_at_s += STEP_S

    def has(self, fault: str) -> bool:
        """Whether this is wrong now."""
        return self.clock() < self.faults.get(fault, Fault()).ends_at_s

    async def _moves(self) -> None:
        while True:
            self.move()
            await asyncio.sleep(STEP_S)

    async def _sends(self) -> None:
        """What tells each fix, at an even pace."""
        loop, due_at_s = asyncio.get_running_loop(), self.clock()
        while True:
            due_at_s += 1 / self.body.dimensions.rate_hz
            await asyncio.sleep(max(due_at_s - self.clock(), 0.0))
            self.move()
            if self.has("muted"):
                continue
            late_for_s = LATENCY_S
            if self.has("late"):
                late_for_s += self.faults["late"].values[0]
            loop.call_later(late_for_s, self._tell, self.fix_teller())

    def _tell(self, tell: Callable[[], None]) -> None:
        if not self.has("muted"):
            tell()

    def fix_teller(self) -> Callable[[], None]:
        """Tells the fix of now, when it is called."""
        return partial(self._send, self.fix())

    def _send(self, sentences: bytes) -> None:
        for writer in list(self._receivers):
            if writer.transport.get_write_buffer_size() < LATE_MAX * LINE_MAX:
                writer.write(sentences)

    def received(self) -> "ReceivedPlace":
        """The place of now as its receiver has it, with noise and faults."""
        body, noise_m = self.body, self.body.dimensions.noise_m
        place = body.x_m, body.y_m, body.heading_rad
        if self.has("frozen"):
            place = self._frozen = self._frozen or place
        else:
            self._frozen = None
        x_m, y_m, heading_rad = place
        if self._frozen is None:
            x_m, y_m = x_m + self._rng.gauss(0.0, noise_m), y_m + self._rng.gauss(0.0, noise_m)
        if self.has("jumped"):
            dx_m, dy_m = self.faults["jumped"].values
            x_m, y_m = x_m + dx_m, y_m + dy_m
        kind = FIX_FLOAT if self.has("inaccurate") else FIX_RTK
        utc = datetime.fromtimestamp(self._utc_start_at_s + self.clock() - self._began_at_s, UTC)
        ahead_m_s, left_m_s, _ = body.velocity
        course_deg = (90.0 - degrees(heading_rad + atan2(left_m_s, ahead_m_s))) % 360.0
        bearing_deg = (90.0 - degrees(heading_rad)) % 360.0
        origin_deg = self.origin
        longitude, latitude, _ = EARTH.fwd(
            origin_deg[1], origin_deg[0], degrees(atan2(x_m, y_m)), hypot(x_m, y_m)
        )
        return ReceivedPlace(
            latitude, longitude, bearing_deg, course_deg, hypot(ahead_m_s, left_m_s), kind, utc
        )

    def fix(self) -> bytes:
        """The sentences that tell of the place of now."""
        here = self.received()
        kind, utc, course_deg, speed_m_s = here.kind, here.utc, here.course_deg, here.speed_m_s
        latitude, longitude = (
            _angle(here.latitude_deg, 2, "NS"),
            _angle(here.longitude_deg, 3, "EW"),
        )
        clock = f"{utc:%H%M%S}.{utc.microsecond // 1000:03d}"
        std = f"{STD_M[kind]:.3f}"
        return b"".join(map(_sentence, (
            f"GNGGA,{clock},{latitude},{longitude},{kind},17,0.6,80.0,M,46.0,M,1.0,0001",
            f"GNGST,{clock},0.5,{std},{std},0.0,{std},{std},{std}",
            f"GNVTG,{course_deg:.2f},T,,M,{speed_m_s * 3600 / 1852:.3f},N,{speed_m_s * 3.6:.3f},K,D",
            f"GNHDT,{here.bearing_deg:.3f},T",
        )))  # fmt: skip

    def _seated(self, serve: Serve) -> Serve:
        """A port that serves `CLIENTS_MAX` at once. A newcomer takes the seat of the oldest, because a
        robot that restarts must get in."""
        seats: list[asyncio.StreamWriter] = []

        async def seated(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            seats.append(writer)
            if len(seats) > CLIENTS_MAX:
                seats.pop(0).transport.abort()
            try:
                await serve(reader, writer)
            finally:
                if writer in seats:
                    seats.remove(writer)

        return seated

    async def _receiver(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._receivers.add(writer)
        with suppress(ConnectionError):
            while await reader.read(SKIPPED_BYTES):  # until it is gone
                pass
        self._receivers.discard(writer)
        writer.close()

    async def _controller(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async for line in _lines(reader):
            if self.has("deaf"):
                continue
            told = _told(line, len(self.body.wheels_m_s))
            if told is None:
                self.refused += 1
                continue
            self.sentences += 1
            life_for_s, implement, steer_rad, wheels = told
            self.move()
            ends_at_s = self.clock() + min(life_for_s, self.body.dimensions.life_max_for_s)
            self.body.tell(wheels, steer_rad, implement, ends_at_s)
        writer.close()

    async def _orders(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async for line in _lines(reader):
            writer.write(self.order(line.decode("ascii", "replace").split()) + b"\n")
            if writer.transport.get_write_buffer_size() > LATE_MAX * LINE_MAX:
                writer.transport.abort()  # it asks and does not read
        writer.close()

    def order(self, words: list[str]) -> bytes:
        """The answer to one line of the control port."""
        counts = {"muted": 0, "frozen": 0, "inaccurate": 0, "deaf": 0, "late": 1, "jumped": 2}
        if words == ["where"]:
            return json.dumps(self.truth()._asdict()).encode()
        try:
            name, *rest = words
            *values, for_s = map(float, rest)
        except ValueError:
            name, values, for_s = "", [], 0.0
        known = len(values) == counts.get(name) and all(map(isfinite, (*values, for_s)))
        if not known or for_s <= 0.0:
            return b"not understood; it is one of where, " + ", ".join(sorted(counts)).encode()
        self.faults[name] = Fault(self.clock() + for_s, tuple(values))
        return b"ok"


async def _lines(reader: asyncio.StreamReader) -> Any:
    """Lines until the other side is gone, or sends one that is too long."""
    while True:
        try:
            line = await reader.readline()
        except (ValueError, ConnectionError):
            return
        if not line:
            return
        yield line.strip()


def _sentence(body: str) -> bytes:
    return b"$%b*%02X\r\n" % (body.encode(), reduce(xor, body.encode(), 0))


def _angle(value: float, digits: int, sides: str) -> str:
    """Degrees as NMEA has them: whole degrees, minutes, side."""
    whole = int(abs(value))
    minutes = (abs(value) - whole) * 60
    return f"{whole:0{digits}d}{minutes:010.7f},{sides[value < 0]}"


def _told(line: bytes, wheels: int) -> tuple[float, bool, float, list[float]] | None:
    """Life in seconds, implement, steering angle and wheels of a sentence; None if it is none."""
    body, _, checksum = line.strip().removeprefix(b"$").rpartition(b"*")
    fields = body.decode("ascii", "replace").split(",")
    if f"{reduce(xor, body, 0):02X}".encode() != checksum or fields[0] != "PHLW":
        return None
    try:
        life_for_ms, implement, steer_rad, *speeds = (float(field) for field in fields[2:])
    except ValueError:
        return None
    if len(speeds) != wheels or not all(map(isfinite, (life_for_ms, steer_rad, *speeds))):
        return None
    return life_for_ms / 1000, implement == 1.0, steer_rad, speeds
