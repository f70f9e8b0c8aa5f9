"""Extended transport protocol: messages above 1,785 bytes to one device (ISO 11783-3).

For the pictures of a terminal and the descriptions of large implements. One device's end, sans I/O, as
`protocol/transport.py`: frames and the time go in, frames and whole messages come out.
"""

from collections import Counter
from enum import Enum, IntEnum
from typing import Final, NamedTuple

from protocol.frames.network_frames import ExtendedTransportData, ExtendedTransportManagement
from protocol.state_machine import StateMachine, matrix
from protocol.transport import (
    PACKET,
    RETRIES_MAX,
    SIZE_MAX,
    T1_US,
    T2_US,
    T3_US,
    WORDS_MAX,
    Abort,
    ReceivedMessage,
)
from protocol.units import MS

LONG_SIZE_MIN: Final = SIZE_MAX + 1
LONG_SIZE_MAX: Final = 1 << 16  # that we take and send; the standard allows 117 MB
DATA_GAP_US: Final = 1 * MS  # between our packets: two thirds of the bus, at its lowest priority
# After a DPO: its identifier is less urgent than that of packets, which would overtake it in our queue.
OFFSET_GAP_US: Final = 10 * MS
BURST_MAX: Final = 255  # packets after one DPO
GRANT_PACKETS: Final = 64  # that we let a sender send before it needs the next CTS
RECEIVING_MAX, SENDING_MAX = 4, 2  # sessions


class ExtendedControl(IntEnum):
    """The first byte of an ETP.CM frame, with the numbers of the standard."""

    RTS = 20
    CTS = 21
    DPO = 22
    END = 23
    ABORT = 255


class LongSendingState(Enum):
    """How far a long message of ours is."""

    AWAITING = "an answer of the receiver is due: a CTS, or the end of message"
    SENDING = "the packets of the newest grant are sent, after their DPO"
    CLOSED = "the message has arrived, or was given up"


class LongSendingEvent(Enum):
    """What moves a long message of ours."""

    GRANTED = "a CTS asks for packets"
    ON_HOLD = "a CTS asks for none: the receiver needs time"
    GRANT_SENT = "the last packet of the grant was sent"
    DELIVERED = "the receiver has acknowledged the end"
    TIMED_OUT = "no answer came in time"
    GIVEN_UP = "the receiver asks for what there is not, or asks too often"
    ABORTED = "the receiver has ended the session"


AWAITING, SENDING, CLOSED = LongSendingState
stay = None

# fmt: off
LONG_SENDING_TABLE = matrix(
    LongSendingEvent,
    # state     GRANTED  ON_HOLD   GRANT_SENT  DELIVERED  TIMED_OUT  GIVEN_UP  ABORTED
    (AWAITING,  SENDING, stay,     stay,       CLOSED,    CLOSED,    CLOSED,   CLOSED),
    (SENDING,   stay,    AWAITING, AWAITING,   stay,      stay,      CLOSED,   CLOSED),
    (CLOSED,    stay,    stay,     stay,       stay,      stay,      stay,     stay),
)
# fmt: on


class LongOutgoing(NamedTuple):
    """An ETP.CM or ETP.DT to send, and the address that it goes to."""

    message: ExtendedTransportManagement | ExtendedTransportData
    destination: int


class _LongReceiving:
    """A long message that is being received."""

    def __init__(self, pgn: int, size: int) -> None:
        self.pgn, self.size = pgn, size
        self.packets = -(-size // PACKET)
        self.data = bytearray()
        self.offset = -1  # of the newest DPO; -1: none for the newest grant
        self.granted_to = 0
        self.retries = 0
        self.due_at_us = 0

    @property
    def expected(self) -> int:
        """The number of the next packet, from 1."""
        return len(self.data) // PACKET + 1


class _LongSending:
    """A long message that is being sent by us."""

    def __init__(self, pgn: int, data: bytes, destination: int) -> None:
        self.pgn, self.data, self.destination = pgn, data, destination
        self.packets = -(-len(data) // PACKET)
        self.next = self.last = self.offset = 0  # packets of the newest grant
        self.words = 0  # CTS received
        self.dpo_due = False
        self.machine = StateMachine("long transport session", LONG_SENDING_TABLE, AWAITING)
        self.due_at_us = 0


class ExtendedTransport:
    """One device's long sessions, to it and from it."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()  # errors and successes, by kind
        self._receiving: dict[int, _LongReceiving] = {}  # by source
        self._sending: dict[int, _LongSending] = {}  # by destination

    @property
    def due_at_us(self) -> int | None:
        """When `on_tick` next has something to do; None: no session is open."""
        if not self._receiving and not self._sending:
            return None
        due = [session.due_at_us for session in self._receiving.values()]
        due += [session.due_at_us for session in self._sending.values()]
        return min(due, default=None)

    def send(
        self, pgn: int, data: bytes, destination: int, now_us: int
    ) -> list[LongOutgoing] | None:
        """Start to send a message of 1,786 bytes or more; None if a session to that device is open."""
        assert LONG_SIZE_MIN <= len(data) <= LONG_SIZE_MAX
        if destination in self._sending or len(self._sending) >= SENDING_MAX:
            self.counts["refused"] += 1
            return None
        session = self._sending[destination] = _LongSending(pgn, data, destination)
        session.due_at_us = now_us + T3_US
        size = len(data).to_bytes(4, "little")
        return [_manage(ExtendedControl.RTS, size, pgn, destination)]

    def forget(self, destination: int) -> None:
        """End our session to an address: its device is gone."""
        self._sending.pop(destination, None)

    def close_all(self) -> None:
        """End all sessions without a word: we have no address."""
        self._sending.clear()
        self._receiving.clear()

    def on_tick(self, now_us: int) -> list[LongOutgoing]:
        """Send packets that are due; end sessions that have timed out."""
        out: list[LongOutgoing] = []
        for sending in list(self._sending.values()):
            if now_us >= sending.due_at_us:
                out += self._send_on(sending, now_us)
        for source, receiving in list(self._receiving.items()):
            if now_us >= receiving.due_at_us:
                out += self._overdue(source, receiving, now_us)
        return out

    def on_message(
        self, source: int, m: ExtendedTransportManagement | ExtendedTransportData, now_us: int
    ) -> tuple[list[LongOutgoing], ReceivedMessage | None]:
        """Handle a frame that was sent to us; returns the answers, and a message that is complete."""
        if isinstance(m, ExtendedTransportData):
            return self._data(source, m, now_us)
        match m.control:
            case ExtendedControl.RTS:
                return self._announced(source, m, now_us), None
            case ExtendedControl.DPO:
                return self._offset(source, m, now_us), None
            case ExtendedControl.CTS:
                return self._granted(source, m, now_us), None
            case ExtendedControl.END:
                self._ended(source, m, LongSendingEvent.DELIVERED)
            case ExtendedControl.ABORT:
                self._ended(source, m, LongSendingEvent.ABORTED)
                receiving = self._receiving.get(source)
                if receiving is not None and receiving.pgn == m.pgn:
                    del self._receiving[source]
            case _:
                self.counts["malformed"] += 1
        return [], None

    # ---------------------------------------------------------------- sending

    def _send_on(self, session: _LongSending, now_us: int) -> list[LongOutgoing]:
        if session.machine.state is AWAITING:
            self._fire(session, LongSendingEvent.TIMED_OUT)
            return [_abort(Abort.TIMEOUT, session.pgn, session.destination)]
        session.due_at_us = now_us + DATA_GAP_US
        if session.dpo_due:
            session.dpo_due = False
            session.due_at_us = now_us + OFFSET_GAP_US
            count = session.last - session.next + 1
            body = bytes((count,)) + session.offset.to_bytes(3, "little")
            return [_manage(ExtendedControl.DPO, body, session.pgn, session.destination)]
        number = session.next
        session.next += 1
        body = session.data[PACKET * (number - 1) : PACKET * number].ljust(PACKET, b"\xff")
        if session.next > session.last:
            self._fire(session, LongSendingEvent.GRANT_SENT)
            session.due_at_us = now_us + T3_US
        data = ExtendedTransportData(number - session.offset, body)
        return [LongOutgoing(data, session.destination)]

    def _granted(
        self, source: int, m: ExtendedTransportManagement, now_us: int
    ) -> list[LongOutgoing]:
        session = self._sending.get(source)
        if session is None or session.pgn != m.pgn:
            self.counts["unexpected CTS"] += 1
            return []
        count, first = m.body[0], int.from_bytes(m.body[1:4], "little")
        session.words += 1
        if session.words > session.packets + WORDS_MAX or (
            count and not 1 <= first <= session.packets
        ):
            self._fire(session, LongSendingEvent.GIVEN_UP)
            return [_abort(Abort.UNEXPECTED_CTS, m.pgn, source)]
        if count == 0:
            self._fire(session, LongSendingEvent.ON_HOLD)
            session.due_at_us = now_us + T3_US
            return []
        self._fire(session, LongSendingEvent.GRANTED)
        session.next, session.offset, session.dpo_due = first, first - 1, True
        session.last = min(first + min(count, BURST_MAX) - 1, session.packets)
        session.due_at_us = now_us
        return self._send_on(session, now_us)

    def _ended(self, source: int, m: ExtendedTransportManagement, event: LongSendingEvent) -> None:
        session = self._sending.get(source)
        if session is not None and session.pgn == m.pgn:
            self._fire(session, event)

    def _fire(self, session: _LongSending, event: LongSendingEvent) -> None:
        before, after = session.machine.fire(event)
        if after is CLOSED and before is not CLOSED:
            del self._sending[session.destination]
            self.counts[event.name.lower().replace("_", " ")] += 1

    # ---------------------------------------------------------------- receiving

    def _announced(
        self, source: int, m: ExtendedTransportManagement, now_us: int
    ) -> list[LongOutgoing]:
        size = int.from_bytes(m.body, "little")
        if not LONG_SIZE_MIN <= size <= LONG_SIZE_MAX:
            self.counts["malformed"] += 1
            return [_abort(Abort.RESOURCES, m.pgn, source)]
        if source not in self._receiving and len(self._receiving) >= RECEIVING_MAX:
            self.counts["refused"] += 1
            return [_abort(Abort.RESOURCES, m.pgn, source)]
        session = self._receiving[source] = _LongReceiving(m.pgn, size)
        return [self._grant(source, session, now_us)]

    def _grant(self, source: int, session: _LongReceiving, now_us: int) -> LongOutgoing:
        count = min(session.packets - session.expected + 1, GRANT_PACKETS)
        session.granted_to, session.offset = session.expected + count - 1, -1
        session.due_at_us = now_us + (T1_US if session.retries < RETRIES_MAX else T2_US)
        body = bytes((count,)) + session.expected.to_bytes(3, "little")
        return _manage(ExtendedControl.CTS, body, session.pgn, source)

    def _offset(
        self, source: int, m: ExtendedTransportManagement, now_us: int
    ) -> list[LongOutgoing]:
        session = self._receiving.get(source)
        if session is None or session.pgn != m.pgn:
            self.counts["unexpected DPO"] += 1
            return []
        if session.offset < 0:  # one that is said again gains no time
            session.due_at_us = now_us + T1_US
        session.offset = int.from_bytes(m.body[1:4], "little")
        last = session.offset + m.body[0]
        # It may send fewer than were granted, and then waits for the next CTS.
        if session.expected <= last < session.granted_to:
            session.granted_to = last
        return []

    def _data(
        self, source: int, m: ExtendedTransportData, now_us: int
    ) -> tuple[list[LongOutgoing], ReceivedMessage | None]:
        session = self._receiving.get(source)
        if session is None or session.offset < 0:
            self.counts["unexpected data"] += 1
            return [], None
        number = session.offset + m.sequence
        if number == session.expected:
            # Others gain no time: a sender could hold the session for ever.
            session.due_at_us = now_us + T1_US
            session.data += m.body
            session.retries = 0
        if session.expected > session.packets:
            del self._receiving[source]
            self.counts["received"] += 1
            size = session.size.to_bytes(4, "little")
            end = _manage(ExtendedControl.END, size, session.pgn, source)
            whole = bytes(session.data[: session.size])
            return [end], ReceivedMessage(source, session.pgn, whole, False)
        if number >= session.granted_to:
            return self._again(source, session, number, now_us), None
        return [], None

    def _again(
        self, source: int, session: _LongReceiving, number: int, now_us: int
    ) -> list[LongOutgoing]:
        """A grant has passed: ask for the next one, or again from the first packet that was lost."""
        if session.expected <= number:
            session.retries += 1
            self.counts["asked again"] += 1
            if session.retries > RETRIES_MAX:
                del self._receiving[source]
                self.counts["lost"] += 1
                return [_abort(Abort.RETRIES, session.pgn, source)]
        return [self._grant(source, session, now_us)]

    def _overdue(self, source: int, session: _LongReceiving, now_us: int) -> list[LongOutgoing]:
        if session.retries < RETRIES_MAX:
            session.retries += 1
            self.counts["asked again"] += 1
            return [self._grant(source, session, now_us)]
        del self._receiving[source]
        self.counts["timeout"] += 1
        return [_abort(Abort.TIMEOUT, session.pgn, source)]


def refused(m: ExtendedTransportManagement, source: int) -> list[LongOutgoing]:
    """What a device without a use for long messages answers to a frame from `source`: an abort of what it
    announces, and nothing to all else.
    """
    return [_abort(Abort.RESOURCES, m.pgn, source)] if m.control == ExtendedControl.RTS else []


def _manage(control: ExtendedControl, body: bytes, pgn: int, destination: int) -> LongOutgoing:
    return LongOutgoing(ExtendedTransportManagement(control, body, pgn), destination)


def _abort(reason: Abort, pgn: int, destination: int) -> LongOutgoing:
    return _manage(ExtendedControl.ABORT, bytes((reason, 0xFF, 0xFF, 0xFF)), pgn, destination)
