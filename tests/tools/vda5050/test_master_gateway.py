"""The gateway of a fleet to a master, on a bus without robots."""

import asyncio
import json
from pathlib import Path

import can
import pytest

pytest.importorskip("aiomqtt", reason="the extra `vda5050` is not installed")
pytest.importorskip("vda5050.validation", reason="pip install vda5050-sdk: it has the schemas")

from agent.delivery.cost_matrix import Carrier
from agent.delivery.task_outcome import TaskOutcome, TaskPhase
from agent.delivery.task_registry import TransportTask
from agent.delivery.warehouse import Warehouse
from agent.interface.vehicle import Vehicle
from agent.mapping.building import Floor
from agent.runtime.vda5050.broker_link import Broker, BrokerLink
from agent.runtime.vda5050.messages import (
    NODES_MAX,
    Action,
    ActionStatus,
    BlockingType,
    InstantActions,
)
from crdt import Phase
from protocol.authentication import Keys
from protocol.frames.codec import encode
from protocol.frames.delivery_frames import BUCKET_TASKS, TASK_NUMBERS, TaskBookDigest
from protocol.frames.fleet_frames import Member, Pose
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.safety_frames import Command, EmergencyStop
from protocol.frames.work_frames import TaskClaim, WorkProgress
from protocol.links.bus import CanBus
from protocol.name import fleet_name
from sim.fleet.transport_orders import TransportClient
from tests.tools.vda5050.test_fleet_vehicle import BRING, FETCH, HOUSE, node, order
from tools.common.event_lines import EventLines
from tools.inspect.proven_work import ProvenWork
from tools.operate.operator_device import KnownRobot
from tools.vda5050 import master_gateway
from tools.vda5050.command import serve
from tools.vda5050.fleet_vehicle import UNHEARD
from tools.vda5050.master_gateway import TICK_S, FleetNames, MasterGateway
from tools.vda5050.order_book import BookedOrder, BookError, OrderBook
from tools.vda5050.transport_rules import OrderRefused, transport_of

WAIT_S = 20.0


def test_a_robot_that_died_while_the_gateway_was_away_is_still_told_of(tmp_path: Path) -> None:
    """Else a master waits for ever for an order that the other robots have delivered."""

    async def story() -> None:
        book, whole = OrderBook(tmp_path / "book.jsonl"), order(FETCH, BRING | {"sequenceId": 2})
        transport = transport_of(whole, HOUSE, "yard")
        assert transport is not None
        book.write(BookedOrder(1, whole, 5, transport.task))
        bus = CanBus(can.Bus("gateway without robots", interface="virtual"))
        named = FleetNames("uagv", "Headland", "yard", Vehicle(), "2.0.0")
        broker = Broker.read("mqtt://127.0.0.1:1")  # nobody serves there
        made, end = asyncio.Event(), asyncio.Event()
        gateway = MasterGateway(
            bus, HOUSE, book, broker, named, None, EventLines(out=lambda line: made.set())
        )
        running = asyncio.create_task(gateway.run(end))
        async with asyncio.timeout(WAIT_S):
            await made.wait()
        vehicle = gateway.ports[1].vehicle
        assert (
            vehicle.robot is UNHEARD and vehicle.booked is not None and vehicle.booked.number == 5
        )
        end.set()
        await running
        bus.close()
        book.close()

    asyncio.run(story())


def gateway_on(tmp_path: Path, told: list[str], as_json: bool = False) -> MasterGateway:
    """Of a fleet that nobody hears, at a broker that nobody serves; needs a running loop."""
    bus = CanBus(can.Bus(f"gateway {tmp_path}", interface="virtual"))
    named = FleetNames("uagv", "Headland", "yard", Vehicle(), "2.0.0")
    broker = Broker.read("mqtt://127.0.0.1:1")
    book = OrderBook(tmp_path / "book.jsonl")
    gateway = MasterGateway(bus, HOUSE, book, broker, named, None, EventLines(as_json, told.append))
    gateway._add(0)
    return gateway


def say_delivered(gateway: MasterGateway, task: int, address: int) -> None:
    """Robot 0 says at this address that it has delivered a task."""
    for message in (
        AddressClaimed(fleet_name("yard", 0).pack()), Member(0, 1, 0),
        TaskClaim(task, 0, Phase.DONE, 0, 5, 0), WorkProgress(task, 0, 3),
    ):  # fmt: skip
        gateway.hear(encode(message, address))


async def left(gateway: MasterGateway) -> None:
    port = gateway.ports[0]
    port.running.cancel()
    for working in gateway.working:
        working.cancel()
    await asyncio.gather(port.running, *gateway.working, return_exceptions=True)
    gateway.operator.bus.close()
    gateway.book.close()


def instant(kind: str, name: str) -> Action:
    return Action(action_type=kind, action_id=name, blocking_type=BlockingType.HARD)


async def done(gateway: MasterGateway, *actions: Action) -> None:
    """A master asks the first vehicle for these, and each of them ends."""
    gateway.act(gateway.ports[0], InstantActions(actions=list(actions)))
    async with asyncio.timeout(WAIT_S):
        await asyncio.gather(*gateway.working)


WHOLE = order(FETCH, BRING | {"sequenceId": 2}, name="o\x1b[2J1")


def test_an_order_that_cannot_be_booked_is_refused_and_the_next_record_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk ended the vehicle's connection for good, and what it took spoiled the book."""
    told: list[str] = []

    async def story() -> None:
        gateway = gateway_on(tmp_path, told)
        port = gateway.ports[0]

        def full(_: int) -> None:
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr("tools.vda5050.order_book.os.fsync", full)
            gateway.order(port, WHOLE)
        assert port.vehicle.booked is None and not gateway.desk.due()
        assert "No space left" in str(port.vehicle.errors[-1].error_description)
        assert "\x1b" not in told[-1], "a master's words do not steer the terminal"
        gateway.order(port, WHOLE)
        assert port.vehicle.booked is not None
        await left(gateway)

    asyncio.run(story())
    again = OrderBook(tmp_path / "book.jsonl")
    again.close()
    assert again.orders[0].order.order_id == WHOLE.order_id


def test_an_order_that_lost_its_number_is_one_transport_also_after_a_restart(
    tmp_path: Path,
) -> None:
    """The book kept the lost number as well. After a restart it was ordered, lost and numbered again."""
    told: list[str] = []

    async def story() -> None:
        gateway = gateway_on(tmp_path, told)
        port = gateway.ports[0]
        gateway.order(port, WHOLE)
        (said,) = gateway.desk.due()
        other = said._replace(dropoff=said.dropoff + 1)  # the greater order keeps the number
        gateway.desk.hear(128, other)
        gateway._observe(port)
        assert port.vehicle.booked is not None and port.vehicle.booked.number == said.task + 1
        await left(gateway)

        again = OrderBook(tmp_path / "book.jsonl")
        desk = TransportClient(max(again.tasks) + 1)
        for number, task in again.tasks.items():
            desk.recall(number, task)
        desk.hear(128, other)
        assert [each.task for each in desk.due()] == [said.task + 1]
        again.close()

    asyncio.run(story())


def test_a_full_disk_does_not_end_a_gateway_whose_order_gets_another_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`headland vda5050` ended with exit code 2, and all vehicles were gone."""
    told: list[str] = []

    async def story() -> None:
        gateway, end = gateway_on(tmp_path, told), asyncio.Event()
        port = gateway.ports[0]
        running = asyncio.create_task(gateway.run(end))
        await asyncio.wait({running}, timeout=0.01)
        gateway.order(port, WHOLE)
        (said,) = gateway.desk.due()

        def full(_: int) -> None:
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr("tools.vda5050.order_book.os.fsync", full)
            gateway.desk.hear(128, said._replace(dropoff=said.dropoff + 1))
            async with asyncio.timeout(WAIT_S):
                while not any("waits until that can be booked" in line for line in told):
                    assert not running.done()
                    await asyncio.wait({running}, timeout=0.01)
            vehicle = port.vehicle
            assert vehicle.booked is not None and vehicle.booked.number == said.task + 1
            assert gateway.due() == [], "no robot hears of what is not booked"
        async with asyncio.timeout(WAIT_S):
            while not gateway.due():
                await asyncio.wait({running}, timeout=0.01)
        assert [order.task for order in gateway.due()] == [said.task + 1]
        end.set()
        await running
        await left(gateway)

    asyncio.run(story())
    again = OrderBook(tmp_path / "book.jsonl")
    again.close()
    number = again.orders[0].number
    assert list(again.tasks) == [number] and sum("booked" in line for line in told) == 1


def test_a_cancelled_order_that_has_just_lost_its_number_is_taken_back(tmp_path: Path) -> None:
    """The action failed without a word, and the parcel was carried."""
    told: list[str] = []

    async def story() -> None:
        gateway = gateway_on(tmp_path, told)
        port = gateway.ports[0]
        gateway.order(port, WHOLE)
        (said,) = gateway.desk.due()
        cancel = Action(action_type="cancelOrder", action_id="c1", blocking_type=BlockingType.HARD)
        gateway.act(port, InstantActions(actions=[cancel]))
        gateway.desk.hear(128, said._replace(dropoff=said.dropoff + 1))
        async with asyncio.timeout(WAIT_S):
            while port.vehicle.booked is None or not port.vehicle.booked.cancelled:
                await asyncio.wait(gateway.working, timeout=0.01)
        gateway._observe(port)
        (again,) = gateway.desk.due()
        assert again.task == said.task + 1 and TransportTask(again.pickup, again.dropoff).withdrawn
        assert port.vehicle.booked is not None and port.vehicle.booked.cancelled
        await left(gateway)

    asyncio.run(story())


def test_an_order_for_which_no_number_is_left_is_refused(tmp_path: Path) -> None:
    """Found: it was accepted, and robots ignored it."""
    told: list[str] = []

    async def story() -> None:
        gateway = gateway_on(tmp_path, told)
        gateway.desk = TransportClient(TASK_NUMBERS)
        gateway.order(gateway.ports[0], WHOLE)
        vehicle = gateway.ports[0].vehicle
        assert vehicle.booked is None and str(TASK_NUMBERS) in str(
            vehicle.errors[-1].error_description
        )
        assert "start a fleet with new state folders" in told[-1]
        await left(gateway)

    asyncio.run(story())
    assert not (tmp_path / "book.jsonl").read_bytes()


def test_with_json_each_event_of_the_gateway_is_one_object(tmp_path: Path) -> None:
    told: list[str] = []

    async def story() -> None:
        gateway = gateway_on(tmp_path, told, as_json=True)
        gateway.order(gateway.ports[0], WHOLE)
        gateway.order(gateway.ports[0], order(BRING, name="another"))
        await left(gateway)

    asyncio.run(story())
    vehicle, taken, refused = map(json.loads, told)
    assert vehicle == {"event": "vehicle", "robot": 0, "serial": "robot0"}
    assert taken["event"] == "order" and taken["order"] == WHOLE.order_id
    assert refused["event"] == "order-refused" and refused["order"] == "another" and refused["why"]
    assert isinstance(taken["task"], int) and {taken["robot"], refused["robot"]} == {0}


def test_an_order_that_its_updates_make_too_long_is_refused_and_the_book_is_read_again(
    tmp_path: Path,
) -> None:
    """It was booked, and from then on no gateway started: its own book was no book to it."""
    ways = [node(f"w{number}", number, None) for number in range(2, 2 * NODES_MAX + 2, 2)]
    hidden = BRING | {"sequenceId": 2 * NODES_MAX + 2, "released": False}
    told: list[str] = []

    async def story() -> None:
        gateway = gateway_on(tmp_path, told)
        half = NODES_MAX // 2
        first, more = [FETCH, *ways[: half - 1]], ways[half - 2 :]
        gateway.order(gateway.ports[0], order(*first, more[1] | {"released": False}))
        assert gateway.ports[0].vehicle.booked is not None
        gateway.order(gateway.ports[0], order(*more, hidden, update=1))
        assert "longer than" in told[-1]
        await left(gateway)

    asyncio.run(story())
    OrderBook(tmp_path / "book.jsonl").close()


def test_an_instant_action_without_a_usable_key_fails_and_says_why(tmp_path: Path) -> None:
    """It was RUNNING for ever, and the master waited."""

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        gateway.keys = tmp_path / "no.key"  # gone since the start
        port = gateway.ports[0]
        await done(gateway, instant("startPause", "s1"))
        state = port.vehicle.instant["s1"]
        assert state.action_status is ActionStatus.FAILED and "no.key" in str(
            state.result_description
        )
        await left(gateway)

    asyncio.run(story())


def test_a_stop_is_said_also_where_the_key_is_gone_and_is_reported_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing was sent. Robots brake for a stop without a tag, too."""

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        gateway.keys = tmp_path / "no.key"  # gone since the start
        port, sent = gateway.ports[0], list[EmergencyStop]()
        monkeypatch.setattr(master_gateway, "OBEY_S", 0.1)
        monkeypatch.setattr(gateway.operator, "stop", sent.append)
        await done(gateway, instant("stop", "s1"))
        state = port.vehicle.instant["s1"]
        assert state.action_status is ActionStatus.FAILED and sent
        assert "no.key" in str(state.result_description)
        await left(gateway)

    asyncio.run(story())


def test_a_stop_that_no_robot_hears_has_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A master was told FINISHED, although nobody had confirmed it."""

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        port = gateway.ports[0]
        monkeypatch.setattr(master_gateway, "OBEY_S", 0.1)
        await done(gateway, instant("stop", "s1"))
        state = port.vehicle.instant["s1"]
        assert state.action_status is ActionStatus.FAILED
        assert state.result_description == "no robot is heard"
        await left(gateway)

    asyncio.run(story())


def test_a_stop_waits_for_no_address_that_is_long_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each stop of hours later had failed because of one that never said which robot it is."""

    async def none_late(*_: object) -> list[KnownRobot]:
        return []

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        port, operator, loop = gateway.ports[0], gateway.operator, asyncio.get_running_loop()
        monkeypatch.setattr(master_gateway, "press", none_late)
        operator.hear(loop.time(), encode(Member(0, 1, 7), 128))
        operator.unknown[140] = loop.time() - 3600.0
        await done(gateway, instant("stop", "s1"))
        assert port.vehicle.instant["s1"].action_status is ActionStatus.FINISHED
        operator.unknown[140] = loop.time()
        await done(gateway, instant("stop", "s2"))
        state = port.vehicle.instant["s2"]
        assert state.result_description == "not confirmed by address 140"
        await left(gateway)

    asyncio.run(story())


def test_an_instant_action_that_comes_twice_is_done_once_also_after_the_next_order(
    tmp_path: Path,
) -> None:
    """A cancellation that the broker delivered twice would have cancelled the next order."""

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        port = gateway.ports[0]
        act = instant("stateRequest", "c1")
        gateway.order(port, WHOLE)
        await done(gateway, act)
        port.vehicle.outcome = TaskOutcome(TaskPhase.DELIVERED, 0)
        gateway.order(port, order(FETCH, BRING | {"sequenceId": 2}, name="o2"))
        assert not port.vehicle.instant
        gateway.act(port, InstantActions(actions=[act]))
        assert not gateway.working
        await left(gateway)

    asyncio.run(story())


def test_a_robot_that_has_told_no_place_yet_is_not_initialized_at_the_origin(
    tmp_path: Path,
) -> None:
    """The first states after the start of a gateway said so, and a master believed it."""

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        port = gateway.ports[0]
        for message in (AddressClaimed(fleet_name("yard", 0).pack()), Member(0, 1, 0)):
            gateway.hear(encode(message, 130))
        gateway._observe(port)
        at = port.vehicle.state("yard", gateway.serial).agv_position
        assert at is not None and not at.position_initialized
        gateway.hear(encode(Pose(1.5, 2.5, 0.0, 0.0, 1, False, 255), 130))
        gateway._observe(port)
        at = port.vehicle.state("yard", gateway.serial).agv_position
        assert at is not None and at.position_initialized and at.x == 1.5
        await left(gateway)

    asyncio.run(story())


def test_a_pause_that_ends_before_the_robot_has_told_of_it_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """stopPause was FINISHED at once, before the robot had obeyed startPause, and then it stood."""

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        port, loop = gateway.ports[0], asyncio.get_running_loop()
        vehicle = port.vehicle
        vehicle.robot = UNHEARD._replace(heard=True)

        def told(started: bool) -> None:
            vehicle.robot = vehicle.robot._replace(started=started)

        def command(said: Command, slot: int) -> None:
            loop.call_later(TICK_S, told, said is Command.START)

        monkeypatch.setattr(gateway.operator, "command", command)
        await done(gateway, instant("startPause", "1"), instant("stopPause", "2"))
        assert vehicle.robot.started
        assert {each.action_status for each in vehicle.instant.values()} == {ActionStatus.FINISHED}
        await left(gateway)

    asyncio.run(story())


def test_a_robot_that_nobody_hears_confirms_no_pause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """stopPause was FINISHED at once for a robot that had said nothing since the gateway began."""
    monkeypatch.setattr("tools.vda5050.master_gateway.OBEY_S", 0.1)

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        vehicle = gateway.ports[0].vehicle
        await done(gateway, instant("stopPause", "1"))
        assert vehicle.instant["1"].action_status is ActionStatus.FAILED
        await left(gateway)

    asyncio.run(story())


def test_a_cancellation_without_an_order_fails_with_the_error_of_the_standard(
    tmp_path: Path,
) -> None:
    """Its type was instantActionError, so a master that looks for noOrderToCancel waited for ever."""

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        vehicle = gateway.ports[0].vehicle
        await done(gateway, instant("cancelOrder", "1"))
        assert vehicle.instant["1"].action_status is ActionStatus.FAILED
        assert [error.error_type for error in vehicle.errors] == ["noOrderToCancel"]
        await left(gateway)

    asyncio.run(story())


def test_a_master_that_cancels_again_and_again_is_waited_for_once(tmp_path: Path) -> None:
    """While no robot answered, each cancelOrder was booked again, and looked for an answer by itself."""

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        port = gateway.ports[0]
        gateway.order(port, WHOLE)
        (said,) = gateway.desk.due()
        cancels = [instant("cancelOrder", f"{number}") for number in range(3)]
        gateway.act(port, InstantActions(actions=cancels))
        async with asyncio.timeout(WAIT_S):
            await asyncio.wait(gateway.working, timeout=TICK_S)  # each has begun
            assert (tmp_path / "book.jsonl").read_bytes().count(b"\n") == 2
            (back,) = gateway.desk.due()
            gateway.desk.hear(130, TaskBookDigest(said.task // BUCKET_TASKS, 0, 1, 0))
            gateway.desk.hear(130, back)
            gateway._observe(port)
            await asyncio.gather(*gateway.working)
        assert {each.action_status for each in port.vehicle.instant.values()} == {
            ActionStatus.FINISHED
        }
        await left(gateway)

    asyncio.run(story())


def test_what_a_master_lists_last_need_not_be_travelled_last(tmp_path: Path) -> None:
    """Found: the base was looked for in the order of the list, so a drop in the horizon was ordered."""
    hidden = BRING | {"sequenceId": 2, "released": False}

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        port = gateway.ports[0]
        for update, whole in enumerate(
            (order(FETCH, hidden), order(FETCH, BRING | {"sequenceId": 2}))
        ):
            changed = {"nodes": whole.nodes[::-1], "order_update_id": update}
            gateway.order(port, whole.model_copy(update=changed))
            assert len(gateway.desk.due()) == update
        port.vehicle.outcome = TaskOutcome(TaskPhase.DELIVERED, 0)
        state = port.vehicle.state("yard", str)
        assert (state.last_node_id, state.last_node_sequence_id) == ("b", 2)
        await left(gateway)

    asyncio.run(story())


def test_a_book_of_another_building_is_one_line(tmp_path: Path) -> None:
    """Found: a traceback. The usual place of the book is the same for each scenario."""

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        gateway.order(gateway.ports[0], WHOLE)
        await left(gateway)
        book = OrderBook(tmp_path / "book.jsonl")
        bus = CanBus(can.Bus("another building", interface="virtual"))
        named = gateway.named._replace(map_id="hall")
        other = MasterGateway(bus, HOUSE, book, gateway.broker, named, None, EventLines(out=print))
        with pytest.raises(
            BookError, match=r"--book .*map yard is not known.*another book"
        ) as told:
            await other.run(asyncio.Event())
        assert "\x1b" not in str(told.value)
        bus.close()
        book.close()

    asyncio.run(story())


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("mqtt://" + "a" * 70, "uagv", "Headland"), "no host has this name"),
        (("mqtt://x..y", "uagv", "Headland"), "no host has this name"),
        (("mqtt://127.0.0.1", "yard/#", "Headland"), "--topics yard/#: a level of a topic"),
        (("mqtt://127.0.0.1", "uagv", "A/B"), "--manufacturer A/B: a level of a topic"),
        (("mqtt://127.0.0.1", "uagv", ""), "--manufacturer : a level of a topic"),
    ],
)
def test_names_that_no_broker_takes_are_one_line(
    words: tuple[str, str, str], line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Found: the command ran, and no vehicle ever came to the broker."""
    broker, topics, manufacturer = words
    where = ("socketcand", "can0", 250_000, "127.0.0.1", 1)
    book = tmp_path / "book.jsonl"
    assert serve(broker, "warehouse", book, where, None, topics, manufacturer, "2.0.0", 0.1) == 2
    told = capsys.readouterr().err
    assert line in told and len(told.splitlines()) == 1


def test_a_place_beyond_all_cells_is_refused() -> None:
    """Found: it ended the vehicle's connection for good."""
    house = Warehouse(Floor.drawn("............\n" * 6, 0.5, 0.2), Carrier(1.0, 0.0))
    beyond = FETCH | {"nodePosition": {"x": 1.7e308, "y": 0.5, "mapId": "yard"}}
    with pytest.raises(OrderRefused, match="no robot can stand at"):
        transport_of(order(beyond, BRING | {"sequenceId": 2}), house, "yard")


def test_a_connection_that_fails_is_begun_again_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Found: whatever was wrong with one message, the vehicle was gone from the broker without a word."""
    told: list[str] = []
    monkeypatch.setattr("tools.vda5050.master_gateway.AGAIN_S", 0.01)

    async def story() -> None:
        runs, again = list[int](), asyncio.Event()

        async def run(link: BrokerLink, topics: object) -> None:
            runs.append(1)
            if len(runs) == 1:
                raise RuntimeError("that nobody expected")
            again.set()
            await asyncio.get_running_loop().create_future()

        monkeypatch.setattr(BrokerLink, "run", run)
        gateway = gateway_on(tmp_path, told)
        async with asyncio.timeout(WAIT_S):
            await again.wait()
        assert "robot0: its connection has failed" in told[-1] and "nobody expected" in told[-1]
        await left(gateway)
        assert gateway.ports[0].running.cancelled() and len(told) == 2

    asyncio.run(story())


@pytest.mark.parametrize("keyed", [True, False])
def test_a_fleet_with_keys_delivers_nothing_that_no_robot_has_proven(
    tmp_path: Path, keyed: bool
) -> None:
    """An outsider could make a transport look delivered, and a master then sends the next vehicle."""
    address = 130

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        if keyed:
            gateway.inspector.proven = ProvenWork(Keys(b"m" * 16, None), 1, 0)
        port = gateway.ports[0]
        gateway.order(port, WHOLE)
        booked = port.vehicle.booked
        assert booked is not None and booked.number is not None
        say_delivered(gateway, booked.number, address)
        gateway._observe(port)
        outcome = port.vehicle.outcome
        delivered = outcome is not None and outcome.phase is TaskPhase.DELIVERED
        assert delivered is not keyed, "without keys nobody proves anything"
        await left(gateway)

    asyncio.run(story())


def test_a_delivered_transport_is_not_ordered_again_where_its_number_is_used_again(
    tmp_path: Path,
) -> None:
    """A greater order under its number gave it a new one, and its parcel was carried a second time."""

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        port = gateway.ports[0]
        gateway.order(port, WHOLE)
        (said,) = gateway.desk.due()
        say_delivered(gateway, said.task, 130)
        gateway._observe(port)
        gateway.desk.hear(128, said._replace(dropoff=said.dropoff + 1))
        gateway._observe(port)
        booked, outcome = port.vehicle.booked, port.vehicle.outcome
        assert booked is not None and booked.number == said.task and not gateway.desk.due()
        assert outcome is not None and outcome.phase is TaskPhase.DELIVERED
        why = await gateway._cancel(port)
        assert why is not None and why.startswith("noOrderToCancel")
        await left(gateway)

    asyncio.run(story())


def test_delivered_transports_of_the_book_are_not_ordered_again(tmp_path: Path) -> None:
    """After a restart the book recalls every transport, and each could be carried a second time."""

    async def story() -> None:
        gateway = gateway_on(tmp_path, [])
        task = TransportTask(3, 4)
        for number in (5, 6):
            gateway.desk.recall(number, task)
        for message in (
            AddressClaimed(fleet_name("yard", 0).pack()), Member(0, 1, 0),
            TaskClaim(5, 0, Phase.DONE, 0, 5, 0),
        ):  # fmt: skip
            gateway.hear(encode(message, 130))
        gateway._finish_delivered()
        assert list(gateway.desk.wanted) == [6]
        await left(gateway)

    asyncio.run(story())
