"""The server's end of sessions with implements: a task controller (ISO 11783-10), sans I/O.

Messages of clients and the time go in; what is to be sent, and what has changed, comes out. It stores
device descriptions while it runs, and asks for and sets values. What it sets is decided elsewhere
(`agent/implements/task_controller.py`).
"""

from collections import Counter
from collections.abc import Sequence
from enum import Enum
from struct import pack, unpack
from typing import Final, NamedTuple

from protocol.device_description import BY_TIME, ON_CHANGE, ROBOT_LABEL, SETTABLE, VERSION_4
from protocol.device_pool import DevicePool, read_pool
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.name import Name, is_robot
from protocol.state_machine import StateMachine, matrix
from protocol.task_client import (
    ACKNOWLEDGE,
    ACTIVATE,
    ACTIVATED,
    ASK_LOCALIZATION,
    ASK_STRUCTURE,
    ASK_UPLOAD,
    ASK_VERSION,
    CHANGE,
    CLIENT_TASK,
    DELETE,
    DELETED,
    DESCRIPTION,
    LOCALIZATION,
    MAY_UPLOAD,
    OPTIONS,
    POOL,
    POOL_TAKEN,
    REQUEST_VALUE,
    SET_AND_ACKNOWLEDGE,
    STATUS,
    STRUCTURE,
    TIME_INTERVAL,
    VALUE,
    VERSION,
    VERSION_3,
    Key,
)
from protocol.units import S

STATUS_PERIOD_US: Final = 2 * S  # between two status messages
CLIENT_SILENT_US: Final = 6 * S  # a client that says nothing for so long is gone
CLIENTS_MAX: Final = 16  # implements on one bus; a tractor has two or three
ROBOTS_MAX: Final = 108  # on one bus; they log in, too, and take no place of an implement
POOL_BYTES_MAX: Final = 1 << 16  # of one description
STORED_MAX: Final = 16  # descriptions kept, of devices that are here and of those that have gone
BOOMS, SECTIONS, CHANNELS = 4, 96, 1
TOTALS_ACTIVE: Final = 1  # bit of the status: a task is being worked on
RENAME, RENAMED = 0xC1, 0xD1
REFUSED: Final = 1  # in the answers about a description


class ClientState(Enum):
    """How far an implement is."""

    GREETED = "it has spoken, and no description of it is used"
    STORED = "its description is here"
    ACTIVE = "its description is used: values are told and set"
    GONE = "it has been silent for 6 s, or its address has changed hands"


class ClientEvent(Enum):
    """What moves a session."""

    TAKEN = "a description has arrived and can be read"
    DELETED = "it has deleted its description"
    ACTIVATED = "it wants its description to be used"
    DEACTIVATED = "it wants its description not to be used"
    SILENT = "nothing was heard of it for 6 s"


GREETED, STORED, ACTIVE, GONE = ClientState
stay = None

# fmt: off
CLIENT_TABLE = matrix(
    ClientEvent,
    # state   TAKEN    DELETED  ACTIVATED  DEACTIVATED  SILENT
    (GREETED, STORED,  stay,    stay,      stay,        GONE),
    (STORED,  stay,    GREETED, ACTIVE,    stay,        GONE),
    (ACTIVE,  STORED,  GREETED, stay,      STORED,      GONE),
    (GONE,    stay,    stay,    stay,      stay,        stay),
)
# fmt: on


class ServerMessage(NamedTuple):
    """Bytes for one client, or for all: eight as a frame."""

    destination: int
    data: bytes


class ClientActivated(NamedTuple):
    """From now on values of this client are told and can be set."""

    source: int


class ClientLost(NamedTuple):
    """The session of this client has ended."""

    source: int


class ValueTold(NamedTuple):
    """A client has told a value of its own."""

    source: int
    key: Key
    number: int


ServerOutput = ServerMessage | ClientActivated | ClientLost | ValueTold


class PoolUpload:
    """A description that arrives in one message, or in parts that follow each other."""

    def __init__(self, announced_bytes: int) -> None:
        """`announced_bytes`: how long its maker says it is; 0: nothing was announced."""
        self.announced_bytes = announced_bytes
        self.received = b""
        self.is_read = True  # all that has arrived

    @property
    def is_whole(self) -> bool:
        """Whether nothing that was announced is missing."""
        return len(self.received) >= self.announced_bytes

    def add(self, part: bytes) -> None:
        """A frame carries eight bytes at least, so a short last part is padded with 0xFF."""
        self.received = part if self.is_whole else self.received + part
        surplus = self.received[self.announced_bytes :]
        if self.announced_bytes and not surplus.strip(b"\xff"):
            self.received = self.received[: self.announced_bytes]


class ImplementSession:
    """What is known of one device that has spoken to the task controller: its description, its values."""

    def __init__(self, source: int, name: int, now_us: int) -> None:
        self.source, self.name = source, name
        self.version = VERSION_4  # that both speak
        self.pool: DevicePool | None = None
        self.upload = PoolUpload(0)
        self.values: dict[Key, int] = {}  # as it has told them
        self.heard_at_us = now_us
        self.machine = StateMachine("implement", CLIENT_TABLE, GREETED)

    @property
    def active(self) -> bool:
        """Whether values can be set."""
        return self.machine.state is ACTIVE

    @property
    def robot(self) -> bool:
        """Whether it is a robot, by its NAME or, where that is of another maker, its description."""
        described = self.pool is not None and self.pool.label.startswith(ROBOT_LABEL)
        return described or is_robot(Name.unpack(self.name))


class TaskServer:
    """All sessions of one task controller."""

    def __init__(self, status_at_us: int, version: int = VERSION_4) -> None:
        """`status_at_us`: when it first says that it is there."""
        self.version = version
        self.clients: dict[int, ImplementSession] = {}  # by source address
        self.stored: dict[int, DevicePool] = {}  # by NAME; kept when a client goes, the newest last
        self.counts: Counter[str] = Counter()  # sessions, and what was refused, by kind
        self._left: dict[int, ImplementSession] = {}  # NAME -> an active session that has ended
        self._status_at_us = status_at_us

    @property
    def due_at_us(self) -> int:
        """When `on_timer` next has something to do."""
        silent = [c.heard_at_us + CLIENT_SILENT_US for c in self.clients.values()]
        return min([self._status_at_us, *silent])

    def on_timer(self, now_us: int) -> list[ServerOutput]:
        """The status, each 2 s; and clients that are silent are forgotten."""
        outputs: list[ServerOutput] = []
        for client in [*self.clients.values()]:
            if now_us >= client.heard_at_us + CLIENT_SILENT_US:
                outputs += self.forget(client.source)
        if now_us >= self._status_at_us:
            self._status_at_us = now_us + STATUS_PERIOD_US
            outputs.append(
                _said(GLOBAL_ADDRESS, bytes((0xF0 | STATUS, *b"\xff" * 3, TOTALS_ACTIVE, 0, 0)))
            )
        return outputs

    def forget(self, source: int) -> list[ServerOutput]:
        """End the session with an address: it is silent, or another device has it now."""
        client = self.clients.pop(source, None)
        if client is None:
            return []
        self._left.pop(client.name, None)
        if client.active:
            self._left[client.name] = client
            if len(self._left) > CLIENTS_MAX:
                del self._left[next(iter(self._left))]
        client.machine.fire(ClientEvent.SILENT)
        self.counts["lost"] += 1
        return [ClientLost(source)]

    def on_message(
        self, source: int, name: int | None, data: bytes, now_us: int
    ) -> list[ServerOutput]:
        """Handle process data of the device with this address and NAME.

        `name`: its 64-bit number; without one it is not served. `data`: eight bytes, or more for a
        description.
        """
        command = data[0] & 0xF
        if name is None or command == STATUS:  # the status of another task controller
            return []
        client, moved = self.clients.get(source), list[ServerOutput]()
        if client is None or client.name != name:
            for other in [*self.clients.values()]:
                if other.name == name:
                    moved += self.forget(other.source)
            if client is None and self._full(name):
                self.counts["too many clients"] += 1
                return moved
            self.clients[source] = client = ImplementSession(source, name, now_us)
            client.pool = self.stored.get(name)
            if client.pool is not None:
                client.machine.fire(ClientEvent.TAKEN)
                moved += self._goes_on(client, now_us)
        client.heard_at_us = now_us
        return [*moved, *self._heard(client, command, data)]

    def _full(self, name: int) -> bool:
        """Whether there is no place for one more device with this NAME."""
        implements = sum(not client.robot for client in self.clients.values())
        no_place = implements >= CLIENTS_MAX and not is_robot(Name.unpack(name))
        return no_place or len(self.clients) >= CLIENTS_MAX + ROBOTS_MAX

    def _goes_on(self, client: ImplementSession, now_us: int) -> list[ServerOutput]:
        """A device that has claimed another address goes on with its session, and does not log in."""
        left = self._left.pop(client.name, None)
        if left is None or now_us >= left.heard_at_us + CLIENT_SILENT_US:
            return []
        client.version = left.version
        client.machine.fire(ClientEvent.ACTIVATED)
        return [ClientActivated(client.source)]

    def _heard(self, client: ImplementSession, command: int, data: bytes) -> list[ServerOutput]:
        source = client.source
        if command in (0, DESCRIPTION):
            return self._describe(client, data)
        if command == VALUE:
            key, (number,) = _key(data), unpack("<i", data[4:8])
            if client.pool is not None and client.pool.describes(key):
                client.values[key] = number
            else:
                self.counts["value that is not described"] += 1
            return [ValueTold(source, key, number)]
        if command not in (CLIENT_TASK, ACKNOWLEDGE):
            self.counts["no command of a client"] += 1
        return []

    # ---------------------------------------------------------------- what it sets and asks

    def set_value(self, client: ImplementSession, key: Key, number: int) -> list[ServerOutput]:
        """Set a value; a client of version 4 is to acknowledge it."""
        if (
            not client.active
            or not client.pool
            or not client.pool.properties.get(key, 0) & SETTABLE
        ):
            return []
        command = SET_AND_ACKNOWLEDGE if client.version >= VERSION_4 else VALUE
        return [_said(client.source, _command(command, key, number))]

    def ask(self, client: ImplementSession, key: Key) -> list[ServerOutput]:
        """Ask for a value once."""
        return [_said(client.source, _command(REQUEST_VALUE, key, 0))]

    def measure(self, client: ImplementSession, key: Key, period_ms: int) -> list[ServerOutput]:
        """Ask for a value on change, and by time, as far as the client offers it. `period_ms`: 0: on
        change alone."""
        offered = 0 if client.pool is None else client.pool.triggers.get(key, 0)
        wanted = ((TIME_INTERVAL, BY_TIME, period_ms), (CHANGE, ON_CHANGE, 1))
        said: list[ServerOutput] = []
        for command, bit, number in wanted:
            if offered & bit and number:
                said.append(_said(client.source, _command(command, key, number)))
        return said or self.ask(client, key)

    # ---------------------------------------------------------------- descriptions

    def _describe(self, client: ImplementSession, data: bytes) -> list[ServerOutput]:
        source, kind = client.source, data[0]
        if kind == VERSION:
            client.version = min(max(data[1], VERSION_3), self.version)
            return []
        if kind == POOL:
            before = client.active
            answer = _said(source, self._take(client, data[1:]))
            return [answer, ClientLost(source)] if before and not client.active else [answer]
        pool, absent = client.pool, b"\xff" * 7
        match kind:
            case 0x00:
                options = (self.version, 0xFF, OPTIONS, 0, BOOMS, SECTIONS, CHANNELS)
                asked = _said(source, bytes((ASK_VERSION,)))
                return [_said(source, bytes((VERSION, *options))), asked]
            case _ if kind == ASK_STRUCTURE:
                return [_said(source, bytes((STRUCTURE,)) + (pool.label if pool else absent))]
            case _ if kind == ASK_LOCALIZATION:
                language = pool.localization if pool else absent
                return [_said(source, bytes((LOCALIZATION,)) + language)]
            case _ if kind == ASK_UPLOAD:
                size = int.from_bytes(data[1:5], "little")
                fits = 0 < size <= POOL_BYTES_MAX
                client.upload = PoolUpload(size if fits else 0)
                return [_said(source, bytes((MAY_UPLOAD, 0 if fits else REFUSED)))]
            case _ if kind == ACTIVATE:
                return self._activate(client, bool(data[1]))
            case _ if kind == DELETE:
                return self._delete(client)
            case _ if kind == RENAME:
                return [_said(source, bytes((RENAMED, *data[1:3], REFUSED)))]
        self.counts["no command of a client"] += 1
        return []

    def _take(self, client: ImplementSession, data: bytes) -> bytes:
        """Store a description; returns the answer."""
        upload, size = client.upload, len(data).to_bytes(4, "little")
        if len(upload.received) + len(data) <= POOL_BYTES_MAX:
            upload.add(data)
        pool = _read(client, upload.received) or _read(client, data)
        upload.is_read = pool is not None
        if pool is None and not upload.is_whole:
            return bytes((POOL_TAKEN, 0)) + size  # the rest follows
        if pool is None:
            client.upload = PoolUpload(0)
            self.counts["unreadable description"] += 1
            return bytes((POOL_TAKEN, REFUSED)) + size
        self.stored.pop(client.name, None)
        client.pool = self.stored[client.name] = pool
        client.values.clear()
        if len(self.stored) > STORED_MAX:  # a device that comes back is asked again
            del self.stored[next(iter(self.stored))]
        client.machine.fire(ClientEvent.TAKEN)
        return bytes((POOL_TAKEN, 0)) + size

    def _activate(self, client: ImplementSession, wanted: bool) -> list[ServerOutput]:
        event = ClientEvent.ACTIVATED if wanted else ClientEvent.DEACTIVATED
        if wanted and not client.upload.is_read:
            self.counts["activated in the middle of a description"] += 1
            return [_said(client.source, bytes((ACTIVATED, REFUSED, *b"\xff" * 4, REFUSED)))]
        before, after = client.machine.fire(event)
        right = (after is ACTIVE) is wanted
        answer = bytes((ACTIVATED, 0 if right else REFUSED, *b"\xff" * 4, 0 if right else REFUSED))
        outputs: list[ServerOutput] = [_said(client.source, answer)]
        if after is ACTIVE and wanted:
            if before is ACTIVE:  # it has begun again, and has forgotten what it was told
                outputs.append(ClientLost(client.source))
            self.counts["sessions"] += 1
            client.values.clear()
            outputs.append(ClientActivated(client.source))
        elif before is ACTIVE and after is not ACTIVE:
            outputs.append(ClientLost(client.source))
        return outputs

    def _delete(self, client: ImplementSession) -> list[ServerOutput]:
        self.stored.pop(client.name, None)
        client.pool, client.upload = None, PoolUpload(0)
        before, _ = client.machine.fire(ClientEvent.DELETED)
        lost: Sequence[ServerOutput] = [ClientLost(client.source)] if before is ACTIVE else []
        return [_said(client.source, bytes((DELETED, 0))), *lost]


def _read(client: ImplementSession, data: bytes) -> DevicePool | None:
    """A description in the version that both speak, or in the other one."""
    other = VERSION_3 if client.version >= VERSION_4 else VERSION_4
    return read_pool(data, client.version) or read_pool(data, other)


def _said(destination: int, data: bytes) -> ServerMessage:
    return ServerMessage(destination, data.ljust(8, b"\xff"))


def _key(data: bytes) -> Key:
    return data[0] >> 4 | data[1] << 4, data[2] | data[3] << 8


def _command(command: int, key: Key, number: int) -> bytes:
    element, ddi = key
    return pack("<BBHi", command | (element & 0xF) << 4, element >> 4, ddi, number)
