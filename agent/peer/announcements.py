"""The periodic announcements of a peer: the beat, the heartbeat, and what is sent with them.

Beats are spread over the period by slot, so that a fleet booted together does not send all at the
same time. Deadlines advance from the previous deadline, not from now, so they do not drift.
"""

from collections.abc import Mapping
from math import atan2, hypot
from typing import Any, Final

from agent.interface.config import MEMBER_EVERY, STANDSTILL_US, BeaconTiming
from agent.interface.effects import Effect, Send, Trace
from agent.interface.identity import Identity
from agent.interface.lifecycle import EMERGENCY_STOP
from agent.peer import notices
from agent.peer.member_conflicts import Conflicts
from agent.peer.network_join import NetworkJoin
from agent.peer.part import NOTHING, Listener, Outputs, Part, StepContext
from agent.peer.self_health import POOR, HealthSource, Reading, SelfKnowledge, health, readings
from agent.peer.sense_freshness import Senses
from agent.safety.stop_cause import StopCause, about, further
from agent.safety.stop_controller import StopController
from crdt import VectorClock
from protocol.frames.fleet_frames import (
    NOBODY,
    NOWHERE_M,
    PLACE_UNKNOWN_M_S,
    Heartbeat,
    Pose,
    Standstill,
    VectorSlice,
)  # fmt: skip
from protocol.sync.synchronizer import Synchronizer

FIRST_COUNTER, LAST_COUNTER, LEAVING_COUNTER = 251, 250, 255  # ISO 11783-7 heartbeat
# Below the resolution of POSE the course is noise, so the heading is sent instead.
STANDS_M_S: Final = 0.02
CAUSES_MAX: Final = 15  # causes reported by one robot: four bits
SLICE: Final = 7  # components in one frame of the vector clock

NOWHERE: Final = NOWHERE_M, NOWHERE_M, 0.0


class Announcements(Part):
    """The part that sends our beat, our heartbeat, and what goes with them."""

    def __init__(
        self,
        identity: Identity,
        beat: BeaconTiming,
        safety: StopController,
        joining: NetworkJoin,
        conflicts: Conflicts,
        senses: Senses,
        knowledge: SelfKnowledge,
        clock: VectorClock,
        sync: Synchronizer,
        now_us: int,
    ) -> None:
        self.slot, self.beat = identity.slot, beat
        self._bases = sorted({slot // SLICE * SLICE for slot in identity.members})  # of slices
        self.safety, self.joining, self.senses, self.knowledge = safety, joining, senses, knowledge
        self.conflicts, self.clock, self.sync = conflicts, clock, sync
        self.next_at_us = now_us + first_beat_for_us(identity, beat)
        self.beats_a_heartbeat = beat.heartbeat_period_us // beat.pose_period_us
        self.beats = self.slot % self.beats_a_heartbeat  # heartbeats are spread over the beats
        self.heartbeats = 0
        self.heartbeats_a_standstill = max(1, STANDSTILL_US // beat.heartbeat_period_us)
        self._cause = 0  # index of the cause reported next
        self.counter = FIRST_COUNTER
        self.at_work = False  # our implement is down, or soon will be
        self._poor: frozenset[HealthSource] = frozenset()  # poor sources at our last heartbeat
        self._live: frozenset[int] = frozenset()
        self._others: list[int] = []

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {notices.Leaving: self._farewell, notices.ImplementMoved: self._implement}

    @property
    def due_at_us(self) -> int:
        return self.next_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        """The beacon and what is sent with it.

        Without an address the beacon keeps its rhythm but sends nothing."""
        late_for_us = ctx.now_us - self.next_at_us
        if late_for_us < 0:
            return NOTHING
        self.next_at_us += (late_for_us // self.beat.pose_period_us + 1) * self.beat.pose_period_us
        if not ctx.joined:
            return NOTHING
        pose = self.pose(ctx)
        self.conflicts.say(pose)
        outputs: list[Any] = [Send(pose)]
        self.beats += 1
        beats_heart = self.beats % self.beats_a_heartbeat == 0
        if beats_heart:
            outputs += self.heartbeat(ctx)
        outputs.append(notices.BeatDue(beats_heart))
        return outputs

    def _farewell(self, ctx: StepContext, notice: notices.Leaving) -> Outputs:
        if not ctx.joined:
            return NOTHING
        share = health(self.knowledge.known(ctx.now_us))
        return [Send(self._beat(ctx, LEAVING_COUNTER, share), source=self.joining.address)]

    def _implement(self, ctx: StepContext, notice: notices.ImplementMoved) -> Outputs:
        self.at_work = notice.at_work
        return NOTHING

    def pose(self, ctx: StepContext) -> Pose:
        """Our beacon now."""
        here, state = ctx.here, ctx.state
        stopped = state is EMERGENCY_STOP
        heard = self._reflected(ctx.live)
        if here is None or not self.senses.current:  # its last known place, marked by its speed
            known = self.senses.known
            x_m, y_m, heading_rad = NOWHERE if known is None else known[:3]
            return Pose(x_m, y_m, heading_rad, PLACE_UNKNOWN_M_S, state, stopped, heard)
        vx_m_s, vy_m_s = here.vx_m_s, here.vy_m_s
        speed_m_s = hypot(vx_m_s, vy_m_s)
        course_rad = atan2(vy_m_s, vx_m_s) if speed_m_s > STANDS_M_S else here.heading_rad
        return Pose(here.x_m, here.y_m, course_rad, speed_m_s, state, stopped, heard, self.at_work)

    def _reflected(self, live: frozenset[int]) -> int:
        """The member named in this beacon, in rotation, so that each learns that we receive it."""
        if live is not self._live:
            self._live, self._others = live, sorted(live - {self.slot})
        if not self._others:
            return NOBODY
        return self._others[(self.beats + self.slot) % len(self._others)]

    def heartbeat(self, ctx: StepContext) -> Outputs:
        """Our heartbeat, and what is sent with some of them."""
        self.heartbeats += 1
        found = readings(self.knowledge.known(ctx.now_us))
        beat = self._beat(ctx, self.counter, found[0].share)
        self.conflicts.say(beat)
        outputs: list[Any] = [Send(beat), *self._tell_poor(found)]
        self.counter = 0 if self.counter >= LAST_COUNTER else self.counter + 1
        if not self.safety.free and self.heartbeats % self.heartbeats_a_standstill == 0:
            outputs.append(Send(self._standstill()))
        turn = self.heartbeats + self.slot  # so that not all robots send in the same second
        if turn % MEMBER_EVERY == 0:
            outputs.append(Send(self.joining.announcement))
        if turn % MEMBER_EVERY == MEMBER_EVERY // 2:
            base = self._bases[turn // MEMBER_EVERY % len(self._bases)]
            counts = tuple(self.clock[base + k] & 0xFF for k in range(SLICE))
            outputs.append(Send(VectorSlice(base, counts)))
        return outputs

    def _tell_poor(self, found: list[Reading]) -> list[Effect]:
        """A trace for each source that became poor or recovered: it explains the health number."""
        poor = {reading.source: reading for reading in reversed(found) if reading.share <= POOR}
        was, self._poor = self._poor, frozenset(poor)
        new = [reading for source, reading in poor.items() if source not in was]
        effects: list[Effect] = [
            Trace("health", "", r.source.name, f"{r.share:.2f}", r.why) for r in new
        ]
        over = sorted(source.name for source in was - self._poor)
        return [*effects, *(Trace("health", name, "WELL", "", "no longer poor") for name in over)]

    def _standstill(self) -> Standstill:
        """The next of the causes that hold us, in rotation."""
        causes = self.safety.causes[:CAUSES_MAX]
        place = self._cause % len(causes)
        self._cause = place + 1
        cause, detail = causes[place]
        stops, far = self.safety.stops, self.safety.far
        dots = len(stops.active) + stops.more + len(far.active) + far.more
        count = min(dots if cause is StopCause.STOP_DOT else further(cause, detail), 0xFFFF)
        about_whom = about(cause, detail)
        return Standstill(self.slot, cause.number, place, len(causes), about_whom, count)

    def _beat(self, ctx: StepContext, counter: int, share: float) -> Heartbeat:
        return Heartbeat(
            counter=counter,
            state=ctx.state,
            stopped=ctx.state is EMERGENCY_STOP,
            held=not self.safety.may_move,
            started=self.safety.started,
            leaving=counter == LEAVING_COUNTER,
            health=share,
            operations=self.clock[self.slot] & 0xFFFF,
            digest=self.sync.outgoing_digest(),
            keyed=self.safety.keyed,
        )


def first_beat_for_us(identity: Identity, beat: BeaconTiming) -> int:
    """When the first beacon of this slot is sent after its boot, so that beacons are spread."""
    return beat.pose_period_us * identity.slot // max(len(identity.members), identity.slot + 1)
