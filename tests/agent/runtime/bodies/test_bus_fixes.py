"""Observations from a receiver on a CAN bus; its messages are made by the package `nmea2000`."""

import asyncio
from collections.abc import Iterable
from datetime import time as clock
from math import inf, radians
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.interface.config import S
from agent.interface.observation import Observation
from agent.interface.vehicle import Vehicle
from agent.runtime.bodies.bus_fixes import READERS, BusFixes, FastPackets
from agent.runtime.bodies.nmea_body import NmeaBody, in_field
from agent.runtime.bodies.position_fixes import ReceiverClock
from agent.runtime.robot_body import DeclaredMachine
from protocol.frames.identifier import Identifier

nmea2000 = pytest.importorskip("nmea2000", reason="the package nmea2000 is not installed")

ORIGIN = (52.0, 5.0)
LATENCY_US = 20_000
RECEIVER = 28


def messages(pgn: int, source: int = RECEIVER, **fields: Any) -> list[can.Message]:
    """As `nmea2000` encodes them for python-can."""
    encoder = nmea2000.create_encoder("python_can")
    whole = nmea2000.NMEA2000Message(
        PGN=pgn, source=source, destination=255, priority=2,
        fields=[nmea2000.NMEA2000Field(id=name, value=value) for name, value in fields.items()],
    )  # fmt: skip
    found: list[can.Message] = encoder.encode(whole)
    return found


def gnss(
    kind: str, at: clock, latitude: float = 52.0, longitude: float = 5.0, source: int = RECEIVER
) -> list[can.Message]:
    return messages(
        129029, source, sid=1, date=None, time=at, latitude=latitude, longitude=longitude, altitude=12.0,
        gnssType="GPS", method=kind, integrity="No integrity checking", numberOfSvs=17, hdop=0.6,
        pdop=1.0, geoidalSeparation=46.0, referenceStations=0,
    )  # fmt: skip


def fixes(accuracy_m: float = inf) -> BusFixes:
    clock_of = ReceiverClock(LATENCY_US)
    return BusFixes(in_field(ORIGIN), (0.0, 0.0), clock_of.sensed_at_us, LATENCY_US, accuracy_m)


def taken(into: BusFixes, frames: Iterable[can.Message], at_us: int) -> list[Observation]:
    seen = [into.take(each.arbitration_id, bytes(each.data), at_us) for each in frames]
    return [each for each in seen if each is not None]


def heading(bearing_rad: float, source: int = RECEIVER) -> list[can.Message]:
    return messages(
        127250, source, sid=1, heading=bearing_rad, deviation=None, variation=None, reference="True"
    )


def place(latitude: float, longitude: float, source: int = RECEIVER) -> list[can.Message]:
    return messages(129025, source, latitude=latitude, longitude=longitude)


def test_messages_of_nmea_2000_make_an_observation() -> None:
    into = fixes()
    taken(into, gnss("RTK Fixed Integer", clock(12, 35, 19)), S)
    velocity = messages(129026, sid=1, cogReference="True", cog=radians(90.0), sog=1.5)
    taken(into, velocity, S)
    taken(into, place(52.001, 5.001), S)
    (seen,) = taken(into, heading(radians(45.0)), S + 1000)
    assert (seen.x_m, seen.y_m) == pytest.approx((68.7, 111.3), abs=0.2)
    assert seen.heading_rad == pytest.approx(radians(45.0), abs=1e-4)
    assert (seen.vx_m_s, seen.vy_m_s) == pytest.approx((1.5, 0.0), abs=1e-3)
    assert seen.sensed_at_us == S - LATENCY_US and seen.position_accuracy_m == 0.02


def test_the_place_of_129029_counts_where_no_other_comes_and_has_its_own_time() -> None:
    into = fixes()
    for second, late_us in enumerate((0, 0, 400_000)):
        at_us = (second + 1) * S + late_us
        frames = gnss("RTK Fixed Integer", clock(12, 35, second), 52.001)
        assert len(frames) > 5, "a fast packet"
        taken(into, heading(0.0), at_us)
        (seen,) = taken(into, frames, at_us)
        assert seen.sensed_at_us == (second + 1) * S - LATENCY_US
        assert seen.y_m == pytest.approx(111.3, abs=0.2)


def test_without_a_kind_of_fix_places_are_believed_as_the_options_say() -> None:
    for accuracy_m in (inf, 0.03):
        into = fixes(accuracy_m)
        taken(into, place(52.0, 5.0), 0)
        (seen,) = taken(into, heading(0.0), 0)
        assert seen.position_accuracy_m == accuracy_m
    into = fixes(0.03)
    taken(into, gnss("RTK float", clock(12, 0, 0)), 0)
    taken(into, place(52.0, 5.0), 0)
    (seen,) = taken(into, heading(0.0), 0)
    assert seen.position_accuracy_m == 0.4, "what the receiver says outdoes an option"


def test_a_second_receiver_and_a_second_compass_are_not_believed() -> None:
    into = fixes()
    taken(into, place(52.0, 5.0), 0)
    taken(into, heading(1.0, source=40), 0)
    assert taken(into, place(53.0, 5.0, source=99), 0) == []
    taken(into, place(52.0, 5.0), 0)
    assert taken(into, heading(2.0, source=41), 0) == []
    assert into.counts["another device"] == 2


def test_who_says_that_it_has_no_place_is_not_the_receiver() -> None:
    """A display without an antenna was heard first, and no place was believed for good."""
    none = b"\xff" * 8
    for pgn, data in ((129025, b"\xff\xff\xff\x7f" * 2), (65267, none)):
        into = fixes(0.03)
        assert into.take(Identifier(6, pgn, 255, 99).pack(), data, 0) is None
        taken(into, gnss("no GNSS", clock(1, 2, 3), source=98), 0)
        taken(into, place(52.0, 5.0), 3 * S)
        assert into.receiver.address == RECEIVER
        (seen,) = taken(into, heading(0.0), 3 * S)
        assert seen.position_accuracy_m == 0.03
        assert taken(into, place(53.0, 5.0, source=99), 3 * S) == []


def test_fast_packets_of_two_senders_are_kept_apart_before_a_receiver_is_known() -> None:
    into = fixes()
    pairs = zip(
        gnss("no GNSS", clock(1, 2, 3), source=98), gnss("RTK float", clock(1, 2, 3)), strict=True
    )
    for pair in pairs:
        taken(into, pair, 0)
    assert into.receiver.address == RECEIVER
    (seen,) = taken(into, heading(0.0), 0)
    assert seen.position_accuracy_m == 0.4


def test_a_magnetic_compass_is_not_the_one_that_is_believed() -> None:
    into = fixes(0.03)
    magnetic = messages(
        127250, 40, sid=1, heading=2.0, deviation=None, variation=None, reference="Magnetic"
    )
    taken(into, magnetic, 0)
    taken(into, place(52.0, 5.0), 0)
    (seen,) = taken(into, heading(radians(90.0)), 0)
    assert seen.heading_rad == pytest.approx(0.0, abs=1e-4) and into.compass.address == RECEIVER


def claim(address: int, name: int) -> list[can.Message]:
    identifier = Identifier(6, 0xEE00, 255, address).pack()
    return [can.Message(arbitration_id=identifier, data=name.to_bytes(8, "little"))]


@pytest.mark.parametrize("known_before", [True, False])
def test_a_receiver_is_followed_when_an_implement_with_another_one_takes_its_address(
    known_before: bool,
) -> None:
    """Its own places were ignored for good, and those of the implement were taken for them."""
    into, ours, other = fixes(), 0xA0_00_00_00_00_00_00_02, 0xA0_00_00_00_00_00_00_01
    if known_before:
        taken(into, claim(RECEIVER, ours), 0)
    taken(into, place(52.0, 5.0), 0)
    taken(into, heading(0.0), 0)
    taken(into, claim(RECEIVER, ours), 0)
    taken(into, claim(RECEIVER, other), S)
    taken(into, place(52.001, 5.0), S)
    assert taken(into, heading(0.0), S) == []
    taken(into, claim(99, ours), S)
    taken(into, place(52.0, 5.0, source=99), S)
    (seen,) = taken(into, heading(0.0, source=99), S)
    assert seen.y_m == pytest.approx(0.0, abs=0.01)
    taken(into, place(52.001, 5.0), S)
    assert taken(into, heading(0.0), S) == []


def test_j1939_places_and_bearings() -> None:
    into = fixes(0.03)
    latitude, longitude = ((each + 210.0) * 1e7 for each in (52.001, 5.001))
    where = b"".join(round(each).to_bytes(4, "little") for each in (latitude, longitude))
    into.take(Identifier(6, 65267, 255, RECEIVER).pack(), where, 0)
    into.take(Identifier(6, 65267, 255, RECEIVER).pack(), where, S)
    bearing, speed = 90 * 128, round(7.2 * 256)
    course = bearing.to_bytes(2, "little") + speed.to_bytes(2, "little") + b"\xff" * 4
    seen = into.take(Identifier(6, 65256, 255, RECEIVER).pack(), course, S)
    assert seen is not None and (seen.x_m, seen.y_m) == pytest.approx((68.7, 111.3), abs=0.2)
    assert (seen.vx_m_s, seen.vy_m_s) == pytest.approx((2.0, 0.0), abs=1e-2)


def test_the_bearing_of_65256_is_no_heading_where_a_compass_sends_127250() -> None:
    """The bearing of 65256 was the course, so a robot that reversed was turned round."""
    into = fixes(0.03)
    reversing = (270 * 128).to_bytes(2, "little") + (round(3.6 * 256)).to_bytes(2, "little")
    course = reversing + b"\xff" * 4
    taken(into, place(52.0, 5.0), 0)
    assert into.take(Identifier(6, 65256, 255, RECEIVER).pack(), course, 0) is None
    taken(into, heading(radians(90.0)), S // 20)
    for at_us in (2 * S, 2 * S + S // 20):
        taken(into, heading(radians(90.0)), at_us)
        assert into.take(Identifier(6, 65256, 255, RECEIVER).pack(), course, at_us) is None
        (seen,) = taken(into, place(52.0, 5.0), at_us)
        assert seen.heading_rad == pytest.approx(0.0, abs=1e-4), "a bearing of 90 degrees is east"
        assert (seen.vx_m_s, seen.vy_m_s) == pytest.approx((-1.0, 0.0), abs=1e-2)


def test_a_fast_packet_with_a_missing_frame_is_dropped() -> None:
    frames = [bytes(each.data) for each in gnss("RTK Fixed Integer", clock(1, 2, 3))]
    for gone in range(len(frames)):
        packets = FastPackets()
        assert not any(packets.take(1, f) for k, f in enumerate(frames) if k != gone)
        assert [f for f in frames if packets.take(1, f)] == frames[-1:]


@given(st.sampled_from(sorted(READERS)), st.lists(st.binary(max_size=8), max_size=40))
def test_no_frame_is_an_exception(pgn: int, frames: list[bytes]) -> None:
    into = fixes(0.03)
    taken(into, place(52.0, 5.0), 0)
    taken(into, heading(1.0), 0)
    identifier = Identifier(2, pgn, 255, RECEIVER).pack()
    for number, data in enumerate(frames):
        into.take(identifier, data, number)
        into.take(identifier, bytes([number & 0x1F]) + data[:7], number)


def test_the_body_takes_its_places_from_a_bus() -> None:
    asyncio.run(_take_from_a_bus())


async def _take_from_a_bus() -> None:
    body = NmeaBody(0, "can:virtual:receiver", "udp://127.0.0.1:15027", origin=ORIGIN)
    body.declare(DeclaredMachine(Vehicle(), None))
    with can.Bus(interface="virtual", channel="receiver") as bus:
        opening = asyncio.create_task(body.open())
        frames = [*gnss("RTK Fixed Integer", clock(1, 2, 3)), *place(52.001, 5.0), *heading(0.0)]
        while not opening.done():
            for frame in frames:
                bus.send(frame)
            await asyncio.wait({opening}, timeout=0.05)
        await opening
        seen = body.sense(0)
        assert seen is not None and seen.y_m == pytest.approx(111.3, abs=0.2)
        body.close()
