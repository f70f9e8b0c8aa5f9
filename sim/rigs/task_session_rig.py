"""A robot at work for hours, and a task controller whose bytes were recorded: does its record agree?

The answers of the task controller are constant bytes, one table for each version of ISO 11783-10. The
robot drives circles and lowers its implement for a minute of each five quarters. What its body was told
is the work record that the values are held against.
"""

from collections.abc import Sequence
from math import cos, hypot, sin
from random import Random
from struct import pack, unpack
from typing import Final, NamedTuple

import numpy as np

from agent.interface.config import MS, S
from agent.interface.effects import HALT, Drive, Send
from agent.interface.identity import Identity
from agent.interface.mission import ClaimRequest, FleetView, Mission, MotionRequest
from agent.interface.motion_controller import BodyLimits
from agent.interface.observation import Observation
from agent.motion.holonomic_motion import HolonomicMotion
from agent.peer.diagnostics import root_causes
from agent.peer.inputs import BusState, Press, Received, Sensed, Timer
from agent.runtime.peer_factory import MissionParts, make_peer
from agent.safety.stop_cause import StopCause
from protocol.controller_health import Health
from protocol.frames.codec import encode
from protocol.frames.diagnostic_frames import ActiveFaults
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.frames.network_frames import TransportData, TransportManagement
from protocol.frames.safety_frames import Reason
from protocol.frames.task_frames import ProcessData
from protocol.name import fleet_name
from sim.can.frame_timing import frame_bits

SERVER: Final = 247
BITS_A_SECOND: Final = 250_000
WIDTH_MM: Final = 4000
RADIUS_M, SPEED_M_S = 30.0, 1.0
WORK_US, CYCLE_US = 60 * S, 75 * S
STATUS: Final = bytes.fromhex("FEFFFFFF01FFFFFF")
RECORDED: Final = {  # the first byte of a client's message -> the answer, as recorded
    3: {0x00: "1003001101041001", 0x01: "11FFFFFFFFFFFFFF", 0x21: "31FFFFFFFFFFFFFF",
        0x41: "5100FFFFFFFFFFFF", 0x61: "710000000000FFFF", 0x81: "9100FFFFFFFFFFFF"},
    4: {0x00: "1004FF1100046001", 0x01: "11FFFFFFFFFFFFFF", 0x21: "31FFFFFFFFFFFFFF",
        0x41: "5100FFFFFFFFFFFF", 0x61: "710000000000FFFF", 0x81: "9100FFFFFFFF00FF"},
}  # fmt: skip
# Values are asked for by time, by distance and on change once the session is there (recorded, too).
TRIGGERS: Final = ("1400770010270000", "1500740010270000", "18008D0001000000", "1400750010270000")
AREA, DISTANCE, TIME, STATE = 116, 117, 119, 141


class Circles(Mission):
    """Drives circles, and works for a minute of each 75 s."""

    def choose(self, view: FleetView) -> ClaimRequest | None:
        """There are no sections."""
        return None

    def work(self, view: FleetView) -> MotionRequest:
        """Never called without a section."""
        return self.idle(view)

    def idle(self, view: FleetView) -> MotionRequest:
        """Along the circle, with the implement down or up."""
        turned = view.now_us / S * SPEED_M_S / RADIUS_M
        works = view.now_us % CYCLE_US < WORK_US
        return MotionRequest(SPEED_M_S * cos(turned), SPEED_M_S * sin(turned), 0.0, works)


class SessionRecord(NamedTuple):
    """What came of hours with a task controller."""

    log_in_for_s: float  # from its first status
    log_ins: int
    told: int  # values
    area_error: float  # share, of the last value
    distance_error: float
    time_error_for_s: float
    states_missed: int  # changes of the implement that were not told
    load: float  # of the bus by one session, both ways; the status for all is not counted


class StandingLoad(NamedTuple):
    """Shares of the bus that one robot takes while it stands, both ways."""

    session: float  # with its task controller, which asked for the values of `TRIGGERS`
    faults: float  # DM1 with its transport frames
    told: int  # faults in each DM1


class RecordedServer:
    """The task controller: it answers with its table, and keeps the values that it is told."""

    def __init__(self, version: int) -> None:
        self.answers = {kind: bytes.fromhex(text) for kind, text in RECORDED[version].items()}
        self.values: dict[int, int] = {}
        self.told = self.states = 0
        self.activated_at_us: int | None = None
        self._size = 0
        self._pool = bytearray()

    def hears(self, message: object, now_us: int) -> list[tuple[int, bytes]]:
        """Take what the robot says; returns (PGN, bytes) to answer."""
        if isinstance(message, TransportManagement) and message.control == 16:
            self._size, self._pool = int.from_bytes(message.body[:2], "little"), bytearray()
            head = bytes((17, message.body[2], 1, 255, 255)) + message.pgn.to_bytes(3, "little")
            return [(0xEC00, head)]
        if isinstance(message, TransportData) and self._size:
            self._pool += message.body
            if len(self._pool) < self._size:
                return []
            packets, size, self._size = -(-self._size // 7), self._size, 0
            end = pack("<BHBB", 19, size, packets, 255) + b"\x00\xcb\x00"
            return [(0xEC00, end), (0xCB00, self.answers[self._pool[0]])]
        if not isinstance(message, ProcessData):
            return []
        data = message.body
        if data[0] & 0xF == 3:
            ddi, number = unpack("<Hi", data[2:])
            self.values[ddi], self.told = number, self.told + 1
            self.states += ddi == STATE
            return []
        answer = self.answers.get(data[0])
        if answer is None:
            return []
        if data[0] != 0x81:
            return [(0xCB00, answer)]
        self.activated_at_us = now_us
        return [(0xCB00, answer), *((0xCB00, bytes.fromhex(text)) for text in TRIGGERS)]


def standing_load(causes: Sequence[StopCause], seed: int = 1, for_s: int = 60) -> StandingLoad:
    """What a robot sends for a task controller and for diagnostic tools while it stands, by frames.

    It is pressed 10 s after it was switched on and was never started. `causes`: those that hold it
    beside that, as silent members do. Counted from the twentieth second on, for `for_s` seconds.
    """
    identity = Identity(
        0, frozenset({0}), fleet_name("stands", 0), 1, first_boot=True, diagnostics=True,
        implement_width_mm=WIDTH_MM,
    )  # fmt: skip
    peer, server = make_peer(identity, Random(seed), 0, {}), RecordedServer(4)
    queue, now_us, sent, session, faults = list[tuple[int, bytes]](), 0, 0, 0, 0
    since_at_us, status_at_us, end_at_us = 20 * S, 0, (20 + for_s) * S
    pressed = False

    def perform(effects: object) -> None:
        nonlocal sent, session, faults
        assert isinstance(effects, list | tuple)
        for effect in effects:
            if not isinstance(effect, Send):
                continue
            sent += 1
            frame = encode(effect.message, peer.address or 0, effect.destination)
            if effect.destination == SERVER:
                queue.extend(server.hears(effect.message, now_us))
            if now_us < since_at_us:
                continue
            if effect.destination == SERVER:
                session += frame_bits(*frame)
            elif isinstance(effect.message, ActiveFaults | TransportManagement | TransportData):
                faults += frame_bits(*frame)

    while now_us < end_at_us:
        now_us = max(min(max(peer.due_at_us, now_us + MS), status_at_us), now_us)
        if now_us >= status_at_us:
            status_at_us += 2 * S
            perform(peer.step(Received(_from_server(0xCB00, STATUS, GLOBAL_ADDRESS)), now_us))
        perform(peer.step(BusState(Health.ACTIVE, True, sent), now_us))
        if not pressed and now_us >= 10 * S:
            pressed = True
            perform(peer.step(Press(Reason.OPERATOR_INTERVENTION), now_us))
            for cause in causes:
                peer.safety.raise_cause(cause, now_us)
        perform(peer.step(Timer(), now_us))
        while queue and peer.address is not None:
            frame = _from_server(*queue.pop(0), peer.address)
            session += frame_bits(*frame) if now_us >= since_at_us else 0
            perform(peer.step(Received(frame), now_us))
    assert server.activated_at_us is not None and server.told > 0, "no session"
    told = len(root_causes(peer.safety.causes))
    bits = for_s * BITS_A_SECOND
    return StandingLoad(session / bits, faults / bits, told)


def _from_server(pgn: int, data: bytes, destination: int) -> Frame:
    return Frame(0x0C000000 | pgn << 8 | destination << 8 | SERVER, data)


def task_session(version: int, hours: float, seed: int = 1) -> SessionRecord:
    """One robot and one task controller for so many hours of virtual time."""
    identity = Identity(
        0, frozenset({0}), fleet_name("session", 0), 1, started=True, first_boot=True, diagnostics=True,
        implement_width_mm=WIDTH_MM,
    )  # fmt: skip
    motion = HolonomicMotion(0, BodyLimits(0.8, 2.5, 1.5), np.empty((0, 4)))
    peer = make_peer(identity, Random(seed), 0, {}, MissionParts(Circles(), motion))
    server, drive, queue = RecordedServer(version), Drive(0.0, 0.0), list[tuple[int, bytes]]()
    x_m = y_m = worked_m = 0.0
    worked_for_us = changes = sent = now_us = bits = 0
    counts, down = False, False
    end_at_us, status_at_us = round(hours * 3600 * S), 0

    def perform(effects: object) -> None:
        nonlocal drive, sent, bits
        assert isinstance(effects, list | tuple)
        for effect in effects:
            if isinstance(effect, Drive):
                drive = effect
            elif isinstance(effect, Send):
                sent += 1
                if effect.destination == SERVER:
                    bits += frame_bits(*encode(effect.message, peer.address or 0, SERVER))
                    queue.extend(server.hears(effect.message, now_us))

    def say(pgn: int, data: bytes, destination: int) -> None:
        nonlocal bits
        frame = _from_server(pgn, data, destination)
        bits += frame_bits(*frame) if destination != GLOBAL_ADDRESS else 0
        perform(peer.step(Received(frame), now_us))

    while now_us < end_at_us:
        due_at_us = min(max(peer.due_at_us, now_us + MS), status_at_us)
        step_for_us, now_us = due_at_us - now_us, max(due_at_us, now_us)
        x_m, y_m = x_m + drive.vx_m_s * step_for_us / S, y_m + drive.vy_m_s * step_for_us / S
        if counts and drive.tool_on:
            worked_m += hypot(drive.vx_m_s, drive.vy_m_s) * step_for_us / S
            worked_for_us += step_for_us
        if now_us >= status_at_us:
            status_at_us += 2 * S
            say(0xCB00, STATUS, GLOBAL_ADDRESS)
        perform(peer.step(BusState(Health.ACTIVE, True, sent), now_us))
        if peer.wants_observation(now_us):
            here = Observation(x_m, y_m, 0.0, drive.vx_m_s, drive.vy_m_s, sensed_at_us=now_us)
            perform(peer.step(Sensed(here), now_us))
        perform(peer.step(Timer(), now_us))
        while queue and peer.address is not None:
            say(*queue.pop(0), peer.address)
        if drive.tool_on is not down:
            down, changes = drive.tool_on, changes + (server.activated_at_us is not None)
        counts = counts or server.activated_at_us is not None
    say(0xCB00, bytes.fromhex("1200740000000000"), peer.address or 0)
    say(0xCB00, bytes.fromhex("1200750000000000"), peer.address or 0)
    say(0xCB00, bytes.fromhex("1200770000000000"), peer.address or 0)
    values, area_m2 = server.values, worked_m * WIDTH_MM / 1000
    assert drive != HALT, "the robot stands"
    return SessionRecord(
        (server.activated_at_us or now_us) / S, peer.named.tasks.client.sessions, server.told,
        abs(values.get(AREA, 0) - area_m2) / area_m2,
        abs(values.get(DISTANCE, 0) / 1000 - worked_m) / worked_m,
        abs(values.get(TIME, 0) - worked_for_us / S), 1 + changes - server.states,
        bits / (now_us / S) / BITS_A_SECOND,
    )  # fmt: skip
