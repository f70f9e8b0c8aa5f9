"""Answers requests of other devices for parameter groups: component name, newest traces, texts.

Texts are longer than a frame and use the transport protocol: to all if the request was global, else
to the requester. This part changes neither state nor safety.
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from agent.interface.effects import Effect, Send, Trace
from agent.peer import notices
from agent.peer.network_join import NetworkJoin
from agent.peer.part import FOREVER, NOTHING, Handler, Header, Outputs, Part, StepContext
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS
from protocol.frames.network_frames import (
    Acknowledgment,
    AcknowledgmentControl,
    RepetitionRateRequest,
    Request,
    TransportData,
    TransportManagement,
)
from protocol.transport import SIZE_MAX, SIZE_MIN, OutgoingFrame, ReceivedMessage, Transport

COMPONENT_PGN = 65259  # component identification (SAE J1939-71): make*model*serial number*unit*
LOG_PGN = 0xFF1F  # our own group: the newest traces as lines
LINES_MAX = 64  # traces kept; an answer is cut at 1,785 bytes
NAMES_MAX = 256  # number of addresses
INBOX_MAX = 16  # newest received texts, for display only; no decision uses them


class PgnResponder(Part):
    """The part that answers other devices' requests for parameter groups with texts."""

    def __init__(self, component: str, known: frozenset[int], joining: NetworkJoin) -> None:
        """`known`: the groups that other parts of the peer answer."""
        self.joining = joining
        self.transport = Transport()
        self.names: dict[int, str] = {}  # address -> component identification, as received
        self.inbox: deque[ReceivedMessage] = deque(maxlen=INBOX_MAX)
        self._component, self._known = component, known
        self._speaks: dict[int, Callable[[], bool]] = {}  # groups that one peer answers for all
        self._lines: deque[str] = deque(maxlen=LINES_MAX)
        self._texts: dict[int, Callable[[StepContext], str]] = {  # PGN -> its text now
            COMPONENT_PGN: lambda _: self._component,
            LOG_PGN: self._log,
        }

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {
            Request: self._request,
            RepetitionRateRequest: self._letter,
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
        assert pgn not in self._texts and pgn not in self._known
        self._texts[pgn] = text
        if speaks is not None:
            self._speaks[pgn] = speaks

    @property
    def due_at_us(self) -> int:
        due_at_us = self.transport.due_at_us if self.joining.joined else None
        return FOREVER if due_at_us is None else due_at_us

    def note(self, now_us: int, trace: Trace) -> None:
        """Keep a trace for later requests."""
        self._lines.append(f"{now_us / 1e6:.3f} {' '.join(part for part in trace if part)}")

    def on_timer(self, ctx: StepContext) -> Outputs:
        due_at_us = self.transport.due_at_us
        if not ctx.joined or due_at_us is None or ctx.now_us < due_at_us:
            return NOTHING
        return _sends(self.transport.on_tick(ctx.now_us))

    def _request(self, ctx: StepContext, header: Header, m: Request) -> Outputs:
        answer = self._asked(ctx, header, m.pgn) if ctx.joined else NOTHING
        if m.pgn not in self._known:
            return answer
        everybody = header.destination == GLOBAL_ADDRESS
        return [*answer, notices.GroupRequested(m.pgn, everybody)]

    def _letter(
        self,
        ctx: StepContext,
        header: Header,
        m: RepetitionRateRequest | TransportManagement | TransportData,
    ) -> Outputs:
        source, destination, now_us = header.source, header.destination, ctx.now_us
        if not ctx.joined:
            return NOTHING
        if isinstance(m, RepetitionRateRequest):
            return _refused(source, destination, m.pgn)
        out, arrived = self.transport.on_message(source, destination, m, now_us)
        if arrived is not None:
            self.inbox.append(arrived)
            if arrived.pgn == COMPONENT_PGN and source < NULL_ADDRESS:
                self.names[source] = arrived.data.decode("latin-1").rstrip()
                assert len(self.names) <= NAMES_MAX
        return _sends(out)

    def _asked(self, ctx: StepContext, header: Header, pgn: int) -> Sequence[Effect]:
        source, destination = header.source, header.destination
        text = self._texts.get(pgn)
        if text is not None:
            asker = GLOBAL_ADDRESS if destination == GLOBAL_ADDRESS else source
            speaks = self._speaks.get(pgn)
            if asker == GLOBAL_ADDRESS and speaks is not None:
                if source >= NULL_ADDRESS or not speaks():
                    return ()
                asker = source
            data = text(ctx).encode("latin-1", "replace")[-SIZE_MAX:].ljust(SIZE_MIN)
            return _sends(self.transport.send(pgn, data, asker, ctx.now_us) or ())
        return () if pgn in self._known else _refused(source, destination, pgn)

    def _log(self, _: StepContext) -> str:
        return "\n".join(self._lines) or "no traces yet"


def _refused(source: int, destination: int, pgn: int) -> Sequence[Effect]:
    """Refuse a group that is not served, or a rate request: no group of ours changes its rate."""
    if destination == GLOBAL_ADDRESS:  # J1939-21: no NACK to a global request
        return ()
    return [Send(Acknowledgment(AcknowledgmentControl.NACK, 0xFF, source, pgn & 0x3FFFF))]


def _sends(out: Iterable[OutgoingFrame]) -> Sequence[Effect]:
    return [Send(o.message, o.destination) for o in out]
