"""The gateway of a fleet to a master, on a bus without robots."""

import asyncio
from pathlib import Path

import can
import pytest

pytest.importorskip("aiomqtt", reason="the extra `vda5050` is not installed")
pytest.importorskip("vda5050.validation", reason="pip install vda5050-sdk: it has the schemas")

from agent.interface.vehicle import Vehicle
from agent.runtime.vda5050.broker_link import Broker
from protocol.links.bus import CanBus
from tests.tools.vda5050.test_fleet_vehicle import BRING, FETCH, HOUSE, order
from tools.vda5050.fleet_vehicle import UNHEARD
from tools.vda5050.master_gateway import FleetNames, MasterGateway
from tools.vda5050.order_book import BookedOrder, OrderBook
from tools.vda5050.transport_rules import transport_of

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
        gateway = MasterGateway(bus, HOUSE, book, broker, named, None, told=lambda line: made.set())
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
