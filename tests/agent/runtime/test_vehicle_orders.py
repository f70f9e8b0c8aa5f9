"""A VDA 5050 vehicle that is driven by orders of one step: what is sent for which command and state."""

import json
from math import cos, sin
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.avoidance.stopping_constraint import REACTION_S
from agent.interface.config import ACTUATOR_TTL_US, MS, S
from agent.interface.effects import Drive
from agent.interface.vehicle import Vehicle
from agent.runtime.vda5050.messages import (
    ActionState,
    ActionStatus,
    AgvPosition,
    BatteryState,
    InstantActions,
    Load,
    MasterOrder,
    MessageHeader,
    NodeState,
    Topic,
    VehicleState,
)
from agent.runtime.vda5050.vehicle_orders import (
    ACCEPTED_US,
    CANCELLED_US,
    FAILED_US,
    STEP_S,
    OrderPhase,
    VehicleOrders,
)
from tools.bench.vda5050.official_schemas import flaws

pytest.importorskip("vda5050.validation", reason="pip install vda5050-sdk: it has the schemas")

STILL = Drive(0.0, 0.0)
EAST = Drive(0.5, 0.0)


def fresh(boot: str = "b") -> VehicleOrders:
    return VehicleOrders(boot, "hall", {"stationType": "floor"})


def state(
    order: MasterOrder, ahead: bool, *, load: bool | None = None, status: str = "FINISHED"
) -> VehicleState:
    node = order.nodes[-1]
    return VehicleState(
        order_id=order.order_id, order_update_id=order.order_update_id,
        node_states=[
            NodeState(node_id=node.node_id, sequence_id=node.sequence_id, released=True)
        ] * ahead,
        action_states=[
            ActionState(
                action_id=act.action_id, action_type=act.action_type,
                action_status=ActionStatus[status],
            )
            for each in order.nodes for act in each.actions
        ],
        loads=None if load is None else [Load()] * load,
        battery_state=BatteryState(battery_charge=50.0),
    )  # fmt: skip


def sent(message: MessageHeader | None) -> Any:
    assert message is not None
    header = {
        "header_id": 1, "timestamp": "2024-01-01T00:00:00.000Z", "manufacturer": "A",
        "serial_number": "1",
    }  # fmt: skip
    return json.loads(message.model_copy(update=header).to_json())


def ordered(message: MasterOrder | InstantActions | None) -> MasterOrder:
    assert isinstance(message, MasterOrder)
    assert flaws(Topic.ORDER, sent(message)) == []
    return message


def cancels(message: MasterOrder | InstantActions | None) -> bool:
    if not isinstance(message, InstantActions):
        return False
    plain = sent(message)
    assert flaws(Topic.INSTANT_ACTIONS, plain) == []
    assert plain["actions"] == plain["instantActions"]  # the name of 1.1, which some libraries read
    return [act.action_type for act in message.actions] == ["cancelOrder"]


def test_a_velocity_is_an_edge_and_the_next_one_is_added_before_its_end() -> None:
    orders = fresh()
    first = ordered(orders.want(EAST, (1.0, 1.0), 0))
    end = first.nodes[-1].node_position
    assert end is not None and end.x == pytest.approx(1.0 + STEP_S * 0.5)
    assert orders.want(EAST, (1.0, 1.0), 50 * MS) is None
    orders.on_state(state(first, ahead=True), 60 * MS)
    assert orders.want(EAST, (1.1, 1.0), 100 * MS) is None
    more = ordered(orders.want(EAST, (1.2, 1.0), 150 * MS))
    assert (more.order_id, more.order_update_id) == (first.order_id, 1)
    assert more.nodes[0].node_id == first.nodes[-1].node_id


@pytest.mark.parametrize(
    ("speed_m_s", "acceleration_m_s2", "length_m"),
    [
        (0.8, 1.0, 0.08 + 0.32),  # what others reckon with
        (0.4, 1.0, 0.15),  # within the tolerance of vehicles
        (1.5, 0.5, 0.9),  # 0.6 s of driving
        (1.0, 9.0, 0.375),  # the next edge needs as long to arrive
    ],
)
def test_a_vehicle_that_hears_nothing_more_stands_within_its_stopping_distance(
    speed_m_s: float, acceleration_m_s2: float, length_m: float
) -> None:
    orders = fresh()
    orders.vehicle = Vehicle(speed_m_s=1.5, acceleration_m_s2=acceleration_m_s2)
    end = ordered(orders.want(Drive(speed_m_s, 0.0), (1.0, 2.0), 0)).nodes[-1].node_position
    assert end is not None and end.x == pytest.approx(1.0 + length_m)


def test_a_body_and_the_robots_round_it_reckon_with_the_same_stopping_distance() -> None:
    assert ACTUATOR_TTL_US / S == REACTION_S


def test_standing_cancels_once_and_the_next_order_waits_for_the_end() -> None:
    orders = fresh()
    first = ordered(orders.want(EAST, (1.0, 1.0), 0))
    orders.on_state(state(first, ahead=True), 50 * MS)
    assert cancels(orders.want(STILL, (1.1, 1.0), S))
    assert orders.want(STILL, (1.1, 1.0), S + 50 * MS) is None
    assert orders.want(EAST, (1.1, 1.0), S + 100 * MS) is None
    assert cancels(orders.want(STILL, (1.1, 1.0), S + CANCELLED_US))  # it may have been lost
    orders.on_state(state(first, ahead=False), 2 * S)
    assert orders.phase is OrderPhase.FREE
    assert ordered(orders.want(EAST, (1.1, 1.0), 2 * S)).order_id != first.order_id


def test_turning_away_cancels_and_a_slight_turn_does_not() -> None:
    orders = fresh()
    orders.on_state(state(ordered(orders.want(EAST, (1.0, 1.0), 0)), ahead=True), 0)
    slight = Drive(0.5 * cos(0.3), 0.5 * sin(0.3))
    assert orders.want(slight, (1.0, 1.0), 50 * MS) is None
    assert cancels(orders.want(Drive(0.0, 0.5), (1.0, 1.0), S))


def test_an_order_that_no_state_shows_is_sent_again_as_another() -> None:
    orders = fresh()
    first = ordered(orders.want(EAST, (1.0, 1.0), 0))
    again = ordered(orders.want(EAST, (1.0, 1.0), ACCEPTED_US))
    assert again.order_id != first.order_id


def test_standing_after_an_order_that_never_arrived_ends() -> None:
    """A vehicle stood for 30 minutes: it was told twice a second to cancel what it had never had."""
    orders = fresh()
    last = ordered(orders.want(EAST, (1.0, 1.0), 0))
    orders.on_state(state(last, ahead=False), 500 * MS)
    ordered(orders.want(EAST, (1.2, 1.0), S))  # the broker ends, and it is lost
    assert cancels(orders.want(STILL, (1.2, 1.0), S + 50 * MS))
    orders.on_state(state(last, ahead=False), S + 500 * MS)
    assert cancels(orders.want(STILL, (1.2, 1.0), S + 50 * MS + CANCELLED_US))
    assert orders.want(STILL, (1.2, 1.0), S + ACCEPTED_US) is None
    assert ordered(orders.want(EAST, (1.2, 1.0), S + ACCEPTED_US))


def test_an_update_that_never_arrived_is_given_up_and_another_order_follows() -> None:
    """The vehicle stood at the end of its step, and nothing more was sent."""
    orders = fresh()
    first = ordered(orders.want(EAST, (1.0, 1.0), 0))
    orders.on_state(state(first, ahead=True), 100 * MS)
    update = ordered(orders.want(EAST, (1.2, 1.0), 400 * MS))
    assert update.order_id == first.order_id
    orders.on_state(state(first, ahead=False), 700 * MS)
    assert orders.want(EAST, (1.3, 1.0), 800 * MS) is None  # it may be on its way
    assert ordered(orders.want(EAST, (1.3, 1.0), 400 * MS + ACCEPTED_US)).order_id != first.order_id


def test_a_vehicle_that_has_started_again_gets_another_order() -> None:
    orders = fresh()
    first = ordered(orders.want(EAST, (1.0, 1.0), 0))
    orders.on_state(state(first, ahead=True), 100 * MS)
    blank = VehicleState(battery_state=BatteryState(battery_charge=50.0))
    orders.on_state(blank, 200 * MS)
    assert ordered(orders.want(EAST, (1.0, 1.0), 250 * MS)).order_id != first.order_id


def test_an_order_that_arrives_after_it_was_given_up_is_cancelled() -> None:
    orders = fresh()
    late = ordered(orders.want(EAST, (1.0, 1.0), 0))
    assert cancels(orders.want(STILL, (1.0, 1.0), ACCEPTED_US // 2))
    assert orders.want(STILL, (1.0, 1.0), ACCEPTED_US) is None
    orders.on_state(state(late, ahead=True), 2 * S)
    assert cancels(orders.want(STILL, (1.0, 1.0), 2 * S))
    orders.on_state(state(late, ahead=False), 3 * S)
    assert orders.want(STILL, (1.0, 1.0), 3 * S) is None


def test_a_pick_whose_states_were_lost_is_not_done_twice() -> None:
    """The vehicle handles the parcel while the broker is away: only its next state says so. An order
    that is sent again is the same, which the vehicle drops."""
    orders = fresh()
    act = STILL._replace(parcel_action=7)
    pick = ordered(orders.want(act, (1.0, 1.0), 0))
    assert orders.want(act, (1.0, 1.0), 5 * ACCEPTED_US) == pick
    orders.on_state(state(pick, ahead=False, load=True), 6 * ACCEPTED_US)
    assert orders.load == 7


def test_a_pick_that_no_later_state_shows_is_sent_again_as_the_same_order() -> None:
    """As another order it was picked twice, if the first one was late: a broker that stalls for a second
    delivers both."""
    orders = fresh()
    act = STILL._replace(parcel_action=7)
    lost = ordered(orders.want(act, (1.0, 1.0), 0))
    blank = VehicleState(battery_state=BatteryState(battery_charge=50.0))
    orders.on_state(blank, ACCEPTED_US // 2)  # said before it could arrive
    assert orders.want(act, (1.0, 1.0), ACCEPTED_US // 2) is None
    orders.on_state(blank, ACCEPTED_US)
    assert orders.want(act, (1.0, 1.0), ACCEPTED_US) == lost
    assert orders.want(act, (1.0, 1.0), ACCEPTED_US + 50 * MS) is None
    moved = ordered(orders.want(act, (1.5, 1.0), 2 * ACCEPTED_US))  # it may have been out of reach
    assert moved.order_id != lost.order_id


def test_a_cancellation_of_a_pick_that_never_arrived_ends() -> None:
    orders = fresh()
    ordered(orders.want(STILL._replace(parcel_action=7), (1.0, 1.0), 0))
    blank = VehicleState(battery_state=BatteryState(battery_charge=50.0))
    assert cancels(orders.want(EAST, (1.0, 1.0), ACCEPTED_US // 2))
    assert cancels(orders.want(EAST, (1.0, 1.0), ACCEPTED_US))
    orders.on_state(blank, ACCEPTED_US)
    assert ordered(orders.want(EAST, (1.0, 1.0), ACCEPTED_US))


def test_a_vehicle_that_forgot_its_pick_and_has_a_load_has_picked() -> None:
    """It was done unheard, and the vehicle started again: the robot would have picked once more."""
    orders = fresh()
    empty = VehicleState(battery_state=BatteryState(battery_charge=50.0), loads=[])
    orders.on_state(empty, 0)
    ordered(orders.want(STILL._replace(parcel_action=7), (1.0, 1.0), 0))
    orders.on_state(empty.model_copy(update={"loads": [Load()]}), ACCEPTED_US)
    assert orders.load == 7 and orders.phase is OrderPhase.FREE


def test_a_program_that_died_while_the_vehicle_put_a_parcel_down_knows_where_it_lies() -> None:
    """No robot found it: vehicles see no parcels, and the program that knew the place was gone."""
    orders = fresh()
    act = STILL._replace(parcel_action=7)
    orders.on_state(state(ordered(orders.want(act, (1.0, 1.0), 0)), ahead=False, load=True), 0)
    drop = ordered(orders.want(act, (4.0, 1.0), S))
    at = AgvPosition(x=4.0, y=1.0, theta=0.0, map_id="hall", position_initialized=True)
    done = state(drop, ahead=False, load=False).model_copy(update={"agv_position": at})
    later = fresh("later")
    later.on_state(done, 2 * S)
    assert later.dropped == {7: (4.0, 1.0)} and later.load == -1
    runs = state(drop, ahead=False, load=True, status="RUNNING")
    during = fresh("during")
    during.on_state(runs.model_copy(update={"agv_position": at}), 2 * S)
    assert during.load == 7, "it is aboard until the vehicle has put it down"
    assert during.want(act, (4.0, 1.0), 2 * S) is None
    during.on_state(done, 3 * S)
    assert during.dropped == {7: (4.0, 1.0)} and during.load == -1


def test_a_parcel_is_picked_and_dropped_and_a_failure_changes_nothing() -> None:
    orders = fresh()
    act = STILL._replace(parcel_action=7)
    pick = ordered(orders.want(act, (1.0, 1.0), 0))
    assert [each.action_type for each in pick.nodes[0].actions] == ["pick"]
    orders.on_state(state(pick, ahead=False, status="FAILED"), S)
    assert orders.load == -1
    assert orders.want(act, (1.0, 1.0), S) is None  # a vehicle that cannot is not asked at once
    again_us = S + FAILED_US
    pick = ordered(orders.want(act, (1.0, 1.0), again_us))
    orders.on_state(state(pick, ahead=False, status="RUNNING"), again_us)
    assert orders.load == -1 and orders.want(act, (1.0, 1.0), again_us + 1) is None
    orders.on_state(state(pick, ahead=False, load=True), 4 * S)
    assert orders.load == 7
    drop = ordered(orders.want(act, (4.0, 1.0), 9 * S))
    assert [each.action_type for each in drop.nodes[0].actions] == ["drop"]
    orders.on_state(state(drop, ahead=False, load=False), 9 * S)
    assert orders.load == -1 and orders.dropped == {7: (4.0, 1.0)}


def untyped(state: VehicleState) -> VehicleState:
    acts = [each.model_copy(update={"action_type": None}) for each in state.action_states]
    return state.model_copy(update={"action_states": acts})


def test_a_vehicle_that_does_not_say_types_of_actions_is_understood() -> None:
    """Found: the type is optional in a state. Without it no pick ever ended, and the next was sent."""
    orders = fresh()
    act = STILL._replace(parcel_action=7)
    pick = ordered(orders.want(act, (1.0, 1.0), 0))
    orders.on_state(untyped(state(pick, ahead=False, status="RUNNING")), S)
    assert orders.load == -1 and orders.want(act, (1.0, 1.0), S) is None
    orders.on_state(untyped(state(pick, ahead=False)), 2 * S)
    assert orders.load == 7
    drop = ordered(orders.want(act, (4.0, 1.0), 3 * S))
    at = AgvPosition(x=4.0, y=1.0, theta=0.0, map_id="hall", position_initialized=True)
    runs = untyped(state(drop, ahead=False, status="RUNNING"))
    during = fresh("during")
    during.on_state(runs.model_copy(update={"agv_position": at}), 4 * S)
    assert during.load == 7 and during.want(act, (4.0, 1.0), 4 * S) is None
    for own in (orders, during):
        own.on_state(untyped(state(drop, ahead=False)), 5 * S)
        assert own.load == -1 and own.dropped == {7: (4.0, 1.0)}


@pytest.mark.parametrize(
    "name", ["", "headland", "headland/", "headland/7", "headland//7", "other/pick/7"]
)
def test_an_action_without_type_whose_id_is_no_pick_of_ours_is_none(name: str) -> None:
    orders = fresh()
    pick = ordered(orders.want(STILL._replace(parcel_action=7), (1.0, 1.0), 0))
    strange = ActionState(action_id=name, action_status=ActionStatus.RUNNING)
    orders.on_state(state(pick, ahead=False).model_copy(update={"action_states": [strange]}), S)
    assert orders.phase is OrderPhase.FREE and orders.load == -1


def test_a_program_that_forgot_learns_from_the_vehicle_what_is_aboard() -> None:
    orders = fresh()
    act = STILL._replace(parcel_action=7)
    pick = ordered(orders.want(act, (1.0, 1.0), 0))
    orders.on_state(state(pick, ahead=False, load=True), 0)
    later = fresh("later")
    later.on_state(state(pick, ahead=False, load=True), 0)
    assert later.load == 7
    way = ordered(orders.want(EAST, (1.0, 1.0), S))
    last = fresh("last")
    last.on_state(state(way, ahead=True, load=True), 0)
    assert last.load == 7
    empty = fresh("empty")
    empty.on_state(state(pick, ahead=False, load=False), 0)
    assert empty.load == -1


@given(st.lists(st.tuples(
    st.sampled_from([STILL, EAST, Drive(0.0, -0.7), STILL._replace(parcel_action=3)]),
    st.sampled_from(["nothing", "ahead", "over"]), st.integers(50 * MS, 2 * S),
), max_size=40))  # fmt: skip
def test_whatever_comes_every_message_is_valid_and_ids_are_used_once(
    story: list[tuple[Drive, str, int]],
) -> None:
    orders, newest, now_us = fresh(), None, 0
    seen: set[tuple[str, int]] = set()
    for command, said, for_us in story:
        now_us += for_us
        message = orders.want(command, (2.0, 2.0), now_us)
        if isinstance(message, MasterOrder):
            newest = ordered(message)
            key = newest.order_id, newest.order_update_id
            assert key not in seen or newest.nodes[0].actions, "a pick or drop may be repeated"
            seen.add(key)
        elif message is not None:
            assert cancels(message)
        if newest is not None and said != "nothing":
            orders.on_state(state(newest, ahead=said == "ahead"), now_us)
