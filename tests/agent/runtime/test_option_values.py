"""Options of bodies that make no sense are refused in one line, where the body is made."""

from math import inf, nan
from typing import Any

import pytest

pytest.importorskip("pynmeagps", reason="the extra nmea is not installed")

from agent.runtime.bodies.isobus_body import IsobusBody
from agent.runtime.bodies.nmea_body import NmeaBody
from agent.runtime.bodies.replay_body import ReplayBody
from agent.runtime.robot_body import StandingBody

PORTS: dict[str, Any] = {"gnss": "tcp://127.0.0.1:1", "wheels": "tcp://127.0.0.1:2"}


@pytest.mark.parametrize(
    "options",
    [
        {"wheel_radius_m": 0},
        {"wheel_radius_m": "0.1"},
        {"wheel_radius_m": -0.1},
        {"wheel_radius_m": True},
        {"latency_ms": -20.0},
        {"latency_ms": inf},
        {"accuracy_m": "good"},
        {"accuracy_m": nan},
        {"antenna_ahead_m": [1.0]},
        {"origin": [52.0]},
        {"origin": "52,5"},
        {"origin": [5.0, 520.0]},
    ],
)
def test_a_number_that_makes_no_sense_is_one_line_and_no_exception_later(
    options: dict[str, Any],
) -> None:
    """A wheel without a radius ended a robot with ZeroDivisionError, and a text with TypeError."""
    (name,) = options
    with pytest.raises(ValueError, match=rf"\Aoptions\.{name}: [^\n]+\Z"):
        NmeaBody(0, **PORTS, **options)
    if name != "wheel_radius_m":
        with pytest.raises(ValueError, match=name):
            IsobusBody(0, "can0", **options)


@pytest.mark.parametrize("name", ["steering", "speed"])
@pytest.mark.parametrize("value", ["false", "no", 0, 1, None])
def test_a_tractor_is_not_commanded_because_of_a_word(name: str, value: Any) -> None:
    """steering = "false" in a robot file steered the tractor: a text counts as true."""
    with pytest.raises(ValueError, match=rf"\Aoptions\.{name}: [^\n]+\Z"):
        IsobusBody(0, "can0", **{name: value})
    body = IsobusBody(0, "can0", steering=False, speed=True)
    assert body.wanted == (False, True)


def test_other_bodies_check_their_options_too() -> None:
    with pytest.raises(ValueError, match="antenna_left_m"):
        ReplayBody(0, "log", antenna_left_m="1")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="x_m"):
        StandingBody(0, x_m="1")  # type: ignore[arg-type]


def test_options_that_make_sense_are_taken_as_they_are() -> None:
    body = NmeaBody(0, **PORTS, wheel_radius_m=1, latency_ms=0, origin=(52.0, 5))
    assert (body.wheel_radius_m, body.latency_us, body.origin) == (1.0, 0, (52.0, 5.0))
    assert (body.accuracy_m, body.antenna_m) == (inf, (0.0, 0.0))


@pytest.mark.parametrize(
    "value", [5, True, None, "", ["tcp://127.0.0.1:1"], "tcp://127.0.0.1:99999"]
)
@pytest.mark.parametrize("name", ["gnss", "wheels"])
def test_an_address_that_is_none_is_told_by_its_option(name: str, value: Any) -> None:
    """`gnss = 5` was "'int' object has no attribute 'startswith'", and other lines did not say which."""
    with pytest.raises(ValueError, match=rf"\Aoptions\.{name}: [^\n]+ is not serial:PATH[^\n]+\Z"):
        NmeaBody(0, **{**PORTS, name: value})


def test_a_host_that_no_computer_can_have_is_told_before_it_is_called() -> None:
    """A label of more than 63 letters is a UnicodeError where the connection is made."""
    with pytest.raises(ValueError, match=r"\Aoptions\.gnss: [^\n]+ no name of a computer\Z"):
        NmeaBody(0, **{**PORTS, "gnss": f"tcp://{'a' * 70}:1"})


@pytest.mark.parametrize("value", [5, None, "", ["a.nmea"]])
def test_the_log_of_a_drive_is_the_name_of_a_file(value: Any) -> None:
    """`log = ""` said "Is a directory"."""
    with pytest.raises(
        ValueError, match=r"\Aoptions\.log: [^\n]+ is not the name of a file[^\n]+\Z"
    ):
        ReplayBody(0, value)
