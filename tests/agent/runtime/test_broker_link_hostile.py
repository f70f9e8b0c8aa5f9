"""What a broker sends that no broker should: bytes on a socket of the test. It ends no link, and it
costs nothing."""

import asyncio
import json
import logging
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest

pytest.importorskip("aiomqtt", reason="the extra `vda5050` is not installed")

import aiomqtt
import paho.mqtt.client as paho
from paho.mqtt.enums import MQTTErrorCode

from agent.runtime.bodies.vda5050_body import Vda5050Body
from agent.runtime.vda5050.broker_link import (
    CREDENTIAL_BYTES_MAX,
    Broker,
    BrokerError,
    BrokerLink,
    VehicleAddress,
    is_level,
)
from agent.runtime.vda5050.messages import MessageHeader, Topic, VehicleState

WAIT_S = 20.0
CONNECT, PUBLISH, SUBSCRIBE = 0x10, 0x30, 0x80
CONNACK = b"\x20\x02\x00\x00"
STATE = "uagv/v2/ACME/7/state"
GOOD = {
    "timestamp": "", "orderId": "", "batteryState": {"batteryCharge": 50.0},
    "agvPosition": {"x": 1.0, "y": 2.0, "theta": 0.0, "mapId": "hall", "positionInitialized": True},
}  # fmt: skip
Hear = Callable[[MessageHeader], None]


def packet(kind: int, body: bytes) -> bytes:
    """One packet of MQTT."""
    size, length = b"", len(body)
    while True:
        length, low = length >> 7, length & 0x7F
        size += bytes([low | (0x80 if length else 0)])
        if not length:
            return bytes([kind]) + size + body


def publish(topic: bytes, payload: bytes) -> bytes:
    return packet(PUBLISH, struct.pack("!H", len(topic)) + topic + payload)


def state(**changed: object) -> bytes:
    return publish(STATE.encode(), json.dumps(GOOD | changed).encode())


class FakeBroker:
    """Grants what a client asks, and sends it any bytes."""

    def __init__(self) -> None:
        self.subscribed = asyncio.Queue[asyncio.StreamWriter]()
        self.left = asyncio.Event()  # a client has closed its connection

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                kind = (await reader.readexactly(1))[0] & 0xF0
                length = shift = 0
                while True:
                    byte = (await reader.readexactly(1))[0]
                    length |= (byte & 0x7F) << shift
                    shift += 7
                    if byte < 0x80:
                        break
                body = await reader.readexactly(length)
                if kind == CONNECT:
                    writer.write(CONNACK)
                elif kind == SUBSCRIBE:
                    writer.write(packet(0x90, body[:2] + b"\x00"))
                    self.subscribed.put_nowait(writer)
        except (asyncio.IncompleteReadError, ConnectionError):
            self.left.set()
        finally:
            writer.close()


@asynccontextmanager
async def linked(heard: Hear) -> AsyncIterator[tuple[FakeBroker, BrokerLink]]:
    """A link to a broker of ours, as a master control."""
    broker = FakeBroker()
    server = await asyncio.start_server(broker.serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    link = BrokerLink(
        Broker("127.0.0.1", port), VehicleAddress("uagv", "ACME", "7"), heard, lambda: None,
        is_vehicle=False,
    )  # fmt: skip
    running = asyncio.create_task(link.run([Topic.STATE]))
    try:
        async with asyncio.timeout(WAIT_S):
            yield broker, link
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        server.close()


class Reads:
    """Counts how often paho is asked to read."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.count, read = 0, paho.Client.loop_read

        def counted(client: paho.Client, max_packets: int = 1) -> MQTTErrorCode:
            self.count += 1
            return read(client, max_packets)

        monkeypatch.setattr(paho.Client, "loop_read", counted)


@pytest.mark.parametrize(
    "topic", [b"uagv/v2/ACME/7/\xff\xfe", b"uagv/v2/ACME/+/state", b"#"],
    ids=["no UTF-8", "wildcard", "all"],
)  # fmt: skip
def test_a_topic_that_cannot_be_is_counted_and_the_link_goes_on(
    topic: bytes, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Found: paho read the same packet again for 5 s, at 100 % CPU, and wrote 180,000 lines."""
    reads = Reads(monkeypatch)

    async def story() -> None:
        heard = asyncio.Queue[MessageHeader]()
        async with linked(heard.put_nowait) as (broker, link):
            writer = await broker.subscribed.get()
            writer.write(publish(topic, b"{}") + state(orderId="after"))
            found = await heard.get()
            assert isinstance(found, VehicleState) and found.order_id == "after"
            assert link.connected and link.refused == {"topic": 1} and not broker.left.is_set()

    asyncio.run(story())
    assert reads.count < 20 and capfd.readouterr().err == ""


def test_a_packet_at_which_the_client_fails_ends_the_connection_at_once_and_not_the_link(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Whatever it fails at: it would read the packet again as long as its socket has more."""
    reads, take = Reads(monkeypatch), aiomqtt.Client._on_message

    def fail(client: aiomqtt.Client, *given: Any) -> None:
        monkeypatch.setattr(aiomqtt.Client, "_on_message", take)
        raise TypeError("that nobody expected")

    monkeypatch.setattr(aiomqtt.Client, "_on_message", fail)

    async def story() -> None:
        heard = asyncio.Queue[MessageHeader]()
        async with linked(heard.put_nowait) as (broker, link):
            writer = await broker.subscribed.get()
            writer.write(state(orderId="before") + state(orderId="lost"))
            await broker.left.wait()
            again = await broker.subscribed.get()
            again.write(state(orderId="after"))
            found = await heard.get()
            assert isinstance(found, VehicleState) and found.order_id == "after"
            assert link.refused == {"packet": 1}

    asyncio.run(story())
    assert reads.count < 20 and capfd.readouterr().err == ""


def test_a_link_that_is_cancelled_as_the_broker_answers_ends() -> None:
    """Found: `asyncio.wait_for` of Python 3.11 kept the cancellation, and the link went on for ever."""

    async def story() -> None:
        broker = FakeBroker()
        server = await asyncio.start_server(broker.serve, "127.0.0.1", 0)
        link = BrokerLink(
            Broker("127.0.0.1", server.sockets[0].getsockname()[1]),
            VehicleAddress("uagv", "ACME", "7"), lambda message: None, lambda: None, is_vehicle=False,
        )  # fmt: skip
        asked: asyncio.Future[asyncio.Future[Any]] = asyncio.get_running_loop().create_future()

        def granted(client: aiomqtt.Client, *given: Any) -> None:
            answer(client, *given)
            running.cancel()
            asked.set_result(running)

        answer = aiomqtt.Client._on_subscribe
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(aiomqtt.Client, "_on_subscribe", granted)
            running = asyncio.create_task(link.run([Topic.ORDER]))
            async with asyncio.timeout(WAIT_S):
                await asyncio.wait({await asked})
        assert running.cancelled()
        server.close()

    asyncio.run(story())


def test_a_topic_of_no_message_is_counted() -> None:
    async def story() -> None:
        heard = asyncio.Queue[MessageHeader]()
        async with linked(heard.put_nowait) as (broker, link):
            writer = await broker.subscribed.get()
            writer.write(publish(b"uagv/v2/ACME/7/other", b"{}") + publish(STATE.encode(), b"{"))
            writer.write(state())
            await heard.get()
            assert link.refused == {"other": 1, "state": 1}

    asyncio.run(story())


@pytest.mark.parametrize("topic", [Topic.ORDER, Topic.INSTANT_ACTIONS])
def test_what_a_broker_has_retained_is_no_order(topic: Topic) -> None:
    """A parcel was carried, and a fleet stopped, again at each start of the gateway."""
    address, heard, invalid = (
        VehicleAddress("uagv", "ACME", "7"),
        list[MessageHeader](),
        list[str](),
    )
    link = BrokerLink(Broker("127.0.0.1", 1), address, heard.append, lambda: None)
    link.invalid = lambda topic, why: invalid.append(f"{topic}: {why}")
    node = {"nodeId": "a", "sequenceId": 0, "released": True, "actions": []}
    said = {"orderId": "o1", "orderUpdateId": 0, "nodes": [node], "edges": [], "actions": []}
    for retain in (True, False):
        link._take(
            aiomqtt.Message(address.topic(topic), json.dumps(said).encode(), 0, retain, 1, None)
        )
    assert len(heard) == 1 and link.refused == {"retained": 1}
    assert invalid == [f"{topic}: a retained message is not obeyed: it may be old"]


def test_a_fault_at_one_message_is_told_once_and_the_link_goes_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Found: what `heard` raised ended the link for good, without a word, and the body stood for ever."""

    async def story() -> None:
        heard = asyncio.Queue[MessageHeader]()

        def hear(message: MessageHeader) -> None:
            assert isinstance(message, VehicleState)
            if message.order_id == "bad":
                raise KeyError("that nobody expected")
            heard.put_nowait(message)

        async with linked(hear) as (broker, link):
            invalid = list[str]()
            link.invalid = lambda topic, why: invalid.append(f"{topic}: {why}")
            writer = await broker.subscribed.get()
            writer.write(2 * state(orderId="bad") + state())
            await heard.get()
            assert link.connected and link.refused == {"failed": 2}
            assert invalid == 2 * ["state: KeyError('that nobody expected')"]

    with caplog.at_level(logging.ERROR):
        asyncio.run(story())
    assert len(caplog.messages) == 1 and "7: KeyError('that nobody expected')" in caplog.messages[0]


def test_a_fault_of_the_connection_is_told_and_it_is_begun_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def story() -> None:
        told = list[str]()
        async with linked(lambda message: None) as (broker, link):
            link.failed = told.append

            def up() -> None:
                monkeypatch.setattr(link, "up", lambda: None)
                raise RuntimeError("that nobody expected")

            monkeypatch.setattr(link, "up", up)
            await broker.subscribed.get()
            await broker.subscribed.get()
            assert told == ["RuntimeError('that nobody expected')"]

    asyncio.run(story())


@pytest.mark.parametrize("load", ["9" * 5000, "999999999999", "24576", "٣", "-3", ""])
def test_a_body_takes_the_place_of_a_vehicle_whose_order_names_no_task(load: str) -> None:
    """Found: 5000 digits ended the link, and 999999999999 was the number of the parcel aboard."""
    made = Vda5050Body(0, "mqtt://127.0.0.1", "ACME", "7", "hall")
    made.link.connected = True
    hear = made.link.heard
    for loads in ([], [{"loadId": "1"}]):
        text = json.dumps(GOOD | {"orderId": f"headland/a/1/{load}", "loads": loads})
        hear(VehicleState.model_validate_json(text))
    assert made.state is not None
    assert made.orders.load == (3 if load == "٣" else -1)


def test_a_place_beyond_all_numbers_gives_no_velocity_that_is_none() -> None:
    made = Vda5050Body(0, "mqtt://127.0.0.1", "ACME", "7", "hall")
    for second, x_m in enumerate((-1.7e308, 1.7e308)):
        place = {**GOOD["agvPosition"], "x": x_m}  # type: ignore[dict-item]
        at = f"2026-01-01T00:00:00.{second}00Z"
        made.link.heard(VehicleState.model_validate(GOOD | {"agvPosition": place, "timestamp": at}))
    assert made._velocity == (0.0, 0.0)


@pytest.mark.parametrize("host", ["x..y", ".", "a" * 64, "a." + "b" * 64 + ".c", "a\0b", "ü" * 70])
def test_a_name_that_no_host_has_is_one_line_when_it_is_read(host: str) -> None:
    """Found: the look-up raised UnicodeError in the link, which ended."""
    with pytest.raises(BrokerError, match="no host has this name"):
        Broker.read(f"mqtt://user:secret@{host}")


@pytest.mark.parametrize(
    "user", ["u" * (CREDENTIAL_BYTES_MAX + 1), "\udcff"], ids=["too long", "no UTF-8"]
)
def test_a_user_that_mqtt_cannot_send_is_one_line_when_it_is_read(user: str) -> None:
    with pytest.raises(BrokerError, match="user and password"):
        Broker.read(f"mqtt://{user}@host")


@pytest.mark.parametrize("serial", ["7+", "#", "7/8", "7\0"])
def test_a_serial_that_is_no_level_of_a_topic_is_refused(serial: str) -> None:
    assert not is_level(serial) and not is_level("")
    with pytest.raises(BrokerError, match="levels of a topic"):
        Vda5050Body(0, "mqtt://127.0.0.1", "ACME", serial, "hall")


@pytest.mark.parametrize(
    "url", ["http://user:secret@host", "mqtt://user:secret@host:x", "mqtt://user:secret@"]
)
def test_a_wrong_address_is_told_without_its_password(url: str) -> None:
    """Found: the line had the whole address."""
    with pytest.raises(BrokerError) as told:
        Broker.read(url)
    assert "secret" not in str(told.value) and str(told.value)
