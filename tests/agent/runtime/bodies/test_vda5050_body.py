"""What a robot senses of a VDA 5050 vehicle, from its messages."""

from math import pi

import pytest

from agent.interface.config import MS
from agent.interface.effects import HALT, Drive, GatedDrive
from agent.interface.vehicle import Vehicle
from agent.runtime.bodies.vda5050_body import LATE_US, RENEWED_US, Vda5050Body
from agent.runtime.robot_body import DeclaredMachine
from agent.runtime.vda5050.messages import (
    AgvPosition,
    BatteryState,
    EStop,
    MasterOrder,
    NodeState,
    OperatingMode,
    SafetyState,
    VehicleState,
    Visualization,
    timestamp,
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


@pytest.mark.parametrize("mode", list(OperatingMode))
def test_a_vehicle_that_a_person_drives_gets_no_orders(
    monkeypatch: pytest.MonkeyPatch, mode: OperatingMode
) -> None:
    now_us = [1_000 * MS]
    made = body(monkeypatch, now_us)
    sent: list[object] = []
    monkeypatch.setattr(made.link, "publish", sent.append)
    made._heard(state(1.0).model_copy(update={"operating_mode": mode}))
    made.drive(GatedDrive(Drive(0.5, 0.0)), now_us[0])
    ours = mode in (OperatingMode.AUTOMATIC, OperatingMode.SEMIAUTOMATIC)
    seen = made.sense(now_us[0])
    assert seen is not None and (seen.health == 1.0) is ours and bool(sent) is ours


def test_a_place_follows_while_the_vehicle_drives_by_our_order_and_says_new_places(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_us = [1_000 * MS]
    made = body(monkeypatch, now_us)
    sent: list[MasterOrder] = []
    monkeypatch.setattr(made.link, "publish", sent.append)

    def under_way(after_us: int = 0) -> bool:
        seen = made.sense(now_us[0] + after_us)
        assert seen is not None
        return seen.under_way

    made._heard(state(1.0))
    assert not under_way(), "it drives, and by no order of ours"
    made.drive(GatedDrive(Drive(0.5, 0.0)), now_us[0])
    assert not under_way(), "no state shows the order yet"
    node = sent[0].nodes[-1]
    shown = state(1.0).model_copy(
        update={
            "order_id": sent[0].order_id,
            "node_states": [
                NodeState(node_id=node.node_id, sequence_id=node.sequence_id, released=True)
            ],
        }
    )
    made._heard(shown.model_copy(update={"driving": False}))
    assert not under_way(), "it has not begun"
    made._heard(shown)
    assert under_way() and under_way(RENEWED_US) and not under_way(RENEWED_US + 1)
    made.drive(HALT, now_us[0])
    assert not under_way(), "it was told to end it"


def said(at_us: int, x_m: float, map_id: str = "hall") -> Visualization:
    at = AgvPosition(x=x_m, y=2.0, theta=0.0, map_id=map_id, position_initialized=True)
    return Visualization(timestamp=timestamp(at_us / 1e6), agv_position=at)


def test_places_that_arrive_together_do_not_make_a_vehicle_fast(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """After a stall two places came 30 ms apart: 6 m/s, and a place that was half a metre ahead."""
    now_us = [1_000 * MS]
    made = body(monkeypatch, now_us)
    made._heard(state(1.0).model_copy(update={"timestamp": timestamp(5.0)}))
    now_us[0] += 30 * MS
    made._heard(said(5_200 * MS, 1.16))
    seen = made.sense(now_us[0])
    assert seen is not None and seen.vx_m_s == pytest.approx(0.8)


def test_a_place_just_before_a_step_and_one_just_after_it_do_not_make_a_vehicle_fast(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Found with four vehicles: 1.6 m/s for one that drove 0.8. Its robot wanted to brake from there,
    ordered a step of 0.9 m at 1.5 m/s, and came too near to another."""
    now_us = [1_000 * MS]
    made = body(monkeypatch, now_us)
    made.declare(DeclaredMachine(Vehicle(0.35, 0.8, 1.0), None))
    speeds = []
    for at_us, x_m in ((0, 2.2591), (68, 2.2918), (100, 2.3426), (184, 2.3862), (207, 2.4043)):
        now_us[0] = (1_000 + at_us) * MS
        made._heard(state(x_m).model_copy(update={"timestamp": timestamp(now_us[0] / 1e6)}))
        seen = made.sense(now_us[0])
        assert seen is not None
        speeds.append(seen.vx_m_s)
    assert max(speeds) == pytest.approx(0.8) and speeds[-1] > 0.4


def test_a_late_place_is_none_and_a_clock_that_jumps_back_is_believed_soon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_us = [1_000 * MS]
    made = body(monkeypatch, now_us)
    made._heard(state(1.0))
    made._heard(said(5_000 * MS, 1.2))
    made._heard(said(4_900 * MS, 1.1))
    late = made.sense(now_us[0])
    assert late is not None and late.x_m == pytest.approx(1.2)
    now_us[0] += LATE_US
    made._heard(said(500 * MS, 1.1))
    jumped = made.sense(now_us[0])
    assert jumped is not None and jumped.x_m == pytest.approx(1.1)
    assert jumped.sensed_at_us == now_us[0]


def test_a_vehicle_on_another_map_has_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lift took it to another floor: its robot went on with coordinates of that one."""
    now_us = [1_000 * MS]
    made = body(monkeypatch, now_us)
    made._heard(state(1.0))
    made._heard(said(5_000 * MS, 1.0, map_id="floor 2"))
    assert made.sense(now_us[0]) is None and "floor 2" in made._placeless()
    made._heard(said(5_100 * MS, 1.0))
    assert made.sense(now_us[0]) is not None
