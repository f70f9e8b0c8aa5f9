"""The simulated machine: its places are where it is, its commands expire, its faults show."""

import json
from math import hypot, pi

import pytest

from sim.machines.nmea_machine import Dimensions, NmeaMachine, WheeledBody

pytest.importorskip("pynmeagps", reason="the extra nmea is not installed")

from agent.runtime.bodies.nmea_body import in_field
from agent.runtime.bodies.nmea_fixes import NmeaFixes

ORIGIN = (52.0, 5.0)


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def machine(drive: str = "differential", x_m: float = 40.0) -> tuple[NmeaMachine, Clock]:
    clock = Clock()
    body = WheeledBody(Dimensions(drive, noise_m=0.0), x_m, -30.0, 0.5)
    return NmeaMachine(body, ORIGIN, clock=clock), clock


def seen_of(made: NmeaMachine) -> tuple[float, float, float, float]:
    fixes = NmeaFixes(in_field(ORIGIN), (0.0, 0.0), lambda utc_us, at_us: utc_us)
    seen = [fixes.take(line, 0) for line in made.fix().splitlines()][-1]
    assert seen is not None
    return seen.x_m, seen.y_m, seen.heading_rad, seen.position_accuracy_m


@pytest.mark.parametrize("x_m", [40.0, -900.0, 0.001])
def test_its_sentences_tell_where_it_is(x_m: float) -> None:
    made, _ = machine(x_m=x_m)
    assert seen_of(made) == pytest.approx((x_m, -30.0, 0.5, 0.012), abs=1e-3)


def test_a_command_lives_for_its_life_and_no_longer_than_the_controller_lets_it() -> None:
    for life_for_s, ends_s in ((0.05, 0.05), (30.0, 0.1)):
        made, clock = machine()
        body = made.body
        body.tell([9.0, 9.0], 0.0, True, clock() + min(life_for_s, body.dimensions.life_max_for_s))
        clock.now_s += ends_s - 0.01
        assert made.truth().implement and made.truth().ahead_m_s > 0
        clock.now_s += 0.02 + 1.0
        assert made.truth()[3:7] == (0.0, 0.0, 0.0, False)


@pytest.mark.parametrize(
    ("drive", "wheels", "steer_rad", "turned_rad"),
    [
        ("differential", [-5.0, 5.0], 0.0, 1.0),
        ("mecanum", [-5.0, 5.0, -5.0, 5.0], 0.0, 0.5 / 1.1),
        ("ackermann", [5.0], 0.3, None),
    ],
)
def test_it_turns_left_for_wheels_that_turn_it_left(
    drive: str, wheels: list[float], steer_rad: float, turned_rad: float | None
) -> None:
    made, _ = machine(drive)
    body = made.body
    for step in range(1000):
        body.tell(wheels, steer_rad, False, 1e9)
        body.step(step * 0.005, 0.005)
    assert body.velocity[2] > 0.1
    if turned_rad is not None:
        assert body.velocity[2] == pytest.approx(turned_rad), "of a track of 1 m, and arms of 1.1 m"
    assert abs(body.heading_rad) <= pi


def test_its_faults_show_in_its_sentences() -> None:
    made, clock = machine()
    assert made.order(["jumped", "2", "-1", "3"]) == b"ok"
    assert seen_of(made)[:2] == pytest.approx((42.0, -31.0), abs=1e-3)
    clock.now_s += 3.0
    assert seen_of(made)[:2] == pytest.approx((40.0, -30.0), abs=1e-3)
    assert made.order(["inaccurate", "1"]) == b"ok" and seen_of(made)[3] == 0.4
    made.order(["frozen", "1"])
    before = seen_of(made)
    made.body.x_m += 1.0
    assert seen_of(made) == before
    clock.now_s += 1.0
    assert hypot(seen_of(made)[0] - before[0]) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    "line", ["", "fly 3", "muted", "muted x", "jumped 1 2", "muted nan", "muted -3"]
)
def test_an_order_that_it_does_not_know_is_answered(line: str) -> None:
    made, _ = machine()
    assert b"not understood" in made.order(line.split())
    assert set(json.loads(made.order(["where"]))) >= {"x_m", "y_m", "heading_rad", "implement"}
