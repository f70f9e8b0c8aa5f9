"""Commands to a tractor by its bus, as bytes, with its interlocks, and on a tractor that obeys them."""

import asyncio
import time
from itertools import pairwise
from math import cos, hypot, radians, sin
from struct import pack, unpack_from
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.interface.config import CONTROL_PERIOD_US, MS, S
from agent.interface.effects import Drive, GatedDrive
from agent.interface.vehicle import DriveTrain, Vehicle
from agent.motion.wheel_kinematics import WheelSpeeds
from agent.runtime.bodies.guidance_commands import GuidanceCommands
from agent.runtime.bodies.isobus_body import IsobusBody
from agent.runtime.body_plugins import made
from agent.runtime.robot_body import DeclaredMachine, FactoryError
from protocol.frames.codec import encode
from protocol.frames.frame import Frame
from protocol.frames.network_frames import Request

TRACTOR, US = 240, 200
INFO = 0x0CACFF00 | TRACTOR
READY = bytes.fromhex("807D F4 1F 40 FFFFFF")  # no lockout, ready, switch on
BASE_M = 2.5


def commands(steering: bool = True, speed: bool = True) -> GuidanceCommands:
    return GuidanceCommands(BASE_M, steering=steering, speed=speed)


def wheels(forward_m_s: float, steer_rad: float = 0.0) -> WheelSpeeds:
    return WheelSpeeds((forward_m_s,), steer_rad)


def test_the_bytes_are_those_of_the_standard() -> None:
    guidance = commands()
    guidance.take(INFO, READY, 0)
    steer, speed = guidance.commands(wheels(1.5, 0.2), 1.0, US, 0)
    assert steer.identifier == 0x0CADF000 | US, "to the tractor"
    (bits,) = unpack_from("<H", steer.data)
    assert bits * 0.25 - 8032 == pytest.approx(-1000 * 0.2027 / BASE_M, abs=0.2), (
        "to the left is negative"
    )
    assert steer.data[2:] == bytes.fromhex("FD FFFFFFFFFF")
    assert speed == Frame(0x0CFD4300 | US, bytes.fromhex("DC05 FFFF FFFFFF FD"))
    (_, back) = guidance.commands(wheels(-0.5), 1.0, US, 100 * MS)
    assert back.data == bytes.fromhex("F401 FFFF FFFFFF FC")


def test_it_is_off_by_default() -> None:
    body = IsobusBody(0, "can1")
    assert body.wanted == (False, False)
    guidance = commands(steering=False, speed=False)
    guidance.take(INFO, READY, 0)
    assert guidance.commands(wheels(1.0), 1.0, US, 0) == []


@pytest.mark.parametrize(
    "info", ["807D F5 1F 40", "807D F0 1F 40", "807D F4 1F 00", "807D FC 1F C0"]
)
def test_nothing_is_commanded_before_the_tractor_allows_it(info: str) -> None:
    guidance = commands()
    assert guidance.commands(wheels(1.0), 1.0, US, 0) == []
    guidance.take(INFO, bytes.fromhex(info) + b"\xff" * 3, 0)
    assert guidance.commands(wheels(1.0), 1.0, US, 0) == []


@given(st.lists(st.integers(-5 * MS, 5 * MS), min_size=100, max_size=100))
def test_commands_keep_their_rate_though_control_periods_come_early_or_late(
    late: list[int],
) -> None:
    """Each period that came a microsecond early made a gap of 150 ms."""
    guidance, said = commands(), list[int]()
    for period, late_us in enumerate(late):
        now_us = period * CONTROL_PERIOD_US + late_us
        guidance.take(INFO, READY, now_us)
        if guidance.commands(wheels(1.0), 1.0, US, now_us):
            said.append(now_us)
    gaps = [after - before for before, after in pairwise(said)]
    assert len(said) == 50 and all(90 * MS <= gap <= 110 * MS for gap in gaps), gaps


def test_it_lets_go_when_the_switch_goes_off_or_the_tractor_falls_silent() -> None:
    for ends in ("off", "silent"):
        guidance = commands()
        guidance.take(INFO, READY, 0)
        assert len(guidance.commands(wheels(1.0), 1.0, US, 0)) == 2
        now_us = 600 * MS if ends == "silent" else 50 * MS
        if ends == "off":
            guidance.take(INFO, READY[:4] + b"\x00" + READY[5:], now_us)
        steer, speed = guidance.commands(wheels(1.0), 1.0, US, now_us)
        assert steer.data[2] & 3 == 0 and speed.data[:2] == b"\0\0"
        assert guidance.commands(wheels(1.0), 1.0, US, now_us) == [], "once"
    assert guidance.let_go(US) == []


def test_the_switch_of_another_device_does_not_engage_a_tractor_whose_own_is_off() -> None:
    """It was taken for the tractor as soon as that was not ready, and then it counted alone."""
    guidance, other = commands(), 0x0CACFF00 | 19
    off = READY[:4] + b"\x00" + READY[5:]
    for now_us in range(0, S, 100 * MS):
        guidance.take(INFO, off, now_us)
        guidance.take(other, READY, now_us + 10 * MS)
        assert guidance.commands(wheels(1.0), 1.0, US, now_us + 20 * MS) == []
    guidance.take(INFO, READY, S)
    steer, _ = guidance.commands(wheels(1.0), 1.0, US, S)
    assert steer.identifier >> 8 & 0xFF == TRACTOR
    moved_at_us = S + 501 * MS  # the tractor has another address now
    guidance.take(other, READY, moved_at_us)
    assert len(guidance.commands(wheels(1.0), 1.0, US, moved_at_us)) == 2


def test_a_halt_is_said_at_once_and_speeds_are_taken() -> None:
    guidance = commands()
    guidance.take(INFO, READY, 0)
    assert guidance.commands(wheels(1.0), 1.0, US, 0)
    assert guidance.commands(wheels(1.0), 1.0, US, 50 * MS) == [], "each 100 ms"
    assert guidance.commands(wheels(0.0), 1.0, US, 60 * MS)[1].data[:2] == b"\0\0"
    guidance.take(0x0CFE4800 | TRACTOR, bytes.fromhex("DC05 00000000 FF FC"), 0)
    assert guidance.machine_speed_m_s(0) == -1.5
    guidance.take(0x0CFE4900 | TRACTOR, bytes.fromhex("E803 00000000 FF FD"), 0)
    assert guidance.machine_speed_m_s(0) == 1.0
    assert guidance.machine_speed_m_s(501 * MS) is None


def test_a_speed_without_a_direction_is_no_velocity() -> None:
    """A tractor that reversed seemed to drive forward with each message of its radar."""
    guidance = commands()
    for unknown in ("E803 00000000 FF FE", "E803 00000000 FF FF"):
        guidance.take(0x0CFE4900 | TRACTOR, bytes.fromhex(unknown), 0)
        assert guidance.machine_speed_m_s(0) is None
    guidance.take(0x0CFE4800 | TRACTOR, bytes.fromhex("DC05 00000000 FF FC"), 0)
    guidance.take(0x0CFE4900 | TRACTOR, bytes.fromhex("DC05 00000000 FF FF"), 0)
    assert guidance.machine_speed_m_s(0) == -1.5
    guidance.take(0x0CFE4900 | TRACTOR, bytes.fromhex("0000 00000000 FF FF"), 0)
    assert guidance.machine_speed_m_s(0) == 0.0


class Tractor:
    """A tractor on the bus: it obeys curvature and speed, and tells places, heading and readiness."""

    def __init__(self) -> None:
        self.x_m, self.y_m, self.heading_rad = 0.0, 3.0, 0.3
        self.curvature_1_m = self.speed_m_s = 0.0
        self.switch, self.heard = True, 0

    def hears(self, identifier: int, data: bytes) -> None:
        if identifier >> 8 & 0x3FF00 == 0xAD00:
            self.heard += 1
            steers = data[2] & 3 == 1
            self.curvature_1_m = -(unpack_from("<H", data)[0] * 0.25 - 8032) / 1000 * steers
        if identifier >> 8 & 0x3FFFF == 0xFD43:
            self.speed_m_s = unpack_from("<H", data)[0] / 1000 * (1 if data[7] & 3 == 1 else -1)

    def moves(self, for_s: float) -> None:
        step_m = self.speed_m_s * for_s
        self.heading_rad += self.curvature_1_m * step_m
        self.x_m += step_m * cos(self.heading_rad)
        self.y_m += step_m * sin(self.heading_rad)

    def frames(self) -> list[tuple[int, bytes]]:
        metre_deg = 1 / 111_195.0
        place = pack("<ii", round(1e7 * self.y_m * metre_deg), round(1e7 * self.x_m * metre_deg))
        bearing = round(1e4 * ((radians(90) - self.heading_rad) % 6.283185))
        info = READY if self.switch else READY[:4] + b"\x00" + READY[5:]
        return [
            (0x09F8011C, place), (0x09F1121C, pack("<BHHHB", 1, bearing, 0x7FFF, 0x7FFF, 0xFC)),
            (INFO, info),
        ]  # fmt: skip


def test_a_tractor_is_brought_to_a_line_and_stands_when_its_switch_goes_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On python-can's virtual bus, with the time of the test instead of a clock."""

    async def story() -> None:
        clock = {"us": S}
        monkeypatch.setattr("agent.runtime.bodies.isobus_body._now_us", lambda: clock["us"])
        body: Any = IsobusBody(
            1,
            "tractor bus",
            "virtual",
            steering=True,
            speed=True,
            accuracy_m=0.02,
            origin=(0.0, 0.0),
        )
        body.declare(DeclaredMachine(Vehicle(drive=DriveTrain.ACKERMANN), None))
        tractor, bus = Tractor(), can.Bus("tractor bus", interface="virtual")
        opening = asyncio.create_task(body.open())
        while not opening.done():
            for identifier, data in tractor.frames():
                bus.send(can.Message(arbitration_id=identifier, data=data))
            clock["us"] += 50 * MS
            await asyncio.wait({opening}, timeout=0.01)
        await opening

        async def drives(for_s: float) -> None:
            for _ in range(round(for_s * 20)):
                clock["us"] += 50 * MS
                tractor.moves(0.05)
                for identifier, data in tractor.frames():
                    body._heard(Frame(identifier, data))
                here = body.sense(clock["us"])
                assert here is not None
                towards = -0.4 * here.y_m  # back to y = 0
                speed = 1.2 / hypot(1.0, towards)
                body.drive(GatedDrive(Drive(speed, towards * speed)), clock["us"])
                while (message := bus.recv(0)) is not None:
                    tractor.hears(message.arbitration_id, bytes(message.data))

        await drives(40.0)
        assert abs(tractor.y_m) < 0.2 and tractor.x_m > 20.0, (tractor.x_m, tractor.y_m)
        assert tractor.heard > 300
        ours = body.claim.address
        body._heard(encode(Request(0xFEDA), 38, ours))  # a terminal asks for a group (ISO 11783-3)
        body._heard(encode(Request(0xFEDA), 38))
        answers = iter(lambda: bus.recv(0), None)
        told = [(m.arbitration_id & 0xFF, bytes(m.data)) for m in answers
                if m.arbitration_id >> 16 & 0xFF == 0xE8]  # fmt: skip
        assert told == [(ours, bytes.fromhex("01FFFFFF26DAFE00"))]
        tractor.switch = False
        await drives(1.0)
        stands_at_m = tractor.x_m
        await drives(2.0)
        assert tractor.speed_m_s == 0.0 and tractor.x_m == stands_at_m
        body.close()
        bus.shutdown()

    asyncio.run(story())


NO_VELOCITY = (0x09F8021C, b"\xff" * 8)  # 129026 of a receiver that knows neither course nor speed
BACK_1_5_M_S = (0x0CFE4800 | TRACTOR, bytes.fromhex("DC05 00000000 FF FC"))


def listening(monkeypatch: pytest.MonkeyPatch, clock: dict[str, int]) -> Any:
    """A body that only listens, and whose place has been told once."""
    monkeypatch.setattr("agent.runtime.bodies.isobus_body._now_us", lambda: clock["us"])
    body: Any = IsobusBody(1, "tractor bus", "virtual", accuracy_m=0.02, origin=(0.0, 0.0))
    body.declare(DeclaredMachine(Vehicle(drive=DriveTrain.ACKERMANN), None))
    hears(body, Tractor().frames())
    return body


def hears(body: Any, frames: list[tuple[int, bytes]]) -> None:
    for identifier, data in frames:
        body._heard(Frame(identifier, data))


def test_a_tractor_is_told_to_stand_when_the_robot_says_nothing_for_100_ms() -> None:
    """It drove on for as long as the tractor itself obeys a command, and CI saw 311 ms."""

    async def silent() -> tuple[list[int], float]:
        body: Any = IsobusBody(
            1, "silent", "virtual", speed=True, accuracy_m=0.02, origin=(0.0, 0.0)
        )
        body.declare(DeclaredMachine(Vehicle(drive=DriveTrain.ACKERMANN), None))
        bus = can.Bus("silent", interface="virtual")
        loop = asyncio.get_running_loop()
        opening = asyncio.create_task(body.open())
        while not opening.done() or body.claim.address is None:
            for identifier, data in Tractor().frames():
                bus.send(can.Message(arbitration_id=identifier, data=data))
            await asyncio.wait({opening}, timeout=0.01)
            body._claims(time.monotonic_ns() // 1000)
        while bus.recv(0) is not None:
            pass
        hears(body, Tractor().frames())
        body.drive(GatedDrive(Drive(1.0, 0.0)), time.monotonic_ns() // 1000)
        silent_since_s, speeds = loop.time(), list[int]()
        while not speeds or speeds[-1] != 0:
            hears(body, Tractor().frames())
            while (message := bus.recv(0)) is not None:
                if message.arbitration_id >> 8 & 0xFFFF == 0xFD43:
                    speeds.append(unpack_from("<H", message.data)[0])
            await asyncio.wait({loop.create_future()}, timeout=0.005)
        stood_after_s = loop.time() - silent_since_s
        body.close()
        bus.shutdown()
        return speeds, stood_after_s

    speeds, stood_after_s = asyncio.run(asyncio.wait_for(silent(), 10.0))
    assert speeds[0] > 500 and speeds[1:] == [0] and stood_after_s > 0.09, (speeds, stood_after_s)


def test_a_receiver_that_knows_no_velocity_does_not_hide_the_speed_of_the_tractor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    body = listening(monkeypatch, {"us": S})
    hears(body, [NO_VELOCITY, BACK_1_5_M_S, *Tractor().frames()])
    here = body.sense(S)
    assert hypot(here.vx_m_s, here.vy_m_s) == pytest.approx(1.5)


def test_the_last_speed_of_a_tractor_that_says_none_any_more_is_forgotten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = {"us": S}
    body = listening(monkeypatch, clock)
    hears(body, [BACK_1_5_M_S])
    for _ in range(20):
        clock["us"] += 50 * MS
        hears(body, Tractor().frames())  # which stands
    here = body.sense(clock["us"])
    assert (here.vx_m_s, here.vy_m_s) == (0.0, 0.0)


def test_it_is_a_plug_in_for_steered_machines() -> None:
    body = made("isobus", None, 0, {"channel": "can1"})
    with pytest.raises(ValueError, match="ackermann"):
        body.declare(DeclaredMachine(Vehicle(), (0.0, 0.0)))
    with pytest.raises(FactoryError):
        made("isobus", None, 0, {})
