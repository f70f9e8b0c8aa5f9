"""Options of bodies that make no sense are refused in one line, where the body is made."""

from math import inf, nan
from typing import Any

import pytest

pytest.importorskip("pynmeagps", reason="the extra nmea is not installed")

from agent.runtime.bodies.isobus_body import IsobusBody
from agent.runtime.bodies.nmea_body import NmeaBody
from agent.runtime.bodies.replay_body import ReplayBody
from agent.runtime.bodies.ros2_body import Ros2Body
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


VEHICLE: dict[str, Any] = {
    "broker": "mqtt://127.0.0.1", "manufacturer": "ACME", "serial": "7", "map": "hall",
}  # fmt: skip
NO_TEXTS = (None, True, "", ["a"], {"a": 1}, 1.5)


@pytest.mark.parametrize("value", [*NO_TEXTS, 7], ids=lambda value: type(value).__name__)
@pytest.mark.parametrize("name", [*VEHICLE, "interface", "version"])
def test_the_name_of_a_vehicle_is_a_text(name: str, value: Any) -> None:
    """`broker = 7` was "'int' object has no attribute 'rpartition'", and `map = 7` a vehicle that is on
    the map '7', not 7. A serial number may have no quotes."""
    vda5050_body = pytest.importorskip(
        "agent.runtime.bodies.vda5050_body", reason="the extra `vda5050` is not installed"
    )
    if name == "serial" and value == 7:
        made = vda5050_body.Vda5050Body(0, **{**VEHICLE, name: value})
        assert made.link.identity.serial == "7"
        return
    with pytest.raises(ValueError, match=rf"\Aoptions\.{name}: [^\n]{{1,100}}\Z"):
        vda5050_body.Vda5050Body(0, **{**VEHICLE, name: value})


@pytest.mark.parametrize("value", ["fast", [1], 7, 0.5])
def test_what_a_vehicle_wants_with_pick_and_drop_is_a_table(value: Any) -> None:
    vda5050_body = pytest.importorskip(
        "agent.runtime.bodies.vda5050_body", reason="the extra `vda5050` is not installed"
    )
    with pytest.raises(ValueError, match=r"\Aoptions\.parameters: [^\n]+ is not a table[^\n]+\Z"):
        vda5050_body.Vda5050Body(0, **VEHICLE, parameters=value)


@pytest.mark.parametrize("value", NO_TEXTS, ids=lambda value: type(value).__name__)
@pytest.mark.parametrize("name", ["channel", "interface"])
def test_the_bus_of_a_tractor_is_named_by_texts(name: str, value: Any) -> None:
    """They were passed on to python-can, and the line was that of one of its interfaces. Some of those
    count their channels: such a number may have no quotes."""
    with pytest.raises(ValueError, match=rf"\Aoptions\.{name}: [^\n]{{1,100}}\Z"):
        IsobusBody(0, **{"channel": "can0", name: value})
    assert IsobusBody(0, 1).channel == "1"  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "options",
    [
        {"rays": "many"}, {"rays": 0}, {"rays": 36.5}, {"rays": True}, {"rays": 10**30},
        {"domain": "7"}, {"domain": -1}, {"domain": 233}, {"odom": ""}, {"cmd_vel": 7}, {"scan": 7},
        {"namespace": None}, {"implement_state": ["a"]}, {"navigate": True},
    ],
)  # fmt: skip
def test_names_and_counts_of_a_ros_robot_are_told_by_their_option(options: dict[str, Any]) -> None:
    """`rays = "many"` was "'<=' not supported between instances of 'int' and 'str'"."""
    (name,) = options
    with pytest.raises(ValueError, match=rf"\Aoptions\.{name}: [^\n]+\Z"):
        Ros2Body(0, **options)
    assert Ros2Body(0, rays=12, domain=7, scan="scan").rays == 12


@pytest.mark.parametrize("value", [5, None, "", ["a.nmea"]])
def test_the_log_of_a_drive_is_the_name_of_a_file(value: Any) -> None:
    """`log = ""` said "Is a directory"."""
    with pytest.raises(
        ValueError, match=r"\Aoptions\.log: [^\n]+ is not the name of a file[^\n]+\Z"
    ):
        ReplayBody(0, value)
