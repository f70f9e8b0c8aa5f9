"""A task controller as a device on the bus: address, long messages, sessions, places and sections.

Sans I/O: frames and the time go in, frames to send come out. Cells that are whole come out of
`take_cells`, for the fleet that shares the map.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from math import isfinite
from random import Random
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from agent.implements.as_applied_map import AsAppliedMap
from agent.implements.section_control import (
    CONTROL_PERIOD_US,
    PLACES,
    STEP_MAX_US,
    TIMES,
    SectionedImplement,
)
from agent.interface.config import MS, S
from agent.interface.observation import Observation
from protocol.address import AddressClaim, AddressMessage
from protocol.device_description import ROBOT_LABEL
from protocol.extended_transport import ExtendedTransport
from protocol.frames.codec import decode, encode
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS, Identifier
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import (
    AddressClaimed,
    ExtendedTransportData,
    ExtendedTransportManagement,
    Request,
    TransportData,
    TransportManagement,
    refusal,
)
from protocol.frames.task_frames import PROCESS_DATA, ProcessData
from protocol.name import Name
from protocol.task_client import Key
from protocol.task_server import (
    CLIENT_SILENT_US,
    ClientActivated,
    ClientLost,
    ServerMessage,
    ServerOutput,
    TaskServer,
    ValueTold,
)
from protocol.transport import ReceivedMessage, Transport

ADDRESS: Final = 247  # preferred, of a task controller (ISO 11783-1)
FUNCTION: Final = 130  # task controller (ISO 11783-1), of the non-specific device class
CLAIM_PGN: Final = GROUP_OF[AddressClaimed].pgn
TOLD_EACH_MS: Final = 1000  # states of sections, beside those on change
AGAIN_US: Final = 1 * S  # a setpoint that is not obeyed is said again
SETTLES_US: Final = 500 * MS  # after a log-in its places are known
ASKS_A_PERIOD: Final = 10  # questions in a control period: an implement has hundreds of values
# With an older place all sections stay as they are: one fix of a receiver with 5 Hz is missing and the
# next one late. A receiver with fewer fixes may be half a fix late.
FIX_AGE_MAX_US: Final = 500 * MS
LATE: Final = 1.5
TOLD_LATE_US: Final = 100 * MS  # from a change of a state to its word; implements have such cycles
assert LATE * S <= STEP_MAX_US


class Fixes(Protocol):
    """What makes observations of the frames of a receiver on the bus."""

    def take(self, identifier: int, data: bytes, arrived_at_us: int) -> Observation | None:
        """The observation that a frame completes; None if it completes none."""
        ...


def controller_name(identity: int) -> Name:
    """The NAME of a task controller of ours. `identity`: 21 bits."""
    return Name(identity, function=FUNCTION, device_class=0)


class TaskController:
    """One task controller: the implements of one bus, and the map that it shares."""

    def __init__(
        self, name: Name, ground: AsAppliedMap, fixes: Fixes, hitch_ahead_m: float, rng: Random,
        now_us: int, quiet_for_us: int = CLIENT_SILENT_US,
    ) -> None:  # fmt: skip
        """`hitch_ahead_m`: from the place that `fixes` gives to the hitch; negative behind it.
        `quiet_for_us`: until its first status. In that time implements notice that the task controller
        before it has gone, and then log in at this one."""
        self.claim = AddressClaim(name, ADDRESS, rng, now_us, assigned=True)
        self.ground, self.fixes, self.hitch_ahead_m = ground, fixes, hitch_ahead_m
        self.server = TaskServer(now_us + quiet_for_us)
        self.implements: dict[int, SectionedImplement] = {}  # by address
        self.here: Observation | None = None
        self._fix_for_us = 0  # from the fix before to this one
        self._ask_all = True  # for the claims of devices that were there before, as the receiver
        self._transport, self._long = Transport(), ExtendedTransport()
        self._settles_at_us: dict[int, int] = {}  # address -> when its places are known
        self._control_at_us = now_us
        self._said_at_us: dict[int, int] = {}  # address -> time of its newest setpoints
        self._cells: list[tuple[int, int]] = []
        # Address -> cells that are whole if its sections were on, until it is heard again.
        self._held: dict[int, list[tuple[int, int]]] = {}
        self._asks: deque[ServerOutput] = deque()  # questions that wait for their turn

    @property
    def due_at_us(self) -> int:
        """When `on_timer` next has something to do."""
        due = [self.server.due_at_us, self._control_at_us]
        for part in (self.claim, self._transport, self._long):
            if part.due_at_us is not None:
                due.append(part.due_at_us)
        return min(due)

    def take_cells(self) -> Sequence[tuple[int, int]]:
        """Cells, as (row, column), that are whole since the last call: an implement that was heard after
        it had worked them was not off."""
        cells, self._cells = self._cells, []
        return cells

    def on_timer(self, now_us: int) -> list[Frame]:
        """Everything that is due: claims, statuses, packets and setpoints."""
        frames = _claims(self.claim.on_tick(now_us))
        if self._ask_all or self.claim.asks:
            self._ask_all = self.claim.asks = False
            frames.append(encode(Request(CLAIM_PGN), NULL_ADDRESS))
        address = self.claim.address
        if address is None:
            self._control_at_us = now_us + CONTROL_PERIOD_US
            return frames
        for out in self._transport.on_tick(now_us):
            frames.append(encode(out.message, address, out.destination))
        for long in self._long.on_tick(now_us):
            frames.append(encode(long.message, address, long.destination))
        frames += self._said(self.server.on_timer(now_us), now_us)
        if now_us >= self._control_at_us:
            self._control_at_us = now_us + CONTROL_PERIOD_US
            frames += self._control(now_us)
        return frames

    def on_frame(self, frame: Frame, now_us: int) -> list[Frame]:
        """Take one frame of the bus."""
        identifier = Identifier.unpack(frame.identifier)
        here = self.fixes.take(frame.identifier, frame.data, now_us)
        if here is not None:
            self._move(here)
            return []
        if identifier.destination not in (GLOBAL_ADDRESS, self.claim.candidate):
            return []
        source, message = decode(frame)
        everybody = identifier.destination == GLOBAL_ADDRESS
        if isinstance(message, AddressClaimed):
            lost: list[ServerOutput] = []
            client = self.server.clients.get(source)
            if client is not None and client.name != message.name:
                lost = self.server.forget(source)
            claims = _claims(self.claim.on_message(source, message, now_us))
            return [*claims, *self._said(lost, now_us)]
        if isinstance(message, Request) and message.pgn == CLAIM_PGN:
            return _claims(self.claim.on_request(everybody, now_us))
        address = self.claim.address
        if address is None or source >= NULL_ADDRESS:
            return []
        if isinstance(message, Request) and not everybody:
            return [encode(refusal(source, message.pgn), address)]
        if everybody and not isinstance(message, ProcessData):
            return []  # long messages to all would take the sessions of implements
        if isinstance(message, TransportManagement | TransportData):
            packets, whole = self._transport.on_message(
                source, identifier.destination, message, now_us
            )
            frames = [encode(out.message, address, out.destination) for out in packets]
            return frames + self._whole(whole, now_us)
        if isinstance(message, ExtendedTransportManagement | ExtendedTransportData):
            long_packets, whole = self._long.on_message(source, message, now_us)
            frames = [encode(out.message, address, out.destination) for out in long_packets]
            return frames + self._whole(whole, now_us)
        if isinstance(message, ProcessData):
            return self._process(source, message.body, now_us)
        return []

    # ---------------------------------------------------------------- sessions

    def _whole(self, whole: ReceivedMessage | None, now_us: int) -> list[Frame]:
        if whole is None or whole.pgn != PROCESS_DATA.pgn:
            return []
        return self._process(whole.source, whole.data, now_us)

    def _process(self, source: int, data: bytes, now_us: int) -> list[Frame]:
        name = self.claim.names.get(source)
        outputs = self.server.on_message(source, name, data, now_us)
        if name is None:  # a device that claimed before we were there: it is asked who it is
            return [encode(Request(CLAIM_PGN), self.claim.address or NULL_ADDRESS, source)]
        frames = self._said(outputs, now_us)
        self._cells += self._held.pop(source, [])
        return frames

    def _said(self, outputs: Iterable[ServerOutput], now_us: int) -> list[Frame]:
        frames: list[Frame] = []
        address = self.claim.address
        for output in outputs:
            match output:
                case ServerMessage(destination, data) if address is not None:
                    frames.append(encode(ProcessData(data), address, destination))
                case ClientActivated(source) if not self._is_robot(source):
                    self._asks += self._geometry(source, now_us)
                case ClientLost(source):
                    self.implements.pop(source, None)
                    if held := self._held.pop(source, []):
                        self.ground.take_back(held)
                    self._settles_at_us.pop(source, None)
                    self._asks = deque(
                        q
                        for q in self._asks
                        if not (isinstance(q, ServerMessage) and q.destination == source)
                    )
                case ValueTold(source, key, number) if source in self.implements:
                    self._value(source, key, number, now_us)
        return frames

    def _value(self, source: int, key: Key, number: int, now_us: int) -> None:
        """It has told a value. A section is on from the time at which it says so, and off from
        `TOLD_LATE_US` before that: rather an overlap than a gap."""
        implement = self.implements[source]
        was = implement.actual
        implement.heard(key, number)
        here = self._here(now_us)
        if here is not None and (implement.actual != was).any():
            off_at_us = max(here.sensed_at_us, now_us - TOLD_LATE_US)
            self._works(source, _moved_on(here, off_at_us), was)
            self._works(source, _moved_on(here, now_us), was & implement.actual)
        if implement.changes_places(key, number) and source not in self._settles_at_us:
            self._settles_at_us[source] = now_us + SETTLES_US

    def _is_robot(self, source: int) -> bool:
        """Whether this client is a robot of ours. It is on no hitch, so our place says nothing of its."""
        pool = self.server.clients[source].pool
        return pool is not None and pool.label.startswith(ROBOT_LABEL)

    def _geometry(self, source: int, now_us: int) -> list[ServerOutput]:
        """Ask for places, widths and times that the description leaves open."""
        client = self.server.clients[source]
        self._settles_at_us[source] = now_us + SETTLES_US
        outputs: list[ServerOutput] = []
        for element, ddi in client.pool.properties if client.pool else ():
            if ddi in PLACES or ddi in TIMES:
                outputs += self.server.ask(client, (element, ddi))
        return outputs

    def _begin(self, source: int) -> list[ServerOutput]:
        """Its places are known: switch its section control to automatic, and follow its states."""
        client = self.server.clients[source]
        assert client.pool is not None
        implement = SectionedImplement(client.pool, client.values)
        if (before := self.implements.get(source)) is not None:
            implement.recall(before)
        self.implements[source] = implement
        outputs: list[ServerOutput] = []
        for key in implement.measured():
            self._asks += self.server.measure(client, key, TOLD_EACH_MS)
        for key in (*implement.times(), *implement.told_places()):
            self._asks += self.server.measure(client, key, 0)
        for key, number in implement.automatic():
            outputs += self.server.set_value(client, key, number)
        return outputs + self._setpoints(source, np.ones(len(implement.sections), np.bool_))

    # ---------------------------------------------------------------- sections

    def _move(self, here: Observation) -> None:
        """Places without a fix are none: what was worked there is not known."""
        if not isfinite(here.position_accuracy_m):
            return
        if self.here is not None:
            self._fix_for_us = here.sensed_at_us - self.here.sensed_at_us
        self.here = here
        for source, implement in self.implements.items():
            self._works(source, here, implement.actual)

    def _works(self, source: int, here: Observation, on: NDArray[np.bool_]) -> None:
        """Its sections have worked until here. `on`: (n,), since it was at the place before."""
        cells = self.implements[source].worked(here, self.hitch_ahead_m, self.ground, on)
        self._held.setdefault(source, []).extend(cells)

    def _here(self, now_us: int) -> Observation | None:
        """The newest place, if it is not too old to switch sections by."""
        age_max_us = max(FIX_AGE_MAX_US, LATE * min(self._fix_for_us, S))
        here = self.here
        return None if here is None or now_us - here.sensed_at_us > age_max_us else here

    def _control(self, now_us: int) -> list[Frame]:
        outputs: list[ServerOutput] = []
        while self._asks and len(outputs) < ASKS_A_PERIOD:
            outputs.append(self._asks.popleft())
        for source, settles_at_us in list(self._settles_at_us.items()):
            if self._asks:
                self._settles_at_us[source] = now_us + SETTLES_US
            elif now_us >= settles_at_us:
                del self._settles_at_us[source]
                outputs += self._begin(source)
        here = self._here(now_us)
        if here is None:
            return self._said(outputs, now_us)
        for source, implement in self.implements.items():
            wanted = implement.decide(here, self.hitch_ahead_m, self.ground, now_us)
            changed = wanted != implement.wanted
            implement.wanted = wanted
            if not changed.any() and now_us - self._said_at_us.get(source, 0) >= AGAIN_US:
                changed = implement.actual != wanted
            if changed.any():
                self._said_at_us[source] = now_us
                outputs += self._setpoints(source, changed)
        return self._said(outputs, now_us)

    def _setpoints(self, source: int, of: NDArray[np.bool_]) -> list[ServerOutput]:
        client, implement = self.server.clients[source], self.implements[source]
        outputs: list[ServerOutput] = []
        for key, number in implement.setpoints(of):
            outputs += self.server.set_value(client, key, number)
        return outputs


def _moved_on(here: Observation, now_us: int) -> Observation:
    """Where it is at this time, if it has driven straight on since."""
    passed_for_s = (now_us - here.sensed_at_us) / S
    return here._replace(
        x_m=here.x_m + here.vx_m_s * passed_for_s,
        y_m=here.y_m + here.vy_m_s * passed_for_s,
        sensed_at_us=now_us,
    )


def _claims(claims: Iterable[AddressMessage]) -> list[Frame]:
    return [encode(message, source, destination) for message, source, destination in claims]
