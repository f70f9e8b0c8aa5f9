"""Answers requests of other devices for parameter groups: who we are, our faults, newest traces.

Texts are longer than a frame and use the transport protocol: to all if the request was global, else
to the requester. This part changes neither state nor safety.
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from agent.interface.effects import Effect, Send, Trace
from agent.interface.identity import Identity
from agent.interface.instants import FOREVER_US
from agent.peer import notices
from agent.peer.diagnostics import (
    CLEAR_PREVIOUS_PGN,
    COMMANDED_ADDRESS_PGN,
    COMPONENT_PGN,
    MINIMUM,
    PROTOCOLS,
    FaultMemory,
    root_causes,
    texts,
)
from agent.peer.network_join import NetworkJoin
from agent.peer.part import NOTHING, Handler, Header, Outputs, Part, StepContext
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from protocol.frames.diagnostic_frames import DIAGNOSTIC_PROTOCOLS, DM1, DM2, FUNCTIONALITIES
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS
from protocol.frames.messages import Message
from protocol.frames.network_frames import (
    AcknowledgmentControl,
    Request,
    Request2,
    TransportData,
    TransportManagement,
    acknowledgment,
)
from protocol.transport import (
    SIZE_MAX,
    SIZE_MIN,
    OutgoingFrame,
    ReceivedMessage,
    Transport,
    TransportControl,
)

LOG_PGN = 0xFF1F  # our own group: the newest traces as lines
LINES_MAX = 64  # traces kept; an answer is cut at 1,785 bytes
WAITING_MAX = 8  # answers that wait for a message to the same address; more requests get none
NAMES_MAX = 256  # number of addresses
UNREAD = frozenset((DM1.pgn,))  # faults of others: no session is opened for them
COMMANDED_SIZE = 9  # bytes: a NAME and an address
# What a group contains now: a frame, or the data of a longer message.
Content = Callable[[StepContext], "Message | bytes"]
INBOX_MAX = 16  # newest received texts, for display only; no decision uses them


class PgnResponder(Part):
    """The part that answers other devices' requests for parameter groups."""

    def __init__(
        self,
        identity: Identity,
        known: frozenset[int],
        joining: NetworkJoin,
        safety: StopController,
    ) -> None:
        """`known`: the groups that other parts of the peer answer."""
        self.joining = joining
        self.transport = Transport()
        self.names: dict[int, str] = {}  # address -> component identification, as received
        self.inbox: deque[ReceivedMessage] = deque(maxlen=INBOX_MAX)
        self.safety, self.faults = safety, FaultMemory()
        self._known, self._name = known, identity.name.pack()
        self._speaks: dict[int, Callable[[], bool]] = {}  # groups that one peer answers for all
        self._waiting: deque[tuple[int, bytes, int]] = deque()  # group, data, destination
        self._lines: deque[str] = deque(maxlen=LINES_MAX)
        self._contents: dict[int, Content] = {  # by PGN
            LOG_PGN: lambda _: _data(self._log()),
            DM1.pgn: lambda _: self.faults.active_faults(self._active()),
            DM2.pgn: lambda _: self._previous(),
            DIAGNOSTIC_PROTOCOLS.pgn: lambda _: PROTOCOLS,
            FUNCTIONALITIES.pgn: lambda _: MINIMUM,
        }
        for pgn, text in texts(identity).items():
            self._contents[pgn] = _constant(_data(text))

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {
            Request: self._request,
            Request2: self._request2,
            TransportManagement: self._letter,
            TransportData: self._letter,
        }

    def answer(
        self,
        pgn: int,
        text: Callable[[StepContext], str],
        speaks: Callable[[], bool] | None = None,
    ) -> None:
        """Register a text for a group; `text` is called with the context of the request.

        `speaks`: whether this peer answers global requests. It answers only to the requester, because
        global answers of thirty peers would fill the bus for seconds.
        """
        assert pgn not in self._contents and pgn not in self._known
        self._contents[pgn] = lambda ctx: _data(text(ctx))
        if speaks is not None:
            self._speaks[pgn] = speaks

    @property
    def due_at_us(self) -> int:
        due_at_us = self.transport.due_at_us if self.joining.joined else None
        return FOREVER_US if due_at_us is None else due_at_us

    def note(self, now_us: int, trace: Trace) -> None:
        """Keep a trace for later requests."""
        self._lines.append(f"{now_us / 1e6:.3f} {' '.join(part for part in trace if part)}")

    def on_timer(self, ctx: StepContext) -> Outputs:
        due_at_us = self.transport.due_at_us
        if not ctx.joined or due_at_us is None or ctx.now_us < due_at_us:
            return NOTHING
        outputs = list(_sends(self.transport.on_tick(ctx.now_us)))
        return [*outputs, *self._resumed(ctx.now_us)]

    def _resumed(self, now_us: int) -> list[Effect]:
        """Messages that waited for one that has ended."""
        outputs: list[Effect] = []
        waiting = list(self._waiting)
        self._waiting.clear()
        for pgn, content, destination in waiting:
            outputs += self.sends(pgn, content, destination, now_us)
        return outputs

    def _request(self, ctx: StepContext, header: Header, m: Request) -> Outputs:
        answer = self._asked(ctx, header, m.pgn) if ctx.joined else NOTHING
        if m.pgn not in self._known:
            return answer
        everybody = header.destination == GLOBAL_ADDRESS
        return [*answer, notices.GroupRequested(m.pgn, everybody)]

    def _request2(self, ctx: StepContext, header: Header, m: Request2) -> Outputs:
        if m.transfer == 1:
            return _refused(header.source, header.destination, m.pgn) if ctx.joined else NOTHING
        return self._request(ctx, header, Request(m.pgn))

    def sends(
        self, pgn: int, content: Message | bytes, destination: int, now_us: int
    ) -> Sequence[Effect]:
        """Send the content of a group. A longer message waits for one to that address before it."""
        single = not isinstance(content, bytes)
        if pgn in self._contents and self._waiting:  # what still waits is older than this
            self._waiting = deque(
                (group, data, to)
                for group, data, to in self._waiting
                if group != pgn or not (single or to == destination)
            )
        if not isinstance(content, bytes):
            return [Send(content)]
        first = self.transport.send(pgn, content, destination, now_us)
        if first is None and len(self._waiting) < WAITING_MAX:
            self._waiting.append((pgn, content, destination))
        return _sends(first or ())

    def _letter(
        self,
        ctx: StepContext,
        header: Header,
        m: TransportManagement | TransportData,
    ) -> Outputs:
        source, destination, now_us = header.source, header.destination, ctx.now_us
        if not ctx.joined:
            return NOTHING
        if isinstance(m, TransportManagement) and m.pgn in UNREAD and _announces(m):
            return NOTHING
        sessions = self.transport.sessions
        out, arrived = self.transport.on_message(source, destination, m, now_us)
        sent = list(_sends(out))
        if self._waiting and self.transport.sessions < sessions:
            sent += self._resumed(now_us)
        if arrived is not None:
            self.inbox.append(arrived)
            if arrived.pgn == COMPONENT_PGN and source < NULL_ADDRESS:
                self.names[source] = arrived.data.decode("latin-1").rstrip()
                assert len(self.names) <= NAMES_MAX
            if arrived.pgn == COMMANDED_ADDRESS_PGN and len(arrived.data) == COMMANDED_SIZE:
                name = int.from_bytes(arrived.data[:8], "little")
                if name == self._name:
                    return [*sent, notices.AddressCommanded(arrived.data[8])]
        return sent

    def _asked(self, ctx: StepContext, header: Header, pgn: int) -> Sequence[Effect]:
        source, destination = header.source, header.destination
        content = self._contents.get(pgn)
        if content is not None:
            # A device without an address cannot be answered alone (SAE J1939-21).
            alone = destination != GLOBAL_ADDRESS and source < NULL_ADDRESS
            asker = source if alone else GLOBAL_ADDRESS
            speaks = self._speaks.get(pgn)
            if asker == GLOBAL_ADDRESS and speaks is not None:
                if source >= NULL_ADDRESS or not speaks():
                    return ()
                asker = source
            answer = content(ctx)
            return self.sends(pgn, answer, asker, ctx.now_us)
        if pgn == CLEAR_PREVIOUS_PGN:
            self._active()
            self.faults.forget()
            return acknowledged(AcknowledgmentControl.ACK, source, destination, pgn)
        return () if pgn in self._known else _refused(source, destination, pgn)

    def _active(self) -> tuple[StopCause, ...]:
        """The active faults, which are counted by this."""
        active = root_causes(self.safety.causes)
        self.faults.see(active)
        return active

    def _previous(self) -> Message | bytes:
        self._active()
        return self.faults.previous_faults()

    def _log(self) -> str:
        return "\n".join(self._lines) or "no traces yet"


def _announces(m: TransportManagement) -> bool:
    return m.control == TransportControl.BAM


def _data(text: str) -> bytes:
    """The data of a text; of one that is too long the end."""
    return text.encode("latin-1", "replace")[-SIZE_MAX:].ljust(SIZE_MIN)


def _constant(data: bytes) -> Content:
    return lambda _: data


def _refused(source: int, destination: int, pgn: int) -> Sequence[Effect]:
    """Refuse a group that is not served."""
    return acknowledged(AcknowledgmentControl.NACK, source, destination, pgn)


def acknowledged(
    control: AcknowledgmentControl, source: int, destination: int, pgn: int
) -> Sequence[Effect]:
    """The answer to `source`, which has sent something about a group to `destination`."""
    if destination == GLOBAL_ADDRESS:  # J1939-21: no acknowledgment of a global request
        return ()
    return [Send(acknowledgment(control, source, pgn))]


def _sends(out: Iterable[OutgoingFrame]) -> Sequence[Effect]:
    return [Send(o.message, o.destination) for o in out]
