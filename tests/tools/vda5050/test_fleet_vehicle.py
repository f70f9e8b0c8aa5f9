"""One vehicle as a master sees it: what each message says, judged by the official schemas."""

import json
import signal
from errno import ENOSPC
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.delivery.cost_matrix import Carrier
from agent.delivery.task_outcome import TaskOutcome, TaskPhase
from agent.delivery.warehouse import Warehouse
from agent.interface.vehicle import Vehicle
from agent.mapping.building import Floor
from agent.runtime.vda5050.messages import (
    Action,
    ActionStatus,
    BlockingType,
    Connection,
    ConnectionState,
    EStop,
    InstantActions,
    MasterOrder,
    MessageHeader,
    Topic,
)
from tools.bench.vda5050.official_schemas import flaws
from tools.vda5050 import order_book
from tools.vda5050.factsheet import factsheet_of
from tools.vda5050.fleet_vehicle import UNHEARD, FleetVehicle, HeardRobot
from tools.vda5050.order_book import BookedOrder, BookError, OrderBook
from tools.vda5050.transport_rules import OrderRefused, transport_of

pytest.importorskip("vda5050.validation", reason="pip install vda5050-sdk: it has the schemas")

HOUSE = Warehouse(Floor.drawn("......\n......\n......\n", 1.0, 0.4), Carrier(1.0, 0.0))
HEADER = {
    "headerId": 1, "timestamp": "2024-01-01T00:00:00.000Z", "version": "2.0.0",
    "manufacturer": "ACME", "serialNumber": "robot0",
}  # fmt: skip


def node(name: str, number: int, place: tuple[float, float] | None, *acts: str, **more: Any) -> Any:
    found: dict[str, Any] = {
        "nodeId": name, "sequenceId": number, "released": True,
        "actions": [
            {"actionId": f"{name}-{act}", "actionType": act, "blockingType": "HARD"} for act in acts
        ],
    }  # fmt: skip
    if place is not None:
        found["nodePosition"] = {"x": place[0], "y": place[1], "mapId": "yard"}
    return {**found, **more}


def edge(number: int, start: str, end: str, **more: Any) -> Any:
    return {
        "edgeId": f"e{number}", "sequenceId": number, "released": True, "startNodeId": start,
        "endNodeId": end, "actions": [], **more,
    }  # fmt: skip


def order(*nodes: Any, name: str = "o1", update: int = 0, released: bool = True) -> MasterOrder:
    edges = [
        edge(a["sequenceId"] + 1, a["nodeId"], b["nodeId"], released=b["released"])
        for a, b in pairwise(nodes)
    ]
    plain = {
        **HEADER, "orderId": name, "orderUpdateId": update, "nodes": list(nodes), "edges": edges,
    }  # fmt: skip
    assert not flaws(Topic.ORDER, plain)
    return MasterOrder.model_validate_json(json.dumps(plain))


FETCH = node("a", 0, (0.5, 0.5), "pick")
WAY = node("w", 2, None)
BRING = node("b", 4, (4.5, 2.5), "drop")


def vehicle_with(whole: MasterOrder, number: int | None = 7) -> FleetVehicle:
    vehicle = FleetVehicle(0, None, None)
    transport = transport_of(whole, HOUSE, "yard")
    task = None if transport is None else transport.task
    vehicle.accept(BookedOrder(0, whole, number, task), transport)
    return vehicle


def sent(message: MessageHeader) -> Any:
    return json.loads(message.model_copy(update={"timestamp": HEADER["timestamp"]}).to_json())


@given(
    st.sampled_from([None, *TaskPhase]),
    st.builds(
        HeardRobot, st.booleans(), st.booleans(), st.floats(-3000, 3000), st.floats(-3000, 3000),
        st.floats(0, 6.2831), st.floats(0, 12), st.none() | st.floats(0, 1), st.booleans(),
        st.booleans(), st.lists(st.text()), st.lists(st.integers(0, 100)),
    )
    | st.just(UNHEARD),
)  # fmt: skip
def test_every_state_is_valid_by_the_official_schemas(
    phase: TaskPhase | None, robot: HeardRobot
) -> None:
    vehicle = vehicle_with(order(FETCH, WAY, BRING))
    vehicle.robot, vehicle.outcome = robot, None if phase is None else TaskOutcome(phase, 3)
    vehicle.report(
        Action(action_type="x", action_id="1", blocking_type=BlockingType.HARD),
        ActionStatus.FAILED, "why",
    )  # fmt: skip
    assert flaws(Topic.STATE, sent(vehicle.state("yard", str))) == []
    assert flaws(Topic.VISUALIZATION, sent(vehicle.visualization("yard"))) == []


def test_the_other_messages_are_valid_by_the_official_schemas() -> None:
    assert flaws(Topic.FACTSHEET, sent(factsheet_of(Vehicle()))) == []
    for state in ConnectionState:
        assert flaws(Topic.CONNECTION, sent(Connection(connection_state=state))) == []
    act = Action(action_type="startPause", action_id="1", blocking_type=BlockingType.HARD)
    assert flaws(Topic.INSTANT_ACTIONS, sent(InstantActions(actions=[act]))) == []
    assert flaws(Topic.ORDER, sent(order(FETCH, WAY, BRING))) == []
    assert flaws(Topic.STATE, {}) != []  # the judge can say no


def test_a_theta_of_minus_pi_is_within_the_limit_of_the_standard() -> None:
    """vda-5050-lib dropped such a state: -3.1416 is less than -pi."""
    vehicle = FleetVehicle(0, None, None)
    vehicle.robot = UNHEARD._replace(course_rad=3.1415927)
    position = vehicle.state("yard", str).agv_position
    assert position is not None and abs(position.theta) < 3.14159265359


def test_the_state_follows_the_outcome_of_the_task() -> None:
    vehicle = vehicle_with(order(FETCH, WAY, BRING))
    seen = {}
    for phase in TaskPhase:
        vehicle.outcome = TaskOutcome(phase, 3)
        state = vehicle.state("yard", lambda slot: f"robot{slot}")
        nodes = [each.node_id for each in state.node_states]
        acts = [each.action_status.name for each in state.action_states]
        seen[phase.name] = (nodes, state.last_node_id, acts)
    assert seen == {
        "OPEN": (["a", "w", "b"], "", ["WAITING", "WAITING"]),
        "FETCHING": (["a", "w", "b"], "", ["WAITING", "WAITING"]),
        "ABOARD": (["w", "b"], "a", ["FINISHED", "WAITING"]),
        "DELIVERED": ([], "b", ["FINISHED", "FINISHED"]),
        "WITHDRAWN": ([], "", ["FAILED", "FAILED"]),
    }
    (said,) = state.information or []
    told = {each.reference_key: each.reference_value for each in said.info_references or []}
    assert told == {"task": "7", "outcome": "withdrawn", "carrier": "robot3"}


def test_a_latched_robot_says_an_emergency_stop_that_is_released_from_elsewhere() -> None:
    vehicle = FleetVehicle(0, None, None)
    vehicle.robot = UNHEARD._replace(heard=True, latched=True, started=False)
    state = vehicle.state("yard", str)
    assert state.safety_state.e_stop is EStop.REMOTE and state.paused


def test_an_order_is_taken_once_and_the_next_only_when_it_is_done() -> None:
    first = order(FETCH, BRING | {"sequenceId": 2})
    vehicle = vehicle_with(first)
    assert vehicle.takes(first) is None
    with pytest.raises(OrderRefused, match="not done"):
        vehicle.takes(order(FETCH, BRING | {"sequenceId": 2}, name="o2"))
    vehicle.outcome = TaskOutcome(TaskPhase.DELIVERED, 1)
    second = order(FETCH, BRING | {"sequenceId": 2}, name="o2")
    assert vehicle.takes(second) == second
    vehicle.accept(BookedOrder(0, second, 8, None), transport_of(second, HOUSE, "yard"))
    assert vehicle.state("yard", str).last_node_id == "b"  # of the order before


def test_a_horizon_is_waited_for_and_stitched() -> None:
    hidden = order(FETCH, WAY, BRING | {"released": False})
    vehicle = vehicle_with(hidden, None)
    assert vehicle.state("yard", str).new_base_request
    whole = vehicle.takes(order(WAY, BRING, update=1))
    assert whole is not None and transport_of(whole, HOUSE, "yard") is not None
    assert [each.node_id for each in whole.nodes] == ["a", "w", "b"]
    with pytest.raises(OrderRefused, match="base ends"):
        vehicle.takes(order(FETCH, BRING | {"sequenceId": 2}, update=1))


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (order(FETCH), "one pick, then one drop"),
        (order(BRING | {"sequenceId": 0}, FETCH | {"sequenceId": 2}), "one pick, then one drop"),
        (order(FETCH, node("b", 2, (99.0, 0.5), "drop")), "no robot can stand"),
        (order(FETCH, node("b", 2, None, "drop")), "no position"),
        (order(FETCH, node("b", 2, (1.5, 1.5), "wave")), "not supported"),
        (order(FETCH, BRING | {"sequenceId": 3}), "consecutive"),
        (order(FETCH, BRING | {"nodeId": "a", "actions": FETCH["actions"], "sequenceId": 2}), "actionId"),
    ],
)  # fmt: skip
def test_what_is_no_transport_is_refused(wrong: MasterOrder, why: str) -> None:
    with pytest.raises(OrderRefused, match=why) as refused:
        transport_of(wrong, HOUSE, "yard")
    vehicle = FleetVehicle(0, None, None)
    vehicle.refuse(refused.value.error(wrong))
    assert flaws(Topic.STATE, sent(vehicle.state("yard", str))) == []


@given(st.recursive(
    st.none() | st.booleans() | st.floats(allow_nan=True) | st.text(max_size=9) | st.integers(),
    lambda inner: st.lists(inner, max_size=4)
    | st.dictionaries(st.sampled_from([*HEADER, "nodes", "edges", "orderId", "orderUpdateId"]), inner),
    max_leaves=12,
))  # fmt: skip
def test_any_json_is_an_order_or_a_value_error(anything: Any) -> None:
    try:
        found = MasterOrder.model_validate_json(json.dumps(anything))
    except ValueError:
        return
    try:
        transport_of(found, HOUSE, "yard")
    except OrderRefused as refused:
        assert str(refused)


def test_a_book_has_one_gateway(tmp_path: Path) -> None:
    """Two took each order of the master, and one cut off what the other had written."""
    path = tmp_path / "book.jsonl"
    book = OrderBook(path)
    with pytest.raises(BookError, match="another headland vda5050 keeps it"):
        OrderBook(path)
    book.close()
    OrderBook(path).close()


def test_a_book_is_read_again_and_a_torn_last_line_is_forgotten(tmp_path: Path) -> None:
    path = tmp_path / "book.jsonl"
    book, whole = OrderBook(path), order(FETCH, BRING | {"sequenceId": 2})
    transport = transport_of(whole, HOUSE, "yard")
    assert transport is not None
    booked = BookedOrder(2, whole, 5, transport.task)
    book.write(booked)
    book.close()
    with path.open("ab") as file:
        file.write(b'{"slot": 3, "ord')
    book = OrderBook(path)
    assert book.orders == {2: booked} and book.tasks == {5: transport.task}
    book.write(booked._replace(number=6))
    book.close()
    again = OrderBook(path)
    again.close()
    assert again.orders[2].number == 6
    path.write_bytes(b"{}\n")
    with pytest.raises(BookError):
        OrderBook(path)


def test_a_record_that_a_full_disk_cut_short_is_refused_and_the_book_stays_readable(
    tmp_path: Path,
) -> None:
    """A write without a buffer tells by its result alone that a part fitted. The record was acknowledged,
    and the next one came onto its line."""
    resource = pytest.importorskip("resource", reason="Windows has no limit of a file's size")
    path = tmp_path / "book.jsonl"
    booked = BookedOrder(2, order(FETCH, BRING | {"sequenceId": 2}), None, None)
    book = OrderBook(path)
    book.write(booked)
    size = path.stat().st_size
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + size // 2, limits[1]))
    try:
        with pytest.raises(OSError) as told:
            book.write(booked._replace(slot=3))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    assert told.value.errno == ENOSPC and path.stat().st_size == size
    book.write(booked._replace(slot=4))
    book.close()
    again = OrderBook(path)
    again.close()
    assert again.orders.keys() == book.orders.keys() == {2, 4}


@pytest.mark.parametrize("number", ["1e999", "[" * 100_000])
def test_a_book_with_a_number_that_is_none_is_one_line(tmp_path: Path, number: str) -> None:
    """It ended the gateway with a traceback."""
    path = tmp_path / "book.jsonl"
    plain = order(FETCH).model_dump_json(by_alias=True, exclude_none=True)
    said = f'"order": {plain}, "task": null, "slot": 0, "cancelled": false, "number": {number}'
    path.write_text(f"{{{said}}}\n")
    with pytest.raises(BookError, match="a line is no record of an order"):
        OrderBook(path)


def test_a_line_that_is_longer_than_any_record_is_not_read_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(order_book, "LINE_BYTES_MAX", 1_000)
    path = tmp_path / "book.jsonl"
    path.write_bytes(b"x" * 2_000)
    with pytest.raises(BookError, match="too long"):
        OrderBook(path)
