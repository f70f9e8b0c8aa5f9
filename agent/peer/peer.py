"""The core of one robot: facts with their time go in, effects come out.

It reads no clock, socket, file or random source. `Peer` coordinates its parts and contains no rules:
each rule is in the part that it concerns (safety, membership, claims, sync, election, mission,
motion). `agent/peer/inbound.py` says what a frame means, `agent/peer/control_cycle.py` what a control
period does. The order inside a turn is fixed: safety first.
"""

from collections.abc import Mapping, Sequence
from random import Random

from agent.interface import config
from agent.interface.effects import HALT, Effect, Persist, Send, Trace
from agent.interface.identity import Identity
from agent.interface.lifecycle import IDLE, SYNCHRONIZING, TABLE, WORKING, Event, State
from agent.interface.mission import STILL, ClaimRequest, FleetView, Mission, MotionRequest
from agent.interface.motion_controller import MotionController
from agent.interface.ports import Neighbour, Observation
from agent.peer.announcements import Announcements
from agent.peer.control_cycle import ControlCycle
from agent.peer.durable_records import DurableRecords
from agent.peer.frame_origin import Origins
from agent.peer.inbound import InboundHandlers
from agent.peer.journal_recovery import LOST, sensible
from agent.peer.leader_election import OPERATOR_GATEWAY, Election, Leader
from agent.peer.member_conflicts import Conflicts
from agent.peer.member_discovery import CLAIM_REQUEST, MEMBER_PGN, MEMBER_REQUEST, MemberDiscovery
from agent.peer.membership import Membership
from agent.peer.network_join import CLAIM_PGN, NetworkJoin
from agent.peer.operator_directive import OperatorDirective
from agent.peer.pgn_responder import Letter, PgnResponder
from agent.peer.section_claims import SectionClaims
from agent.peer.self_check import SelfCheck
from agent.peer.self_health import Known
from agent.peer.sense_freshness import Senses
from agent.peer.stop_release import Release
from agent.peer.told_causes import ToldCauses
from agent.peer.unknown_stop_sources import Doubts
from agent.peer.work_admission import Admission
from agent.safety.stop_cause import StopCause
from agent.safety.stop_controller import StopController
from crdt import FieldAllocationCRDT, Phase, Progress, VectorClock
from protocol.authentication import Keyring
from protocol.frames.codec import Malformed, decode_once
from protocol.frames.fleet_frames import PLACE_UNKNOWN_M_S, Pose
from protocol.frames.frame import Frame
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS
from protocol.frames.messages import Message
from protocol.frames.network_frames import AddressClaimed, Request
from protocol.frames.safety_frames import EmergencyStop, Reason
from protocol.frames.work_frames import STOPS, StateSyncRequest, TaskClaim
from protocol.state_machine import StateMachine
from protocol.sync.map_sync import MapSync
from protocol.sync.synchronizer import Synchronizer

REQUEST_PF = 0xEA
NOTHING_ROUND, _tuple = (frozenset[tuple[float, float]](), False), tuple.__new__
NOTHING: Sequence[Effect] = ()  # an empty result guarantees that `deadline_us` is not earlier now


def sooner(due_us: int, other_us: int | None) -> int:
    return due_us if other_us is None or due_us <= other_us else other_us


def _unclaimed(questions: Sequence[Effect]) -> list[Effect]:
    """Send these requests from the null address, because we have no address yet (J1939-81)."""
    return [e._replace(source=NULL_ADDRESS) if isinstance(e, Send) else e for e in questions]


class Peer:
    def __init__(
        self,
        identity: Identity,
        rng: Random,
        now_us: int,
        recalled: Mapping[str, bytes],
        mission: Mission | None = None,
        motion: MotionController | None = None,
        keyring: Keyring | None = None,
        chart: MapSync | None = None,
    ) -> None:
        """`chart`: the fleet's map, if the mission makes one."""
        self.identity, self.slot = identity, identity.slot
        recalled = sensible(recalled)
        self.beat = config.beat_of(len(identity.members))
        self.mission, self.motion = mission, motion
        self.records = DurableRecords(recalled, identity.first_boot, rng)
        self.allocation = FieldAllocationCRDT(identity.field_hash)
        units = mission.section_units if mission else {}
        self.progress = Progress(units)
        self.admission = Admission(frozenset(units), identity.members, now_us)
        self.records.restore(self.allocation, self.progress)
        self.chart = chart
        if chart is not None:
            self.records.restore_map(chart.chart)
            chart.recalled(now_us)
        self.clock = VectorClock({self.slot: self.records.operations})
        self.lifecycle = StateMachine("lifecycle", TABLE, State.DISCONNECTED)
        self.membership = Membership(self.slot, identity.members, self.beat.silence_us, now_us)
        self.safety = StopController(
            self.slot, self.records.incarnation, identity.silence, keyring, recalled, now_us
        )
        self.joining = NetworkJoin(identity, self.records.incarnation, rng, now_us)
        self.roll_call = MemberDiscovery(self.slot)
        self.origins, self.name_call = Origins(identity.name), MemberDiscovery(self.slot, CLAIM_PGN)
        self.doubts = Doubts()
        self.conflicts = Conflicts(self)
        self.letters = PgnResponder(identity.component, frozenset((MEMBER_PGN, CLAIM_PGN)))
        self.sync = Synchronizer(self.slot, self.allocation, self.progress)
        self.election = Election(
            OPERATOR_GATEWAY, self.slot, identity.name.hash16, self.records.term, self.records.lost
        )
        self._led: Leader | None = None
        self.claims = SectionClaims(self.slot, self.allocation)
        self.voice = Announcements(self.slot, len(identity.members), self.beat, now_us)
        self.here: Observation | None = None
        self.wish: MotionRequest = STILL
        self.malformed: dict[str, int] = {}
        self.healths: dict[int, float] = {}  # slot -> health from 0 to 1, from its heartbeats
        self.releasing: Release | None = None  # release in progress by a person at this machine
        # Causes for which other members are stopped, as they report them, by slot.
        self.standstills: dict[int, ToldCauses] = {}
        self.directive, self.check = OperatorDirective(self), SelfCheck(self, now_us)
        self.senses = Senses(self)
        self.pause = None if motion is None else motion.obstacle_question()
        self._hearing, self._working = InboundHandlers(self), ControlCycle(self)
        self.beats = self._hearing.beats
        if self.records.lost:
            why = recalled.get(LOST, b"durable memory was lost").decode(errors="replace")
            self.safety.raise_cause(StopCause.BOOT_UNCONFIRMED, now_us, why)
        if identity.started and not self.safety.latched and not self.safety.held:
            self.safety.start(now_us)
        if self.safety.latched:
            self.fire(Event.EMERGENCY, "latched before the restart")

    @property
    def address(self) -> int | None:
        return self.joining.address

    @property
    def state(self) -> State:
        return self.lifecycle.state

    @property
    def leader(self) -> int | None:
        """The slot of the elected leader as this peer knows it; None if there is none."""
        leader = self.election.leader
        return None if leader is None else leader.slot

    @property
    def leads(self) -> bool:
        """Whether this peer answers for the fleet.

        For a while there may be two leaders or none; no safety or work depends on it."""
        return self.leader == self.slot

    # ---------------------------------------------------------------- facts in

    def receive(self, frame: Frame, now_us: int) -> Sequence[Effect]:
        """A frame from the bus. A frame addressed to another node is ignored."""
        identifier = frame.identifier
        if identifier >> 16 & 0xFF >= 240:
            source, message = decode_once(frame)
            return self.hear(source, message, now_us)
        destination = identifier >> 8 & 0xFF
        is_request = identifier >> 16 & 0xFF == REQUEST_PF
        if is_request and frame.data == MEMBER_REQUEST:
            self.roll_call.overheard(destination, now_us)
        elif is_request and frame.data == CLAIM_REQUEST:
            self.name_call.overheard(destination, now_us)
        if destination not in (GLOBAL_ADDRESS, self.joining.address):
            return NOTHING
        source, message = decode_once(frame)
        effects = self.hear(source, message, now_us)
        if self.joining.joined and isinstance(message, Letter):
            effects = [*effects, *self.letters.receive(source, destination, message, now_us)]
        if is_request and isinstance(message, Request):
            everybody = destination == GLOBAL_ADDRESS
            effects = [*effects, *self._asked(message.pgn, everybody, now_us)]
        return effects

    def _asked(self, pgn: int, everybody: bool, now_us: int) -> Sequence[Effect]:
        """A request for our NAME or our slot. Requests for texts go to `letters`."""
        if pgn == MEMBER_PGN:
            self.roll_call.asked(everybody)
        elif pgn == CLAIM_PGN:
            self.roll_call.answer_due |= not everybody  # the slot is requested next anyway
            return self.joining.asked(everybody, now_us)
        return NOTHING

    def hear(self, source: int, message: Message | Malformed, now_us: int) -> Sequence[Effect]:
        """A decoded frame; simulators decode once for all receivers."""
        kind = type(message)
        if kind is EmergencyStop:  # first, in every state, before anything that may fail or be slow
            return self._hearing.stop(source, message, now_us)  # type: ignore[arg-type]
        membership = self.membership
        slot = membership.slot_of.get(source)
        if slot is not None and (kind is not AddressClaimed or membership.stands(slot)):
            if membership.heard(slot, now_us):
                return [
                    *self.membership_changed(now_us),
                    *self._hearing.dispatch(source, slot, message, now_us),
                ]
            if kind is Pose:
                if message.speed_m_s >= PLACE_UNKNOWN_M_S:  # type: ignore[union-attr]
                    return self._hearing.unplaced(slot, message, now_us)  # type: ignore[arg-type]
                membership.neighbours[slot] = Neighbour(message, now_us)  # type: ignore[arg-type]
                if message.heard == self.slot:  # type: ignore[union-attr]
                    self.check.reflected_us = now_us
                if message.stopped or self.safety.latched:  # type: ignore[union-attr]
                    return self.safety.beat(slot, message.stopped, now_us)  # type: ignore[union-attr]
                return NOTHING
        return self._hearing.dispatch(source, slot, message, now_us)

    def observe(self, observation: Observation | None, now_us: int) -> None:
        """The reading of our own sensors, or None; used at the next control period."""
        self.senses.take(observation)
        if observation is None:
            return
        self.here = observation
        if self.directive.home is None:
            self.directive.home = observation.x_m, observation.y_m

    def wants_observation(self, now_us: int) -> bool:
        """Whether a control period is due, so that the runner must sense before the tick."""
        return now_us >= self.voice.next_control_us

    # ---------------------------------------------------------------- time

    @property
    def deadline_us(self) -> int:
        """When `tick` next has something to do if no frame arrives before."""
        due_us = sooner(self.voice.deadline_us, self.safety.deadline_us)
        due_us = sooner(due_us, self.doubts.deadline_us)
        due_us = sooner(sooner(due_us, self.membership.deadline_us), self.joining.deadline_us)
        if not self.joining.away:
            due_us = sooner(due_us, self.name_call.deadline_us)
        if self.joining.joined:  # without an address these parts do nothing
            due_us = sooner(due_us, self.check.deadline_us)
            due_us = sooner(due_us, self.sync.deadline_us)
            due_us = sooner(due_us, self.letters.deadline_us)
            due_us = sooner(due_us, self.roll_call.deadline_us)
            if self.chart is not None:
                due_us = sooner(due_us, self.chart.deadline_us)
            if self.lifecycle.state is IDLE and self.safety.may_move:
                due_us = sooner(due_us, self.claims.deadline_us)  # else the claim waits
        return due_us

    def tick(self, now_us: int) -> Sequence[Effect]:
        effects: list[Effect] = [*self._remember_boot(), *self.safety.tick(now_us)]
        if effects and self.safety.latched:
            effects += self.latch("a stop with a used name")
        effects += self._hearing.overdue(now_us)
        if self.membership.tick(now_us):
            effects += self.membership_changed(now_us)
        if self.joining.due(now_us):
            effects += self._join(now_us)
        if not self.joining.away:
            asked = self.name_call.tick(now_us)
            effects += asked if self.joining.address is not None else _unclaimed(asked)
        if self.joining.joined:
            effects += [Send(message) for message in self.sync.tick(now_us)]
            effects += self._synchronize(now_us)
            effects += self.voice.tell_map(self, now_us)
            effects += self.letters.tick(now_us)
            effects += self.roll_call.tick(now_us)
            effects += self._working.start_due(now_us)
        late_us = now_us - self.voice.next_control_us
        control = self.voice.control_due(now_us)
        if control or self.check.due(now_us):
            effects += self.check.look(late_us, now_us)
        if control:
            effects += self.senses.look(now_us)
            effects += self._working.control(now_us)
        effects += self.voice.speak(self, now_us)
        return effects

    def _remember_boot(self) -> Sequence[Effect]:
        """Make the incarnation durable before the first frame that could reveal it."""
        if not self.records.fresh:
            return NOTHING
        self.records.fresh = False
        return [Persist(*self.records.identity()), self.safety.remember_hold()]

    def _join(self, now_us: int) -> Sequence[Effect]:
        effects, was_joined = list[Effect](), self.joining.joined
        if self.joining.lost_address:  # handle this first: we may get a new address in this turn
            self.safety.raise_cause(StopCause.ADDRESS_LOST, now_us)
            effects += [HALT, *self.fire(Event.BUS_LOST, "lost the address")]
            self.joining.lost_address = False
        effects += self.joining.tick(now_us)
        if self.joining.joined and not was_joined:
            self.safety.clear_cause(StopCause.ADDRESS_LOST, now_us)
            # Drop any earlier binding of this address: it is ours now.
            self.membership.unbind(self.joining.address)
            self.sync.joined(now_us, self.beat.heartbeat_us)
            effects += self.roll_call.joined()
            effects += self.fire(Event.FLEET_JOINED, f"address {self.joining.address}")
            if self.safety.unconfirmed:  # our memory is lost: ask which stops hold the others
                effects.append(Send(StateSyncRequest(0, 0, STOPS, 0)))
            effects += self.membership_changed(now_us)
        return effects

    def _synchronize(self, now_us: int) -> Sequence[Effect]:
        state = self.lifecycle.state
        if self.sync.synchronizing and state in (IDLE, WORKING):
            return self.fire(Event.SYNC_RECEIVED, "digests differ")
        if not self.sync.synchronizing and state is SYNCHRONIZING:
            return self.fire(Event.SYNC_COMPLETE, "in step")  # a robot that may move resumes work
        return NOTHING

    # ---------------------------------------------------------------- operator calls

    def press(self, reason: Reason, now_us: int) -> Sequence[Effect]:
        """Emergency stop at this machine."""
        self.joining.hurry(now_us)
        pressed = self.safety.press(reason, now_us, self.membership.free)
        return [*pressed, *self.latch("pressed here")]

    def manual_reset(self, now_us: int) -> Sequence[Effect]:
        """Reset by a person at this machine. Refused while a stop is not cleared or a cause persists."""
        if self.lifecycle.state is not State.EMERGENCY_STOP or not self.safety.manual_reset(now_us):
            return [Trace("safety", "LATCHED", "MANUAL_RESET", "LATCHED", "refused")]
        held = [*self.safety.hold(now_us)]  # reset is not start
        permit = self.safety.button.release(now_us)
        if permit is not None:  # from the address that sent the stop, before it is claimed again
            held.append(Send(permit, source=self.joining.address))
        if not self.safety.holds(StopCause.BUS_OFF):  # else `bus_back` rejoins
            self.joining.rejoin(now_us)
            self.roll_call.power_up()
            self.name_call.power_up()
        return [*held, *self.fire(Event.MANUAL_RESET, "a person at this machine")]

    def start(self, now_us: int) -> Sequence[Effect]:
        """Permission to move. A latched robot refuses it, because it would start after the reset."""
        if self.safety.latched:
            return [Trace("safety", "LATCHED", "START", "LATCHED", "refused")]
        self.senses.started()
        return [*self.safety.start(now_us), Trace("safety", "HELD", "START", "STARTED", "operator")]

    def claim(
        self, section: int, bid: int, now_us: int, takeover: bool = False
    ) -> Sequence[Effect]:
        if self.lifecycle.state not in (IDLE, WORKING):
            return NOTHING
        key = self.claims.claim(ClaimRequest(section, bid, takeover), now_us)
        return NOTHING if key is None else self.announce(section, key, "claim", now_us)

    def release(self, section: int, now_us: int) -> Sequence[Effect]:
        key = self.claims.drop(section)
        effects = [] if key is None else [*self.announce(section, key, "release", now_us)]
        return [*effects, *self.idle_if_free("released")]

    def finish(self, section: int, now_us: int) -> Sequence[Effect]:
        if self.claims.current != section:
            return NOTHING
        key = self.claims.finish()
        effects = [] if key is None else [*self.announce(section, key, "done", now_us)]
        return [*effects, *self.idle_if_free("finished")]

    def give_back_all(self, now_us: int) -> list[Effect]:
        """Release every claimed, unfinished section, after announcing its covered units."""
        held = [*self.claims.contested_until_us]
        if self.claims.current is not None:
            held.append(self.claims.current)
        effects = list(self.voice.flush(self, now_us)) if held else []
        for section in held:
            effects += self.release(section, now_us)
        if held and self.mission is not None:
            self.mission.abandon()
        return effects

    def leave(self, now_us: int) -> Sequence[Effect]:
        """Announce that we leave, so that our silence stops no robot; release unfinished sections."""
        effects: list[Effect] = [HALT, *self.give_back_all(now_us)]
        if self.joining.joined:
            effects.append(Send(self.voice.farewell(self, now_us), source=self.joining.address))
        self.joining.leave()
        self.membership.forget_all(now_us)
        return [*effects, *self.fire(Event.LEFT, "leaving")]

    def bus_lost(self, now_us: int) -> Sequence[Effect]:
        """The interface reports bus-off, so none of our frames is received."""
        self.safety.raise_cause(StopCause.BUS_OFF, now_us)
        self.joining.away, self.joining.joined = True, False
        return [HALT, *self.fire(Event.BUS_LOST, "bus-off")]

    def bus_back(self, now_us: int) -> Sequence[Effect]:
        self.safety.clear_cause(StopCause.BUS_OFF, now_us)
        self.joining.rejoin(now_us)
        self.roll_call.power_up()
        self.name_call.power_up()
        return NOTHING

    def disk_failed(self, now_us: int) -> Sequence[Effect]:
        """Durable memory may have lost a record: stop for good, without a retry."""
        self.safety.raise_cause(StopCause.DISK_ERROR, now_us)
        return [HALT, *self.latch("the disk failed")]

    # ---------------------------------------------------------------- what the parts share

    def told_standing(self, slot: int, now_us: int) -> list[str]:
        """Why another member stands still and what a person can do, for each cause it reports."""
        told = self.standstills.get(slot)
        return [] if told is None else told.sentences(now_us)

    def self_known(self, now_us: int) -> Known:
        """What this robot knows about itself; the health in its heartbeats is computed from it."""
        here, senses = self.here, self.senses
        return Known(
            None if here is None else here.battery,
            None if here is None else here.health,
            self.check.controller,
            [cause for cause, _ in self.safety.causes],
            senses.age_us(now_us),
            senses.expected,
        )

    def view(self, now_us: int) -> FleetView:
        assert self.here is not None
        things, leave_out = self.pause.round if self.pause is not None else NOTHING_ROUND
        members = self.membership
        return _tuple(FleetView, (
            self.slot, now_us, self.here, self.allocation, self.progress,
            members.live, members.silent_since_us, members.neighbours, things, leave_out,
            self.safety.may_move,
        ))  # fmt: skip

    def stand_while_asking(self, asked: bool, now_us: int) -> None:
        """An open obstacle question holds the robot. `asked`: whether one was open before."""
        pause = self.pause
        if pause is None or pause.asking == asked:
            return
        if pause.asking:
            self.safety.raise_cause(StopCause.OBSTACLE_AHEAD, now_us, pause.why)
        else:
            self.safety.clear_cause(StopCause.OBSTACLE_AHEAD, now_us)

    def membership_changed(self, now_us: int) -> list[Effect]:
        """The live view changed: inform the parts that depend on it."""
        live, silent = self.membership.live, self.membership.silent
        self.sync.live(live, now_us)
        if self.chart is not None:
            self.chart.live(live)
        effects = [*self.safety.members(live, silent, now_us)]
        effects.append(
            Trace("membership", "", "VIEW", "", f"live {sorted(live)} silent {sorted(silent)}")
        )
        self.election.see(now_us)
        return effects

    def elect(self, now_us: int) -> Sequence[Effect]:
        """With our beat: persist our vote, then send it, and trace a new leader."""
        effects: list[Effect] = []
        election = self.election
        election.tick(self.membership.live, now_us)
        vote = election.speak(now_us)
        if vote is not None:
            effects += [Persist(*self.records.vote(vote.term, vote.candidate)), Send(vote)]
        leader = election.leader
        if leader != self._led and leader is not None:
            effects.append(Trace("election", "", "LEADER", f"{leader.slot}", f"term {leader.term}"))
        self._led = leader
        return effects

    def announce(self, section: int, key: int, what: str, now_us: int) -> list[Effect]:
        """Announce an operation of our own: count it, persist it, then send it."""
        self.clock.increment(self.slot)
        self.sync.changed_here(section, None, now_us)
        claim = self.allocation.entry(section)
        message = TaskClaim(
            section, claim.epoch, claim.phase, claim.bid, claim.lamport, claim.owner
        )
        return [
            *(Persist(*r) for r in self.records.operation(self.clock[self.slot], section, key)),
            Send(message),
            Trace("claim", f"S{section}", what.upper(), Phase(claim.phase).name,
                  f"epoch {claim.epoch}"),
        ]  # fmt: skip

    def latch(self, why: str) -> list[Effect]:
        return self.fire(Event.EMERGENCY, why) if self.safety.latched else []

    def idle_if_free(self, why: str) -> list[Effect]:
        done = self.claims.current is None and self.lifecycle.state is WORKING
        return self.fire(Event.TASK_COMPLETE, why) if done else []

    def fire(self, event: Event, why: str) -> list[Effect]:
        source, target = self.lifecycle.fire(event)
        told = Trace("lifecycle", source.name, event.name, target.name, why)
        return [] if source is target else [told]
