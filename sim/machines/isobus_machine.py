"""A simulated tractor on a CAN bus of its own: a receiver and a tractor that obeys commands on the bus.

| PGN | it | is |
|---|---|---|
| 129029, 129026, 127250 | sends, for each fix | place and time, course, heading (NMEA 2000) |
| 44032 | sends each 100 ms | estimated curvature, lockout, readiness, engage switch (ISO 11783-7) |
| 65096 | sends each 100 ms | speed of its wheels |
| 44288 | obeys | commanded curvature |
| 64835 | obeys | machine selected speed command |

Its faults are those of the NMEA machine, ordered on a TCP port, and `switch 3`: the person on the tractor
takes the engage switch off for 3 s. Nothing is shared with the driver that it tries.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from math import atan, inf, radians, tan
from struct import pack, unpack_from
from typing import Final

import can

from sim.machines.nmea_machine import NmeaMachine, WheeledBody

RECEIVER, TRACTOR = 28, 240  # addresses
TELL_S: Final = 0.1
LIFE_S: Final = 0.3  # three commands of 100 ms: then it lets go
HEARD_MAX: Final = 500  # frames that are read in one turn
TICKS_S: Final = 10_000  # of the time in 129029
FAST_FIRST, FAST_NEXT = 6, 7  # bytes in the frames of a fast packet
CURVATURE_1_KM: Final = 0.25  # a bit
CURVATURE_OFFSET_1_KM: Final = 8032.0
CURVATURE_COMMAND, SPEED_COMMAND = 0xAD00, 0xFD43


def opened(bus: str) -> can.BusABC:
    """The bus INTERFACE:CHANNEL of python-can. Raises OSError."""
    interface, _, channel = bus.partition(":")
    try:
        return can.Bus(channel, interface=interface)
    except Exception as problem:  # python-can interfaces raise what they like
        raise OSError(f"{bus}: {problem}") from None


class IsobusMachine(NmeaMachine):
    """A steered body, its receiver and its computer, on one bus."""

    def __init__(
        self, body: WheeledBody, origin: tuple[float, float], bus: can.BusABC, seed: int = 1
    ) -> None:
        """`body`: an Ackermann body. `bus`: is closed by `stop`."""
        super().__init__(body, origin, seed)
        assert body.dimensions.drive == "ackermann", "a tractor is steered"
        self.bus = bus
        self.curvatures = self.speeds = 0  # commands taken
        self._fast_counter = 0
        self._curvature_1_m, self._steered_at_s = 0.0, -inf
        self._speed_m_s, self._driven_at_s = 0.0, -inf

    async def start_on_bus(self, host: str, control: int) -> int:
        """Serve the TCP port `control` for orders (0: any free one); returns it. Raises OSError."""
        port = await self._serve(self._orders, host, control)
        loop = asyncio.get_running_loop()
        for task in (self._moves(), self._sends(), self._tells()):
            self._tasks.append(loop.create_task(task))
        return port

    async def stop(self) -> None:
        """Close the port and the bus."""
        await super().stop()
        self.bus.shutdown()

    def move(self) -> None:
        """Obey what was commanded, and integrate up to now."""
        self._hear()
        steers = self.clock() - self._steered_at_s <= LIFE_S
        drives = self.clock() - self._driven_at_s <= LIFE_S
        if steers and drives and not self.has("switch"):
            size = self.body.dimensions
            steer_rad = atan(self._curvature_1_m * size.wheelbase_m)
            wheel_rad_s = self._speed_m_s / size.wheel_radius_m
            ends_at_s = min(self._steered_at_s, self._driven_at_s) + LIFE_S
            self.body.tell([wheel_rad_s], steer_rad, False, ends_at_s)
        else:
            self.body.tell([0.0], self.body.steer_rad, False, -inf)
        super().move()

    def _hear(self) -> None:
        for _ in range(HEARD_MAX):
            message = self.bus.recv(0)
            if message is None:
                return
            group, data = message.arbitration_id >> 8 & 0x3FFFF, bytes(message.data)
            if self.has("deaf") or len(data) < 8 or message.arbitration_id & 0xFF == TRACTOR:
                continue
            if group == CURVATURE_COMMAND | TRACTOR:
                curvature = unpack_from("<H", data)[0] * CURVATURE_1_KM - CURVATURE_OFFSET_1_KM
                self.curvatures += 1
                # The standard counts curvature to the right.
                self._curvature_1_m = -curvature / 1000
                self._steered_at_s = self.clock() if data[2] & 3 == 1 else -inf
            elif group == SPEED_COMMAND:
                self.speeds += 1
                speed_m_s = unpack_from("<H", data)[0] / 1000
                self._speed_m_s = speed_m_s if data[7] & 3 == 1 else -speed_m_s
                self._driven_at_s = self.clock()

    def fix_teller(self) -> Callable[[], None]:
        return partial(self._say, self.fix_frames())

    def _say(self, frames: list[tuple[int, bytes]]) -> None:
        for identifier, data in frames:
            with suppress(can.CanError):  # nobody takes frames from this bus
                self.bus.send(can.Message(arbitration_id=identifier, data=data))

    def fix_frames(self) -> list[tuple[int, bytes]]:
        """Identifiers and data of the messages about the place of now; the place comes last."""
        here = self.received()
        heading = round(1e4 * radians(here.bearing_deg))
        course, speed = round(1e4 * radians(here.course_deg)), round(100 * here.speed_m_s)
        midnight = here.utc.replace(hour=0, minute=0, second=0, microsecond=0)
        ticks = round((here.utc - midnight).total_seconds() * TICKS_S)
        days = here.utc.toordinal() - 719_163  # since 1970
        place = round(here.latitude_deg * 1e16), round(here.longitude_deg * 1e16), round(80e6)
        whole = pack(
            "<BHIqqqBBBhhiB", 1, days, ticks, *place, here.kind << 4 | 3, 0xFC, 17, 60, 90, 46_00, 0
        )
        return [
            (0x09F11200 | RECEIVER, pack("<BHhhB", 1, heading, 0x7FFF, 0x7FFF, 0xFC)),
            (0x09F80200 | RECEIVER, pack("<BBHHH", 1, 0xFC, course, speed, 0xFFFF)),
            *self._fast_packet(0x0DF80500 | RECEIVER, whole),
        ]

    def _fast_packet(self, identifier: int, whole: bytes) -> list[tuple[int, bytes]]:
        self._fast_counter = (self._fast_counter + 1) % 8
        head = self._fast_counter << 5
        frames = [(identifier, bytes((head, len(whole))) + whole[:FAST_FIRST])]
        rest = whole[FAST_FIRST:]
        for number, at in enumerate(range(0, len(rest), FAST_NEXT), 1):
            part = rest[at : at + FAST_NEXT].ljust(FAST_NEXT, b"\xff")
            frames.append((identifier, bytes((head | number,)) + part))
        return frames

    async def _tells(self) -> None:
        """What the tractor says of itself."""
        while True:
            self._say(self.state_frames())
            await asyncio.sleep(TELL_S)

    def state_frames(self) -> list[tuple[int, bytes]]:
        """Identifiers and data of the messages about its steering and its wheels."""
        body = self.body
        curvature_1_km = -1000 * tan(body.steer_rad) / body.dimensions.wheelbase_m
        bits = round((curvature_1_km + CURVATURE_OFFSET_1_KM) / CURVATURE_1_KM)
        switch = 0x00 if self.has("switch") else 0x40
        speed_m_s = body.wheels_m_s[0]
        direction = 0xFC | (speed_m_s >= 0.0)
        wheel = pack(
            "<HIBB", round(1000 * abs(speed_m_s)), round(1000 * body.driven_m), 0xFF, direction
        )
        return [
            (0x0CAC0000 | 0xFF00 | TRACTOR, pack("<HBBB3s", bits, 0xF4, 0x1F, switch, b"\xff" * 3)),
            (0x0CFE4800 | TRACTOR, wheel),
        ]

    def order(self, words: list[str]) -> bytes:
        """The answer to one line of the control port; `switch 3` in addition to the NMEA machine's."""
        if words[:1] == ["switch"]:
            answer = super().order(["deaf", *words[1:]])
            if answer == b"ok":
                self.faults["switch"] = self.faults.pop("deaf")
            return answer
        return super().order(words)
