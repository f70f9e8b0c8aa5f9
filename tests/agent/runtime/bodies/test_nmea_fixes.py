"""Observations from sentences: units, axes, times, and what is left out or broken."""

from functools import reduce
from math import atan2, cos, degrees, hypot, pi, radians, remainder, sin
from operator import xor
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.interface.config import FAREWELL_SPEED_M_S, S

pytest.importorskip("pynmeagps", reason="the extra nmea is not installed")

from agent.runtime.bodies.nmea_body import in_field
from agent.runtime.bodies.nmea_fixes import NmeaFixes
from agent.runtime.bodies.position_fixes import DAY_US, ReceiverClock

ORIGIN = (52.0, 5.0)
LATENCY_US = 20_000


def sentence(body: str) -> bytes:
    return b"$%b*%02X" % (body.encode(), reduce(xor, body.encode(), 0))


def gga(clock: str = "123519.20", place: str = "5200.0000,N,00500.0000,E", kind: int = 4) -> bytes:
    return sentence(f"GNGGA,{clock},{place},{kind},17,0.6,80.0,M,46.0,M,1.0,0001")


def hdt(bearing: float) -> bytes:
    return sentence(f"GNHDT,{bearing:.3f},T")


def fixes(antenna_m: tuple[float, float] = (0.0, 0.0)) -> NmeaFixes:
    return NmeaFixes(in_field(ORIGIN), antenna_m, ReceiverClock(LATENCY_US).sensed_at_us)


# As recorded from receivers of three makers; the places are those of their manuals.
RECORDED = [
    b"$GPGGA,172814.0,3723.46587704,N,12202.26957864,W,2,6,1.2,18.893,M,-25.669,M,2.0,0031*4F",
    b"$GNGGA,092725.00,4717.11399,N,00833.91590,E,4,08,1.01,499.6,M,48.0,M,1.0,0000*6E",
    b"$GPHDT,123.456,T*32",
    b"$GPGST,172814.0,0.006,0.023,0.020,273.6,0.023,0.020,0.031*6A",
    b"$GPVTG,,T,,M,0.00,N,0.00,K*4E",
]


def test_recorded_sentences_are_taken_or_counted() -> None:
    taken = fixes()
    for at_us, line in enumerate(RECORDED):
        taken.take(line, at_us)
    assert taken.counts["GGA"] + taken.counts["malformed"] >= 2 and taken.counts["HDT"] == 1


def test_a_place_and_a_heading_make_an_observation() -> None:
    taken = fixes()
    assert taken.take(gga(place="5200.0600,N,00500.0600,E"), S) is None
    seen = taken.take(hdt(90.0), S + 5_000)
    assert seen is not None
    # A minute of arc is 1,854 m north here, and 1,145 m east (WGS 84, 52 degrees).
    assert seen.y_m == pytest.approx(0.06 * 1854.6, abs=0.3)
    assert seen.x_m == pytest.approx(0.06 * 1145.0, abs=0.3)
    assert seen.heading_rad == pytest.approx(0.0), "a bearing of 90 degrees is east"
    assert seen.sensed_at_us == S - LATENCY_US and seen.position_accuracy_m == 0.02


@pytest.mark.parametrize("turn_rad_s", [0.5, -1.0])
def test_an_antenna_that_a_turning_body_moves_does_not_move_the_body(turn_rad_s: float) -> None:
    """A body that turns on the spot: its antenna, 1.5 m ahead and 0.4 m to the right, drives."""
    ahead_m, left_m = 1.5, -0.4
    taken, seen = fixes((ahead_m, left_m)), None
    east_m, north_m = 1145.0, 1854.6  # of a minute of arc, as above
    for step in range(20):
        at_s = step / 20
        heading = turn_rad_s * at_s
        x_m = ahead_m * cos(heading) - left_m * sin(heading)
        y_m = ahead_m * sin(heading) + left_m * cos(heading)
        place = f"52{0.1 + y_m / north_m:010.7f},N,005{0.1 + x_m / east_m:010.7f},E"
        at_us = round(at_s * S)
        speed_kmh = abs(turn_rad_s) * hypot(ahead_m, left_m) * 3.6
        course = 90 - degrees(atan2(turn_rad_s * x_m, -turn_rad_s * y_m))
        taken.take(sentence(f"GNVTG,{course % 360:.2f},T,,M,,N,{speed_kmh:.3f},K,D"), at_us)
        taken.take(gga(f"1235{19 + at_s:05.2f}", place), at_us)
        seen = taken.take(hdt((90 - degrees(heading)) % 360), at_us) or seen
    assert seen is not None
    assert hypot(seen.vx_m_s, seen.vy_m_s) < 0.02


@pytest.mark.parametrize("bearing", [0.0, 45.0, 180.0, 271.0])
def test_the_antenna_is_ahead_and_left_of_the_middle(bearing: float) -> None:
    taken = fixes((2.0, 0.5))
    taken.take(gga(), 0)
    seen = taken.take(hdt(bearing), 0)
    assert seen is not None
    course = radians(90 - bearing)
    x_m = seen.x_m + 2.0 * cos(course) - 0.5 * sin(course)
    y_m = seen.y_m + 2.0 * sin(course) + 0.5 * cos(course)
    assert (x_m, y_m) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_velocity_is_of_the_course_over_ground() -> None:
    taken = fixes()
    taken.take(sentence("GNVTG,180.0,T,,M,1.944,N,3.600,K,D"), 0)
    taken.take(gga(), 0)
    seen = taken.take(hdt(0.0), 0)
    assert seen is not None and (seen.vx_m_s, seen.vy_m_s) == pytest.approx((0.0, -1.0), abs=1e-9)


def test_a_receiver_that_tells_no_velocity_does_not_make_a_robot_drive_that_stands() -> None:
    """Its noise was a speed, and the farewell of the robot was perhaps not believed."""
    taken, rng, stands = fixes(), Random(1), 0
    for tick in range(200):
        east, north = (rng.gauss(0.0, 0.01) for _ in range(2))
        here = f"52{1.0 + north / 1854.6:010.7f},N,005{1.0 + east / 1145.0:010.7f},E"
        at_us = tick * 50_000
        taken.take(gga(f"1235{at_us / S:05.2f}", here), at_us)
        seen = taken.take(hdt(0.0), at_us)
        assert seen is not None
        stands += hypot(seen.vx_m_s, seen.vy_m_s) <= FAREWELL_SPEED_M_S / 2
    assert stands > 80


def test_the_velocity_of_places_follows_within_half_a_second() -> None:
    taken = fixes()
    for tick in range(20):
        at_us = tick * 50_000
        taken.take(gga(f"1235{at_us / S:05.2f}", f"5200.0000,N,00500.{tick:04d},E"), at_us)
        seen = taken.take(hdt(0.0), at_us)
    # 0.0001 minutes are 0.1145 m here.
    assert seen is not None and (seen.vx_m_s, seen.vy_m_s) == pytest.approx((2.29, 0.0), abs=0.01)


def test_gst_says_the_accuracy_until_it_is_old() -> None:
    taken = fixes()
    taken.take(sentence("GNGST,123519.20,0.5,0.3,0.3,0.0,0.31,0.11,0.5"), 0)
    taken.take(gga(), 0)
    seen = taken.take(hdt(0.0), 0)
    assert seen is not None and seen.position_accuracy_m == 0.31
    taken.take(gga("123529.20", kind=5), 10 * S)
    seen = taken.take(hdt(0.0), 10 * S)
    assert seen is not None and seen.position_accuracy_m == 0.4


def test_a_repeated_place_and_one_without_a_fix_are_no_places() -> None:
    taken = fixes()
    taken.take(gga(), 0)
    assert taken.take(hdt(0.0), 0) is not None
    taken.take(gga(), S)
    assert taken.take(hdt(0.0), S) is None and taken.counts["repeated"] == 1
    taken.take(gga("123520.20", kind=0), S)
    assert taken.take(hdt(0.0), S) is None


def test_what_arrives_late_is_as_old_as_it_is() -> None:
    clock = ReceiverClock(LATENCY_US)
    begin_us = DAY_US - 30 * S  # over midnight
    for tick in range(2000):
        utc_us, delay_us = (begin_us + tick * 50_000) % DAY_US, 500_000 * (tick % 7 == 3)
        arrived_us = 7 * S + tick * 50_000 + delay_us
        sensed_us = clock.sensed_at_us(utc_us, arrived_us)
        assert sensed_us == arrived_us - delay_us - LATENCY_US


def ages_us(utc_us: list[int], arrived_us: list[int]) -> list[int]:
    """How old each place is said to be at its arrival, beyond the latency."""
    clock = ReceiverClock(LATENCY_US)
    pairs = zip(utc_us, arrived_us, strict=True)
    return [at_us - LATENCY_US - clock.sensed_at_us(utc % DAY_US, at_us) for utc, at_us in pairs]


@pytest.mark.parametrize("back_us", [S, 2 * S, 18 * S])
def test_a_receiver_that_sets_its_time_back_is_believed_again_within_seconds(back_us: int) -> None:
    """Its places looked late for one to two minutes, in which the robot stood."""
    arrived_us = [7 * S + tick * 50_000 + tick % 3 * 4000 for tick in range(400)]
    utc_us = [40_000 * S + tick * 50_000 - back_us * (tick >= 200) for tick in range(400)]
    ages = ages_us(utc_us, arrived_us)
    assert max(ages[:200]) < 10_000, "as before"
    assert ages[200] >= back_us - 10_000, "not before it is steady"
    assert max(ages[245:]) < 10_000


def test_one_wrong_time_ahead_does_not_make_what_follows_late() -> None:
    arrived_us = [7 * S + tick * 50_000 for tick in range(400)]
    utc_us = [40_000 * S + tick * 50_000 + S * (tick == 200) for tick in range(400)]
    assert not any(ages_us(utc_us, arrived_us)[245:])


def test_a_leap_second_at_which_a_receiver_says_no_time_is_a_step() -> None:
    ticks = [tick for tick in range(400) if not 200 <= tick < 220]
    arrived_us = [7 * S + tick * 50_000 for tick in ticks]
    utc_us = [DAY_US - 10 * S + tick * 50_000 - S * (tick >= 220) for tick in ticks]
    assert not any(ages_us(utc_us, arrived_us)[245:])


def test_places_that_are_late_by_a_second_stay_late() -> None:
    """The line stood for a second and is behind by this second from then on."""
    arrived_us = [7 * S + tick * 50_000 + S * (tick >= 200) for tick in range(400)]
    utc_us = [40_000 * S + tick * 50_000 for tick in range(400)]
    assert ages_us(utc_us, arrived_us)[200:] == [S] * 200


@given(st.binary(max_size=100), st.integers(0, 60 * S))
def test_no_bytes_are_an_exception(line: bytes, at_us: int) -> None:
    taken = fixes()
    taken.take(gga(), at_us)
    taken.take(line, at_us)
    body = bytes(each for each in line if 32 <= each < 127 and each not in b"$*")
    for kind in (b"GNGGA,", b"GNHDT,", b"GNVTG,", b"GNGST,", b"GNRMC,", b"GNTHS,"):
        whole = kind + body
        taken.take(b"$%b*%02X" % (whole, reduce(xor, whole, 0)), at_us)
    seen = taken.take(hdt(degrees(1.0)), at_us)
    assert seen is None or abs(remainder(seen.heading_rad, 2 * pi)) <= pi


@pytest.mark.parametrize("said", ["-1.0,-1.0", "0.0,0.0", "0.01,-1"])
def test_an_accuracy_of_nothing_is_none_and_the_kind_of_fix_says_it(said: str) -> None:
    """A GST of a receiver that does not know its accuracy made its places exact: 0.000 m."""
    taken = fixes()
    taken.take(sentence(f"GNGST,123519.20,0.5,0.3,0.3,0.0,{said},0.5"), 0)
    taken.take(gga(kind=4), 0)
    seen = taken.take(hdt(0.0), 0)
    assert seen is not None and seen.position_accuracy_m == 0.02 and taken.counts["invalid"] == 1


@pytest.mark.parametrize(("quality", "at_least_m"), [(1, 1.0), (2, 0.3), (5, 0.05)])
def test_an_rtk_fix_that_is_lost_is_not_hidden_by_what_was_said_of_it(
    quality: int, at_least_m: float
) -> None:
    """A GST of the last RTK fix counted for two seconds, and a robot drove 3.7 m by a place of metres."""
    taken = fixes()
    heading = sentence("GNHDT,90.0,T")
    taken.take(gga("123511.00", kind=4), 0)
    taken.take(sentence("GNGST,123511.00,0.5,0.3,0.3,0.0,0.01,0.01,0.5"), 0)
    seen = taken.take(heading, 0)
    assert seen is not None and seen.position_accuracy_m == 0.01
    taken.take(gga("123512.00", kind=quality), S)
    seen = taken.take(heading, S)
    assert seen is not None and seen.position_accuracy_m >= at_least_m
    taken.take(sentence("GNGST,123512.00,0.5,0.3,0.3,0.0,0.01,0.01,0.5"), S)  # it goes on with it
    taken.take(gga("123513.00", kind=quality), S)
    seen = taken.take(heading, S)
    assert seen is not None and seen.position_accuracy_m >= at_least_m


@pytest.mark.parametrize("mode", ["E", "M", "S", "V"])
def test_a_heading_that_says_that_it_is_none_is_none(mode: str) -> None:
    taken = fixes()
    taken.take(gga("123511.00", kind=4), 0)
    assert taken.take(sentence(f"GNTHS,90.0,{mode}"), 0) is None
    assert taken.counts["invalid"] == 1
    assert taken.take(sentence("GNTHS,90.0,A"), 0) is not None


@pytest.mark.parametrize("word", ["nan", "inf"])
def test_a_field_that_is_not_a_number_is_malformed(word: str) -> None:
    """Programs print "nan" for what they do not know. A heading of "nan" could reach the wheels."""
    taken = fixes()
    lines = (
        f"GNHDT,{word},T",
        f"GNGST,123519.20,1,1,1,1,{word},1,1",
        f"GNVTG,{word},T,,M,1.0,N,1.8,K,A",
        f"GNVTG,90.0,T,,M,1.0,N,{word},K,A",
    )
    for line in lines:
        assert taken.take(sentence(line), S) is None
    assert taken.counts["malformed"] == len(lines)
    assert taken.take(gga(), S) is None, "without a heading"
    seen = taken.take(hdt(90.0), S)
    assert seen is not None and seen.position_accuracy_m == 0.02
    assert (seen.x_m, seen.vx_m_s, seen.vy_m_s) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("bearing", ["999.9", "-1.0", "360.1"])
def test_a_bearing_that_is_none_is_malformed(bearing: str) -> None:
    """A receiver that says 999.9 until it knows its heading turned a robot by that."""
    taken = fixes()
    taken.take(gga("123511.00"), 0)
    assert taken.take(sentence(f"GNHDT,{bearing},T"), 0) is None
    taken.take(sentence(f"GNVTG,{bearing},T,,M,10.0,N,18.5,K,A"), 0)
    assert taken.counts["malformed"] == 2
    seen = taken.take(hdt(360.0), 0)
    assert seen is not None and (seen.vx_m_s, seen.vy_m_s) == (0.0, 0.0)


@pytest.mark.parametrize("place", ["5200.0,,00500.0,E", "5200.0,N,00500.0,"])
def test_a_place_without_its_hemisphere_is_none(place: str) -> None:
    """It was taken for one in the north or the east."""
    taken = fixes()
    taken.take(gga(place=place), 0)
    assert taken.counts["malformed"] == 1 and taken.take(hdt(90.0), 0) is None


@pytest.mark.parametrize(
    "binary", [b"\xb5\x62\x01\x07\x5c\x00", b"\xd3\x00\x13$\x3e", b"\\s:rx*2A\\"]
)
def test_binary_messages_between_sentences_cost_none_of_them(binary: bytes) -> None:
    """A receiver that sends UBX before each GGA had no place at all."""
    taken = fixes()
    taken.take(binary + gga(), 0)
    assert taken.take(hdt(90.0), 0) is not None and taken.counts["malformed"] == 0


def test_a_velocity_that_says_that_it_is_none_is_none() -> None:
    taken = fixes()
    taken.take(sentence("GNRMC,123511.00,V,5200.0,N,00500.0,E,200.0,90.0,010126,,,N"), 0)
    taken.take(sentence("GNVTG,90.0,T,,M,200.0,N,370.0,K,N"), 0)
    taken.take(gga("123511.00", kind=4), 0)
    seen = taken.take(sentence("GNTHS,90.0,A"), 0)
    assert seen is not None and (seen.vx_m_s, seen.vy_m_s) == (0.0, 0.0)
    assert taken.counts["invalid"] == 2
