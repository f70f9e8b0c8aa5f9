"""What a robot senses of a VDA 5050 vehicle, from its messages."""

from math import pi

import pytest

from agent.interface.config import MS
from agent.runtime.bodies.vda5050_body import Vda5050Body
from agent.runtime.vda5050.messages import (
    AgvPosition,
    BatteryState,
    EStop,
    SafetyState,
    VehicleState,
)


def body(monkeypatch: pytest.MonkeyPatch, now_us: list[int]) -> Vda5050Body:
    monkeypatch.setattr(
        "agent.runtime.bodies.vda5050_body.time.monotonic_ns", lambda: now_us[0] * 1000
    )
    made = Vda5050Body(0, "mqtt://127.0.0.1", "ACME", "7", "hall")
    made.link.connected = True
    return made


def state(x_m: float, theta: float = 0.0, e_stop: EStop = EStop.NONE) -> VehicleState:
    return VehicleState(
        driving=True, battery_state=BatteryState(battery_charge=50.0),
        agv_position=AgvPosition(x=x_m, y=2.0, theta=theta, map_id="hall", position_initialized=True),
        safety_state=SafetyState(e_stop=e_stop),
    )  # fmt: skip


def test_between_two_messages_the_way_since_is_added_and_an_old_place_is_old(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_us = [1_000 * MS]
    made = body(monkeypatch, now_us)
    assert made.sense(now_us[0]) is None
    made._heard(state(1.0))
    now_us[0] += 100 * MS
    made._heard(state(1.1))
    seen = made.sense(now_us[0] + 50 * MS)
    assert seen is not None and seen.battery == 0.5
    assert seen.x_m == pytest.approx(1.15) and seen.sensed_at_us == now_us[0] + 50 * MS
    held = made.sense(now_us[0] + 250 * MS)  # a vehicle that has turned since is not further ahead
    assert held is not None and held.x_m == pytest.approx(1.2)
    old = made.sense(now_us[0] + 400 * MS)
    assert old is not None and old.sensed_at_us == now_us[0]
    made.link.connected = False
    lost = made.sense(now_us[0] + 50 * MS)
    assert lost is not None and lost.sensed_at_us == now_us[0]


def test_a_vehicle_that_turns_at_once_is_no_place_that_jumped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Found with twenty vehicles on a busy machine: after a pause of 0.3 s the robot got a heading that
    was 34 degrees off, took its place for lost, and stood until an operator's start."""
    now_us = [1_000 * MS]
    made = body(monkeypatch, now_us)
    made._heard(state(1.0))
    first = made.sense(now_us[0])
    made._heard(state(1.0, theta=pi / 2))
    second = made.sense(now_us[0] + 300 * MS)
    assert first is not None and second is not None
    assert 0.0 < second.heading_rad - first.heading_rad < 0.21


def test_an_emergency_stop_of_the_vehicle_is_a_sick_body(monkeypatch: pytest.MonkeyPatch) -> None:
    now_us = [1_000 * MS]
    made = body(monkeypatch, now_us)
    made._heard(state(1.0, e_stop=EStop.MANUAL))
    seen = made.sense(now_us[0])
    assert seen is not None and seen.health == 0.0
