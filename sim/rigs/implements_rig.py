"""Tractors with sprayers of two makers, each with a bus and a task controller, on one field.

The sprayers are written from the tables of ISO 11783-10, byte by byte, without a line of our own client.
One maker speaks version 4 with condensed states and fixed places; the other one speaks version 3, tells
its places when it is asked, and has a state for each section. What is worked is judged from the places of
the booms and from what the valves do, as exact polygons.
"""

from collections.abc import Callable, Iterator, Sequence
from math import cos, hypot, inf, pi, sin
from random import Random
from struct import pack, unpack
from typing import Final, NamedTuple, Protocol

import shapely
from shapely.geometry import Polygon, box

from agent.implements.as_applied_map import AsAppliedMap, by_row
from agent.implements.task_controller import TaskController, controller_name
from agent.interface.config import MS, S
from agent.interface.effects import Effect, Send
from agent.interface.identity import Identity, SilencePolicy
from agent.interface.observation import Observation
from agent.peer.inputs import BusState, Cover, Received, Timer
from agent.peer.peer import Peer
from agent.runtime.peer_factory import make_peer
from protocol.controller_health import Health
from protocol.frames.codec import encode
from protocol.frames.frame import Frame
from protocol.name import fleet_name
from sim.can.can_wire import Wire

STEP_US: Final = 50 * MS  # of the tractors, and of a fast receiver
RECEIVER: Final = 28  # address of a receiver (ISO 11783-1: GNSS)
SPRAYER: Final = 160
GLOBAL: Final = 255
HITCH_AHEAD_M: Final = -2.0  # from the receiver
CONNECTOR_MM, BOOM_MM = 1500, -2500  # ahead of the reference point of a sprayer
BOOM_AHEAD_M: Final = HITCH_AHEAD_M + (BOOM_MM - CONNECTOR_MM) / 1000


Ends = tuple[tuple[float, float], tuple[float, float]]  # left and right, of a section, metres


class RigDevice(Protocol):
    """What the bus of a rig calls: it takes frames, and has a turn from time to time."""

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """Take a frame; returns what it sends."""
        ...

    def turns(self, now_us: int) -> list[Frame]:
        """It is called each 10 ms, at least."""
        ...


class RigBus:
    """One CAN bus with its devices."""

    def __init__(self, seed: int, tick_for_us: int = 10 * MS) -> None:
        """`tick_for_us`: how often each device has a turn."""
        self.tick_for_us = tick_for_us
        self.wire, self.nodes = Wire(seed), dict[int, RigDevice]()
        self.carried: list[Frame] = []  # all frames, in order

    def attach(self, node: RigDevice) -> None:
        """Put a device on the bus."""
        self.nodes[self.wire.attach()] = node

    def run(self, begin_at_us: int, end_at_us: int) -> None:
        """Everything that happens on the bus in this time."""
        now_us = begin_at_us
        while now_us < end_at_us:
            now_us = min(now_us + self.tick_for_us, end_at_us)
            while (next_at_us := self.wire.next_at_us) is not None and next_at_us <= now_us:
                for at_us, frame, _, receivers in self.wire.advance(next_at_us):
                    self.carried.append(frame)
                    for number in receivers:
                        self._send(number, self.nodes[number].hears(frame, at_us), at_us)
            for number, node in self.nodes.items():
                self._send(number, node.turns(now_us), now_us)

    def _send(self, number: int, frames: list[Frame], now_us: int) -> None:
        for frame in frames:
            assert self.wire.submit(number, frame, now_us), "a queue of the rig is full"


# ---------------------------------------------------------------- two makers


class Maker(NamedTuple):
    """What differs between the sprayers of two makers."""

    version: int
    sections: int
    width_mm: int
    condensed: bool
    on_for_ms: int  # until a valve that is told to open is open
    off_for_ms: int
    manufacturer: int


CONDENSED_MAKER: Final = Maker(4, 24, 500, True, 300, 200, 100)
PLAIN_MAKER: Final = Maker(3, 16, 750, False, 150, 150, 333)


class Sprayer:
    """A sprayer with its controller, as a maker without our code builds it."""

    def __init__(self, maker: Maker, identity: int) -> None:
        self.maker = maker
        name = 1 << 63 | 2 << 60 | 6 << 49 | 132 << 40 | maker.manufacturer << 21 | identity
        self.name = pack("<Q", name)
        self.told = [False] * maker.sections  # by the task controller
        self.valves = [False] * maker.sections
        self.moved_at_us = [0] * maker.sections  # when each valve moved last
        self.automatic = False
        self.phase = "wait"
        self.log_ins = 0
        self.at_us = dict[str, int]()
        self._due: list[tuple[int, int, bool]] = []  # time, section, open
        self._queue: list[Frame] = []  # packets of the pool that is being sent
        self._pool = b""
        self._claimed = False
        self._server = 0
        self._heard_at_us = self._status_at_us = 0
        self._measured = False

    # ------------------------------------------------------------ its description

    def pool(self) -> bytes:
        """Its objects: device, boom with a connector, sections with places and widths."""
        maker, objects = self.maker, b""

        def text(what: str) -> bytes:
            return bytes((len(what),)) + what.encode()

        device = b"DVC" + pack("<H", 0) + text("SPR") + text("7.1") + self.name + text("17")
        device += b"LABEL%02d" % (self.maker.manufacturer % 100) + b"en\x50\x00\x00\x00\xff"
        objects += device + (b"\x00" if maker.version >= 4 else b"")
        boom = [1001, 1003] if maker.condensed else []
        if maker.condensed:
            boom += [1002, 1004][: (maker.sections - 1) // 16 * 2]
        boom += [1005, 1006, 1007]
        objects += b"DET" + pack("<HB", 1, 1) + text("SPR") + pack("<HHH", 0, 0, 0)
        objects += b"DET" + pack("<HB", 2, 6) + text("hitch") + pack("<HHHH", 1, 1, 1, 1008)
        objects += b"DET" + pack("<HB", 3, 2) + text("boom") + pack("<HHH", 2, 1, len(boom))
        objects += pack(f"<{len(boom)}H", *boom)
        for k in range(maker.sections):
            children = [2000 + k, 2100 + k, 2200 + k]
            if not maker.condensed:
                children += [2300 + k, 2400 + k]
            objects += b"DET" + pack("<HB", 10 + k, 4) + text(f"S{k}")
            objects += pack("<HHH", 10 + k, 3, len(children)) + pack(
                f"<{len(children)}H", *children
            )
        if maker.condensed:
            objects += b"DPD" + pack("<HHBB", 1001, 161, 0, 9) + text("act") + b"\xff\xff"
            objects += b"DPD" + pack("<HHBB", 1003, 290, 2, 8) + text("set") + b"\xff\xff"
            if maker.sections > 16:
                objects += b"DPD" + pack("<HHBB", 1002, 162, 0, 9) + text("act2") + b"\xff\xff"
                objects += b"DPD" + pack("<HHBB", 1004, 291, 2, 8) + text("set2") + b"\xff\xff"
        objects += b"DPD" + pack("<HHBB", 1005, 160, 2, 8) + text("auto") + b"\xff\xff"
        objects += b"DPT" + pack("<HHi", 1006, 205, maker.on_for_ms) + text("on") + b"\xff\xff"
        objects += b"DPT" + pack("<HHi", 1007, 206, maker.off_for_ms) + text("off") + b"\xff\xff"
        objects += b"DPT" + pack("<HHi", 1008, 134, CONNECTOR_MM) + text("x") + b"\xff\xff"
        for k in range(maker.sections):
            x_mm, y_mm = BOOM_MM, self.right_mm(k)
            if maker.condensed:
                objects += b"DPT" + pack("<HHi", 2000 + k, 134, x_mm) + text("x") + b"\xff\xff"
                objects += b"DPT" + pack("<HHi", 2100 + k, 135, y_mm) + text("y") + b"\xff\xff"
                objects += (
                    b"DPT" + pack("<HHi", 2200 + k, 67, maker.width_mm) + text("w") + b"\xff\xff"
                )
            else:
                for number, ddi in ((2000, 134), (2100, 135), (2200, 67)):
                    objects += (
                        b"DPD" + pack("<HHBB", number + k, ddi, 0, 8) + text("") + b"\xff\xff"
                    )
                objects += b"DPD" + pack("<HHBB", 2300 + k, 141, 0, 9) + text("st") + b"\xff\xff"
                objects += b"DPD" + pack("<HHBB", 2400 + k, 289, 2, 8) + text("sp") + b"\xff\xff"
        return objects

    def right_mm(self, k: int) -> int:
        """Where the middle of a section is, to the right of the middle of the boom."""
        return round((k - (self.maker.sections - 1) / 2) * self.maker.width_mm)

    # ------------------------------------------------------------ its session

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """Take a frame, as its firmware does."""
        group, data = frame.identifier >> 8 & 0x3FF00, frame.data
        source, destination = frame.identifier & 0xFF, frame.identifier >> 8 & 0xFF
        if destination not in (GLOBAL, SPRAYER):
            return []
        if group == 0xEA00 and data[:3] == b"\x00\xee\x00":
            return self._claim()
        if group == 0xEC00 and destination == SPRAYER:
            return self._transport(data)
        if group == 0xC800 and destination == SPRAYER:
            return self._long_transport(data)
        if group != 0xCB00:
            return []
        if data[0] & 0xF == 0xE and destination == GLOBAL:
            self._heard_at_us, self._server = now_us, source
            if self.phase == "wait":
                self.phase = "version"
                return [self._frame(0x1CFE0D00, b"\x01" + b"\xff" * 7, GLOBAL),
                        *self._status(now_us), self._data(b"\x00")]  # fmt: skip
            return []
        return self._answered(data, now_us) if source == self._server else []

    def _answered(self, data: bytes, now_us: int) -> list[Frame]:
        kind = data[0]
        if kind == 0x00:
            maker = self.maker
            return [self._data(bytes((0x10, maker.version, 0xFF, 0x11, 0, 1, maker.sections, 1)))]
        if kind == 0x10 and self.phase == "version":
            self.phase = "label"
            return [self._data(b"\x01")]
        if kind == 0x11 and self.phase == "label":
            known = data[1:8] != b"\xff" * 7
            self.phase = "activate" if known else "space"
            size = len(self.pool())
            return [self._data(b"\x81\xff" if known else b"\x41" + pack("<I", size))]
        if kind == 0x51 and self.phase == "space" and data[1] == 0:
            self.phase, self._pool = "pool", b"\x61" + self.pool()
            if len(self._pool) > 1785:
                rts = b"\x14" + pack("<I", len(self._pool)) + b"\x00\xcb\x00"
                return [self._frame(0x1CC80000, rts, self._server)]
            packets = -(-len(self._pool) // 7)
            rts = b"\x10" + pack("<H", len(self._pool)) + bytes((packets, 0xFF)) + b"\x00\xcb\x00"
            return [self._frame(0x1CEC0000, rts, self._server)]
        if kind == 0x71 and self.phase == "pool" and data[1] == 0:
            self.phase = "activate"
            return [self._data(b"\x81\xff")]
        if kind == 0x91 and self.phase == "activate" and data[1] == 0:
            self.phase, self.log_ins = "in", self.log_ins + 1
            self.at_us.setdefault("in", now_us)
            return []
        return self._commanded(data, now_us) if self.phase == "in" else []

    def _commanded(self, data: bytes, now_us: int) -> list[Frame]:
        command, element = data[0] & 0xF, data[0] >> 4 | data[1] << 4
        ddi, number = unpack("<Hi", data[2:8])
        if command == 2:
            value = {134: BOOM_MM, 135: self.right_mm(element - 10), 67: self.maker.width_mm}.get(
                ddi
            )
            return [] if value is None else [self._data(self._head(3, data) + pack("<i", value))]
        if command in (4, 8):
            self._measured = True
            states = self._states()
            return states if self.maker.condensed else states[element - 10 : element - 9]
        if command not in (3, 10):
            return []
        if ddi == 160:
            self.automatic = number == 1
        elif 290 <= ddi < 306:
            for k in range(16):
                at, state = 16 * (ddi - 290) + k, number >> 2 * k & 3
                if at < self.maker.sections and state != 3:
                    self._tell(at, state == 1, now_us)
        elif ddi == 289:
            self._tell(element - 10, number == 1, now_us)
        if command == 10:
            return [self._data(self._head(0xD, data) + b"\x00\xfa\xff\xff")]
        return []

    @staticmethod
    def _head(command: int, data: bytes) -> bytes:
        return bytes((data[0] & 0xF0 | command,)) + data[1:4]

    def _tell(self, section: int, wanted: bool, now_us: int) -> None:
        if not self.automatic or self.told[section] == wanted:
            return
        self.told[section] = wanted
        after_ms = self.maker.on_for_ms if wanted else self.maker.off_for_ms
        self._due.append((now_us + after_ms * MS, section, wanted))

    def _states(self) -> list[Frame]:
        """The states of all sections, as this maker tells them."""
        if not self.maker.condensed:
            return [
                self._data(
                    bytes((0x3 | (10 + k & 0xF) << 4, 10 + k >> 4)) + pack("<Hi", 141, valve)
                )
                for k, valve in enumerate(self.valves)
            ]
        said = []
        for word in range(-(-self.maker.sections // 16)):
            number = 0
            for k in range(16):
                at = 16 * word + k
                number |= (3 if at >= self.maker.sections else int(self.valves[at])) << 2 * k
            said.append(self._data(b"\x23\x00" + pack("<HI", 161 + word, number)))
        return said

    def turns(self, now_us: int) -> list[Frame]:
        """Valves move, statuses are due, and packets of the pool are sent."""
        frames = [] if self._claimed else self._claim()
        moved = [each for each in self._due if each[0] <= now_us]
        self._due = [each for each in self._due if each[0] > now_us]
        for _, section, wanted in moved:
            self.valves[section], self.moved_at_us[section] = wanted, now_us
        if moved and self._measured:
            frames += self._states()
        if self.phase != "wait" and now_us >= self._heard_at_us + 6 * S:
            self.phase, self.automatic, self._measured = "wait", False, False
        if self.phase != "wait" and now_us >= self._status_at_us:
            frames += self._status(now_us)
        frames += self._queue[:5]
        self._queue = self._queue[5:]
        return frames

    def _status(self, now_us: int) -> list[Frame]:
        self._status_at_us = now_us + 2 * S
        return [self._data(b"\xff\xff\xff\xff\x01\x00\x00\x00")]

    def _transport(self, data: bytes) -> list[Frame]:
        if data[0] == 17:
            count, first = data[1], data[2]
            self._queue = [
                self._frame(0x1CEB0000, self._packet(k, 0), self._server)
                for k in range(first, first + count)
            ]
        return []

    def _long_transport(self, data: bytes) -> list[Frame]:
        if data[0] != 21:
            return []
        count, first = data[1], int.from_bytes(data[2:5], "little")
        offset = bytes((22, count)) + pack("<I", first - 1)[:3] + b"\x00\xcb\x00"
        self._queue = [
            self._frame(0x1CC70000, self._packet(k, first - 1), self._server)
            for k in range(first, first + count)
        ]
        return [self._frame(0x1CC80000, offset, self._server)]

    def _packet(self, number: int, offset: int) -> bytes:
        part = self._pool[7 * number - 7 : 7 * number]
        return bytes((number - offset,)) + part.ljust(7, b"\xff")

    def _claim(self) -> list[Frame]:
        self._claimed = True
        return [self._frame(0x18EE0000, self.name, GLOBAL)]

    def _data(self, data: bytes) -> Frame:
        return self._frame(0x0CCB0000, data.ljust(8, b"\xff"), self._server)

    @staticmethod
    def _frame(head: int, data: bytes, destination: int) -> Frame:
        broadcast = head >> 16 & 0xFF >= 0xF0
        return Frame(head | (0 if broadcast else destination << 8) | SPRAYER, data)


# ---------------------------------------------------------------- tractors


class Tractor:
    """A tractor on lines along x with half circles between them, and the receiver on it."""

    def __init__(
        self, sprayer: Sprayer, begin_m: tuple[float, float], end_x_m: float, passes: int,
        upwards: bool, starts_at_us: int, speed_m_s: float,
    ) -> None:  # fmt: skip
        self.sprayer, self.speed_m_s, self.starts_at_us = sprayer, speed_m_s, starts_at_us
        self.boom_m = sprayer.maker.sections * sprayer.maker.width_mm / 1000
        self.x_m, self.y_m = begin_m
        self.heading_rad = 0.0 if end_x_m > begin_m[0] else pi
        self.path = list(self._path(begin_m, end_x_m, passes, 1 if upwards else -1))
        self.driven_m = 0.0
        self.worked: list[Polygon] = []
        self._begun: dict[int, Ends] = {}
        self._before: list[Ends] = []
        self._straight = True

    @property
    def done(self) -> bool:
        """Whether the last line has been driven."""
        return self.driven_m >= sum(length_m for length_m, *_ in self.path)

    def _path(
        self, begin_m: tuple[float, float], end_x_m: float, passes: int, up: int
    ) -> Iterator[tuple[float, float, float, float, float]]:
        """Pieces: length, x, y, heading at the begin, curvature."""
        (x_m, y_m), far_m = begin_m, end_x_m
        for number in range(passes):
            heading = 0.0 if far_m > x_m else pi
            yield abs(far_m - x_m), x_m, y_m, heading, 0.0
            if number + 1 < passes:
                radius_m = self.boom_m / 2
                bend = (1 if heading == 0.0 else -1) * up / radius_m
                yield pi * radius_m, far_m, y_m, heading, bend
            x_m, far_m, y_m = far_m, x_m, y_m + up * self.boom_m

    def moves(self, now_us: int) -> list[Frame]:
        """Drive for one step; returns the frames of the receiver."""
        if now_us > self.starts_at_us and not self.done:
            self.driven_m += self.speed_m_s * STEP_US / S
        left_m, curved = self.driven_m, False
        for length_m, x_m, y_m, heading, bend in self.path:
            if left_m > length_m and (length_m, x_m, y_m, heading, bend) != self.path[-1]:
                left_m -= length_m
                continue
            curved = bend != 0.0
            turned = left_m * bend
            self.heading_rad = heading + turned
            if curved:
                self.x_m = x_m + (sin(heading + turned) - sin(heading)) / bend
                self.y_m = y_m - (cos(heading + turned) - cos(heading)) / bend
            else:
                self.x_m, self.y_m = x_m + cos(heading) * left_m, y_m
            break
        self._works(curved, now_us)
        return self._fixes(now_us)

    def _works(self, curved: bool, now_us: int) -> None:
        """The ground under open valves, as polygons: one for each run of a section on a line.

        A valve that moved since the step before begins or ends its run where the boom was then."""
        maker, c, s = self.sprayer.maker, cos(self.heading_rad), sin(self.heading_rad)
        ends = []
        for k in range(maker.sections):
            both = []
            for side in (-0.5, 0.5):
                right_m = (self.sprayer.right_mm(k) + side * maker.width_mm) / 1000
                ahead_m = BOOM_AHEAD_M
                both.append(
                    (self.x_m + c * ahead_m + s * right_m, self.y_m + s * ahead_m - c * right_m)
                )
            ends.append((both[0], both[1]))
        whole_run = not curved and self._straight
        for k, valve in enumerate(self.sprayer.valves):
            begun = self._begun.get(k)
            if not self._before:
                continue
            since = (self.sprayer.moved_at_us[k] - (now_us - STEP_US)) / STEP_US
            at = self._before[k] if since <= 0.0 else _between(self._before[k], ends[k], since)
            if begun is not None and not (valve and whole_run):
                self._close(begun, at if not valve else self._before[k])
                del self._begun[k]
            if valve and k not in self._begun:
                self._begun[k] = at
        self._before, self._straight = ends, not curved

    def _close(self, a: Ends, b: Ends) -> None:
        shape = Polygon((a[0], a[1], b[1], b[0]))
        if shape.area > 1e-9:
            self.worked.append(shape.buffer(0))

    def ends(self) -> None:
        """Close the runs that are still open."""
        for k, begun in self._begun.items():
            self._close(begun, self._before[k])
        self._begun.clear()

    def _fixes(self, now_us: int) -> list[Frame]:
        """Its place as a receiver with 0.1 mm, in a frame of the rig's own."""
        moving = now_us > self.starts_at_us and not self.done
        speed = round(1000 * self.speed_m_s * moving)
        data = pack("<iiHH", round(1e4 * self.x_m), round(1e4 * self.y_m),
                    round(self.heading_rad * 1e4) % 62_832, speed)  # fmt: skip
        return [Frame(0x09F80100 | RECEIVER, data[:8]), Frame(0x09F80200 | RECEIVER, data[8:])]


def _between(before: Ends, now: Ends, share: float) -> Ends:
    """The ends of a section at this share of a step."""
    (one, other) = (
        (ax + share * (bx - ax), ay + share * (by - ay))
        for (ax, ay), (bx, by) in zip(before, now, strict=True)
    )
    return one, other


class RigFixes:
    """Takes the frames of the rig's receivers: metres in the field instead of degrees."""

    def __init__(self) -> None:
        self._place = (0.0, 0.0)

    def take(self, identifier: int, data: bytes, arrived_at_us: int) -> Observation | None:
        """The second frame of a place completes an observation."""
        if identifier == 0x09F80100 | RECEIVER:
            x, y = unpack("<ii", data)
            self._place = x / 1e4, y / 1e4
        if identifier != 0x09F80200 | RECEIVER:
            return None
        heading, speed = unpack("<HH", data)
        heading_rad, speed_m_s = heading / 1e4, speed / 1000
        return Observation(
            *self._place, heading_rad, speed_m_s * cos(heading_rad), speed_m_s * sin(heading_rad),
            sensed_at_us=arrived_at_us - arrived_at_us % STEP_US,
        )  # fmt: skip


# ---------------------------------------------------------------- task controllers


class ControllerNode:
    """One of our task controllers on the bus of its tractor."""

    def __init__(
        self, controller: TaskController, share: Callable[[int, tuple[int, ...]], None]
    ) -> None:
        self.controller, self.share = controller, share

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """Take a frame; returns the answers."""
        return self._told(self.controller.on_frame(frame, now_us))

    def turns(self, now_us: int) -> list[Frame]:
        """Send what is due."""
        if now_us < self.controller.due_at_us:
            return self._told([])
        return self._told(self.controller.on_timer(now_us))

    def _told(self, frames: list[Frame]) -> list[Frame]:
        for row, columns in by_row(self.controller.take_cells()).items():
            self.share(row, columns)
        return frames


class PeerNode:
    """A member of the fleet that shares the map."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        self._covered: list[Cover] = []

    def cover(self, row: int, columns: tuple[int, ...]) -> None:
        """Cells that are whole."""
        self._covered.append(Cover(row, columns))

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """Take a frame; returns the answers."""
        return frames_of(self.peer, self.peer.step(Received(frame), now_us))

    def turns(self, now_us: int) -> list[Frame]:
        """Send what is due."""
        frames: list[Frame] = []
        covered, self._covered = self._covered, []
        for call in covered:
            frames += frames_of(self.peer, self.peer.step(call, now_us))
        if now_us >= self.peer.due_at_us:
            self.peer.step(BusState(Health.ACTIVE, True, now_us), now_us)
            frames += frames_of(self.peer, self.peer.step(Timer(), now_us))
        return frames


def frames_of(peer: Peer, effects: Sequence[Effect]) -> list[Frame]:
    """What a peer sends by these effects; nothing while it has no address."""
    frames = []
    for effect in effects:
        if not isinstance(effect, Send):
            continue
        source = peer.address if effect.source is None else effect.source
        if source is not None:
            frames.append(encode(effect.message, source, effect.destination))
    return frames


class ReceiverNode:
    """The receiver of a tractor: it speaks when the tractor has moved."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """Take a frame; returns the answers."""
        return []

    def turns(self, now_us: int) -> list[Frame]:
        """Send what is due."""
        frames, self.frames = self.frames, []
        return frames


class SharedField(NamedTuple):
    """What came of two sprayers on one field, in shares of the ground that both could work."""

    twice: float  # of the overlapping part, worked by both or twice by one
    left_out: float  # of the field
    overlap: float  # part of the field that both drive over
    log_in_for_s: float  # from the first status to the last log-in
    map_load: float  # of the bus on which the map is shared
    tractor_load: float  # of the busier tractor bus, places of the receiver not counted
    error: float  # of the shared map's area
    nearest_m: float  # between the tractors: they must not be at one place at one time


def two_sprayers(
    seed: int = 1, shared: bool = True, length_m: float = 200.0, passes: int = 5, overlap: float = 0.3,
    speed_m_s: float = 3.0, fix_for_us: int = STEP_US,
) -> SharedField:  # fmt: skip
    """Drive two sprayers of two makers over a field whose middle both are sent to.

    `fix_for_us`: between two places of a receiver.
    `shared`: whether the two task controllers hear each other's map.
    """
    from sim.can.frame_timing import frame_bits

    width_m = 12.0 * passes
    field = box(0.0, 0.0, length_m, width_m)
    middle_m, reach_m = length_m / 2, length_m * overlap / 2
    backbone = RigBus(seed)
    buses: list[RigBus] = []
    tractors: list[Tractor] = []
    receivers: list[ReceiverNode] = []
    peers: list[PeerNode] = []
    for slot, maker in enumerate((CONDENSED_MAKER, PLAIN_MAKER)):
        sprayer = Sprayer(maker, 77 + slot)
        if slot == 0:
            tractor = Tractor(
                sprayer,
                (-20.0, 6.0),
                middle_m + reach_m - BOOM_AHEAD_M + 2.0,
                passes,
                True,
                8 * S,
                speed_m_s,
            )
        else:
            begin_m = (length_m + 20.0, width_m - 6.0)
            tractor = Tractor(
                sprayer,
                begin_m,
                middle_m - reach_m + BOOM_AHEAD_M - 2.0,
                passes,
                False,
                65 * S,
                speed_m_s,
            )
        identity = Identity(
            slot, frozenset((0, 1)), fleet_name("as applied", slot), 4711, SilencePolicy.CONTINUE,
            started=True, first_boot=True,
        )  # fmt: skip
        peer = make_peer(identity, Random(f"{seed}/{slot}"), 0, {})
        node = PeerNode(peer)
        x0, x1 = (0.0, middle_m + reach_m) if slot == 0 else (middle_m - reach_m, length_m)
        sent_to = box(x0, 0.0, x1, width_m)  # on a headland turn beyond it, all sections are off
        ground = AsAppliedMap(field, peer.progress, sent_to)
        controller = TaskController(
            controller_name(5 + slot), ground, RigFixes(), HITCH_AHEAD_M, Random(seed), 0, 0
        )
        bus, receiver = RigBus(seed + slot), ReceiverNode()
        for each in (ControllerNode(controller, node.cover), sprayer, receiver):
            bus.attach(each)
        if shared or slot == 0:
            backbone.attach(node)
        buses.append(bus)
        tractors.append(tractor)
        receivers.append(receiver)
        peers.append(node)
    now_us, nearest_m = 0, inf
    while not all(tractor.done for tractor in tractors) and now_us < 3600 * S:
        for tractor, receiver in zip(tractors, receivers, strict=True):
            fix = tractor.moves(now_us)
            receiver.frames += [] if now_us % fix_for_us else fix
        for bus in buses:
            bus.run(now_us, now_us + STEP_US)
        one_m, other_m = tractors
        if not (one_m.done or other_m.done):
            nearest_m = min(nearest_m, hypot(one_m.x_m - other_m.x_m, one_m.y_m - other_m.y_m))
        if not shared:
            peers[1].turns(now_us + STEP_US)
        backbone.run(now_us, now_us + STEP_US)
        now_us += STEP_US
    for tractor in tractors:
        tractor.ends()
    one, other = (shapely.union_all(tractor.worked).intersection(field) for tractor in tractors)
    both = box(middle_m - reach_m, 0.0, middle_m + reach_m, width_m)
    total = sum(piece.intersection(both).area for tractor in tractors for piece in tractor.worked)
    union = shapely.union_all([one, other])
    twice = total - union.intersection(both).area
    seconds = now_us / S
    load = sum(frame_bits(*frame) for frame in backbone.carried) / seconds / 250_000
    tractor_load = max(
        sum(frame_bits(*f) for f in bus.carried if f.identifier & 0xFF != RECEIVER) for bus in buses
    ) / seconds / 250_000  # fmt: skip
    log_in_for_s = max(tractor.sprayer.at_us.get("in", now_us) for tractor in tractors) / S
    ground = AsAppliedMap(field, peers[0].peer.progress)
    error = abs(ground.area_m2() - union.area) / union.area
    left = field.difference(union).area / field.area
    return SharedField(
        twice / both.area,
        left,
        both.area / field.area,
        log_in_for_s,
        load,
        tractor_load,
        error,
        nearest_m,
    )
