"""The periodic announcements of a peer: the beat, the heartbeat, and what is sent with them.

Beats are spread over the period by slot, so that a fleet booted together does not send all at the
same time. Deadlines advance from the previous deadline, not from now, so they do not drift.
"""

from collections.abc import Iterable
from math import atan2, hypot
from typing import TYPE_CHECKING, Final

from agent.interface.config import BEATS, CONTROL_PERIOD_US, BeaconTiming, S
from agent.interface.effects import Effect, Persist, Send, Trace, to_all
from agent.interface.lifecycle import EMERGENCY_STOP
from agent.interface.mission import CoveredUnits
from agent.peer.self_health import POOR, Reading, Source, health, readings
from agent.safety.stop_cause import StopCause, about, further
from crdt.progress import BLOCK_UNITS
from protocol.frames.fleet_frames import (
    NOBODY,
    NOWHERE_M,
    PLACE_UNKNOWN_M_S,
    Heartbeat,
    Member,
    Pose,
    Standstill,
    VectorSlice,
)  # fmt: skip
from protocol.frames.map_frames import MapPatch
from protocol.frames.work_frames import WorkProgress

if TYPE_CHECKING:
    from agent.peer.peer import Peer

MEMBER_EVERY: Final = 20  # heartbeats between two MEMBER announcements, for robots that missed one
FIRST_COUNTER, LAST_COUNTER, LEAVING_COUNTER = 251, 250, 255  # ISO 11783-7 heartbeat
# Below the resolution of POSE the course is noise, so the heading is sent instead.
STANDS_M_S: Final = 0.02
STANDSTILL_US: Final = 1 * S  # between two reported causes: 7 % of the bus if 108 robots stand
CAUSES_MAX: Final = 15  # causes reported by one robot: four bits
PROGRESS_PERIOD_US = 2 * S  # covered units are announced together, at most this often


_tuple = tuple.__new__


class Announcements:
    def __init__(self, slot: int, members: int, beat: BeaconTiming, now_us: int) -> None:
        phase_us = beat.pose_us * slot // max(members, slot + 1)
        self.slot, self.beat = slot, beat
        self.next_pose_us = now_us + phase_us
        self.next_control_us = now_us + phase_us % CONTROL_PERIOD_US
        self.beats_a_heartbeat = beat.heartbeat_us // beat.pose_us
        # A large fleet announces progress less often, because all robots share the bus.
        self.progress_us = PROGRESS_PERIOD_US * beat.pose_us // BEATS[0].pose_us
        self.next_progress_us = now_us + self.progress_us
        self.beats = slot % self.beats_a_heartbeat  # heartbeats are spread over the beats
        self.heartbeats = 0
        self.heartbeats_a_standstill = max(1, STANDSTILL_US // beat.heartbeat_us)
        self._cause = 0  # index of the cause reported next
        self.counter = FIRST_COUNTER
        self.redone = 0  # units that another robot had announced before us
        self._poor: frozenset[Source] = frozenset()  # poor sources at our last heartbeat
        self._live: frozenset[int] = frozenset()
        self._others: list[int] = []
        self.pending: dict[tuple[int, int], int] = {}  # (section, block) -> bits to announce

    @property
    def deadline_us(self) -> int:
        pose_us, control_us = self.next_pose_us, self.next_control_us
        return pose_us if pose_us < control_us else control_us

    def control_due(self, now_us: int) -> bool:
        if now_us < self.next_control_us:
            return False
        behind = (now_us - self.next_control_us) // CONTROL_PERIOD_US
        self.next_control_us += (behind + 1) * CONTROL_PERIOD_US
        return True

    def pose_due(self, now_us: int) -> bool:
        if now_us < self.next_pose_us:
            return False
        behind = (now_us - self.next_pose_us) // self.beat.pose_us
        self.next_pose_us += (behind + 1) * self.beat.pose_us
        return True

    def speak(self, peer: "Peer", now_us: int) -> Iterable[Effect]:
        if not self.pose_due(now_us) or not peer.joining.joined:
            return ()  # without an address the beat keeps its rhythm but sends nothing
        pose = self._pose(peer)
        peer.conflicts.say(pose)
        effects: list[Effect] = [to_all(pose)]
        self.beats += 1
        if self.beats % self.beats_a_heartbeat == 0:
            effects += self._heartbeat(peer, now_us)
        effects += peer.safety.say_button(peer.membership.live, now_us)
        effects += peer.elect(now_us)
        if peer.mission is not None:
            effects += [Send(message) for message in peer.mission.outgoing(now_us)]
        if peer.roll_call.answer_due:
            peer.roll_call.answer_due = False
            effects.append(Send(self.member(peer)))
        if self.pending and now_us >= self.next_progress_us:
            effects += self.flush(peer, now_us)
        return effects

    def cover(self, peer: "Peer", section: int, units: Iterable[int], now_us: int) -> list[Effect]:
        """Units were covered. They join our replica when they are announced, not before.

        A digest with unannounced entries would look like a difference to repair."""
        for unit in units:
            block, bit = divmod(unit, BLOCK_UNITS)
            self.pending[section, block] = self.pending.get((section, block), 0) | 1 << bit
        return self.flush(peer, now_us) if now_us >= self.next_progress_us else []

    def sweep(self, peer: "Peer", swept: CoveredUnits, now_us: int) -> list[Effect]:
        effects: list[Effect] = []
        for section, unit in swept.units:
            effects += self.cover(peer, section, (unit,), now_us)
        if swept.at_once and self.pending:
            effects += self.flush(peer, now_us)
        return effects

    def flush(self, peer: "Peer", now_us: int) -> list[Effect]:
        """Persist and announce the pending units, and put them into the replica under the digest."""
        effects: list[Effect] = []
        for (section, block), new in sorted(self.pending.items()):
            known = peer.progress.bits(section, block)
            self.redone += (known & new).bit_count()
            bits = known | new
            peer.progress.apply(section, block, bits)
            peer.sync.changed_here(section, block, now_us)
            effects.append(Persist(*peer.records.progress(section, block, bits)))
            effects.append(Send(WorkProgress(section, block, bits)))
        self.pending.clear()
        self.next_progress_us = now_us + self.progress_us
        return effects

    def tell_map(self, peer: "Peer", now_us: int) -> list[Effect]:
        """Announce map patches, persisted first so that our observations survive a restart."""
        effects: list[Effect] = []
        if peer.chart is not None:
            for message in peer.chart.tick(now_us):
                if isinstance(message, MapPatch):
                    effects.append(Persist(*peer.records.patch(peer.chart.chart, message.patch)))
                effects.append(Send(message))
        return effects

    def farewell(self, peer: "Peer", now_us: int) -> Heartbeat:
        return self._beat(peer, LEAVING_COUNTER, health(peer.self_known(now_us)))

    def member(self, peer: "Peer") -> Member:
        return Member(self.slot, peer.records.incarnation, peer.identity.field_hash, 0)

    def _pose(self, peer: "Peer") -> Pose:
        here, state = peer.here, peer.lifecycle.state
        stopped = state is EMERGENCY_STOP
        heard = self._reflected(peer)
        if here is None:
            return Pose(NOWHERE_M, NOWHERE_M, 0.0, PLACE_UNKNOWN_M_S, state, stopped, heard)
        x_m, y_m, heading_rad, vx_m_s, vy_m_s = here[:5]
        if not peer.senses.current:  # send the last known place, marked as unknown by its speed
            pose = x_m, y_m, heading_rad, PLACE_UNKNOWN_M_S, state, stopped, heard
            return _tuple(Pose, pose)
        speed_m_s = hypot(vx_m_s, vy_m_s)
        course_rad = atan2(vy_m_s, vx_m_s) if speed_m_s > STANDS_M_S else heading_rad
        return _tuple(Pose, (x_m, y_m, course_rad, speed_m_s, state, stopped, heard))

    def _reflected(self, peer: "Peer") -> int:
        """The member named in this beat, in rotation, so that each learns that we receive it."""
        live = peer.membership.live
        if live is not self._live:
            self._live, self._others = live, sorted(live - {self.slot})
        if not self._others:
            return NOBODY
        return self._others[(self.beats + self.slot) % len(self._others)]

    def _heartbeat(self, peer: "Peer", now_us: int) -> list[Effect]:
        self.heartbeats += 1
        found = readings(peer.self_known(now_us))
        beat = self._beat(peer, self.counter, found[0].share)
        peer.conflicts.say(beat)
        effects: list[Effect] = [Send(beat), *self._tell_poor(found)]
        self.counter = 0 if self.counter >= LAST_COUNTER else self.counter + 1
        if not peer.safety.free and self.heartbeats % self.heartbeats_a_standstill == 0:
            effects.append(Send(self._standstill(peer)))
        turn = self.heartbeats + self.slot  # so that not all robots send in the same second
        if turn % MEMBER_EVERY == 0:
            effects.append(Send(self.member(peer)))
        if turn % MEMBER_EVERY == MEMBER_EVERY // 2:
            members = len(peer.identity.members)
            slices = (members + 6) // 7
            base = 7 * (turn // MEMBER_EVERY % slices)
            counts = tuple(peer.clock[base + k] & 0xFF for k in range(7))
            effects.append(Send(VectorSlice(base, counts)))
        return effects

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

    def _standstill(self, peer: "Peer") -> Standstill:
        """The next of the causes that hold us, in rotation."""
        causes = peer.safety.causes[:CAUSES_MAX]
        place = self._cause % len(causes)
        self._cause = place + 1
        cause, detail = causes[place]
        stops, far = peer.safety.stops, peer.safety.far
        dots = len(stops.active) + stops.more + len(far.active) + far.more
        count = min(dots if cause is StopCause.STOP_DOT else further(cause, detail), 0xFFFF)
        about_whom = about(cause, detail)
        return Standstill(self.slot, cause.number, place, len(causes), about_whom, count)

    def _beat(self, peer: "Peer", counter: int, share: float) -> Heartbeat:
        state, safety = peer.lifecycle.state, peer.safety
        return Heartbeat(
            counter=counter,
            state=state,
            stopped=state is EMERGENCY_STOP,
            held=not safety.may_move,
            started=safety.started,
            leaving=counter == LEAVING_COUNTER,
            health=share,
            operations=peer.clock[self.slot] & 0xFFFF,
            digest=peer.sync.tell(),
        )
