"""Stops and resets of a fleet of several segments, at one robot.

A press in this segment is sent a second time as FLEET_STOP, with a tag that every segment can
verify. So is its reset. The pressed robot sends it immediately. After a press at a panel, a tool or
an older robot, the first robot in slot order that received it sends it, and the others overhear it.
Gateways forward these frames unchanged and hold no secret. A frame with the bit `told` is not a
press: its sender holds the stop and repeats it for robots that may not know it. A press with a dot
that was cleared here brakes. It latches if it is still sent (`StopController.press_used`), as such a
press on the own bus does.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from agent.interface.config import MS
from agent.interface.effects import HALT, Effect, Send
from agent.interface.instants import FOREVER_US
from agent.peer import notices
from agent.peer.part import (
    NOTHING,
    DirectHandler,
    Handler,
    Header,
    Listener,
    Outputs,
    Part,
    StepContext,
)
from agent.peer.sender_origins import SenderOrigins
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import (
    ANSWER_SPACING_US,
    UNAUTHENTICATED_HOLD_US,
    StopController,
    said_by,
)
from crdt.stops import RemoteStopDot, StopDot, next_in_rotation
from protocol.fleet_tags import FleetTags, plain_reset, plain_stop
from protocol.frames.fleet_frames import Pose
from protocol.frames.segment_frames import FleetReset, FleetStop

TURN_US = 3 * MS  # a frame time, the blocking by another frame, and some margin
TOLD_MAX = 8  # stops of all segments sent per reply, rotating through the set
HALVES_MAX = 64  # resets of which one half was received


class FleetStops(Part):
    """The part of a robot that sends its segment's stops to all segments and obeys theirs."""

    def __init__(
        self, segment: int, safety: StopController, senders: SenderOrigins, tags: FleetTags | None
    ) -> None:
        """`segment`: ours. `safety`: holds the stops. `senders`: knows which senders are doubtful.
        `tags`: None in a fleet without keys.
        """
        self.segment, self.slot, self.safety, self.tags = segment, safety.slot, safety, tags
        self.senders = senders
        self.refused = 0  # frames without a valid tag
        self.holds_far = safety.far.latched  # a stop of another segment is not cleared
        self._pressed = safety.stops.active
        self._far = safety.far.active
        self._cleared = safety.stops.cleared
        self._stop_due_at_us: dict[StopDot, int] = {}  # stops of our segment, to send to the others
        self._reset_due_at_us: dict[RemoteStopDot, int] = {}
        # Stops of our segment that stand since before a switch of keys, to tell under the new ones.
        self._retold_due_at_us: dict[StopDot, int] = {}
        self._halves: dict[tuple[RemoteStopDot, int], int] = {}
        self._told_at_us = -ANSWER_SPACING_US
        self._told: RemoteStopDot | None = None  # last dot sent; the rotation goes on there

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {FleetReset: self._reset}

    @property
    def direct(self) -> Mapping[type[Any], DirectHandler]:
        return {FleetStop: self._stop}

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {
            notices.StopsChanged: self._changed,
            notices.StopsAsked: self._asked,
            notices.KeysChanged: self._keys_changed,
        }

    def _keys_changed(self, ctx: StepContext, notice: notices.KeysChanged) -> Outputs:
        """Segments switch one after the other; until then their stops are not believed and brake.

        A segment that has switched before us did not believe the stops that stand here, so they are told
        again.
        """
        self.tags = FleetTags(notice.keys)
        place = sorted(ctx.live).index(self.slot)
        dots = enumerate(sorted(self.safety.stops.active), place)
        self._retold_due_at_us = {dot: ctx.now_us + turn * TURN_US for turn, dot in dots}
        return self.outgoing(ctx.now_us)

    def on_timer(self, ctx: StepContext) -> Outputs:
        if self.is_behind:
            self.observe(ctx.live, ctx.now_us)
        return self.outgoing(ctx.now_us)

    def on_pose(self, source: int, slot: int | None, m: Pose, now_us: int) -> Outputs:
        """A robot that moves while we hold a stop of another segment does not know that stop."""
        return self.outgoing_repeats(now_us) if self.holds_far and not m.stopped else NOTHING

    def _stop(self, source: int, slot: int | None, m: FleetStop, now_us: int) -> Outputs:
        if slot is None:
            doubted = self.senders.doubted(source, m, now_us)
            if doubted is not None:
                return doubted
        effects = self.on_stop(m, now_us, source)
        return [*effects, notices.Latched(f"a stop from address {source}")]

    def _reset(self, ctx: StepContext, header: Header, m: FleetReset) -> Outputs:
        return self.on_reset(m, ctx.now_us)

    def _changed(self, ctx: StepContext, notice: notices.StopsChanged) -> Outputs:
        self.observe(ctx.live, ctx.now_us)
        return self.outgoing(ctx.now_us)

    def _asked(self, ctx: StepContext, notice: notices.StopsAsked) -> Outputs:
        """Asked by a gateway, by an operator's device, or by a robot that has just joined."""
        return (
            self.outgoing_repeats(ctx.now_us) if notice.from_gateway or self.holds_far else NOTHING
        )

    # ---------------------------------------------------------------- what happened here

    def observe(self, live: Iterable[int], now_us: int) -> None:
        """Schedule what the other segments have to know; call it after any press or clear.

        `live`: slots of the live members. The robot in the first place sends first.
        """
        stops = self.safety.stops
        active, cleared, far = stops.active, stops.cleared, self.safety.far.active
        if active == self._pressed and cleared == self._cleared and far == self._far:
            return
        place = sorted(live).index(self.slot)
        for dot in active - self._pressed:
            next_in_rotation = 0 if dot.slot == self.slot else place
            self._stop_due_at_us.setdefault(dot, now_us + next_in_rotation * TURN_US)
        for dot in cleared - self._cleared:
            self._stop_due_at_us.pop(dot, None)
            self._retold_due_at_us.pop(dot, None)
            self._reset_due_at_us.setdefault(self._everywhere(dot), now_us + place * TURN_US)
        for far_dot in self._far - far:  # a reset of all held stops names no dot in other segments
            self._reset_due_at_us.setdefault(far_dot, now_us + place * TURN_US)
        self._pressed, self._cleared, self._far = active, cleared, far
        self.holds_far = self.safety.far.latched

    @property
    def is_behind(self) -> bool:
        """Whether a stop was pressed or cleared since `observe`."""
        return self.safety.stops.active is not self._pressed

    @property
    def due_at_us(self) -> int:
        if not self._stop_due_at_us and not self._reset_due_at_us and not self._retold_due_at_us:
            return FOREVER_US
        due = self._stop_due_at_us, self._reset_due_at_us, self._retold_due_at_us
        return min(at_us for each in due for at_us in each.values())

    def outgoing(self, now_us: int) -> Sequence[Effect]:
        """The stops and resets that are due now, for all segments."""
        if now_us < self.due_at_us:
            return ()
        effects: list[Effect] = []
        for dot in [d for d, due_at_us in self._stop_due_at_us.items() if due_at_us <= now_us]:
            del self._stop_due_at_us[dot]
            effects.append(Send(self.stop_frame(self._everywhere(dot))))
        for dot in [d for d, due_at_us in self._retold_due_at_us.items() if due_at_us <= now_us]:
            del self._retold_due_at_us[dot]
            effects.append(Send(self.stop_frame(self._everywhere(dot))._replace(told=True)))
        for far in [d for d, due_at_us in self._reset_due_at_us.items() if due_at_us <= now_us]:
            del self._reset_due_at_us[far]
            effects += [Send(half) for half in self.reset_frames(far)]
        return effects

    def outgoing_repeats(self, now_us: int) -> Sequence[Effect]:
        """Repetitions of up to `TOLD_MAX` stops that we hold, in the form for all segments.

        At most one reply in `ANSWER_SPACING_US`; the next one goes on where this one ended.
        """
        if now_us - self._told_at_us < ANSWER_SPACING_US:
            return ()
        self._told_at_us = now_us
        held = [*map(self._everywhere, self.safety.stops.active), *self.safety.far.active]
        dots = next_in_rotation(held, self._told, TOLD_MAX)
        self._told = dots[-1] if dots else None
        return [Send(self.stop_frame(dot)._replace(told=True)) for dot in dots]

    def stop_frame(self, dot: RemoteStopDot) -> FleetStop:
        """The frame of a stop, with its tag if the fleet has keys."""
        return plain_stop(dot) if self.tags is None else self.tags.stop(dot)

    def reset_frames(self, dot: RemoteStopDot) -> tuple[FleetReset, FleetReset]:
        """Both halves of a reset, with their tags if the fleet has keys."""
        return plain_reset(dot) if self.tags is None else self.tags.reset(dot)

    def _everywhere(self, dot: StopDot) -> RemoteStopDot:
        return RemoteStopDot(*dot, self.segment)

    # ---------------------------------------------------------------- from the bus

    def on_stop(self, m: FleetStop, now_us: int, source: int | None = None) -> Sequence[Effect]:
        """A stop of any segment: brake and latch if it is genuine and new. `source`: its bus address.

        A stop without a valid tag brakes for `UNAUTHENTICATED_HOLD_US` after its last frame.
        """
        far = RemoteStopDot(m.slot, m.incarnation, m.counter, m.segment)
        near = StopDot(*far[:3]) if far.segment == self.segment else None
        is_genuine = m == self.stop_frame(far)._replace(told=m.told)
        if near is not None and is_genuine:
            self._stop_due_at_us.pop(near, None)  # another robot has sent it, so we need not
            self._retold_due_at_us.pop(near, None)
        if self._held(far, near) or (m.told and self._cleared_here(far, near)):
            return ()
        if not is_genuine:
            self.refused += 1
            why = said_by(far, source)
            self.safety.raise_cause(
                StopCause.UNAUTHENTICATED_STOP, now_us, why, UNAUTHENTICATED_HOLD_US
            )
            return [HALT]
        if self._cleared_here(far, near):
            return self.safety.press_used(far, now_us, source)
        if near is None:
            self.holds_far = True
            latched = self.safety.latch_far(far, now_us)
            self._far = self.safety.far.active
            # Repeat it once for robots that missed the first frame.
            again = Send(m._replace(told=True))
            return [HALT, again, *latched[1:]] if far in self._far else latched
        effects = self.safety.press_near(near, now_us)
        self._pressed = self.safety.stops.active
        return effects

    def _held(self, far: RemoteStopDot, near: StopDot | None) -> bool:
        active = self.safety.far.active if near is None else self.safety.stops.active
        return (far if near is None else near) in active

    def _cleared_here(self, far: RemoteStopDot, near: StopDot | None) -> bool:
        if near is None:
            return self.safety.far.is_cleared(far)
        return self.safety.stops.is_cleared(near)

    def on_reset(self, m: FleetReset, now_us: int) -> Sequence[Effect]:
        """One half of a reset; the stop is cleared when both halves were received and are
        genuine.
        """
        far = RemoteStopDot(m.slot, m.incarnation, m.counter, m.segment)
        near = StopDot(*far[:3]) if far.segment == self.segment else None
        if self._cleared_here(far, near):
            if m == self.reset_frames(far)[m.part]:  # another robot has sent it
                self._reset_due_at_us.pop(far, None)
            return ()
        self._halves.pop((far, m.part), None)
        self._halves[far, m.part] = m.half  # keep the newest only, so each guess costs a frame
        if len(self._halves) > HALVES_MAX:
            del self._halves[next(iter(self._halves))]
        said = [self._halves.get((far, part)) for part in (0, 1)]
        if None in said:
            return ()
        if said != [half.half for half in self.reset_frames(far)]:
            self.refused += 1
            return ()
        del self._halves[far, 0], self._halves[far, 1]
        if near is None:
            cleared = self.safety.clear_far(far)
            self.holds_far, self._far = self.safety.far.latched, self.safety.far.active
            return cleared
        effects = self.safety.clear_near(near, "a reset of the fleet", now_us)
        self._pressed, self._cleared = self.safety.stops.active, self.safety.stops.cleared
        self._stop_due_at_us.pop(near, None)
        self._retold_due_at_us.pop(near, None)
        return effects
