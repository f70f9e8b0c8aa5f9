"""The client's end of a session with a task controller (ISO 11783-10): log-in, upload, values.

One device's end, sans I/O: commands of the task controller, the time and the values go in, what is to be
sent comes out. It begins when a task controller says that it is there, and again after its silence.
"""

from collections.abc import Mapping
from enum import Enum
from struct import pack, unpack
from typing import Final, NamedTuple

from protocol.device_description import (
    BY_DISTANCE,
    BY_TIME,
    DEFAULT_SET,
    DEVICE,
    EFFECTIVE_DISTANCE,
    ELEMENTS,
    FUNCTION,
    IN_DEFAULT_SET,
    NO_UNITS,
    ON_CHANGE,
    SECTION_CONTROL_STATE,
    SET_BY_CONTROLLER,
    SETPOINT_CONDENSED,
    SETPOINT_WORK_STATE,
    TRIGGERS,
    VALUES,
    VERSION_4,
    DeviceDescription,
)
from protocol.state_machine import StateMachine, matrix
from protocol.units import MS, S

STATUS_US: Final = 2 * S  # between two messages of the client task
SILENT_US: Final = 6 * S  # without a status of the task controller the session is over
ANSWER_US: Final = 6 * S  # limit for an answer; then the log-in begins again
UPLOAD_US: Final = 30 * S  # limit for the answer to a pool
# A task controller that refused us is asked again after this time, doubled each time up to the other. The
# pools of ten robots at each of its statuses would be a third of the bus.
REFUSED_US: Final = 30 * S
REFUSED_MAX_US: Final = 600 * S
INTERVAL_MIN_US: Final = 100 * MS  # shortest time between two values of one trigger
VERSION_3: Final = 3
# Options: task totals and values are told, and sections are switched by the task controller.
DOCUMENTATION, SECTION_CONTROL = 1, 16
OPTIONS: Final = DOCUMENTATION | SECTION_CONTROL
BOOMS, SECTIONS, CHANNELS = 1, 1, 1

# Commands: the low half of the first byte. Those about the description have another one above it.
DESCRIPTION, REQUEST_VALUE, VALUE = 1, 2, 3
TIME_INTERVAL, DISTANCE_INTERVAL, MINIMUM, MAXIMUM, CHANGE = 4, 5, 6, 7, 8
SET_AND_ACKNOWLEDGE, ACKNOWLEDGE, STATUS, CLIENT_TASK = 0xA, 0xD, 0xE, 0xF
ASK_VERSION, VERSION = 0x00, 0x10
ASK_STRUCTURE, STRUCTURE, ASK_LOCALIZATION, LOCALIZATION = 0x01, 0x11, 0x21, 0x31
ASK_UPLOAD, MAY_UPLOAD, POOL, POOL_TAKEN = 0x41, 0x51, 0x61, 0x71
ACTIVATE, ACTIVATED, DELETE, DELETED = 0x81, 0x91, 0xA1, 0xB1
# Reasons of a refusal.
NOT_SUPPORTED, NO_ELEMENT, NO_DDI, NO_TRIGGER, NOT_SETTABLE, BAD_INTERVAL = 1, 2, 4, 8, 16, 32
OBEYED: Final = 0
SECTION_OFF, SECTION_UNCHANGED = 0, 3  # two bits of one section in a condensed state


class SessionState(Enum):
    """How far the log-in is."""

    WAITING = "no task controller has said that it is there"
    VERSION = "its version was asked for"
    STRUCTURE = "the label of our stored description was asked for"
    LOCALIZATION = "the label of its language was asked for"
    DELETING = "an older description of ours is being deleted"
    ASKING = "space for the description was asked for"
    UPLOADING = "the description is sent"
    ACTIVATING = "the stored description is being activated"
    CONNECTED = "values are asked for and sent"


class SessionEvent(Enum):
    """What moves the log-in on."""

    APPEARED = "a task controller has said that it is there"
    VERSION_TOLD = "it has told its version"
    ABSENT = "it has no description of ours"
    OUTDATED = "it has another description of ours"
    EQUAL = "it has this label of ours"
    DELETED = "the older description is gone"
    GRANTED = "there is space"
    STORED = "the description has arrived"
    ACTIVATED = "the description is used"
    LOST = "no answer in time, a refusal, or no status for 6 s"


W, V, T, L, D, A, U, X, C = SessionState
stay = None

# fmt: off
SESSION_TABLE = matrix(
    SessionEvent,
    # state  APPEARED VERSION_TOLD ABSENT OUTDATED EQUAL DELETED GRANTED STORED ACTIVATED LOST
    (W,      V,       stay,        stay,  stay,    stay, stay,   stay,   stay,  stay,     stay),
    (V,      stay,    T,           stay,  stay,    stay, stay,   stay,   stay,  stay,     W),
    (T,      stay,    stay,        A,     D,       L,    stay,   stay,   stay,  stay,     W),
    (L,      stay,    stay,        D,     D,       X,    stay,   stay,   stay,  stay,     W),
    (D,      stay,    stay,        stay,  stay,    stay, A,      stay,   stay,  stay,     W),
    (A,      stay,    stay,        stay,  stay,    stay, stay,   U,      stay,  stay,     W),
    (U,      stay,    stay,        stay,  stay,    stay, stay,   stay,   X,     stay,     W),
    (X,      stay,    stay,        stay,  stay,    stay, stay,   stay,   stay,  C,        W),
    (C,      stay,    stay,        stay,  stay,    stay, stay,   stay,   stay,  stay,     W),
)
# fmt: on


class SessionMessage(NamedTuple):
    """Bytes for the task controller: eight as a frame, more by the transport protocol."""

    data: bytes


class JoinWorkingSet(NamedTuple):
    """Say to all that we are a working set of one."""


SessionOutput = SessionMessage | JoinWorkingSet
Key = tuple[int, int]  # element, DDI
Values = Mapping[Key, int]


class _LogInRefusal(NamedTuple):
    """A task controller has refused us, and is not asked again at once."""

    for_us: int
    log_in_again_at_us: int
    heard_at_us: int  # its newest status


class _Trigger:
    """How often one value is wanted."""

    def __init__(self) -> None:
        self.period_us = 0
        self.due_at_us = 0
        self.every_mm = 0
        self.at_mm = 0
        self.step = 0  # least change
        self.told: int | None = None


class TaskClient:
    """The session of one robot with one task controller at a time."""

    def __init__(self, description: DeviceDescription) -> None:
        self.description = description
        self.server: int | None = None  # address of the task controller
        self.version = VERSION_4  # that both sides speak
        self.sessions = 0  # log-ins that came to their end
        self._machine = StateMachine("task controller session", SESSION_TABLE, W)
        self._heard_at_us = self._due_at_us = self._status_at_us = 0
        self._totals = 0  # the task controller counts: a task is active
        self._refusals: dict[int, _LogInRefusal] = {}  # by address of the task controller
        self._triggers: dict[Key, _Trigger] = {}
        self.setpoints: dict[Key, int] = {}  # as the task controller has set them in this session

    @property
    def work_off(self) -> bool:
        """Whether the task controller has switched the whole implement off."""
        return self.setpoints.get((FUNCTION, SETPOINT_WORK_STATE)) == 0

    @property
    def section_off(self) -> bool:
        """Whether automatic section control has switched our section off."""
        automatic = self.setpoints.get((FUNCTION, SECTION_CONTROL_STATE), 0) == 1
        sections = self.setpoints.get((FUNCTION, SETPOINT_CONDENSED), SECTION_UNCHANGED)
        return automatic and sections & 3 == SECTION_OFF

    @property
    def state(self) -> SessionState:
        """How far the session is."""
        return self._machine.state

    @property
    def due_at_us(self) -> int | None:
        """When `on_timer` has something to do, if nothing is received; None: never."""
        if self.state is W:
            return None
        due = [self._heard_at_us + SILENT_US, self._status_at_us]
        if self.state is not C:
            due.append(self._due_at_us)
        due += [t.due_at_us for t in self._triggers.values() if t.period_us]
        return min(due)

    def reset(self) -> None:
        """Forget the session: we have no address any more."""
        self._lose()

    def refused(self, source: int) -> None:
        """The device at the address `source` refuses our process data. A task controller does so that was
        started again and does not know us: the log-in begins again with its next status.
        """
        if source == self.server:
            self._lose()

    def on_message(
        self, source: int, data: bytes, values: Values, now_us: int
    ) -> list[SessionOutput]:
        """Handle eight bytes of process data from the address `source`; returns what to send."""
        command = data[0] & 0xF
        if command == STATUS:
            return self._status(source, data, now_us)
        if source != self.server or self.state is W:
            return []
        if command in (0, DESCRIPTION):
            return self._login(data, now_us)
        if self.state is not C:
            return []
        return self._command(command, data, values, now_us)

    def on_timer(self, values: Values, now_us: int) -> list[SessionOutput]:
        """Our status, values that are due, and the end of a session that has fallen silent."""
        if self.state is W:
            return []
        late = self.state is not C and now_us >= self._due_at_us
        if late or now_us >= self._heard_at_us + SILENT_US:
            self._lose()
            return []
        outputs: list[SessionOutput] = []
        if now_us >= self._status_at_us:
            self._status_at_us = now_us + STATUS_US
            outputs.append(_frame(pack("<B3sI", 0xFF, b"\xff\xff\xff", self._totals)))
        return outputs + self.changed(values, now_us)

    def changed(self, values: Values, now_us: int) -> list[SessionOutput]:
        """Values that are to be told now, because of their time, our way, or a change."""
        outputs: list[SessionOutput] = []
        distance_mm = values.get((FUNCTION, EFFECTIVE_DISTANCE), 0)
        for key, trigger in self._triggers.items():
            value = values.get(key, 0)
            due = bool(trigger.period_us) and now_us >= trigger.due_at_us
            far = bool(trigger.every_mm) and distance_mm >= trigger.at_mm
            moved = bool(trigger.step) and (
                trigger.told is None or abs(value - trigger.told) >= trigger.step
            )
            if due:
                missed = (now_us - trigger.due_at_us) // trigger.period_us
                trigger.due_at_us += (missed + 1) * trigger.period_us
            if far:
                trigger.at_mm = distance_mm + trigger.every_mm
            if due or far or moved:
                trigger.told = value
                outputs.append(_value(key, value))
        return outputs

    # ---------------------------------------------------------------- log-in

    def _status(self, source: int, data: bytes, now_us: int) -> list[SessionOutput]:
        """A task controller says that it is there. The first one is taken, until it is silent."""
        refusal = self._refusals.get(source)
        if refusal is not None:
            if now_us < refusal.heard_at_us + SILENT_US:
                self._refusals[source] = refusal._replace(heard_at_us=now_us)
            else:  # it may be another one, or have other room
                del self._refusals[source]
                refusal = None
        if self.state is not W and source != self.server:
            return []
        if self.state is W and refusal is not None and now_us < refusal.log_in_again_at_us:
            return []
        self._heard_at_us, self._totals = now_us, data[4] & 1
        if self.state is not W:
            return []
        self.server = source
        self._machine.fire(SessionEvent.APPEARED)
        self._status_at_us = now_us + STATUS_US
        return [
            JoinWorkingSet(),
            _frame(pack("<B3sI", 0xFF, b"\xff\xff\xff", self._totals)),
            *self._ask(bytes((ASK_VERSION,)), now_us),
        ]

    def _login(self, data: bytes, now_us: int) -> list[SessionOutput]:
        kind = data[0]
        if kind == ASK_VERSION:
            options = bytes((VERSION, self.version, 0xFF, OPTIONS, 0, BOOMS, SECTIONS, CHANNELS))
            return [SessionMessage(options)]
        expected = {
            V: (VERSION, self._told_version), T: (STRUCTURE, self._told_structure),
            L: (LOCALIZATION, self._told_localization), D: (DELETED, self._deleted),
            A: (MAY_UPLOAD, self._granted), U: (POOL_TAKEN, self._stored),
            X: (ACTIVATED, self._activated),
        }.get(self.state)  # fmt: skip
        if expected is None or kind != expected[0]:
            return []
        return expected[1](data, now_us)

    def _told_version(self, data: bytes, now_us: int) -> list[SessionOutput]:
        self.version = min(max(data[1], VERSION_3), VERSION_4)
        self._machine.fire(SessionEvent.VERSION_TOLD)
        return self._ask(bytes((ASK_STRUCTURE,)), now_us)

    def _told_structure(self, data: bytes, now_us: int) -> list[SessionOutput]:
        label = data[1:8]
        if label == b"\xff" * 7:
            self._machine.fire(SessionEvent.ABSENT)
            return self._ask_upload(now_us)
        if label != self.description.label:
            return self._delete(now_us)
        self._machine.fire(SessionEvent.EQUAL)
        return self._ask(bytes((ASK_LOCALIZATION,)), now_us)

    def _told_localization(self, data: bytes, now_us: int) -> list[SessionOutput]:
        if data[1:8] != NO_UNITS:
            return self._delete(now_us)
        self._machine.fire(SessionEvent.EQUAL)
        return self._ask(bytes((ACTIVATE, 0xFF)), now_us)

    def _delete(self, now_us: int) -> list[SessionOutput]:
        self._machine.fire(SessionEvent.OUTDATED)
        return self._ask(bytes((DELETE,)), now_us)

    def _deleted(self, data: bytes, now_us: int) -> list[SessionOutput]:
        self._machine.fire(SessionEvent.DELETED)
        return self._ask_upload(now_us)

    def _ask_upload(self, now_us: int) -> list[SessionOutput]:
        size = len(self.description.pool(self.version))
        return self._ask(bytes((ASK_UPLOAD,)) + size.to_bytes(4, "little"), now_us)

    def _granted(self, data: bytes, now_us: int) -> list[SessionOutput]:
        if data[1]:
            self._refused(now_us)
            return []
        self._machine.fire(SessionEvent.GRANTED)
        self._due_at_us = now_us + UPLOAD_US
        return [SessionMessage(bytes((POOL,)) + self.description.pool(self.version))]

    def _stored(self, data: bytes, now_us: int) -> list[SessionOutput]:
        if data[1]:
            self._refused(now_us)
            return []
        self._machine.fire(SessionEvent.STORED)
        return self._ask(bytes((ACTIVATE, 0xFF)), now_us)

    def _activated(self, data: bytes, now_us: int) -> list[SessionOutput]:
        if data[1]:
            self._refused(now_us)
            return []
        self._machine.fire(SessionEvent.ACTIVATED)
        self.sessions += 1
        if self.server is not None:
            self._refusals.pop(self.server, None)
        return []

    def _ask(self, data: bytes, now_us: int) -> list[SessionOutput]:
        self._due_at_us = now_us + ANSWER_US
        return [_frame(data)]

    def _refused(self, now_us: int) -> None:
        """It has no room for our description, or cannot use it."""
        assert self.server is not None
        before = self._refusals.get(self.server)
        longer_for_us = 0 if before is None else 2 * before.for_us
        for_us = min(max(longer_for_us, REFUSED_US), REFUSED_MAX_US)
        self._refusals[self.server] = _LogInRefusal(for_us, now_us + for_us, self._heard_at_us)
        self._lose()

    def _lose(self) -> None:
        self._machine.fire(SessionEvent.LOST)
        self.server, self._totals = None, 0
        self._triggers.clear()
        self.setpoints.clear()

    # ---------------------------------------------------------------- values

    def _command(
        self, command: int, data: bytes, values: Values, now_us: int
    ) -> list[SessionOutput]:
        element, ddi = data[0] >> 4 | data[1] << 4, data[2] | data[3] << 8
        (number,) = unpack("<i", data[4:8])
        key = (element, ddi)
        if command == REQUEST_VALUE:
            if key == (DEVICE, DEFAULT_SET):
                return self._default_set(values, now_us)
            if key in TRIGGERS:
                return [_value(key, values.get(key, 0))]
            return [_acknowledged(data, self._unknown(element), command)]
        if command in (VALUE, SET_AND_ACKNOWLEDGE):
            if key in SET_BY_CONTROLLER:
                self._set(key, number)
                return (
                    [_acknowledged(data, OBEYED, command)] if command == SET_AND_ACKNOWLEDGE else []
                )
            reason = NOT_SETTABLE if key in TRIGGERS else self._unknown(element)
            return [_acknowledged(data, reason, command)]
        if command in (TIME_INTERVAL, DISTANCE_INTERVAL, CHANGE):
            reason = self._measure(command, key, number, values, now_us)
            return [_acknowledged(data, reason, command)] if reason else []
        if command in (MINIMUM, MAXIMUM):
            return [_acknowledged(data, NO_TRIGGER, command)]
        return []

    def _set(self, key: Key, number: int) -> None:
        """Take a value of the task controller; it holds until the session ends."""
        if key[1] == SETPOINT_CONDENSED and number & 3 == SECTION_UNCHANGED:
            return
        self.setpoints[key] = number

    @staticmethod
    def _unknown(element: int) -> int:
        return NO_DDI if element in ELEMENTS else NO_ELEMENT

    def _measure(self, command: int, key: Key, number: int, values: Values, now_us: int) -> int:
        """Begin or end (0) to tell a value; returns the reason of a refusal, 0 for none."""
        known = TRIGGERS.get(key)
        if known is None:
            return self._unknown(key[0])
        wanted = {TIME_INTERVAL: BY_TIME, DISTANCE_INTERVAL: BY_DISTANCE, CHANGE: ON_CHANGE}[
            command
        ]
        if not known & wanted:
            return NO_TRIGGER
        if number < 0:
            return BAD_INTERVAL
        trigger = self._triggers.setdefault(key, _Trigger())
        if command == TIME_INTERVAL:
            trigger.period_us = max(number * MS, INTERVAL_MIN_US) if number else 0
            trigger.due_at_us = now_us + trigger.period_us
        elif command == DISTANCE_INTERVAL:
            trigger.every_mm = number
            trigger.at_mm = values.get((FUNCTION, EFFECTIVE_DISTANCE), 0) + number
        else:
            trigger.step, trigger.told = number, None
        return 0

    def _default_set(self, values: Values, now_us: int) -> list[SessionOutput]:
        """Tell the default set now, and its states on change."""
        outputs: list[SessionOutput] = []
        for value in VALUES:
            if not value.properties & IN_DEFAULT_SET:
                continue
            key = (value.element, value.ddi)
            told = values.get(key, 0)
            if value.triggers & ON_CHANGE:
                trigger = self._triggers.setdefault(key, _Trigger())
                trigger.step, trigger.told = 1, told
            outputs.append(_value(key, told))
        return outputs


def _frame(data: bytes) -> SessionMessage:
    return SessionMessage(data.ljust(8, b"\xff"))


def _value(key: Key, number: int) -> SessionMessage:
    element, ddi = key
    bounded = max(-(1 << 31), min(number, (1 << 31) - 1))
    return SessionMessage(pack("<BBHi", VALUE | (element & 0xF) << 4, element >> 4, ddi, bounded))


def _acknowledged(data: bytes, reason: int, command: int) -> SessionMessage:
    """The answer to a command; `reason`: why it is not obeyed, or OBEYED."""
    return _frame(bytes((ACKNOWLEDGE | data[0] & 0xF0, *data[1:4], reason, 0xF0 | command)))
