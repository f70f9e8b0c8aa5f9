"""Goals of ROS that end at once leave nothing behind; no ROS is needed."""

import asyncio
from pathlib import Path
from types import SimpleNamespace

import can
import pytest

from protocol.frames.delivery_frames import TASK_NUMBERS
from protocol.links.bus import CanBus
from sim.fleet.transport_orders import TransportClient
from tests.tools.vda5050.test_fleet_vehicle import HOUSE
from tools.common.bus_address import AttachError
from tools.common.event_lines import EventLines
from tools.inspect.inspector import Inspector
from tools.operate.operator_device import Operator
from tools.ros2 import goal_desk, transport_desk
from tools.ros2.goal_desk import GoalDesk
from tools.ros2.graph import Ended, GoalPlace
from tools.ros2.transport_desk import TransportDesk

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
