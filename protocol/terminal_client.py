"""The client's end of a session with a virtual terminal (ISO 11783-6): log-in, screen, keys, alarms.

One device's end, sans I/O: messages of the terminal and the time go in, what is to be sent and which keys
were pressed comes out. `serve` says whether this device shows the screen now.
"""

from collections import deque
from enum import Enum
from struct import pack, unpack_from
from typing import Final, NamedTuple

from protocol.state_machine import StateMachine, matrix
from protocol.terminal_pool import (
    ACKNOWLEDGE_CODE,
    ALARM_CHARACTERS,
    ALARM_MASK,
    ALARM_TEXT,
    COVERED,
    DATA_MASK,
    DOTS_MAX,
    DOTS_MIN,
    FIRST_ROW,
    RELEASE_CODE,
    ROW_CHARACTERS,
    STOP_CODE,
    WORKING_SET,
    padded,
)
from protocol.units import MS, S

MAINTENANCE_US: Final = 1 * S  # between two working set maintenance messages
TERMINAL_SILENT_US: Final = 3 * S  # without a status the terminal is gone
# For one answer; the standard's T2 of the transport is 1,250 ms.
TERMINAL_ANSWER_US: Final = 1500 * MS
TERMINAL_UPLOAD_US: Final = 10 * S  # until the end of a pool is answered
# A terminal that refused the pool is asked again after this time, doubled each time up to the other. The
# pool at each of its statuses would be a fifth of the bus.
REFUSED_US: Final = 30 * S
REFUSED_MAX_US: Final = 600 * S
# A terminal that did not answer the log-in is left for so long: another one on the bus may answer.
MUTE_US: Final = 2 * S
CHANGE_GAP_US: Final = 150 * MS  # between two changes: a text takes eight frames
PROBE_US: Final = 800 * MS  # a number is said again: a terminal that was restarted does not answer
CHANGES_MAX: Final = 64  # that wait; each line waits once
CLIENT_VERSION: Final = 3  # of the standard that our pool needs

# Functions of ISO 11783-6.
SOFT_KEY, STATUS, MAINTENANCE = 0x00, 0xFE, 0xFF
GET_MEMORY, GET_FONTS, GET_HARDWARE = 0xC0, 0xC3, 0xC7
POOL, POOL_END, DELETE_POOL = 0x11, 0x12, 0xB2
CHANGE_NUMBER, CHANGE_MASK, CHANGE_TEXT = 0xA8, 0xAD, 0xB3
PRESSED, ACKNOWLEDGE_OF_TERMINAL = 1, 0  # activation code; key code of the terminal's own ACK key


class TerminalState(Enum):
    """How far the screen is."""

    AWAY = "no terminal is heard, or another robot shows the screen"
    MEMORY = "space for the pool was asked for"
    FONTS = "its fonts were asked for"
    HARDWARE = "the size of its screen was asked for"
    SENDING = "the pool is sent, and its end was said"
    SHOWN = "the screen is there"


class TerminalEvent(Enum):
    """What moves the log-in on."""

    CALLED = "a terminal is heard, and this robot is to show the screen"
    SPACE = "there is space"
    FONTS_TOLD = "its fonts are known"
    SIZE_TOLD = "the size of its screen is known"
    POOL_RIGHT = "it has read the pool without an error"
    REDRAWN = "the picture is sent again"
    GONE = "no answer in time, a refusal, silence for 3 s, or another robot's turn"


AWAY, MEMORY, FONTS, HARDWARE, SENDING, SHOWN = TerminalState
stay = None

# fmt: off
TERMINAL_TABLE = matrix(
    TerminalEvent,
    # state     CALLED  SPACE  FONTS_TOLD  SIZE_TOLD  POOL_RIGHT  REDRAWN  GONE
    (AWAY,      MEMORY, stay,  stay,       stay,      stay,       stay,    stay),
    (MEMORY,    stay,   FONTS, stay,       stay,      stay,       stay,    AWAY),
    (FONTS,     stay,   stay,  HARDWARE,   stay,      stay,       stay,    AWAY),
    (HARDWARE,  stay,   stay,  stay,       SENDING,   stay,       stay,    AWAY),
    (SENDING,   stay,   stay,  stay,       stay,      SHOWN,      stay,    AWAY),
    (SHOWN,     stay,   stay,  stay,       stay,      stay,       SENDING, AWAY),
)
# fmt: on


class TerminalKey(Enum):
    """What a person has pressed."""

    STOP = STOP_CODE
    RELEASE = RELEASE_CODE
    ACKNOWLEDGE = ACKNOWLEDGE_CODE


class TerminalData(NamedTuple):
    """Bytes for the terminal: eight as a frame, more by a transport protocol."""

    data: bytes


class JoinTerminal(NamedTuple):
    """Say to all that we are a working set of one."""


class PoolWanted(NamedTuple):
    """The screen is to be drawn now: call `upload` with its pool. `dots`: edge of its data mask."""

    dots: int


class KeyPressed(NamedTuple):
    """A person has pressed a key of the screen."""

    key: TerminalKey


TerminalOutput = TerminalData | JoinTerminal | PoolWanted | KeyPressed


class ShownScreen(NamedTuple):
    """What the terminal shows, or will when the changes that wait are said."""

    rows: tuple[str, ...] = ()
    covered_percent: int = 0
    alarm: str = ""


class _Refusal(NamedTuple):
    """A terminal has refused our pool, and is not asked again at once."""

    for_us: int
    call_again_at_us: int
    heard_at_us: int  # its newest status


class TerminalClient:
    """The session of one robot with one virtual terminal at a time."""

    def __init__(self) -> None:
        self.server: int | None = None  # address of the terminal that was heard last
        self.screens = 0  # screens that came up
        self.serves = False
        self.shown = ShownScreen()
        self._machine = StateMachine("screen on a terminal", TERMINAL_TABLE, AWAY)
        self._heard_at_us = self._due_at_us = self._maintain_at_us = 0
        self._dots = DOTS_MIN
        self._changes: deque[bytes] = deque()
        self._change_at_us = self._probe_at_us = 0
        self._unanswered_at_us: int | None = None  # of the oldest change without an answer
        self._awaited = 0  # function of that change
        self._refusals: dict[int, _Refusal] = {}  # by address of the terminal
        self._redraws = False  # what is sent is the picture alone
        self._refuses: int | None = None  # address of a terminal that took no picture alone

    @property
    def state(self) -> TerminalState:
        """How far the screen is."""
        return self._machine.state

    @property
    def due_at_us(self) -> int | None:
        """When `on_timer` has something to do, if nothing is received; None: never."""
        if self.state is AWAY:
            return None
        due = [self._heard_at_us + TERMINAL_SILENT_US, self._maintain_at_us]
        if self.state is not SHOWN:
            due.append(self._due_at_us)
        elif self._unanswered_at_us is None:
            due.append(self._change_at_us if self._changes else self._probe_at_us)
        else:
            due.append(self._unanswered_at_us + TERMINAL_ANSWER_US)
        return min(due)

    def serve(self, wanted: bool, now_us: int) -> list[TerminalOutput]:
        """Whether this robot shows the screen from now on. It takes its screen down when it stops."""
        if wanted == self.serves:
            return []
        self.serves = wanted
        if wanted:
            return self._call(now_us)
        outputs: list[TerminalOutput] = []
        if self.state is not AWAY and self.server is not None:
            outputs.append(_terminal_frame(bytes((DELETE_POOL,))))
        self._lose()
        return outputs

    def reset(self) -> None:
        """Forget the session without a word: we have no address any more."""
        self.serves = False
        self._lose()

    def on_message(self, source: int, data: bytes, now_us: int) -> list[TerminalOutput]:
        """Handle eight bytes of a terminal at the address `source`."""
        function = data[0]
        if function == STATUS:
            return self._status(source, now_us)
        if source != self.server or self.state is AWAY:
            return []
        if function == SOFT_KEY:
            return self._key(data)
        if function in (CHANGE_NUMBER, CHANGE_MASK, CHANGE_TEXT):
            if function == self._awaited:
                self._unanswered_at_us = None
            return []
        answered = {
            MEMORY: (GET_MEMORY, self._memory), FONTS: (GET_FONTS, self._fonts),
            HARDWARE: (GET_HARDWARE, self._hardware), SENDING: (POOL_END, self._read),
        }.get(self.state)  # fmt: skip
        if answered is None or answered[0] != function:
            return []
        return answered[1](data, now_us)

    def on_timer(self, now_us: int) -> list[TerminalOutput]:
        """Maintenance, a change that waits, and the end of a session that has fallen silent."""
        if self.state is AWAY:
            return []
        mute = late = self.state is not SHOWN and now_us >= self._due_at_us
        if self._unanswered_at_us is not None:
            late = now_us >= self._unanswered_at_us + TERMINAL_ANSWER_US
        silent = now_us >= self._heard_at_us + TERMINAL_SILENT_US
        if silent and self.server is not None:
            self._refusals.pop(self.server, None)
        elif mute and self.server is not None:
            before = self._refusals.get(self.server)
            for_us = 0 if before is None else before.for_us
            self._refusals[self.server] = _Refusal(for_us, now_us + MUTE_US, self._heard_at_us)
        if late or silent:
            self._lose()
            return self._call(now_us)
        outputs: list[TerminalOutput] = []
        if now_us >= self._maintain_at_us:
            outputs.append(self._maintenance(now_us))
        if (
            self._unanswered_at_us is not None
        ):  # one change at a time: a lost one brings the screen again
            return outputs
        if self.state is SHOWN and not self._changes and now_us >= self._probe_at_us:
            body = pack("<BHBI", CHANGE_NUMBER, COVERED, 0xFF, self.shown.covered_percent)
            self._changes.append(body)
        if self.state is SHOWN and self._changes and now_us >= self._change_at_us:
            self._change_at_us, self._probe_at_us = now_us + CHANGE_GAP_US, now_us + PROBE_US
            change = self._changes.popleft()
            self._unanswered_at_us, self._awaited = now_us, change[0]
            outputs.append(TerminalData(change))
        return outputs

    def upload(self, pool: bytes, shown: ShownScreen, now_us: int) -> list[TerminalOutput]:
        """Send the pool, as `PoolWanted` has asked for. `shown`: what is in it."""
        assert self.state is SENDING
        self._due_at_us = now_us + TERMINAL_UPLOAD_US
        self.shown = shown
        return [TerminalData(bytes((POOL,)) + pool)]

    def uploaded(self) -> list[TerminalOutput]:
        """The pool has arrived: say that it is whole."""
        return [_terminal_frame(bytes((POOL_END,)))] if self.state is SENDING else []

    @property
    def redrawable(self) -> bool:
        """Whether an object can be sent again now: not while a change waits, and not to a terminal that
        has refused one, which keeps the first picture.
        """
        waits = bool(self._changes) or self._unanswered_at_us is not None
        return self.state is SHOWN and not waits and self._refuses != self.server

    def redraw(self, picture: bytes, now_us: int) -> list[TerminalOutput]:
        """Send an object of the pool again, in the place of the one that is shown; nothing if that is not
        possible now.
        """
        if not self.redrawable:
            return []
        self._machine.fire(TerminalEvent.REDRAWN)
        self._redraws, self._due_at_us = True, now_us + TERMINAL_UPLOAD_US
        return [TerminalData(bytes((POOL,)) + picture)]

    def show(self, wanted: ShownScreen, now_us: int) -> None:
        """Change what differs; each change is said in its turn."""
        if self.state is not SHOWN or self._changes:
            return
        missing = len(self.shown.rows) - len(
            wanted.rows
        )  # lines of the pool for which there is no robot now
        wanted = wanted._replace(rows=(*wanted.rows, *[""] * missing))
        for k, (row, before) in enumerate(zip(wanted.rows, self.shown.rows, strict=False)):
            if row != before:
                self._changes.append(_changed_text(FIRST_ROW + k, padded(row, ROW_CHARACTERS)))
        if wanted.covered_percent != self.shown.covered_percent:
            body = pack("<BHBI", CHANGE_NUMBER, COVERED, 0xFF, wanted.covered_percent)
            self._changes.append(body)
        if wanted.alarm != self.shown.alarm:
            mask = ALARM_MASK if wanted.alarm else DATA_MASK
            urgent = [pack("<BHHBBB", CHANGE_MASK, WORKING_SET, mask, 0xFF, 0xFF, 0xFF)]
            if wanted.alarm:
                urgent.insert(0, _changed_text(ALARM_TEXT, padded(wanted.alarm, ALARM_CHARACTERS)))
            self._changes.extendleft(reversed(urgent))
        self.shown = wanted
        assert len(self._changes) <= CHANGES_MAX
        self._change_at_us = max(self._change_at_us, now_us)

    # ---------------------------------------------------------------- log-in

    def _status(self, source: int, now_us: int) -> list[TerminalOutput]:
        refusal = self._refusals.get(source)
        if refusal is not None:
            if now_us < refusal.heard_at_us + TERMINAL_SILENT_US:
                self._refusals[source] = refusal._replace(heard_at_us=now_us)
            else:
                del self._refusals[source]  # it may be another one, or a repaired one
        if self.state is not AWAY and source != self.server:
            return []
        self.server, self._heard_at_us = source, now_us
        return self._call(now_us)

    def _call(self, now_us: int) -> list[TerminalOutput]:
        """Begin the log-in, if it is our turn and a terminal is there."""
        heard = self.server is not None and now_us < self._heard_at_us + TERMINAL_SILENT_US
        if self.state is not AWAY or not self.serves or not heard:
            return []
        refusal = None if self.server is None else self._refusals.get(self.server)
        if refusal is not None and now_us < refusal.call_again_at_us:
            return []
        self._machine.fire(TerminalEvent.CALLED)
        first = TerminalData(pack("<BBBIB", MAINTENANCE, 1, CLIENT_VERSION, 0xFFFF_FFFF, 0xFF))
        self._maintain_at_us = now_us + MAINTENANCE_US
        ask = pack("<BBIH", GET_MEMORY, 0xFF, 1 << 13, 0xFFFF)
        return [JoinTerminal(), first, *self._ask(ask, now_us)]

    def _memory(self, data: bytes, now_us: int) -> list[TerminalOutput]:
        if data[2]:
            self._refused(now_us)
            return []
        self._machine.fire(TerminalEvent.SPACE)
        return self._ask(bytes((GET_FONTS,)), now_us)

    def _fonts(self, data: bytes, now_us: int) -> list[TerminalOutput]:
        self._machine.fire(TerminalEvent.FONTS_TOLD)
        return self._ask(bytes((GET_HARDWARE,)), now_us)

    def _hardware(self, data: bytes, now_us: int) -> list[TerminalOutput]:
        (width,) = unpack_from("<H", data, 4)
        self._machine.fire(TerminalEvent.SIZE_TOLD)
        self._due_at_us = now_us + TERMINAL_UPLOAD_US
        self._dots = min(max(width, DOTS_MIN), DOTS_MAX)  # 0xFFFF: it does not say
        return [PoolWanted(self._dots)]

    def _read(self, data: bytes, now_us: int) -> list[TerminalOutput]:
        if data[1]:
            if self._redraws:
                self._refuses = self.server
                self._lose()
            else:
                self._refused(now_us)
            return []
        self._machine.fire(TerminalEvent.POOL_RIGHT)
        if self.server is not None:
            self._refusals.pop(self.server, None)
        self.screens += not self._redraws
        self._redraws = False
        self._changes.clear()
        return []

    def _ask(self, data: bytes, now_us: int) -> list[TerminalOutput]:
        self._due_at_us = now_us + TERMINAL_ANSWER_US
        return [_terminal_frame(data)]

    def _maintenance(self, now_us: int) -> TerminalOutput:
        self._maintain_at_us = now_us + MAINTENANCE_US
        return TerminalData(pack("<BBBIB", MAINTENANCE, 0, CLIENT_VERSION, 0xFFFF_FFFF, 0xFF))

    def _refused(self, now_us: int) -> None:
        self._lose()
        assert self.server is not None
        before = self._refusals.get(self.server)
        longer_for_us = 0 if before is None else 2 * before.for_us
        for_us = min(max(longer_for_us, REFUSED_US), REFUSED_MAX_US)
        self._refusals[self.server] = _Refusal(for_us, now_us + for_us, self._heard_at_us)

    def _lose(self) -> None:
        self._machine.fire(TerminalEvent.GONE)
        self._changes.clear()
        self.shown, self._unanswered_at_us, self._redraws = ShownScreen(), None, False

    # ---------------------------------------------------------------- keys

    def _key(self, data: bytes) -> list[TerminalOutput]:
        """A key; the terminal wants its bytes back."""
        code, key = data[1], data[6]
        answer = TerminalData(data[:7] + b"\xff")
        if code != PRESSED:
            return [answer]
        if key == ACKNOWLEDGE_OF_TERMINAL:
            return [answer, KeyPressed(TerminalKey.ACKNOWLEDGE)]
        if key in {each.value for each in TerminalKey}:
            return [answer, KeyPressed(TerminalKey(key))]
        return [answer]


def _terminal_frame(data: bytes) -> TerminalData:
    return TerminalData(data.ljust(8, b"\xff"))


def _changed_text(number: int, text: bytes) -> bytes:
    return pack("<BHH", CHANGE_TEXT, number, len(text)) + text
