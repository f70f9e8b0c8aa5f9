"""A connection of one VDA 5050 client to an MQTT broker, with a last will, that comes back by itself.

    link = BrokerLink(Broker.read("mqtt://10.0.0.7"), VehicleAddress("uagv", "ACME", "7"), heard, up)
    running = asyncio.create_task(link.run([Topic.ORDER, Topic.INSTANT_ACTIONS]))
    link.publish(state)

What is published while the broker is away is dropped: the next state says what is true then. A broker
that does not take a message in `KEEP_ALIVE_S` is left, and reached again.

A broker is not trusted: whatever it sends is counted in `refused`, and ends no link.
"""

import asyncio
import contextlib
import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple
from urllib.parse import unquote, urlsplit

import aiomqtt

from agent.runtime.vda5050.messages import (
    MAJOR,
    MESSAGE_BYTES_MAX,
    MODELS,
    VERSION,
    Connection,
    ConnectionState,
    MessageHeader,
    Sent,
    Topic,
    timestamp,
)

KEEP_ALIVE_S: Final = 5  # a broker publishes the last will 1.5 times this after the last word
AGAIN_S: Final = (0.2, 0.5, 1.0, 2.0)  # pauses between attempts; the last one is repeated
# States that wait for a slow broker. More are older than the newest by seconds, and useless.
WAITING_MAX: Final = 64
TOPIC_OF: Final = {kind: topic for topic, kind in MODELS.items()}
LINE_CHARS_MAX: Final = 200
WILD: Final = "+#\0"  # no topic that is published has them
CREDENTIAL_BYTES_MAX: Final = 0xFFFF  # of a string in MQTT

log = logging.getLogger(__name__)
# What paho says of each packet that it cannot read: it is counted here, and a broker may send many.
UNSAID: Final = logging.Logger("unsaid", logging.CRITICAL + 1)


class BrokerError(ValueError):
    """One line: why an address of a broker or a name at it cannot be used."""


class Broker(NamedTuple):
    """Address of an MQTT broker, and who we are there."""

    host: str
    port: int
    user: str | None = None
    password: str | None = None
    encrypted: bool = False

    @classmethod
    def read(cls, url: str) -> "Broker":
        """The broker of "mqtt://[user:password@]host[:port]", or mqtts. Raises BrokerError."""
        shown = url.rpartition("@")[2]  # without user and password
        try:
            parts = urlsplit(url if "://" in url else f"mqtt://{url}")
            port = parts.port
        except ValueError as problem:
            raise BrokerError(f"{shown}: {problem}") from None
        if parts.scheme not in ("mqtt", "mqtts") or not parts.hostname:
            raise BrokerError(f"{shown}: not mqtt://HOST:PORT or mqtts://HOST:PORT")
        encrypted = parts.scheme == "mqtts"
        user = None if parts.username is None else unquote(parts.username)
        password = None if parts.password is None else unquote(parts.password)
        found = cls(
            parts.hostname, port or (8883 if encrypted else 1883), user, password, encrypted
        )
        found._check()
        return found

    def _check(self) -> None:
        """What would end the connection itself, with an error that nobody expects there."""
        try:
            if "\0" in self.host or not self.host.encode("idna"):
                raise UnicodeError
        except UnicodeError:
            raise BrokerError(f"{self}: no host has this name") from None
        try:
            sizes = [len(word.encode()) for word in (self.user, self.password) if word]
        except UnicodeError:
            raise BrokerError(f"{self}: user and password are UTF-8") from None
        if max(sizes, default=0) > CREDENTIAL_BYTES_MAX:
            raise BrokerError(
                f"{self}: user and password have {CREDENTIAL_BYTES_MAX} bytes at most"
            )

    def __str__(self) -> str:
        """Without user and password."""
        return f"{'mqtts' if self.encrypted else 'mqtt'}://{self.host}:{self.port}"


def is_level(word: str, deeper: bool = False) -> bool:
    """Whether a word can be a level of a topic; or, `deeper`, several levels.

    >>> is_level("ACME"), is_level("AC+ME"), is_level("a/b"), is_level("a/b", deeper=True)
    (True, False, False, True)
    """
    return bool(word) and not any(sign in word for sign in (WILD if deeper else f"{WILD}/"))


def _obey_cancellation() -> None:
    """End this task if it was told to end. `asyncio.wait_for` of Python 3.11 keeps a cancellation for
    itself when what it waits for comes at the same time."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


class VehicleAddress(NamedTuple):
    """Which vehicle a client speaks for, or to."""

    interface: str
    manufacturer: str
    serial: str
    version: str = VERSION  # of the standard, as each header says

    def topic(self, topic: Topic) -> str:
        """The whole topic.

        >>> VehicleAddress("uagv", "ACME", "7").topic(Topic.STATE)
        'uagv/v2/ACME/7/state'
        """
        return f"{self.interface}/{MAJOR}/{self.manufacturer}/{self.serial}/{topic}"


class _Client(aiomqtt.Client):
    """A client that no broker keeps busy.

    Where paho raises while it reads a packet, it keeps the packet, and reads it again as long as its
    socket has more: for ever, with a line for each time.
    """

    def __init__(self, refused: Counter[str], broker: Broker, will: aiomqtt.Will | None) -> None:
        super().__init__(
            broker.host, broker.port, username=broker.user, password=broker.password,
            will=will, keepalive=KEEP_ALIVE_S, timeout=KEEP_ALIVE_S, logger=UNSAID,
            tls_params=aiomqtt.TLSParameters() if broker.encrypted else None,
        )  # fmt: skip
        self.refused = refused
        self._disconnected.add_done_callback(self._lost)

    def _on_message(self, client: Any, userdata: Any, message: Any) -> None:
        try:
            super()._on_message(client, userdata, message)
        except ValueError:  # its topic is not UTF-8, or has a wildcard
            self.refused["topic"] += 1

    def _lost(self, how: "asyncio.Future[None]") -> None:
        """Close the socket, if paho has not: it has failed at a packet."""
        if how.exception() is not None and self._client.socket() is not None:
            self.refused["packet"] += 1
            self._client._sock_close()


class BrokerLink:
    """One client: publishes messages with their header, and passes on what it receives."""

    def __init__(
        self,
        broker: Broker,
        identity: VehicleAddress,
        heard: Callable[[MessageHeader], None],
        up: Callable[[], None],
        *,
        is_vehicle: bool = True,
    ) -> None:
        """`heard`: takes each valid message, in the thread of the loop. `up`: called each time the
        broker has been reached. `is_vehicle`: it has a last will and says that it is online; else it
        is the vehicle's master control."""
        self.broker, self.identity, self.heard, self.up = broker, identity, heard, up
        self.is_vehicle, self.connected = is_vehicle, False
        self.present = True  # as `say` was told last; each new connection begins with it
        self.refused: Counter[str] = Counter()  # received and not valid, by what is wrong
        # Told of a message that is not valid: its topic, and why.
        self.invalid: Callable[[str, ValueError], None] = lambda topic, why: None
        # Told in one line of a fault of ours, once for each kind; the link goes on.
        self.failed: Callable[[str], None] = lambda why: log.error(
            "%s %s: %s", broker, identity.serial, why
        )
        self.problem = ""  # why the broker was not reached the last time
        self._faults: set[type[Exception]] = set()  # that were told
        self._numbers: Counter[Topic] = Counter()
        self._waiting: deque[Sent] = deque(maxlen=WAITING_MAX)
        self._wake = asyncio.Event()

    def publish(self, message: Sent) -> bool:
        """Send a message with the next header of its topic; False without a broker."""
        if not self.connected:
            return False
        self._waiting.append(message)
        self._wake.set()
        return True

    def say(self, present: bool) -> None:
        """Say whether the vehicle itself is there, now and whenever the broker is reached again."""
        self.present = present
        self.publish(self._presence)

    @property
    def _presence(self) -> Connection:
        return self._state(
            ConnectionState.ONLINE if self.present else ConnectionState.CONNECTIONBROKEN
        )

    async def run(self, topics: Sequence[Topic]) -> None:
        """Stay connected, subscribed to these topics, until it is cancelled; then say OFFLINE."""
        attempts = 0
        while True:
            _obey_cancellation()
            try:
                async with self._client() as client:
                    attempts = 0
                    await self._stay(client, topics)
            except aiomqtt.MqttError as problem:
                self.problem = str(problem)
            except Exception as problem:
                self.problem = self._fault(problem)
            finally:
                self.connected = False
            await asyncio.sleep(AGAIN_S[min(attempts, len(AGAIN_S) - 1)])
            attempts += 1

    def _client(self) -> aiomqtt.Client:
        will = None
        if self.is_vehicle:
            broken = self._with_header(self._state(ConnectionState.CONNECTIONBROKEN))
            will = aiomqtt.Will(
                self.identity.topic(Topic.CONNECTION), broken.to_json(), qos=1, retain=True
            )
        return _Client(self.refused, self.broker, will)

    async def _stay(self, client: aiomqtt.Client, topics: Sequence[Topic]) -> None:
        for topic in topics:
            # A connection message counts, as the standard says: once at least.
            await client.subscribe(self.identity.topic(topic), qos=int(topic is Topic.CONNECTION))
        said = self._presence
        if self.is_vehicle:
            await self._send(client, said)
        self._waiting.clear()
        self.connected = True
        if self.is_vehicle and said != self._presence:
            self.publish(self._presence)
        self.up()
        sending = asyncio.create_task(self._sending(client))
        reading = asyncio.create_task(self._reading(client))
        try:
            _obey_cancellation()
            # A broker that takes nothing any more may still be connected, and say nothing for long.
            await asyncio.wait((sending, reading), return_when=asyncio.FIRST_COMPLETED)
            for each in (sending, reading):
                if each.done():
                    each.result()
        except asyncio.CancelledError:
            if self.is_vehicle:
                with contextlib.suppress(aiomqtt.MqttError):
                    await self._send(client, self._state(ConnectionState.OFFLINE))
            raise
        finally:
            sending.cancel()
            reading.cancel()
            await asyncio.gather(sending, reading, return_exceptions=True)

    async def _reading(self, client: aiomqtt.Client) -> None:
        async for message in client.messages:
            self._take(message)

    async def _sending(self, client: aiomqtt.Client) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._waiting:
                await self._send(client, self._waiting.popleft())

    async def _send(self, client: aiomqtt.Client, message: Sent) -> None:
        topic = TOPIC_OF[type(message)]
        connection = topic is Topic.CONNECTION
        payload = self._with_header(message).to_json()
        await client.publish(
            self.identity.topic(topic), payload, qos=int(connection), retain=connection
        )

    def _with_header(self, message: Sent) -> MessageHeader:
        topic = TOPIC_OF[type(message)]
        number = self._numbers[topic]
        self._numbers[topic] += 1
        header = {
            "header_id": number, "timestamp": timestamp(time.time()), "version": self.identity.version,
            "manufacturer": self.identity.manufacturer, "serial_number": self.identity.serial,
        }  # fmt: skip
        return message.model_copy(update=header)

    @staticmethod
    def _state(state: ConnectionState) -> Connection:
        return Connection(connection_state=state)

    def _fault(self, problem: Exception) -> str:
        """In one line; told only the first time, because a vehicle repeats itself ten times a second."""
        line = repr(problem).splitlines()[0][:LINE_CHARS_MAX]
        if type(problem) not in self._faults:
            self._faults.add(type(problem))
            self.failed(line)
        return line

    def _take(self, message: aiomqtt.Message) -> None:
        """A message that is not valid is counted, and told to `invalid`; so is one at which `heard`
        fails."""
        topic = str(message.topic).rpartition("/")[2]
        payload = message.payload
        if self.is_vehicle and message.retain:
            # It is of any time, and comes again with each connection. The standard retains none.
            self.refused["retained"] += 1
            self.invalid(topic, ValueError("a retained message is not obeyed: it may be old"))
            return
        if not isinstance(payload, bytes | bytearray) or len(payload) > MESSAGE_BYTES_MAX:
            self.refused["size"] += 1
            return
        try:
            found = MODELS[Topic(topic)].model_validate_json(payload)
        except ValueError as problem:
            self.refused[topic] += 1
            self.invalid(topic, problem)
            return
        try:
            self.heard(found)
        except Exception as problem:
            self.refused["failed"] += 1
            self.invalid(topic, ValueError(self._fault(problem)))
