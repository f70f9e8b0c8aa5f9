"""The core of one robot: facts with their time go in, effects come out.

It reads no clock, socket, file or random source. `step` is the only entrance. `Peer` contains no
rules: it passes each message to one part by the routing table (`agent/peer/routing.py`), each timer
to all parts in their order, and each notice to the parts that listen to it. Safety comes first.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from agent.interface.effects import Drive, Effect, Persist, Send, Trace
from agent.interface.instants import FOREVER_US
from agent.interface.lifecycle import State
from agent.interface.mission import FleetView, MotionRequest
from agent.interface.observation import Observation
from agent.peer import notices
from agent.peer.inputs import Heard, Input, Received, Timer
from agent.peer.part import (
    NOTHING,
    DirectHandler,
    DirectListener,
    Handler,
    Header,
    Listener,
    Output,
    Outputs,
    Part,
    Senders,
    StepContext,
)
from agent.peer.peer_parts import PeerParts
from agent.peer.routing import ROUTES, Routes
from agent.peer.self_health import Known
from protocol.frames.codec import Malformed, decode_once
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed
from protocol.frames.segment_frames import gateway_slot

REQUEST_PF = 0x0EA  # with both data pages: another page is another group
URGENT, DEVICE, GATEWAY = Senders.URGENT, Senders.DEVICE, Senders.GATEWAY
MEMBER, MEMBER_ONLY = Senders.MEMBER, Senders.MEMBER_ONLY
EFFECTS = frozenset((Send, Drive, Persist, Trace))


class BoundRoute(NamedTuple):
    """A row of the routing table with the methods of this peer's parts."""

    senders: Senders
    handler: Handler | None
    direct: DirectHandler | None  # instead of `handler`, without a snapshot


class Segments(NamedTuple):
    """What a fleet of several segments adds to a peer."""

    parts: Sequence[Part]
    routes: Routes
    carried: frozenset[type[Any]]  # messages that a gateway brings from other segments
    overhears: Mapping[type[Any], DirectHandler]  # called after the route's own handler


ONE_SEGMENT = Segments((), {}, frozenset(), {})


class Peer:
    """One robot: inputs go in by `step`, effects come out in the order in which they must be
    performed.

    It routes messages and notices to its parts and decides nothing itself. The attributes that are
    not methods are for runners, recorders and displays to read.
    """

    def __init__(self, parts: PeerParts, segments: Segments = ONE_SEGMENT) -> None:
        self.named = parts
        self.parts: tuple[Part, ...] = (*parts.in_order, *segments.parts)
        self.slot, self.identity = parts.identity.slot, parts.identity
        self.safety, self.joining, self.lifecycle = parts.safety, parts.joining, parts.lifecycle
        self.membership, self.senses, self.senders = parts.membership, parts.senses, parts.senders
        self.letters = parts.letters
        # What runners, recorders and displays read.
        self.mission, self.motion = parts.mission, parts.motion
        self.allocation, self.progress, self.clock = parts.allocation, parts.progress, parts.clock
        self.claims, self.sync, self.records = parts.claims, parts.sync, parts.records
        self.check, self.reports, self.stop_release = parts.check, parts.reports, parts.release
        self.departure, self.proven = parts.departure, parts.proven
        self._carried, self._overhears = segments.carried, segments.overhears
        self._slot_of = parts.membership.slot_of
        self.reached_at_us = 0  # the time of the newest step
        self._held = parts.proven.kinds  # messages that must be proven; none without keys
        self._routes = bound(self.parts, {**ROUTES, **segments.routes})
        self._listeners: dict[type[Any], list[Listener]] = {}
        self._direct: dict[type[Any], list[DirectListener]] = {}
        for part in self.parts:
            for kind, listener in part.listens.items():
                self._listeners.setdefault(kind, []).append(listener)
            for kind, direct in part.listens_direct.items():
                self._direct.setdefault(kind, []).append(direct)
        assert self._listeners.keys().isdisjoint(self._direct), "listeners would lose their order"
        self._timed = [p for p in self.parts if type(p).on_timer is not Part.on_timer]
        self._due = [p for p in self.parts if type(p).due_at_us is not Part.due_at_us]

    # ---------------------------------------------------------------- the entrance

    def step(self, fact: Input, now_us: int) -> Sequence[Effect]:
        """Everything that this fact causes, in the order in which it must be performed.

        An empty result of a received beacon guarantees that `due_at_us` is not earlier now."""
        kind = type(fact)
        outputs: Outputs = NOTHING
        effects: list[Effect] = []
        if now_us < self.reached_at_us:
            self._deliver(notices.ClockWentBack(), effects, now_us)
        self.reached_at_us = now_us
        if kind is Received:
            outputs = self._received(fact.frame, now_us)  # type: ignore[union-attr]
        elif kind is Timer:
            self._timer(effects, now_us)
        elif kind is Heard:
            heard: Heard = fact  # type: ignore[assignment]
            outputs = self._heard(heard.source, heard.destination, heard.message, now_us)
        else:
            self._deliver(fact, effects, now_us)
        if outputs:
            self._settle(outputs, effects, now_us)
        return self.proven.cover(effects, now_us) if effects and self._held else effects

    @property
    def due_at_us(self) -> int:
        """When the next `Timer` has something to do if no other input comes before."""
        due_at_us = FOREVER_US
        for part in self._due:
            part_at_us = part.due_at_us
            if part_at_us < due_at_us:
                due_at_us = part_at_us
        return due_at_us

    def wants_observation(self, now_us: int) -> bool:
        """Whether a control period is due, so that `Sensed` must come before the `Timer`."""
        return now_us >= self.named.control.next_at_us

    # ---------------------------------------------------------------- messages

    def _received(self, frame: Frame, now_us: int) -> Outputs:
        identifier = frame.identifier
        if identifier >> 16 & 0xFF >= 240:
            source, message = decode_once(frame)
            return self._heard(source, GLOBAL_ADDRESS, message, now_us)
        destination = identifier >> 8 & 0xFF
        overheard: Outputs = NOTHING
        if identifier >> 16 & 0x3FF == REQUEST_PF:
            request = notices.RequestOverheard(frame.data, destination)
            overheard = self._settled([request], now_us)
        if destination not in (GLOBAL_ADDRESS, self.joining.address):
            return overheard  # it is addressed to another node
        source, message = decode_once(frame)
        return self._heard(source, destination, message, now_us)

    def _heard(
        self,
        source: int,
        destination: int,
        message: Message | Malformed,
        now_us: int,
        proven: bool = False,
    ) -> Outputs:
        kind = type(message)
        route = self._routes.get(kind)
        slot = self._slot_of.get(source)
        if route is not None and route.senders is URGENT:
            # First, in every state, before anything that may fail or be slow.
            return route.direct(source, slot, message, now_us)  # type: ignore[misc]
        if self._carried and slot is None and kind is not AddressClaimed:
            number = gateway_slot(source)
            if number is not None:
                return self._from_gateway(source, number, destination, message, now_us, proven)
        if kind in self._held and not proven and source != self.joining.address:
            held = self.proven.hold(source, slot, message, now_us)
            if held is not None:
                return held
        returned: Outputs = NOTHING
        membership = self.membership
        # An address claim of a moving member is no sign of life: it has been off the bus.
        alive = slot is not None and (kind is not AddressClaimed or membership.stands(slot))
        if alive and membership.heard(slot, now_us):  # type: ignore[arg-type]
            returned = self._settled(membership.changed(), now_us)
        if route is None:
            return returned
        if slot is not None and route.direct is not None:
            outputs = route.direct(source, slot, message, now_us)
        else:
            outputs = self._routed(route, source, slot, destination, message, now_us)
        if self._overhears:
            overhear = self._overhears.get(kind)
            if overhear is not None:
                outputs = [*outputs, *overhear(source, slot, message, now_us)]
        return [*returned, *outputs] if returned else outputs

    def _routed(
        self,
        route: BoundRoute,
        source: int,
        slot: int | None,
        destination: int,
        message: Message | Malformed,
        now_us: int,
    ) -> Outputs:
        senders = route.senders
        if slot is None and senders is not DEVICE:
            if senders is GATEWAY:
                return NOTHING
            refused = self.senders.refused(source, message, now_us)
            if refused is not None:
                return refused
            if senders is MEMBER:
                return [notices.StrangerHeard(source)]
            if senders is MEMBER_ONLY:
                return NOTHING
        if route.direct is not None:
            return route.direct(source, slot, message, now_us)
        header = Header(source, slot, destination)
        return route.handler(self.context(now_us), header, message)  # type: ignore[misc]

    def _from_gateway(
        self,
        source: int,
        number: int,
        destination: int,
        message: Message | Malformed,
        now_us: int,
        proven: bool,
    ) -> Outputs:
        """A gateway is not a member: its silence stops no robot, and it claims no section."""
        kind = type(message)
        route = self._routes.get(kind)
        if route is None or route.handler is None:
            return NOTHING
        senders = route.senders
        if senders is not DEVICE:
            refused = self.senders.foreign_group(source, message, now_us)
            if refused is not None:
                return refused
            if senders is not GATEWAY and kind not in self._carried:
                return NOTHING
            held = None if proven else self.proven.hold_carried(source, message, now_us)
            if held is not None:
                return held
        header = Header(source, number, destination, True)
        return route.handler(self.context(now_us), header, message)

    # ---------------------------------------------------------------- time

    def _timer(self, effects: list[Effect], now_us: int) -> None:
        ctx: StepContext | None = None
        for part in self._timed:
            if ctx is None:
                ctx = self.context(now_us)
            outputs = part.on_timer(ctx)
            if outputs:
                self._settle(outputs, effects, now_us)
                ctx = None  # it may be out of date

    # ---------------------------------------------------------------- notices

    def _settled(self, outputs: Outputs, now_us: int) -> list[Effect]:
        effects: list[Effect] = []
        self._settle(outputs, effects, now_us)
        return effects

    def _settle(self, outputs: Outputs, effects: list[Effect], now_us: int) -> None:
        """Deliver notices, depth first, until only effects are left, in their order."""
        for output in outputs:
            kind = type(output)
            if kind in EFFECTS:
                effects.append(output)
                if kind is Trace:
                    self.letters.note(now_us, output)
                elif kind is Drive:
                    self.named.control.commanded(output)
            elif kind is notices.HeardAgain:
                again = self._heard(
                    output.source, GLOBAL_ADDRESS, output.message, output.at_us, True
                )
                self._settle(again, effects, output.at_us)
            else:
                self._deliver(output, effects, now_us)

    def _deliver(self, notice: Output, effects: list[Effect], now_us: int) -> None:
        kind = type(notice)
        direct = self._direct.get(kind)
        if direct is not None:
            for tell in direct:
                outputs = tell(notice, now_us)
                if outputs:
                    self._settle(outputs, effects, now_us)
            return
        listeners = self._listeners.get(kind)
        if listeners is None:
            return
        ctx: StepContext | None = None
        for listener in listeners:
            if ctx is None:
                ctx = self.context(now_us)
            outputs = listener(ctx, notice)
            if outputs:
                self._settle(outputs, effects, now_us)
                ctx = None  # it may be out of date

    def context(self, now_us: int) -> StepContext:
        """The snapshot that parts get in a step at this time."""
        safety = self.safety
        return StepContext(
            self.slot, now_us, self.lifecycle.machine.state, safety.free or safety.may_move,
            self.senses.here, self.membership.live, self.joining.joined,
        )  # fmt: skip

    # ---------------------------------------------------------------- for readers

    @property
    def address(self) -> int | None:
        """Our source address on the bus; None while we have none."""
        return self.joining.address

    @property
    def state(self) -> State:
        """The lifecycle state of this peer."""
        return self.lifecycle.state

    @property
    def here(self) -> Observation | None:
        """The newest reading of its own sensors."""
        return self.senses.here

    @property
    def wish(self) -> MotionRequest:
        """What its mission wants, before right of way and the gate."""
        return self.named.control.wish

    @property
    def leader(self) -> int | None:
        """The slot of the elected leader as this peer knows it; None if there is none."""
        return self.named.votes.leader

    @property
    def leads(self) -> bool:
        """Whether this peer answers for the fleet.

        For a while there may be two leaders or none; no safety or work depends on it."""
        return self.leader == self.slot

    @property
    def redone(self) -> int:
        """Units that it covered and that another robot had announced before."""
        return self.named.progress_told.redone

    def self_known(self, now_us: int) -> Known:
        """What it knows about itself; the health in its heartbeats is computed from it."""
        return self.named.knowledge.known(now_us)

    def view(self, now_us: int) -> FleetView:
        """What its mission decides by. It must have sensed before."""
        return self.named.views.view(now_us)


def bound(parts: Sequence[Part], routes: Routes) -> dict[type[Any], BoundRoute]:
    """The routing table with the methods of these parts. Every handler must have a route."""
    of = {type(part): part for part in parts}
    handled = {kind for part in parts for kind in (*part.handles, *part.direct)}
    assert handled == routes.keys(), f"routes and handlers differ: {handled ^ routes.keys()}"
    return {
        kind: BoundRoute(senders, of[part].handles.get(kind), of[part].direct.get(kind))
        for kind, (part, senders) in routes.items()
    }
