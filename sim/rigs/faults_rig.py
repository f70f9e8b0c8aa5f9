"""A whole fleet that stands, with the stop button of another maker, as a diagnostic tool reads it.

The button is written from ISO 11783-7, the tool from SAE J1939-21 and -73, byte by byte, without a
line of our own codec.
"""

from struct import pack
from typing import Final, NamedTuple

from agent.interface.config import S
from protocol.frames.frame import Frame
from sim.can.frame_timing import frame_bits
from sim.rigs.terminal_rig import ScreenFleet

BUTTON, TOOL = 41, 250  # addresses
ADDRESSED: Final = 0xF0  # PDU formats below it have a destination
GLOBAL: Final = 255
DM1, REQUEST, ANNOUNCE, PACKETS, CLAIM, BUTTON_STATE = (
    0xFECA, 0xEA00, 0xEC00, 0xEB00, 0xEE00, 0xFD02,
)  # fmt: skip
BAM, RTS, CTS, END = 32, 16, 17, 19


class StopButton:
    """A stop button of another maker: it says its state each second."""

    def __init__(self) -> None:
        self.is_pressed, self.presses = False, 0
        self._say_at_us = 0
        self._claimed = False

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """It listens to nobody."""
        return []

    def turns(self, now_us: int) -> list[Frame]:
        """Its NAME once, then its state."""
        frames = []
        if not self._claimed:
            self._claimed = True
            name = 1 << 63 | 2 << 60 | 61 << 40 | 100 << 21 | 9
            frames.append(Frame(0x18000000 | (CLAIM | GLOBAL) << 8 | BUTTON, pack("<Q", name)))
        if now_us >= self._say_at_us:
            self._say_at_us = now_us + S
            state = 0xFC | (0 if self.is_pressed else 1)  # stop, permit
            data = b"\xff" * 6 + bytes((self.presses, state))
            frames.append(Frame(0x0C000000 | BUTTON_STATE << 8 | BUTTON, data))
        return frames

    def press(self) -> None:
        """A person presses it."""
        self.is_pressed, self.presses = True, self.presses + 1


class ReadFaults(NamedTuple):
    """The faults in one DM1."""

    at_us: int
    source: int
    faults: tuple[tuple[int, int], ...]  # SPN and FMI
    was_asked: bool  # it came to the tool alone


class FaultReader:
    """A diagnostic tool: it reads all DM1 of the bus, and can ask a device for its own."""

    def __init__(self) -> None:
        self.read: list[ReadFaults] = []
        self.bits = 0  # of the frames that told DM1 to all
        self.errors: list[str] = []
        self._open: dict[tuple[int, bool], tuple[int, bytearray]] = {}  # to us alone? size, data
        self._ask: list[Frame] = []

    def ask(self, address: int) -> None:
        """Request its DM1."""
        head = 0x18000000 | REQUEST << 8 | address << 8 | TOOL
        self._ask.append(Frame(head, DM1.to_bytes(3, "little")))

    def turns(self, now_us: int) -> list[Frame]:
        """What it asks."""
        asked, self._ask = self._ask, []
        return asked

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """Take a frame of the bus."""
        group, data, source = frame.identifier >> 8 & 0x3FFFF, frame.data, frame.identifier & 0xFF
        destination = GLOBAL
        if group >> 8 & 0xFF < ADDRESSED:
            group, destination = group & 0x3FF00, group & 0xFF
        if destination not in (GLOBAL, TOOL):
            return []
        alone = destination == TOOL
        if group == DM1:
            self.bits += frame_bits(*frame)
            self._take(source, data, now_us, alone)
        elif group == ANNOUNCE and data[0] in (BAM, RTS):
            if int.from_bytes(data[5:8], "little") != DM1:
                self._open.pop((source, alone), None)
                return []
            self._open[source, alone] = int.from_bytes(data[1:3], "little"), bytearray()
            if data[0] == RTS:
                return [self._managed(source, bytes((CTS, data[3], 1, 0xFF, 0xFF)))]
            self.bits += frame_bits(*frame)
        elif group == PACKETS and (source, alone) in self._open:
            return self._packet(frame, source, alone, now_us)
        return []

    def _packet(self, frame: Frame, source: int, alone: bool, now_us: int) -> list[Frame]:
        self.bits += 0 if alone else frame_bits(*frame)
        size, so_far = self._open[source, alone]
        if frame.data[0] != len(so_far) // 7 + 1:
            self.errors.append(f"{source}: packet {frame.data[0]}")
        so_far += frame.data[1:]
        if len(so_far) < size:
            return []
        del self._open[source, alone]
        self._take(source, bytes(so_far[:size]), now_us, alone)
        if not alone:
            return []
        return [self._managed(source, bytes((END, size & 0xFF, size >> 8, -(-size // 7), 0xFF)))]

    def _managed(self, source: int, head: bytes) -> Frame:
        identifier = 0x1C000000 | ANNOUNCE << 8 | source << 8 | TOOL
        return Frame(identifier, head + DM1.to_bytes(3, "little"))

    def _take(self, source: int, data: bytes, now_us: int, alone: bool) -> None:
        faults = []
        for at in range(2, 2 + (len(data) - 2) // 4 * 4, 4):
            one, two, three, _ = data[at : at + 4]
            if data[at : at + 3] != b"\0\0\0" and (one, two) != (0xFF, 0xFF):
                faults.append((one | two << 8 | three >> 5 << 16, three & 31))
        self.read.append(ReadFaults(now_us, source, tuple(faults), alone))


class StandingFleet:
    """A fleet with its screen, a button and a tool. All robots are latched; the button is pressed."""

    def __init__(self, robots: int, seed: int) -> None:
        self.fleet, self.button, self.tool = ScreenFleet(robots, seed), StopButton(), FaultReader()
        for device in (self.button, self.tool):
            self.fleet.bus.attach(device)
        self.fleet.run(6 * S)

    def stop(self) -> None:
        """An emergency stop at the terminal, and the button."""
        self.fleet.press_stop()
        self.button.press()
        self.fleet.run(3 * S)

    def load(self, for_s: int) -> float:
        """The share of the bus that DM1 takes from now on, for so many seconds."""
        before = self.tool.bits
        self.fleet.run(for_s * S)
        return (self.tool.bits - before) / for_s / 250_000
