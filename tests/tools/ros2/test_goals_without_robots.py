"""Goals of ROS that end at once leave nothing behind; no ROS is needed."""

import asyncio
from pathlib import Path
from types import SimpleNamespace

import can
import pytest

from agent.delivery.task_registry import TransportTask
from crdt import Phase
from protocol.frames.codec import encode
from protocol.frames.delivery_frames import BUCKET_TASKS, TASK_NUMBERS, TaskBookDigest, TaskOrder
from protocol.frames.fleet_frames import Member
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.work_frames import TaskClaim
from protocol.links.bus import CanBus
from protocol.name import Name, fleet_name
from sim.fleet.transport_orders import TransportClient
from tests.tools.vda5050.test_fleet_vehicle import HOUSE
from tools.common.bus_address import AttachError
from tools.common.event_lines import EventLines
from tools.inspect.inspector import Inspector
from tools.operate.operator_device import Operator
from tools.ros2 import goal_desk, transport_desk
from tools.ros2.action_tasks import ActionTasks
from tools.ros2.goal_desk import GoalDesk
from tools.ros2.graph import ActionGoal, Ended, GoalPlace
from tools.ros2.transport_desk import TransportDesk

WAIT_S = 20.0
ROBOT = 130  # an address
HERE, THERE = GoalPlace("map", 0.5, 0.5), GoalPlace("map", 4.5, 2.5)


class Goal:
    """Of nobody."""

    cancelled = False

    def __init__(self, *places: GoalPlace) -> None:
        self.places, self.ended = list(places), list[tuple[Ended, str]]()

    def tell(self, at: GoalPlace, left_m: float, places_left: int) -> None:
        raise AssertionError("nobody drives")

    def end(self, how: Ended, why: str) -> None:
        self.ended.append((how, why))


def test_a_goal_whose_key_is_gone_is_listened_for_no_more(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Found: each such goal left a listener that took every frame of the bus from then on."""
    robot = SimpleNamespace(slot=0, report=None)
    monkeypatch.setattr(goal_desk, "LISTEN_S", 0.0)
    monkeypatch.setattr(Operator, "live", property(lambda self: [robot]))

    def gone(*_: object) -> None:
        raise AttachError("the key is gone")

    monkeypatch.setattr(goal_desk, "operator_keyring", gone)

    async def story() -> None:
        bus, told = CanBus(can.Bus("goals without robots", interface="virtual")), list[str]()
        device, lines = Operator(bus, None).device, EventLines(out=told.append)
        desk = GoalDesk(bus, device, tmp_path / "key", Inspector(), SimpleNamespace(), lines)
        goal = Goal(THERE)

        async def go(each: Goal) -> None:
            await desk._go(0, each)

        await desk._tasks._whole(go, goal)  # type: ignore[arg-type]
        assert goal.ended == [(Ended.ABORTED, "the key is gone")] and "the key is gone" in told[0]
        assert not desk._listeners and not desk._newest
        bus.close()

    asyncio.run(story())


def test_a_goal_that_fails_for_a_reason_that_nobody_expected_is_ended_all_the_same() -> None:
    """Its client waited for ever, and people saw nothing until the end of the program."""

    async def fails(goal: ActionGoal) -> None:
        raise KeyError(7)

    async def story() -> None:
        goal, told = Goal(HERE), list[str]()
        await ActionTasks(EventLines(out=told.append))._whole(fails, goal)
        assert [how for how, _ in goal.ended] == [Ended.ABORTED]
        assert told == ["goal aborted: it failed: KeyError(7)"]

    asyncio.run(story())


def test_a_transport_for_which_no_number_is_left_is_told_to_people(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(transport_desk, "LISTEN_S", 0.0)

    async def story() -> None:
        bus, told = CanBus(can.Bus("transports without robots", interface="virtual")), list[str]()
        device, lines = Operator(bus, None).device, EventLines(out=told.append)
        desk = TransportDesk(bus, device, HOUSE, Inspector(), SimpleNamespace(), lines)
        desk.client = TransportClient(TASK_NUMBERS)
        goal = Goal(HERE, THERE)
        await desk._carry(goal)
        assert goal.ended[0][0] is Ended.ABORTED and "numbers of transports" in told[0]
        bus.close()

    asyncio.run(story())


@pytest.mark.parametrize("end", [Ended.SUCCEEDED, Ended.CANCELLED])
def test_a_transport_that_is_over_is_kept_no_more(
    end: Ended, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A desk kept every order for ever, and looked through all of them for each one that is open."""
    monkeypatch.setattr(transport_desk, "LISTEN_S", 0.0)
    monkeypatch.setattr(transport_desk, "TELL_S", 0.0)

    async def story() -> None:
        bus, inspector = CanBus(can.Bus("transports over", interface="virtual")), Inspector()
        device, lines = Operator(bus, None).device, EventLines(out=lambda line: None)
        desk = TransportDesk(bus, device, HOUSE, inspector, SimpleNamespace(), lines)
        goal = Goal(HERE, THERE)
        goal.cancelled = end is Ended.CANCELLED

        def answered(said: object) -> bool:
            """A robot knows the order, repeats that it is taken back, or has delivered it."""
            if isinstance(said, TaskOrder):
                desk.client.hear(ROBOT, TaskBookDigest(said.task // BUCKET_TASKS, 0, 1, 0))
                desk.client.hear(ROBOT, said)
                claim = TaskClaim(said.task, 0, Phase.DONE, 0, 5, 0)
                for message in (
                    AddressClaimed(fleet_name("yard", 0).pack()),
                    Member(0, 1, 0),
                    claim,
                ):
                    if end is Ended.SUCCEEDED:
                        inspector.hear(1.0, encode(message, ROBOT))
            return True

        monkeypatch.setattr(device, "send", answered)
        async with asyncio.timeout(WAIT_S):
            await desk._carry(goal)
        assert [how for how, _ in goal.ended] == [end]
        assert not desk.client.wanted
        (index,) = desk.client.order([TransportTask(1, 2)])
        assert desk.client.number_of(index) == 1, "the number stays that of the transport"
        bus.close()

    asyncio.run(story())


def test_a_goal_of_a_robot_that_lost_its_address_is_given_up_and_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A device of another maker took the robot's address. The goal failed unseen, and its client waited
    for ever."""
    monkeypatch.setattr(goal_desk, "LISTEN_S", 0.0)
    monkeypatch.setattr(goal_desk, "GIVEN_UP_S", 0.0)
    robot = SimpleNamespace(slot=0, report=None)
    monkeypatch.setattr(Operator, "live", property(lambda self: [robot]))
    monkeypatch.setattr(goal_desk, "operator_keyring", lambda *_: None)

    async def story() -> None:
        bus, inspector = CanBus(can.Bus("address lost", interface="virtual")), Inspector()
        device, lines = Operator(bus, None).device, EventLines(out=lambda line: None)
        desk = GoalDesk(bus, device, tmp_path / "key", inspector, SimpleNamespace(), lines)
        foreign = Name(1, industry_group=2, function=130)
        inspector.hear(1.0, encode(Member(0, 1, 0), ROBOT))  # it claimed its address before
        assert 0 in inspector.robots

        async def obeys(*_: object) -> bool:
            inspector.hear(1.1, encode(AddressClaimed(foreign.pack()), ROBOT))
            return True

        monkeypatch.setattr(goal_desk, "convey", obeys)
        goal = Goal(THERE)
        async with asyncio.timeout(WAIT_S):
            await desk._go(0, goal)
        assert 0 not in inspector.robots
        assert goal.ended == [(Ended.ABORTED, "robot 0 is not heard")]
        bus.close()

    asyncio.run(story())
