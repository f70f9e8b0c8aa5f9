"""Transport protocol: messages of 9 to 1,785 bytes, for names and logs, never for state or safety.

ISO 11783-3 and SAE J1939-21 5.10: to all devices by BAM, to one by RTS and CTS. One device's end,
sans I/O. Sessions are few and bounded. Whatever another device sends causes at most a count and an
abort.
"""

from collections import Counter, deque
from collections.abc import Iterable
from enum import Enum, IntEnum
from typing import NamedTuple

from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS
from protocol.frames.network_frames import TransportData, TransportManagement
from protocol.state_machine import StateMachine, matrix
from protocol.units import MS

PACKET = 7  # bytes of the message in one TP.DT
SIZE_MIN, SIZE_MAX = 9, 1785  # 255 packets
T1_US, T2_US, T3_US, T4_US = 750 * MS, 1250 * MS, 1250 * MS, 1050 * MS
BAM_GAP_US = 50 * MS  # J1939-21: 50 to 200 ms; ISO 11783-3 would allow 10
DATA_GAP_US = 3 * MS  # between our TP.DT frames to one device: at most a fifth of the bus
GRANT_PACKETS = 16  # packets that we let a sender send before it needs the next CTS: 112 bytes
RECEIVING_MAX = 8  # sessions to us: 14 kB
SENDING_MAX = 4  # sessions of ours
RETRIES_MAX = 2  # how often a CTS requests lost packets again (J1939-21: at most two retransmits)
# CTS accepted in one session beyond one per packet: holds, and packets requested again.
WORDS_MAX = 20


class TransportControl(IntEnum):
    """The first byte of a TP.CM frame, with the numbers of the standard."""

    RTS = 16
    CTS = 17
    END = 19  # end of message acknowledged
    BAM = 32
    ABORT = 255


class Abort(IntEnum):
    """Why a session was ended, with the numbers of the standard."""

    BUSY = 1  # already in a session with you
    RESOURCES = 2
    TIMEOUT = 3
    UNEXPECTED_CTS = 4  # while we are sending
    RETRIES = 5
    UNEXPECTED_DATA = 6
    SEQUENCE = 7
    SIZE = 9


class SendingState(Enum):
    """How far a message of ours is."""

    AWAITING = "an answer of the receiver is due: a CTS, or the end of message"
    SENDING = "packets are sent, of the latest grant or of a broadcast"
    CLOSED = "the message has arrived, or was given up"


class SendingEvent(Enum):
    """What moves a message of ours from one state to another."""

    GRANTED = "a CTS asks for packets"
    ON_HOLD = "a CTS asks for none: the receiver needs time"
    GRANT_SENT = "the last packet of a grant was sent"
    DELIVERED = "the receiver has acknowledged the end, or the last packet of a broadcast was sent"
    TIMED_OUT = "no answer came in time"
    GIVEN_UP = "the receiver asks for what there is not, or asks too often"
    ABORTED = "the receiver has ended the session"


AWAITING, SENDING, CLOSED = SendingState
stay = None

# fmt: off
SENDING_TABLE = matrix(
    SendingEvent,
    # state     GRANTED  ON_HOLD   GRANT_SENT  DELIVERED  TIMED_OUT  GIVEN_UP  ABORTED
    (AWAITING,  SENDING, stay,     stay,       CLOSED,    CLOSED,    CLOSED,   CLOSED),
    (SENDING,   stay,    AWAITING, AWAITING,   CLOSED,    stay,      CLOSED,   CLOSED),
    (CLOSED,    stay,    stay,     stay,       stay,      stay,      stay,     stay),
)
# fmt: on
# What is counted when a session ends; an abort is counted as it arrives.
OUTCOME = {
    SendingEvent.DELIVERED: "sent",
    SendingEvent.TIMED_OUT: "timeout",
    SendingEvent.GIVEN_UP: "given up",
}


class OutgoingFrame(NamedTuple):
    """A TP.CM or TP.DT to send, and the address that it goes to."""

    message: TransportManagement | TransportData
    destination: int


class ReceivedMessage(NamedTuple):
    """All bytes of a message that was put together from its packets."""

    source: int
    pgn: int
    data: bytes
    broadcast: bool


class _Receiving:
    """A message being received, addressed to us or to all."""

    def __init__(self, pgn: int, size: int, packets: int, limit: int) -> None:
        self.pgn, self.size, self.packets = pgn, size, packets
        self.limit = limit  # packets per CTS that the sender allows
        self.data = bytearray()
        self.expected = 1
        self.granted_to = 0  # last packet that we have requested
        self.retries = 0
        self.due_at_us = 0


class _Sending:
    """A message being sent by us."""

    def __init__(self, pgn: int, data: bytes, destination: int) -> None:
        self.pgn, self.data, self.destination = pgn, data, destination
        self.packets = -(-len(data) // PACKET)
        self.queue: deque[int] = deque()  # sequence numbers to send
        self.words = 0  # CTS received
        # A broadcast is answered by nobody.
        start = SENDING if destination == GLOBAL_ADDRESS else AWAITING
        self.machine = StateMachine("transport session", SENDING_TABLE, start)
        self.due_at_us = 0  # of the next packet; while `AWAITING`, of the answer

    def packet(self, sequence: int) -> TransportData:
        body = self.data[PACKET * (sequence - 1) : PACKET * sequence]
        return TransportData(sequence, body.ljust(PACKET, b"\xff"))


class Transport:
    """One device's sessions, to it and from it, at most `RECEIVING_MAX` and `SENDING_MAX` at a
    time.

    It has no clock and no bus: received frames and the time go in, frames to send come out.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()  # errors and successes, by kind
        self._receiving: dict[tuple[int, bool], _Receiving] = {}  # (source, broadcast)
        self._sending: dict[int, _Sending] = {}  # destination

    @property
    def due_at_us(self) -> int | None:
        """When `on_tick` next has something to do, if nothing is received before; None: no session is
        open."""
        if not self._receiving and not self._sending:
            return None
        due = [session.due_at_us for session in self._receiving.values()]
        due += [session.due_at_us for session in self._sending.values()]
        return min(due, default=None)

    @property
    def sessions(self) -> int:
        """Number of open sessions, both ways."""
        return len(self._receiving) + len(self._sending)

    # ---------------------------------------------------------------- sending

    def send(
        self, pgn: int, data: bytes, destination: int, now_us: int
    ) -> Iterable[OutgoingFrame] | None:
        """Start to send a message; None if a session to that device is open, or too many are open.

        Returns the first frame; `on_tick` returns the others. `data` has 9 to 1,785 bytes.
        """
        assert SIZE_MIN <= len(data) <= SIZE_MAX and 0 <= pgn < 1 << 18
        if destination in self._sending or len(self._sending) >= SENDING_MAX:
            self.counts["refused"] += 1
            return None
        session = self._sending[destination] = _Sending(pgn, data, destination)
        head = len(data).to_bytes(2, "little") + bytes((session.packets,))
        if destination == GLOBAL_ADDRESS:
            session.due_at_us = now_us + BAM_GAP_US
            session.queue.extend(range(1, session.packets + 1))
            return [_manage(TransportControl.BAM, head + b"\xff", pgn, GLOBAL_ADDRESS)]
        session.due_at_us = now_us + T3_US
        return [_manage(TransportControl.RTS, head + bytes((GRANT_PACKETS,)), pgn, destination)]

    def on_tick(self, now_us: int) -> Iterable[OutgoingFrame]:
        """Send packets that are due; end sessions that have timed out."""
        out: list[OutgoingFrame] = []
        for sending in list(self._sending.values()):
            if now_us >= sending.due_at_us:
                out += self._send_on(sending, now_us)
        for key, receiving in list(self._receiving.items()):
            if now_us >= receiving.due_at_us:
                out += self._overdue(key, receiving, now_us)
        return out

    def _send_on(self, session: _Sending, now_us: int) -> Iterable[OutgoingFrame]:
        if session.machine.state is AWAITING:
            self._fire(session, SendingEvent.TIMED_OUT)
            return [_abort(Abort.TIMEOUT, session.pgn, session.destination)]
        out = [OutgoingFrame(session.packet(session.queue.popleft()), session.destination)]
        broadcast = session.destination == GLOBAL_ADDRESS
        session.due_at_us = now_us + (BAM_GAP_US if broadcast else DATA_GAP_US)
        if not session.queue and broadcast:
            self._fire(session, SendingEvent.DELIVERED)
        elif not session.queue:
            self._fire(session, SendingEvent.GRANT_SENT)
            session.due_at_us = now_us + T3_US
        return out

    def _fire(self, session: _Sending, event: SendingEvent) -> None:
        """Move a session of ours, and forget it where that ends it."""
        if session.machine.fire(event)[1] is CLOSED:
            del self._sending[session.destination]
            if event in OUTCOME:
                self.counts[OUTCOME[event]] += 1

    # ---------------------------------------------------------------- receiving

    def on_message(
        self, source: int, destination: int, m: TransportManagement | TransportData, now_us: int
    ) -> tuple[Iterable[OutgoingFrame], ReceivedMessage | None]:
        """Handle a frame from the address `source` that was sent to us or to all.

        Returns the frames to send in reply, and the message if it is complete now.
        """
        broadcast = destination == GLOBAL_ADDRESS
        if isinstance(m, TransportData):
            return self._data(source, broadcast, m, now_us)
        # All controls but BAM are between two devices, which have addresses. One from 255 would be
        # taken for an answer to our broadcast.
        if broadcast != (m.control == TransportControl.BAM) or source >= NULL_ADDRESS:
            self.counts["malformed"] += 1
            return (), None
        match m.control:
            case TransportControl.BAM | TransportControl.RTS:
                return self._announced(source, broadcast, m, now_us), None
            case TransportControl.CTS:
                return self._granted(source, m, now_us), None
            case TransportControl.END:
                return self._acknowledged(source, m), None
            case TransportControl.ABORT:
                self._aborted(source, m)
                return (), None
        self.counts["malformed"] += 1
        return (), None

    def _announced(
        self, source: int, broadcast: bool, m: TransportManagement, now_us: int
    ) -> Iterable[OutgoingFrame]:
        size, packets, limit = int.from_bytes(m.body[:2], "little"), m.body[2], m.body[3]
        if not SIZE_MIN <= size <= SIZE_MAX or packets != -(-size // PACKET):
            self.counts["malformed"] += 1
            return () if broadcast else [_abort(Abort.SIZE, m.pgn, source)]
        key = (source, broadcast)
        running = self._receiving.get(key)
        if running is not None and not broadcast and running.pgn != m.pgn:
            self.counts["refused"] += 1
            return [_abort(Abort.BUSY, m.pgn, source)]
        if running is None and len(self._receiving) >= RECEIVING_MAX:
            self.counts["refused"] += 1
            return () if broadcast else [_abort(Abort.RESOURCES, m.pgn, source)]
        session = self._receiving[key] = _Receiving(m.pgn, size, packets, limit or 1)
        if running is not None:
            self.counts["begun again"] += 1
        if broadcast:
            session.granted_to, session.due_at_us = packets, now_us + T1_US
            return ()
        return [self._grant(session, source, now_us)]

    def _grant(self, session: _Receiving, source: int, now_us: int) -> OutgoingFrame:
        count = min(session.packets - session.expected + 1, session.limit, GRANT_PACKETS)
        session.granted_to = session.expected + count - 1
        # Request again before the sender's T3 ends the session. The last request gets the time of
        # the standard.
        session.due_at_us = now_us + (T1_US if session.retries < RETRIES_MAX else T2_US)
        body = bytes((count, session.expected, 0xFF, 0xFF))
        return _manage(TransportControl.CTS, body, session.pgn, source)

    def _data(
        self, source: int, broadcast: bool, m: TransportData, now_us: int
    ) -> tuple[Iterable[OutgoingFrame], ReceivedMessage | None]:
        key = (source, broadcast)
        session = self._receiving.get(key)
        if session is None:
            self.counts["unexpected data"] += 1
            return (), None
        if m.sequence < session.expected:
            self.counts["repeated data"] += 1
            at = PACKET * (m.sequence - 1)
            if broadcast and session.data[at : at + PACKET] != m.body:
                # Another message: its BAM was lost, as the end of ours.
                del self._receiving[key]
                self.counts["lost"] += 1
            return (), None
        if m.sequence > session.granted_to or (broadcast and m.sequence != session.expected):
            del self._receiving[key]
            self.counts["lost" if broadcast else "bad sequence"] += 1
            return () if broadcast else [_abort(Abort.SEQUENCE, session.pgn, source)], None
        if m.sequence == session.expected:
            session.data += m.body
            session.expected += 1
            session.due_at_us = now_us + T1_US
        # else: a packet was lost; the rest of the grant passes, then the packet is requested again
        if session.expected > session.packets:
            return self._complete(key, session)
        if not broadcast and m.sequence == session.granted_to:
            return self._ask_on(key, session, m.sequence, now_us), None
        return (), None

    def _ask_on(
        self, key: tuple[int, bool], session: _Receiving, sequence: int, now_us: int
    ) -> Iterable[OutgoingFrame]:
        """The grant has passed: request the next packets, or again from the first that was lost."""
        if session.expected <= sequence:
            session.retries += 1
            self.counts["asked again"] += 1
            if session.retries > RETRIES_MAX:
                del self._receiving[key]
                self.counts["lost"] += 1
                return [_abort(Abort.RETRIES, session.pgn, key[0])]
        return [self._grant(session, key[0], now_us)]

    def _complete(
        self, key: tuple[int, bool], session: _Receiving
    ) -> tuple[Iterable[OutgoingFrame], ReceivedMessage]:
        del self._receiving[key]
        self.counts["received"] += 1
        source, broadcast = key
        arrived = ReceivedMessage(
            source, session.pgn, bytes(session.data[: session.size]), broadcast
        )
        if broadcast:
            return (), arrived
        body = session.size.to_bytes(2, "little") + bytes((session.packets, 0xFF))
        return [_manage(TransportControl.END, body, session.pgn, source)], arrived

    def _overdue(
        self, key: tuple[int, bool], session: _Receiving, now_us: int
    ) -> Iterable[OutgoingFrame]:
        source, broadcast = key
        # The last packets, or our CTS, were lost.
        if not broadcast and session.retries < RETRIES_MAX:
            session.retries += 1
            self.counts["asked again"] += 1
            return [self._grant(session, source, now_us)]
        del self._receiving[key]
        self.counts["timeout"] += 1
        return () if broadcast else [_abort(Abort.TIMEOUT, session.pgn, source)]

    # ---------------------------------------------------------------- answers to our sending

    def _granted(self, source: int, m: TransportManagement, now_us: int) -> Iterable[OutgoingFrame]:
        session = self._sending.get(source)
        if session is None or session.pgn != m.pgn:
            self.counts["unexpected CTS"] += 1
            return ()
        count, first = m.body[0], m.body[1]
        session.words += 1
        if session.words > session.packets + WORDS_MAX:
            return self._give_up(session, Abort.RETRIES)
        if count == 0:  # hold
            session.queue.clear()
            self._fire(session, SendingEvent.ON_HOLD)
            session.due_at_us = now_us + T4_US
            return ()
        if not 1 <= first <= session.packets:
            return self._give_up(session, Abort.SEQUENCE)
        last = min(first + count - 1, session.packets)
        session.queue = deque(range(first, last + 1))
        self._fire(session, SendingEvent.GRANTED)
        session.due_at_us = now_us
        return ()

    def _give_up(self, session: _Sending, reason: Abort) -> Iterable[OutgoingFrame]:
        self._fire(session, SendingEvent.GIVEN_UP)
        return [_abort(reason, session.pgn, session.destination)]

    def _acknowledged(self, source: int, m: TransportManagement) -> Iterable[OutgoingFrame]:
        session = self._sending.get(source)
        if session is None or session.pgn != m.pgn:
            self.counts["unexpected end"] += 1
        else:
            self._fire(session, SendingEvent.DELIVERED)
        return ()

    def _aborted(self, source: int, m: TransportManagement) -> None:
        self.counts["aborted"] += 1
        sending = self._sending.get(source)
        if sending is not None and sending.pgn == m.pgn:
            self._fire(sending, SendingEvent.ABORTED)
        receiving = self._receiving.get((source, False))
        if receiving is not None and receiving.pgn == m.pgn:
            del self._receiving[source, False]


def _manage(control: TransportControl, body: bytes, pgn: int, destination: int) -> OutgoingFrame:
    return OutgoingFrame(TransportManagement(control, body, pgn), destination)


def _abort(reason: Abort, pgn: int, destination: int) -> OutgoingFrame:
    return _manage(TransportControl.ABORT, bytes((reason, 0xFF, 0xFF, 0xFF)), pgn, destination)
