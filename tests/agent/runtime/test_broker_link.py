"""The connection to a broker when the broker takes nothing any more."""

import asyncio
import json
from collections.abc import AsyncIterator
from typing import Any

import pytest

pytest.importorskip("aiomqtt", reason="the extra `vda5050` is not installed")

import aiomqtt

from agent.runtime.vda5050.broker_link import Broker, BrokerLink, VehicleAddress
from agent.runtime.vda5050.messages import Topic, Visualization

WAIT_S = 20.0


class DeafClient:
    """Connected, and silent: the second publication, after ONLINE, is not taken in time."""

    def __init__(self) -> None:
        self.published = 0

    async def __aenter__(self) -> "DeafClient":
        return self

    async def __aexit__(self, *_: object) -> None:
        pass

    async def subscribe(self, *_: Any, **__: Any) -> None:
        pass

    async def publish(self, *_: Any, **__: Any) -> None:
        self.published += 1
        if self.published > 1:
            raise aiomqtt.MqttError("Operation timed out")

    @property
    def messages(self) -> AsyncIterator[Any]:
        return self._silence()

    async def _silence(self) -> AsyncIterator[Any]:
        await asyncio.get_running_loop().create_future()
        yield


def test_a_broker_that_takes_no_message_any_more_is_left_and_reached_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A vehicle was ONLINE to its master and said nothing until the master gave an order: the task that
    sends had ended, and nobody looked at it while nothing was received."""

    async def story() -> None:
        reached = asyncio.Semaphore(0)
        link = BrokerLink(
            Broker.read("mqtt://127.0.0.1"), VehicleAddress("uagv", "ACME", "7"),
            lambda _: None, reached.release,
        )  # fmt: skip
        monkeypatch.setattr(link, "_client", DeafClient)
        running = asyncio.create_task(link.run([Topic.ORDER]))
        async with asyncio.timeout(WAIT_S):
            await reached.acquire()
            assert link.publish(Visualization())
            await reached.acquire()
        assert link.problem == "Operation timed out"
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

    asyncio.run(story())


class DyingClient(DeafClient):
    """The broker ends while a message is on its way, and giving that up takes a while."""

    def __init__(
        self, lost: asyncio.Event, giving_up: asyncio.Event, given_up: asyncio.Event
    ) -> None:
        super().__init__()
        self.lost, self.giving_up, self.given_up = lost, giving_up, given_up

    async def publish(self, *_: Any, **__: Any) -> None:
        self.published += 1
        if self.published == 1:
            return
        self.lost.set()
        try:
            await asyncio.get_running_loop().create_future()
        except asyncio.CancelledError:
            self.giving_up.set()
            await self.given_up.wait()
            raise

    async def _silence(self) -> AsyncIterator[Any]:
        await self.lost.wait()
        raise aiomqtt.MqttError("Disconnected during message iteration")
        yield


def test_a_connection_that_is_ended_while_the_broker_dies_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`headland vda5050` and its broker were ended at once: the gateway took the cancellation for that of
    the task that sends, and tried to reach the broker for 40 minutes more."""

    async def story() -> None:
        events = [asyncio.Event() for _ in range(3)]
        up = asyncio.Event()
        link = BrokerLink(
            Broker.read("mqtt://127.0.0.1"), VehicleAddress("uagv", "ACME", "7"),
            lambda _: None, up.set,
        )  # fmt: skip
        monkeypatch.setattr(link, "_client", lambda: DyingClient(*events))
        running = asyncio.create_task(link.run([Topic.ORDER]))
        async with asyncio.timeout(WAIT_S):
            await up.wait()
            link.publish(Visualization())
            await events[1].wait()
            running.cancel()
            events[2].set()
            await asyncio.wait({running})
        assert running.cancelled()

    asyncio.run(story())


class Listening(DeafClient):
    """Takes all, and keeps what it was told of the vehicle."""

    def __init__(self, told: list[str]) -> None:
        super().__init__()
        self.told = told

    async def publish(self, _: str, payload: str, **__: Any) -> None:
        self.told.append(json.loads(payload)["connectionState"])


def test_a_vehicle_whose_robot_is_silent_is_not_online_when_the_broker_is_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each time the broker came back a dead robot was ONLINE for 70 ms, and a master gave it an order."""

    async def story() -> None:
        up, told = asyncio.Event(), list[str]()
        link = BrokerLink(
            Broker.read("mqtt://127.0.0.1"), VehicleAddress("uagv", "ACME", "7"),
            lambda _: None, up.set,
        )  # fmt: skip
        monkeypatch.setattr(link, "_client", lambda: Listening(told))
        link.say(False)
        running = asyncio.create_task(link.run([Topic.ORDER]))
        async with asyncio.timeout(WAIT_S):
            await up.wait()
        assert told == ["CONNECTIONBROKEN"]
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

    asyncio.run(story())
